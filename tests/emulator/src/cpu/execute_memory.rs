//! Execution: loads and stores, and the way of an access to the bus or to the private peripherals.

use super::instruction::{Address, Reg, SReg};
use super::{Bus, Cpu, Fault, Size, Trap};

/// Address, and what write-back puts into the base register.
type Located = (u32, Option<(Reg, u32)>);

impl Cpu {
    /// A data read by an instruction that allows unaligned addresses.
    #[inline(always)]
    pub(super) fn read<B: Bus>(&mut self, bus: &mut B, address: u32, size: Size) -> Result<u32, Fault> {
        if address & (size.bytes() - 1) != 0 {
            return self.read_unaligned(bus, address, size);
        }
        self.read_aligned(bus, address, size)
    }

    #[inline(always)]
    fn read_aligned<B: Bus>(&mut self, bus: &mut B, address: u32, size: Size) -> Result<u32, Fault> {
        if is_private(address) {
            return Ok(self.read_private(address, size));
        }
        if self.is_guarded(address) {
            return Err(Fault::Guarded { address });
        }
        self.wait(bus, address);
        bus.read(address, size).map_err(|_| Fault::DataBus { address })
    }

    /// A data write by an instruction that allows unaligned addresses.
    #[inline(always)]
    pub(super) fn write<B: Bus>(&mut self, bus: &mut B, address: u32, size: Size, value: u32) -> Result<(), Fault> {
        if address & (size.bytes() - 1) != 0 {
            return self.write_unaligned(bus, address, size, value);
        }
        self.write_aligned(bus, address, size, value)
    }

    #[inline(always)]
    fn write_aligned<B: Bus>(&mut self, bus: &mut B, address: u32, size: Size, value: u32) -> Result<(), Fault> {
        if is_private(address) {
            self.write_private(address, size, value);
            return Ok(());
        }
        if self.is_guarded(address) {
            return Err(Fault::Guarded { address });
        }
        self.wait(bus, address);
        bus.write(address, size, value).map_err(|_| Fault::DataBus { address })
    }

    /// Whether the MPU forbids data accesses to `address`; not at the priorities of HardFault and NMI.
    #[inline(always)]
    pub(super) fn is_guarded(&self, address: u32) -> bool {
        self.system.mpu.guards(address) && self.execution_priority() >= 0
    }

    /// Wait states of a data access; flash has a cache.
    #[inline(always)]
    fn wait<B: Bus>(&mut self, bus: &mut B, address: u32) {
        if address >= 0x2000_0000 || self.accelerator.misses_data(address) {
            self.cycles += bus.wait_states(address);
        }
    }

    /// Aligned accesses one byte each, lowest address first.
    #[cold]
    #[inline(never)]
    fn read_unaligned<B: Bus>(&mut self, bus: &mut B, address: u32, size: Size) -> Result<u32, Fault> {
        self.check_unaligned(address)?;
        let mut value = 0;
        for byte in 0..size.bytes() {
            value |= self.read_aligned(bus, address.wrapping_add(byte), Size::Byte)? << (8 * byte);
        }
        Ok(value)
    }

    #[cold]
    #[inline(never)]
    fn write_unaligned<B: Bus>(&mut self, bus: &mut B, address: u32, size: Size, value: u32) -> Result<(), Fault> {
        self.check_unaligned(address)?;
        for byte in 0..size.bytes() {
            self.write_aligned(bus, address.wrapping_add(byte), Size::Byte, value >> (8 * byte) & 255)?;
        }
        Ok(())
    }

    /// Unaligned accesses cost a cycle more, and fault on device memory.
    fn check_unaligned(&mut self, address: u32) -> Result<(), Fault> {
        let device = matches!(address, 0x4000_0000..0x6000_0000 | 0xa000_0000..);
        if device {
            return Err(Fault::Unaligned { address });
        }
        self.cycles += 1;
        Ok(())
    }

    /// A word of a multiple, dual or exclusive access, which must be aligned.
    #[inline(always)]
    pub(super) fn read_word<B: Bus>(&mut self, bus: &mut B, address: u32) -> Result<u32, Fault> {
        must_be_aligned(address, Size::Word)?;
        self.read_aligned(bus, address, Size::Word)
    }

    /// See [`Self::read_word`].
    #[inline(always)]
    pub(super) fn write_word<B: Bus>(&mut self, bus: &mut B, address: u32, value: u32) -> Result<(), Fault> {
        must_be_aligned(address, Size::Word)?;
        self.write_aligned(bus, address, Size::Word, value)
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
    pub(super) fn load<B: Bus>(
        &mut self,
        bus: &mut B,
        size: Size,
        signed: bool,
        rt: Reg,
        address: Address,
    ) -> Result<(), Trap> {
        let (address, moved) = self.locate(address);
        let raw = self.read(bus, address, size)?;
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
    pub(super) fn store<B: Bus>(&mut self, bus: &mut B, size: Size, rt: Reg, address: Address) -> Result<(), Trap> {
        let (address, moved) = self.locate(address);
        let value = self.get(rt);
        let value = match size {
            Size::Byte => value & 0xff,
            Size::Half => value & 0xffff,
            Size::Word => value,
        };
        self.write(bus, address, size, value)?;
        self.write_back(moved);
        Ok(())
    }

    pub(super) fn load_pair<B: Bus>(&mut self, bus: &mut B, rt: Reg, rt2: Reg, address: Address) -> Result<(), Trap> {
        let (address, moved) = self.locate(address);
        let low = self.read_word(bus, address)?;
        let high = self.read_word(bus, address.wrapping_add(4))?;
        self.write_back(moved);
        self.set(rt, low);
        self.set(rt2, high);
        Ok(())
    }

    pub(super) fn store_pair<B: Bus>(&mut self, bus: &mut B, rt: Reg, rt2: Reg, address: Address) -> Result<(), Trap> {
        let (address, moved) = self.locate(address);
        self.write_word(bus, address, self.get(rt))?;
        self.write_word(bus, address.wrapping_add(4), self.get(rt2))?;
        self.write_back(moved);
        Ok(())
    }

    pub(super) fn load_multiple<B: Bus>(&mut self, bus: &mut B, registers: u16, address: Address) -> Result<(), Trap> {
        let (mut address, moved) = self.locate(address);
        let mut loaded = [0; 16];
        for (number, value) in loaded.iter_mut().enumerate() {
            if registers >> number & 1 != 0 {
                *value = self.read_word(bus, address)?;
                address = address.wrapping_add(4);
            }
        }
        self.write_back(moved);
        for number in 0..15 {
            if registers >> number & 1 != 0 {
                self.set(Reg(number), loaded[usize::from(number)]);
            }
        }
        if registers & Reg::PC.bit() != 0 {
            return self.branch_exchange(loaded[15]);
        }
        Ok(())
    }

    pub(super) fn store_multiple<B: Bus>(&mut self, bus: &mut B, registers: u16, address: Address) -> Result<(), Trap> {
        let (mut address, moved) = self.locate(address);
        for number in 0..15 {
            if registers >> number & 1 != 0 {
                self.write_word(bus, address, self.get(Reg(number)))?;
                address = address.wrapping_add(4);
            }
        }
        self.write_back(moved);
        Ok(())
    }

    #[inline(always)]
    pub(super) fn load_float<B: Bus>(
        &mut self,
        bus: &mut B,
        first: SReg,
        count: u8,
        address: Address,
    ) -> Result<(), Trap> {
        self.check_float()?;
        let (base, moved) = self.locate(address);
        for n in 0..count {
            let word = self.read_word(bus, base.wrapping_add(4 * u32::from(n)))?;
            self.float.set(SReg(first.0 + n), word);
        }
        self.write_back(moved);
        Ok(())
    }

    #[inline(always)]
    pub(super) fn store_float<B: Bus>(
        &mut self,
        bus: &mut B,
        first: SReg,
        count: u8,
        address: Address,
    ) -> Result<(), Trap> {
        self.check_float()?;
        let (base, moved) = self.locate(address);
        self.await_float(&[first]);
        for n in 0..count {
            self.write_word(bus, base.wrapping_add(4 * u32::from(n)), self.float.get(SReg(first.0 + n)))?;
        }
        self.write_back(moved);
        Ok(())
    }

    pub(super) fn load_exclusive<B: Bus>(
        &mut self,
        bus: &mut B,
        size: Size,
        rt: Reg,
        rn: Reg,
        offset: u16,
    ) -> Result<(), Trap> {
        let address = self.get(rn).wrapping_add(offset.into());
        must_be_aligned(address, size)?;
        let value = self.read_aligned(bus, address, size)?;
        self.exclusive = true;
        self.set(rt, value);
        Ok(())
    }

    pub(super) fn store_exclusive<B: Bus>(
        &mut self,
        bus: &mut B,
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
            self.write_aligned(bus, address, size, self.get(rt) & mask)?;
        }
        self.set(rd, (!allowed).into());
        Ok(())
    }
}

/// The private peripheral bus.
#[inline(always)]
fn is_private(address: u32) -> bool {
    address >> 20 == 0xe00
}

fn must_be_aligned(address: u32, size: Size) -> Result<(), Fault> {
    if address & (size.bytes() - 1) == 0 { Ok(()) } else { Err(Fault::Unaligned { address }) }
}
