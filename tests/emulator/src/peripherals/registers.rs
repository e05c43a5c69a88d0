//! Registers that hold what is written, as tables.

use std::ops::{Index, IndexMut};

use super::Effects;

/// Offset, value after reset, and the bits that a write sets or clears; the others stay as after reset. With no such bits a
/// register reads as after reset; that it is written no model knows, unless the unit's own code answers for it.
pub type Register = (u32, u32, u32);

pub const ALL: u32 = u32::MAX;

#[derive(Clone, Debug)]
pub struct Bank {
    table: &'static [Register],
    words: [u32; 46],
}

impl Bank {
    pub fn new(table: &'static [Register]) -> Self {
        let mut bank = Self { table, words: [0; 46] };
        bank.reset();
        bank
    }

    pub fn reset(&mut self) {
        for &(offset, reset, _) in self.table {
            self[offset] = reset;
        }
    }

    /// Bits that a write to the register keeps, if there is one.
    fn keeps(&self, offset: u32) -> Option<u32> {
        self.table.iter().find(|register| register.0 == offset).map(|register| register.2)
    }

    pub fn read(&self, offset: u32, effects: &mut Effects) -> u32 {
        if self.keeps(offset).is_none() {
            effects.unmodelled();
            return 0;
        }
        self[offset]
    }

    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match self.keeps(offset) {
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
