//! The programmer's registers: R0–R15, xPSR, PRIMASK and CONTROL (DDI0403, B1.4).

use super::instruction::{Reg, Special};

/// N, Z, C, V and Q of the APSR.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Flags {
    pub n: bool,
    pub z: bool,
    pub c: bool,
    pub v: bool,
    pub q: bool,
}

impl Flags {
    pub fn to_bits(self) -> u32 {
        u32::from(self.n) << 31
            | u32::from(self.z) << 30
            | u32::from(self.c) << 29
            | u32::from(self.v) << 28
            | u32::from(self.q) << 27
    }

    pub fn from_bits(bits: u32) -> Self {
        let bit = |n: u32| bits >> n & 1 != 0;
        Self { n: bit(31), z: bit(30), c: bit(29), v: bit(28), q: bit(27) }
    }

    #[inline]
    pub fn set_nz(&mut self, result: u32) {
        self.n = (result as i32) < 0;
        self.z = result == 0;
    }

    /// ConditionPassed for a condition field of four bits.
    #[inline]
    pub fn pass(self, condition: u8) -> bool {
        let holds = match condition >> 1 {
            0 => self.z,
            1 => self.c,
            2 => self.n,
            3 => self.v,
            4 => self.c && !self.z,
            5 => self.n == self.v,
            6 => self.n == self.v && !self.z,
            _ => return true,
        };
        holds != (condition & 1 != 0)
    }
}

#[derive(Clone, Debug, Default)]
pub(super) struct Registers {
    /// R0–R15. R15 reads as instruction address plus 4.
    pub r: [u32; 16],
    /// Lowest value the main stack pointer has had since reset.
    pub min_msp: u32,
    pub flags: Flags,
    /// EPSR.T: clear after a jump to an even address, which is a fault.
    pub thumb: bool,
    /// ITSTATE: 0 outside an IT block.
    pub it: u8,
    /// Number of the exception being handled, 0 in thread mode.
    pub ipsr: u16,
    pub primask: bool,
    /// CONTROL.FPCA: the context has floating-point state.
    pub float_active: bool,
}

impl Registers {
    /// State after reset with main stack pointer `msp`.
    pub fn at_reset(msp: u32) -> Self {
        let mut r = [0; 16];
        r[13] = msp & !3;
        r[14] = 0xffff_ffff;
        Self { r, min_msp: msp & !3, ..Self::default() }
    }

    #[inline(always)]
    pub fn get(&self, register: Reg) -> u32 {
        self.r[register.index()]
    }

    /// Writes a register that is not PC.
    #[inline(always)]
    pub fn set(&mut self, register: Reg, value: u32) {
        if register == Reg::SP {
            self.set_sp(value);
        } else {
            self.r[register.index()] = value;
        }
    }

    pub fn sp(&self) -> u32 {
        self.r[13]
    }

    #[inline]
    pub fn set_sp(&mut self, value: u32) {
        self.r[13] = value & !3;
        self.min_msp = self.min_msp.min(value & !3);
    }

    pub fn xpsr(&self) -> u32 {
        let it = u32::from(self.it);
        self.flags.to_bits() | (it & 3) << 25 | (it >> 2) << 10 | u32::from(self.thumb) << 24 | u32::from(self.ipsr)
    }

    /// Restores flags, ITSTATE and exception number as an exception return does.
    pub fn set_xpsr(&mut self, xpsr: u32) {
        self.flags = Flags::from_bits(xpsr);
        self.thumb = xpsr >> 24 & 1 != 0;
        self.it = (xpsr >> 25 & 3 | xpsr >> 8 & 0xfc) as u8;
        self.ipsr = (xpsr & 0x1ff) as u16;
    }

    /// MRS.
    pub fn read_special(&self, special: Special) -> u32 {
        match special {
            Special::Psr(number) => {
                let apsr = if number & 4 == 0 { self.flags.to_bits() } else { 0 };
                apsr | if number & 1 != 0 { u32::from(self.ipsr) } else { 0 }
            }
            Special::Msp => self.sp(),
            Special::Primask => self.primask.into(),
            Special::Control => u32::from(self.float_active) << 2,
        }
    }

    /// MSR.
    pub fn write_special(&mut self, special: Special, value: u32) {
        match special {
            Special::Psr(number) if number & 4 == 0 => self.flags = Flags::from_bits(value),
            Special::Psr(_) => {}
            Special::Msp => self.set_sp(value),
            Special::Primask => self.primask = value & 1 != 0,
            Special::Control => self.float_active = value & 4 != 0,
        }
    }
}
