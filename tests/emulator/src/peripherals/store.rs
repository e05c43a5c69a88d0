//! Registers that only keep what is written to them, where nothing else matters to a program.

use std::collections::BTreeMap;

/// Words by offset; zero until written.
#[derive(Clone, Debug, Default)]
pub struct Registers {
    words: BTreeMap<u32, u32>,
}

impl Registers {
    /// All zero.
    pub fn new() -> Self {
        Self::default()
    }

    /// Value of a register.
    pub fn read(&self, offset: u32) -> u32 {
        self.words.get(&offset).copied().unwrap_or(0)
    }

    /// Keeps the value of a register.
    pub fn write(&mut self, offset: u32, value: u32) {
        self.words.insert(offset, value);
    }
}
