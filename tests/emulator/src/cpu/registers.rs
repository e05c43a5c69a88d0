//! The programmer's registers: R0–R15 with both stack pointers, xPSR, masks and CONTROL (DDI0403, B1.4).

use super::instruction::{Reg, Special};

/// N, Z, C, V, Q and GE of the APSR.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Flags {
    pub n: bool,
    pub z: bool,
    pub c: bool,
    pub v: bool,
    pub q: bool,
    pub ge: u8,
}

impl Flags {
    pub fn to_bits(self) -> u32 {
        u32::from(self.n) << 31
            | u32::from(self.z) << 30
            | u32::from(self.c) << 29
            | u32::from(self.v) << 28
            | u32::from(self.q) << 27
            | u32::from(self.ge) << 16
    }

    pub fn from_bits(bits: u32) -> Self {
        let bit = |n: u32| bits >> n & 1 != 0;
        Self { n: bit(31), z: bit(30), c: bit(29), v: bit(28), q: bit(27), ge: (bits >> 16 & 15) as u8 }
    }

    /// N and Z of `result`.
    pub fn set_nz(&mut self, result: u32) {
        self.n = (result as i32) < 0;
        self.z = result == 0;
    }

    /// ConditionPassed for a condition field of four bits.
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

#[derive(Clone, Debug)]
pub(super) struct Registers {
    /// R0–R15. R13 is the stack pointer in use; R15 reads as instruction address plus 4.
    pub r: [u32; 16],
    /// The stack pointer not in use.
    other_sp: u32,
    /// Whether R13 is PSP.
    psp_in_use: bool,
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
    pub faultmask: bool,
    pub basepri: u8,
    /// CONTROL.nPRIV.
    pub unprivileged: bool,
    /// CONTROL.SPSEL.
    pub psp_selected: bool,
    /// CONTROL.FPCA: the context has floating-point state.
    pub float_active: bool,
}

impl Registers {
    /// State after reset with main stack pointer `msp`.
    pub fn at_reset(msp: u32) -> Self {
        let mut r = [0; 16];
        r[13] = msp & !3;
        r[14] = 0xffff_ffff;
        Self {
            r,
            other_sp: 0,
            psp_in_use: false,
            min_msp: msp & !3,
            flags: Flags::default(),
            thumb: true,
            it: 0,
            ipsr: 0,
            primask: false,
            faultmask: false,
            basepri: 0,
            unprivileged: false,
            psp_selected: false,
            float_active: false,
        }
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
        if !self.psp_in_use {
            self.min_msp = self.min_msp.min(value & !3);
        }
    }

    /// Brings the stack pointer in use in line with mode and CONTROL.SPSEL.
    pub fn select_stack(&mut self) {
        let psp = self.psp_selected && self.ipsr == 0;
        if psp != self.psp_in_use {
            self.psp_in_use = psp;
            std::mem::swap(&mut self.r[13], &mut self.other_sp);
        }
    }

    pub fn msp(&self) -> u32 {
        if self.psp_in_use { self.other_sp } else { self.r[13] }
    }

    pub fn psp(&self) -> u32 {
        if self.psp_in_use { self.r[13] } else { self.other_sp }
    }

    fn set_msp(&mut self, value: u32) {
        if self.psp_in_use {
            self.other_sp = value & !3;
        } else {
            self.r[13] = value & !3;
        }
        self.min_msp = self.min_msp.min(value & !3);
    }

    fn set_psp(&mut self, value: u32) {
        if self.psp_in_use {
            self.r[13] = value & !3;
        } else {
            self.other_sp = value & !3;
        }
    }

    /// Handler mode is always privileged.
    pub fn privileged(&self) -> bool {
        self.ipsr != 0 || !self.unprivileged
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

    pub fn control(&self) -> u32 {
        u32::from(self.float_active) << 2 | u32::from(self.psp_selected) << 1 | u32::from(self.unprivileged)
    }

    /// MRS.
    pub fn read_special(&self, special: Special) -> u32 {
        match special {
            Special::Psr(number) => {
                let apsr = if number & 4 == 0 { self.flags.to_bits() } else { 0 };
                let ipsr = if number & 1 != 0 && self.privileged() { u32::from(self.ipsr) } else { 0 };
                apsr | ipsr
            }
            Special::Control => self.control(),
            _ if !self.privileged() => 0,
            Special::Msp => self.msp(),
            Special::Psp => self.psp(),
            Special::Primask => self.primask.into(),
            Special::Basepri | Special::BasepriMax => self.basepri.into(),
            Special::Faultmask => self.faultmask.into(),
        }
    }

    /// MSR. Unprivileged code reaches the flags only. `below_hardfault`: the execution priority is lower in
    /// urgency than HardFault's, so that FAULTMASK may be set.
    pub fn write_special(&mut self, special: Special, value: u32, mask: u8, below_hardfault: bool) {
        match special {
            Special::Psr(number) if number & 4 == 0 => {
                let selected =
                    if mask & 2 != 0 { 0xf800_0000 } else { 0 } | if mask & 1 != 0 { 0x000f_0000 } else { 0 };
                self.flags = Flags::from_bits(self.flags.to_bits() & !selected | value & selected);
            }
            Special::Psr(_) => {}
            _ if !self.privileged() => {}
            Special::Msp => self.set_msp(value),
            Special::Psp => self.set_psp(value),
            Special::Primask => self.primask = value & 1 != 0,
            Special::Basepri => self.basepri = value as u8 & 0xf0,
            Special::BasepriMax => {
                let value = value as u8 & 0xf0;
                if value != 0 && (self.basepri == 0 || value < self.basepri) {
                    self.basepri = value;
                }
            }
            Special::Faultmask => self.faultmask = value & 1 != 0 && below_hardfault,
            Special::Control => {
                self.unprivileged = value & 1 != 0;
                if self.ipsr == 0 {
                    self.psp_selected = value & 2 != 0;
                }
                self.float_active = value & 4 != 0;
                self.select_stack();
            }
        }
    }
}
