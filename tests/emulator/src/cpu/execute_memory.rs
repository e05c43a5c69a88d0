//! Execution: loads and stores, and the way of an access to the bus or to the private peripherals.

use super::instruction::{Address, Reg, SReg};
use super::{Cpu, Fault, Size, Trap};
use crate::board::Board;

/// Address, and what write-back puts into the base register.
type Located = (u32, Option<(Reg, u32)>);

impl Cpu {
    /// A data access by an instruction that allows unaligned addresses: a write of `value`, or a read. Returns what was read.
    #[inline(always)]
    pub(super) fn access(
        &mut self,
        board: &mut Board,
        address: u32,
        size: Size,
        value: Option<u32>,
    ) -> Result<u32, Fault> {
        if address & (size.bytes() - 1) != 0 {
            return self.access_unaligned(board, address, size, value);
        }
        self.access_aligned(board, address, size, value)
    }

    #[inline(always)]
    fn access_aligned(
        &mut self,
        board: &mut Board,
        address: u32,
        size: Size,
        value: Option<u32>,
    ) -> Result<u32, Fault> {
        if is_private(address) {
            return Ok(match value {
                None => self.read_private(address, size),
                Some(value) => {
                    self.write_private(address, size, value);
                    0
                }
            });
        }
        if self.is_guarded(address) {
            return Err(Fault::Guarded { address });
        }
        self.wait(board, address);
        let done = match value {
            None => board.read(address, size),
            Some(value) => board.write(address, size, value).map(|()| 0),
        };
        done.map_err(|_| Fault::DataBus { address })
    }

    /// Whether the MPU forbids data accesses to `address`; not at the priorities of HardFault and NMI.
    #[inline(always)]
    pub(super) fn is_guarded(&self, address: u32) -> bool {
        self.system.mpu.guards(address) && self.execution_priority() >= 0
    }

    /// Wait states of a data access; flash has a cache.
    #[inline(always)]
    fn wait(&mut self, board: &mut Board, address: u32) {
        if address >= 0x2000_0000 || self.accelerator.misses_data(address) {
            self.cycles += board.wait_states(address);
        }
    }

    /// Aligned accesses one byte each, lowest address first. They cost a cycle more, and fault on device memory.
    #[cold]
    #[inline(never)]
    fn access_unaligned(
        &mut self,
        board: &mut Board,
        address: u32,
        size: Size,
        value: Option<u32>,
    ) -> Result<u32, Fault> {
        let device = matches!(address, 0x4000_0000..0x6000_0000 | 0xa000_0000..);
        if device {
            return Err(Fault::Unaligned { address });
        }
        self.cycles += 1;
        let mut read = 0;
        for byte in 0..size.bytes() {
            let part = value.map(|value| value >> (8 * byte) & 255);
            read |= self.access_aligned(board, address.wrapping_add(byte), Size::Byte, part)? << (8 * byte);
        }
        Ok(read)
    }

    /// A word of a multiple, dual or exclusive access, which must be aligned.
    #[inline(always)]
    fn access_word(&mut self, board: &mut Board, address: u32, value: Option<u32>) -> Result<u32, Fault> {
        must_be_aligned(address, Size::Word)?;
        self.access_aligned(board, address, Size::Word, value)
    }

    #[inline(always)]
    fn locate(&self, address: Address) -> Located {
        match address {
            Address::Offset { rn, offset } => {
                let base = if rn == Reg::PC { self.get(rn) & !3 } else { self.get(rn) };
                (base.wrapping_add_signed(offset.into()), None)
            }
            Address::PreIndexed { rn, offset } => {
                let moved = self.get(rn).wrapping_add_signed(offset.into());
                (moved, Some((rn, moved)))
            }
            Address::PostIndexed { rn, offset } => {
                let base = self.get(rn);
                (base, Some((rn, base.wrapping_add_signed(offset.into()))))
            }
            Address::Register { rn, rm, shift } => (self.get(rn).wrapping_add(self.get(rm) << shift), None),
        }
    }

    #[inline(always)]
    fn write_back(&mut self, moved: Option<(Reg, u32)>) {
        if let Some((rn, value)) = moved {
            self.set(rn, value);
        }
    }

    #[inline(always)]
    pub(super) fn load(
        &mut self,
        board: &mut Board,
        size: Size,
        signed: bool,
        rt: Reg,
        address: Address,
    ) -> Result<(), Trap> {
        let (address, moved) = self.locate(address);
        let raw = self.access(board, address, size, None)?;
        let value = match (size, signed) {
            (Size::Half, true) => raw as i16 as u32,
            (Size::Byte, true) => raw as i8 as u32,
            _ => raw,
        };
        self.write_back(moved);
        if rt == Reg::PC {
            return self.branch_exchange(value);
        }
        self.set(rt, value);
        Ok(())
    }

    #[inline(always)]
    pub(super) fn store(&mut self, board: &mut Board, size: Size, rt: Reg, address: Address) -> Result<(), Trap> {
        let (address, moved) = self.locate(address);
        let value = self.get(rt);
        let value = match size {
            Size::Byte => value & 0xff,
            Size::Half => value & 0xffff,
            Size::Word => value,
        };
        self.access(board, address, size, Some(value))?;
        self.write_back(moved);
        Ok(())
    }

    pub(super) fn move_pair(
        &mut self,
        board: &mut Board,
        is_load: bool,
        registers: [Reg; 2],
        address: Address,
    ) -> Result<(), Trap> {
        let (address, moved) = self.locate(address);
        let mut words = registers.map(|register| self.get(register));
        for (word, offset) in words.iter_mut().zip([0, 4]) {
            *word = self.access_word(board, address.wrapping_add(offset), (!is_load).then_some(*word))?;
        }
        self.write_back(moved);
        if is_load {
            self.set(registers[0], words[0]);
            self.set(registers[1], words[1]);
        }
        Ok(())
    }

    pub(super) fn move_multiple(
        &mut self,
        board: &mut Board,
        is_load: bool,
        registers: u16,
        address: Address,
    ) -> Result<(), Trap> {
        let (mut address, moved) = self.locate(address);
        let mut words = [0; 16];
        for (number, word) in (0..).zip(&mut words) {
            if registers >> number & 1 != 0 {
                let value = (!is_load).then(|| self.get(Reg(number)));
                *word = self.access_word(board, address, value)?;
                address = address.wrapping_add(4);
            }
        }
        self.write_back(moved);
        if !is_load {
            return Ok(());
        }
        for number in 0..15 {
            if registers >> number & 1 != 0 {
                self.set(Reg(number), words[usize::from(number)]);
            }
        }
        if registers & Reg::PC.bit() != 0 {
            return self.branch_exchange(words[15]);
        }
        Ok(())
    }

    #[inline(always)]
    pub(super) fn move_float(
        &mut self,
        board: &mut Board,
        is_load: bool,
        first: SReg,
        count: u8,
        address: Address,
    ) -> Result<(), Trap> {
        self.check_float()?;
        let (base, moved) = self.locate(address);
        if !is_load {
            self.await_float(&[first]);
        }
        for n in 0..count {
            let register = SReg(first.0 + n);
            let value = (!is_load).then(|| self.float.get(register));
            let word = self.access_word(board, base.wrapping_add(4 * u32::from(n)), value)?;
            if is_load {
                self.float.set(register, word);
            }
        }
        self.write_back(moved);
        Ok(())
    }

    pub(super) fn load_exclusive(
        &mut self,
        board: &mut Board,
        size: Size,
        rt: Reg,
        rn: Reg,
        offset: u16,
    ) -> Result<(), Trap> {
        let address = self.get(rn).wrapping_add(offset.into());
        must_be_aligned(address, size)?;
        let value = self.access_aligned(board, address, size, None)?;
        self.exclusive = true;
        self.set(rt, value);
        Ok(())
    }

    pub(super) fn store_exclusive(
        &mut self,
        board: &mut Board,
        size: Size,
        rd: Reg,
        rt: Reg,
        rn: Reg,
        offset: u16,
    ) -> Result<(), Trap> {
        let address = self.get(rn).wrapping_add(offset.into());
        must_be_aligned(address, size)?;
        let allowed = std::mem::replace(&mut self.exclusive, false);
        if allowed {
            let mask = u32::MAX >> (32 - 8 * size.bytes());
            self.access_aligned(board, address, size, Some(self.get(rt) & mask))?;
        }
        self.set(rd, (!allowed).into());
        Ok(())
    }
}

/// The private peripheral board.
#[inline(always)]
fn is_private(address: u32) -> bool {
    address >> 20 == 0xe00
}

fn must_be_aligned(address: u32, size: Size) -> Result<(), Fault> {
    if address & (size.bytes() - 1) == 0 { Ok(()) } else { Err(Fault::Unaligned { address }) }
}
