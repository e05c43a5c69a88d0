//! Where both sides put what they say.

use core::sync::atomic::{AtomicU32, Ordering};

use crate::numbers::Numbers;

/// Name of the [`Mailbox`] among the image's symbols.
pub const MAILBOX_SYMBOL: &str = "SLITPOSE_STOPWATCH_MAILBOX";

/// Numbers a mailbox holds: a cell with the longest profile table is 162.
pub const SLOTS: usize = 168;

/// Who is to act.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// The image has not started yet: memory holds anything.
    Unknown,
    /// The host: the mailbox holds an answer.
    Waiting,
    /// The image: the mailbox holds a request.
    Asked,
    /// The image, whose stopwatch runs.
    Timing,
    /// Nobody: the image has panicked.
    Panicked,
}

impl State {
    /// As the mailbox holds it. Unlikely numbers, for memory that holds anything.
    pub fn word(self) -> u32 {
        match self {
            Self::Unknown => 0,
            Self::Waiting => 0x5707_0001,
            Self::Asked => 0x5707_0002,
            Self::Timing => 0x5707_0003,
            Self::Panicked => 0x5707_0004,
        }
    }

    /// What `word` means.
    pub fn of_word(word: u32) -> Self {
        let known = [Self::Waiting, Self::Asked, Self::Timing, Self::Panicked];
        known.into_iter().find(|state| state.word() == word).unwrap_or(Self::Unknown)
    }
}

/// The mailbox: a word of state, a count of numbers, then their words, low one first.
#[derive(Debug)]
#[repr(C)]
pub struct Mailbox {
    state: AtomicU32,
    count: AtomicU32,
    words: [[AtomicU32; 2]; SLOTS],
}

impl Mailbox {
    /// Where the count is, in bytes from the start.
    pub const COUNT_OFFSET: u32 = 4;
    /// Where the numbers are.
    pub const NUMBERS_OFFSET: u32 = 8;

    /// Without anything in it.
    pub const fn new() -> Self {
        Self {
            state: AtomicU32::new(0),
            count: AtomicU32::new(0),
            words: [const { [const { AtomicU32::new(0) }; 2] }; SLOTS],
        }
    }

    /// Who is to act.
    pub fn state(&self) -> State {
        State::of_word(self.state.load(Ordering::Acquire))
    }

    /// Tells who is to act.
    pub fn set_state(&self, state: State) {
        self.state.store(state.word(), Ordering::Release);
    }

    /// What the other side has said.
    pub fn read(&self) -> Numbers {
        let count = (self.count.load(Ordering::Relaxed) as usize).min(SLOTS);
        self.words[..count]
            .iter()
            .map(|words| {
                let [low, high] = [0, 1].map(|half| u64::from(words[half].load(Ordering::Relaxed)));
                f64::from_bits(low | high << 32)
            })
            .collect()
    }

    /// Says something.
    pub fn write(&self, numbers: &Numbers) {
        self.count.store(numbers.len() as u32, Ordering::Relaxed);
        for (words, number) in self.words.iter().zip(numbers.iter()) {
            let bits = number.to_bits();
            words[0].store(bits as u32, Ordering::Relaxed);
            words[1].store((bits >> 32) as u32, Ordering::Relaxed);
        }
    }
}

impl Default for Mailbox {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::mem::offset_of;

    #[test]
    fn the_layout_is_as_told() {
        assert_eq!(offset_of!(Mailbox, state), 0);
        assert_eq!(offset_of!(Mailbox, count), Mailbox::COUNT_OFFSET as usize);
        assert_eq!(offset_of!(Mailbox, words), Mailbox::NUMBERS_OFFSET as usize);
    }

    #[test]
    fn what_is_written_is_read() {
        let mailbox = Mailbox::new();
        let numbers: Numbers = [1.5, -0.0, f64::INFINITY, 1e-300].into_iter().collect();
        mailbox.write(&numbers);
        mailbox.set_state(State::Asked);
        assert_eq!((mailbox.read(), mailbox.state()), (numbers, State::Asked));
    }
}
