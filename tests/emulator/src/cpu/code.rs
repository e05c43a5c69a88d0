//! Decoded instructions by address.

use super::cycles::{Timing, timing};
use super::decode::{decode, is_wide};
use super::instruction::Instruction;
use super::{Bus, Fault};

/// Flash of the STM32G474RE, bytes; it shows at 0 and at 0x0800_0000.
const FLASH_BYTES: u32 = 512 * 1024;
/// The address bit in which both views of flash differ.
const VIEW: u32 = 0x0800_0000;

/// An instruction with what the core needs to know before it executes it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Decoded {
    pub instruction: Instruction,
    pub timing: Timing,
    /// Length: 2 or 4, or 0 for "not decoded yet".
    pub bytes: u8,
}

/// One entry per halfword of flash. Code elsewhere (RAM can change) is decoded each time.
#[derive(Clone, Debug)]
pub(super) struct Code {
    decoded: Vec<Decoded>,
}

impl Code {
    pub fn new() -> Self {
        let instruction = Instruction::Undefined;
        let none = Decoded { instruction, timing: timing(&instruction), bytes: 0 };
        Self { decoded: vec![none; FLASH_BYTES as usize / 2] }
    }

    /// The instruction at `address`, if it has been decoded.
    #[inline(always)]
    pub fn get(&self, address: u32) -> Option<Decoded> {
        let offset = address & !VIEW;
        self.decoded.get(offset as usize / 2).copied().filter(|decoded| decoded.bytes != 0)
    }

    /// Fetches and decodes the instruction at `address`, and remembers it if it is in flash.
    #[inline(never)]
    pub fn load(&mut self, bus: &mut impl Bus, address: u32) -> Result<Decoded, Fault> {
        let mut fetch = |address: u32| {
            if never_executable(address) {
                return Err(Fault::FetchNeverExecute { address });
            }
            bus.fetch(address).map_err(|_| Fault::FetchBus { address })
        };
        let first = fetch(address)?;
        let (second, bytes) = if is_wide(first) { (fetch(address.wrapping_add(2))?, 4) } else { (0, 2) };
        let instruction = decode(first, second);
        let decoded = Decoded { instruction, timing: timing(&instruction), bytes };
        if let Some(slot) = self.decoded.get_mut((address & !VIEW) as usize / 2) {
            *slot = decoded;
        }
        Ok(decoded)
    }
}

/// Regions of the system address map without code (DDI0403, B3.1).
fn never_executable(address: u32) -> bool {
    matches!(address, 0x4000_0000..0x6000_0000 | 0xa000_0000..)
}

const _: () = assert!(size_of::<Decoded>() <= 20, "decoded flash takes 5 MB and no more");
