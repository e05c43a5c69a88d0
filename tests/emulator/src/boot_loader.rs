//! The boot loader in the MCU's system memory, as a USB DFU device (AN3156, "USB DFU protocol used in the STM32 bootloader";
//! USB DFU 1.1): what the core does once it has jumped there, which is not executed.
//!
//! Modelled: set address, erase of a page, write, read, leave. The supply may fail at any operation on the flash memory.

use crate::cpu::Size;
use crate::machine::Machine;
use crate::memory::{DOUBLE_WORD_BYTES, FLASH_BASE, FLASH_BYTES, PAGE_BYTES};
use crate::st;

/// A transfer's most bytes (AN3156, "wTransferSize").
const TRANSFER_BYTES: usize = 2_048;

const DNLOAD: u8 = 1;
const UPLOAD: u8 = 2;
const GETSTATUS: u8 = 3;
const CLRSTATUS: u8 = 4;
const ABORT: u8 = 6;

const ERR_ERASE: u8 = 4;
const ERR_PROG: u8 = 6;
const ERR_ADDRESS: u8 = 8;
const ERR_STALLED: u8 = 15;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Idle = 2,
    DownloadSync = 3,
    Busy = 4,
    DownloadIdle = 5,
    ManifestSync = 6,
    UploadIdle = 9,
    Error = 10,
}

/// The request was refused, or the device has no supply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stall;

#[derive(Debug)]
pub struct BootLoader<'m> {
    machine: &'m mut Machine,
    state: State,
    status: u8,
    address: u32,
    /// Block and data of a download that the next GETSTATUS carries out.
    pending: Option<(u16, Vec<u8>)>,
    /// Double words programmed and pages erased.
    pub operations: u64,
    /// The supply fails in this operation, after this share of its time.
    pub cut: Option<(u64, f64)>,
}

impl<'m> BootLoader<'m> {
    /// The boot loader of `machine`, which has stopped there.
    pub fn new(machine: &'m mut Machine) -> Self {
        machine.cpu.forget_code();
        Self { machine, state: State::Idle, status: 0, address: FLASH_BASE, pending: None, operations: 0, cut: None }
    }

    /// A control request with data to the device.
    ///
    /// # Errors
    /// [`Stall`] if it does not fit the state, or without supply.
    pub fn control_out(&mut self, request: u8, value: u16, data: &[u8]) -> Result<(), Stall> {
        self.check_supply()?;
        match (request, self.state) {
            (DNLOAD, State::Idle | State::DownloadIdle) if data.len() <= TRANSFER_BYTES => {
                self.pending = Some((value, data.to_vec()));
                self.state = if data.is_empty() { State::ManifestSync } else { State::DownloadSync };
                Ok(())
            }
            (CLRSTATUS, State::Error) => {
                (self.state, self.status) = (State::Idle, 0);
                Ok(())
            }
            (ABORT, State::Idle | State::DownloadIdle | State::UploadIdle) => {
                self.state = State::Idle;
                Ok(())
            }
            _ => Err(self.stall()),
        }
    }

    /// A control request for `bytes` bytes.
    ///
    /// # Errors
    /// [`Stall`] if it does not fit the state, or without supply.
    pub fn control_in(&mut self, request: u8, value: u16, bytes: u16) -> Result<Vec<u8>, Stall> {
        self.check_supply()?;
        match (request, self.state) {
            (GETSTATUS, _) => {
                self.go_on()?;
                // A poll timeout of zero: the model takes no time.
                Ok(vec![self.status, 0, 0, 0, self.state as u8, 0])
            }
            (UPLOAD, State::Idle | State::UploadIdle) if value >= 2 && usize::from(bytes) <= TRANSFER_BYTES => {
                self.state = State::UploadIdle;
                let start = self.place(value).ok_or(Stall)?;
                self.machine
                    .board
                    .flash
                    .array
                    .bytes()
                    .get(start..start + usize::from(bytes))
                    .map(<[u8]>::to_vec)
                    .ok_or(Stall)
            }
            _ => Err(self.stall()),
        }
    }

    fn check_supply(&self) -> Result<(), Stall> {
        self.cut.is_none_or(|(at, _)| self.operations <= at).then_some(()).ok_or(Stall)
    }

    fn stall(&mut self) -> Stall {
        (self.state, self.status) = (State::Error, ERR_STALLED);
        Stall
    }

    /// Offset in flash of a block.
    fn place(&self, block: u16) -> Option<usize> {
        let offset = self.address.checked_sub(FLASH_BASE)? as usize + usize::from(block - 2) * TRANSFER_BYTES;
        (offset < FLASH_BYTES).then_some(offset)
    }

    /// What a GETSTATUS has done: the first one carries a download out, the second one ends it.
    fn go_on(&mut self) -> Result<(), Stall> {
        match self.state {
            State::DownloadSync => {
                self.state = State::Busy;
                let (block, data) = self.pending.take().expect("a download is pending");
                self.status = self.carry_out(block, &data)?;
            }
            State::Busy => self.state = if self.status == 0 { State::DownloadIdle } else { State::Error },
            State::ManifestSync => self.leave(),
            _ => {}
        }
        Ok(())
    }

    /// Gives the status.
    fn carry_out(&mut self, block: u16, data: &[u8]) -> Result<u8, Stall> {
        let target =
            |data: &[u8]| data.get(1..5).map(|bytes| u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]));
        match (block, data.first(), target(data)) {
            (0, Some(0x21), Some(address)) => self.address = address,
            (0, Some(0x41), Some(address)) => {
                let Some(offset) = address.checked_sub(FLASH_BASE).filter(|&offset| (offset as usize) < FLASH_BYTES)
                else {
                    return Ok(ERR_ERASE);
                };
                let page = offset as usize / PAGE_BYTES * PAGE_BYTES;
                self.operate(|machine, complete| machine.board.flash.array.erase(page, PAGE_BYTES, complete))?;
            }
            (2.., ..) => return self.program(block, data),
            _ => return Ok(ERR_STALLED),
        }
        Ok(0)
    }

    fn program(&mut self, block: u16, data: &[u8]) -> Result<u8, Stall> {
        let Some(start) = self
            .place(block)
            .filter(|start| start.is_multiple_of(DOUBLE_WORD_BYTES) && data.len().is_multiple_of(DOUBLE_WORD_BYTES))
        else {
            return Ok(ERR_ADDRESS);
        };
        for (index, word) in data.chunks_exact(DOUBLE_WORD_BYTES).enumerate() {
            let offset = start + index * DOUBLE_WORD_BYTES;
            let word = u64::from_le_bytes(word.try_into().expect("a double word"));
            // RM0440: only zeros are programmed over what is not erased.
            if self.machine.board.flash.array.double_word(offset) != u64::MAX && word != 0 {
                return Ok(ERR_PROG);
            }
            self.operate(|machine, complete| machine.board.flash.array.program(offset, word, complete))?;
        }
        Ok(0)
    }

    /// One operation, whole or cut short.
    fn operate(&mut self, operation: impl FnOnce(&mut Machine, f64)) -> Result<(), Stall> {
        let complete = self.cut.filter(|&(at, _)| at == self.operations).map_or(1.0, |(_, share)| share);
        operation(self.machine, complete);
        self.operations += 1;
        self.check_supply()
    }

    /// Jumps to the program at the address, with the clocks and the peripherals that the boot loader has used.
    fn leave(&mut self) {
        let offset = self.address.saturating_sub(FLASH_BASE) as usize;
        let Machine { board, cpu, .. } = &mut *self.machine;
        let clocks = st::RCC::BASE + st::RCC::APB1ENR1;
        let enabled = board.read(clocks, Size::Word).expect("a register");
        board.write(clocks, Size::Word, enabled | st::RCC::APB1ENR1_USBEN).expect("a register");
        let vectors = board.flash.array.double_word(offset);
        let mut state = cpu.state();
        (state.r[13], state.r[15]) = (vectors as u32, (vectors >> 32) as u32);
        cpu.set_state(&state);
    }
}
