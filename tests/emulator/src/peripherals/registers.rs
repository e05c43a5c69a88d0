//! Register blocks as tables: offset, value after reset and the bits that a write keeps, by ST's names.

use std::ops::{Index, IndexMut};

use super::Effects;

/// A register that holds what is written.
#[derive(Debug)]
pub struct Register {
    /// ST's name.
    #[cfg(test)]
    pub name: &'static str,
    pub offset: u32,
    pub reset: u32,
    /// Bits that a write sets or clears; the others stay as after reset.
    pub keeps: u32,
}

/// Declares the offsets of a unit's registers, and `REGISTERS`, the table of them. Those without `keeps` read as after reset;
/// that they are written no model knows, unless the unit's own code answers for it.
macro_rules! registers {
    ($($(#[$doc:meta])* $name:ident = $offset:literal $(, reset $reset:expr)? $(, keeps $keeps:expr)?;)+) => {
        $($(#[$doc])* pub const $name: u32 = $offset;)+
        pub const REGISTERS: &[$crate::peripherals::registers::Register] =
            &[$($crate::peripherals::registers::Register {
                #[cfg(test)]
                name: stringify!($name),
                offset: $name,
                reset: [$($reset,)? 0][0],
                keeps: [$($keeps,)? 0][0],
            }),+];
    };
}
pub(super) use registers;

pub const ALL: u32 = u32::MAX;

#[derive(Clone, Debug)]
pub struct Bank {
    table: &'static [Register],
    words: [u32; 40],
}

impl Bank {
    pub fn new(table: &'static [Register]) -> Self {
        let mut bank = Self { table, words: [0; 40] };
        bank.reset();
        bank
    }

    pub fn reset(&mut self) {
        for register in self.table {
            self[register.offset] = register.reset;
        }
    }

    fn find(&self, offset: u32) -> Option<&'static Register> {
        self.table.iter().find(|register| register.offset == offset)
    }

    pub fn read(&self, offset: u32, effects: &mut Effects) -> u32 {
        if self.find(offset).is_none() {
            effects.unmodelled();
            return 0;
        }
        self[offset]
    }

    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match self.find(offset).map(|register| register.keeps) {
            None | Some(0) => effects.unmodelled(),
            Some(keeps) => self[offset] = self[offset] & !keeps | value & keeps,
        }
    }
}

impl Index<u32> for Bank {
    type Output = u32;

    #[inline]
    fn index(&self, offset: u32) -> &u32 {
        &self.words[(offset / 4) as usize]
    }
}

impl IndexMut<u32> for Bank {
    #[inline]
    fn index_mut(&mut self, offset: u32) -> &mut u32 {
        &mut self.words[(offset / 4) as usize]
    }
}

/// Asserts that a table has the offsets of ST's structure.
#[cfg(test)]
pub fn assert_offsets<'a>(structure: &str, table: impl IntoIterator<Item = &'a Register>) {
    for Register { name, offset, .. } in table {
        assert_eq!(*offset, crate::facts::bits(&format!("{structure}.{name}")), "{structure}.{name}");
    }
}
