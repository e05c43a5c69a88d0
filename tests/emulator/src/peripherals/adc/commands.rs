//! Registers, their bits, and times in them; what a write to the control register sets going, and the rules of when it may.

use super::{Adc, Phase};
use crate::peripherals::{Effects, TICKS_PER_SECOND, Ticks};

pub const ISR: u32 = 0x00;
pub const IER: u32 = 0x04;
pub const CR: u32 = 0x08;
pub const CFGR: u32 = 0x0C;
pub const CFGR2: u32 = 0x10;
pub const SMPR1: u32 = 0x14;
pub const SMPR2: u32 = 0x18;
pub const TR1: u32 = 0x20;
pub const TR3: u32 = 0x28;
pub const SQR1: u32 = 0x30;
pub const SQR4: u32 = 0x3C;
pub const DR: u32 = 0x40;
pub const DIFSEL: u32 = 0xB0;
pub const CALFACT: u32 = 0xB4;
/// Registers common to a group of converters, from the group's base.
pub const COMMON: u32 = 0x300;
pub const CSR: u32 = COMMON;
pub const CCR: u32 = COMMON + 0x08;

pub const ADRDY: u32 = 1;
pub const EOSMP: u32 = 1 << 1;
pub const EOC: u32 = 1 << 2;
pub const EOS: u32 = 1 << 3;
pub const OVR: u32 = 1 << 4;

pub const ADEN: u32 = 1;
pub const ADDIS: u32 = 1 << 1;
pub const ADSTART: u32 = 1 << 2;
pub const JADSTART: u32 = 1 << 3;
pub const ADSTP: u32 = 1 << 4;
pub const JADSTP: u32 = 1 << 5;
pub const ADVREGEN: u32 = 1 << 28;
pub const DEEPPWD: u32 = 1 << 29;
pub const ADCALDIF: u32 = 1 << 30;
pub const ADCAL: u32 = 1 << 31;
/// Bits of ADC_CR that software only sets and hardware clears.
pub const CR_COMMANDS: u32 = ADEN | ADDIS | ADSTART | JADSTART | ADSTP | JADSTP | ADCAL;

pub const DMAEN: u32 = 1;
pub const OVRMOD: u32 = 1 << 12;
pub const CONT: u32 = 1 << 13;
/// DMAEN, DMACFG, RES, EXTSEL, EXTEN, OVRMOD, CONT, and JQDIS (set after reset).
pub const CFGR_MODELLED: u32 = 0x8000_3FFF & !(1 << 2);
pub const ROVSE: u32 = 1;
/// ROVSE, OVSR, OVSS and ROVSM (without injected conversions both modes are the same).
pub const CFGR2_MODELLED: u32 = ROVSE | 0b111 << 2 | 0b1111 << 5 | 1 << 10;
/// CKMODE, PRESC, and the switches of the internal channels.
pub const CCR_MODELLED: u32 = 0b11 << 16 | 0b1111 << 18 | 0b111 << 22;
pub const CCR_CLOCK: u32 = 0b11 << 16 | 0b1111 << 18;

/// Twice the sampling time in converter clocks, by SMP code.
pub const SAMPLE_HALF_CLOCKS: [u64; 8] = [5, 13, 25, 49, 95, 185, 495, 1281];
/// Twice the duration of the successive approximation in clocks, by RES code.
pub const APPROXIMATION_HALF_CLOCKS: [u64; 4] = [25, 21, 17, 13];
pub const PRESCALERS: [u64; 12] = [1, 2, 4, 6, 8, 10, 12, 16, 32, 64, 128, 256];
/// Trigger to start of sampling, in clocks.
pub const TRIGGER_CLOCKS: u64 = 2;
/// Calibration, in clocks (STM32G474 data sheet, "ADC characteristics", t_CAL).
pub const CALIBRATION_CLOCKS: u64 = 116;
/// From ADEN to ADRDY: one conversion (data sheet, t_STAB), in clocks.
pub const STABILISATION_CLOCKS: u64 = 15;
/// From ADSTP or ADDIS to the end of the command, in clocks.
pub const STOP_CLOCKS: u64 = 2;
/// Wait between ADCAL cleared and ADEN, in clocks (RM0440, "Software procedure to enable the ADC").
pub const CALIBRATION_TO_ENABLE_CLOCKS: u64 = 4;
/// Start-up of the regulator: 20 µs (data sheet, t_ADCVREG_STUP).
pub const REGULATOR_TICKS: Ticks = 3_400;
/// Fault adc-stale: a conversion this long after the one before is wrong.
pub const STALE_TICKS: Ticks = TICKS_PER_SECOND / 1_000;
/// Fault adc-stale: by so many codes.
pub const STALE_CODES: u16 = 700;
/// Fault adc-neighbour: the most codes that a conversion is off by.
pub const NEIGHBOUR_CODES: u64 = 8;
/// Shortest clock period in ticks that the converter follows (60 MHz).
pub const MIN_CLOCK_TICKS: u64 = 3;

impl Adc {
    /// A write that changes nothing breaks no rule.
    pub fn while_stopped(&self, value: u32, before: u32, rule: &'static str, effects: &mut Effects) {
        if value != before && self.cr & ADSTART != 0 {
            effects.violation(value, rule);
        }
    }

    /// Writes ADC_CR.
    pub fn command(&mut self, value: u32, effects: &mut Effects) {
        let now = effects.now();
        self.write_supply(value, effects);
        let commands = value & CR_COMMANDS & !self.cr;
        effects.unmodelled_bits(commands & (JADSTART | JADSTP));
        if commands & ADCAL != 0 {
            self.calibrate(value, effects);
        }
        if commands & ADEN != 0 {
            self.enable(value, effects);
        }
        if commands & ADDIS != 0 {
            if self.cr & ADEN == 0 || self.cr & ADSTART != 0 {
                effects.violation(value, "ADDIS is set only while ADEN = 1 and ADSTART = 0");
            } else {
                self.cr |= ADDIS;
                self.command_at = now + STOP_CLOCKS * self.clock;
            }
        }
        if commands & ADSTART != 0 {
            self.start(value, effects);
        }
        if commands & ADSTP != 0 {
            if self.cr & ADSTART == 0 || self.cr & ADDIS != 0 {
                effects.violation(value, "ADSTP is set only while ADSTART = 1 and ADDIS = 0");
            } else {
                self.cr |= ADSTP;
                self.phase = Phase::Idle;
                self.phase_at = Ticks::MAX;
                self.command_at = now + STOP_CLOCKS * self.clock;
            }
        }
    }

    /// DEEPPWD, ADVREGEN and ADCALDIF.
    pub fn write_supply(&mut self, value: u32, effects: &mut Effects) {
        let bits = DEEPPWD | ADVREGEN | ADCALDIF;
        if (value ^ self.cr) & bits != 0 && self.cr & CR_COMMANDS != 0 {
            effects.violation(value, "DEEPPWD, ADVREGEN and ADCALDIF are written only while the ADC is disabled");
        }
        if value & ADVREGEN != 0 && self.cr & ADVREGEN == 0 {
            self.regulator_since = effects.now();
            if value & DEEPPWD != 0 {
                effects.violation(value, "ADVREGEN is set only after DEEPPWD is cleared");
            }
        }
        self.cr = self.cr & !bits | value & bits;
    }

    pub fn regulated(&self, now: Ticks) -> bool {
        self.cr & (ADVREGEN | DEEPPWD) == ADVREGEN && now - self.regulator_since >= REGULATOR_TICKS
    }

    pub fn calibrate(&mut self, value: u32, effects: &mut Effects) {
        if !self.regulated(effects.now()) {
            effects.violation(value, "ADCAL is set only 20 µs after ADVREGEN");
        }
        if self.cr & CR_COMMANDS != 0 {
            effects.violation(value, "ADCAL is set only while the ADC is disabled");
            return;
        }
        self.cr |= ADCAL;
        self.command_at = effects.now() + CALIBRATION_CLOCKS * self.clock;
    }

    pub fn enable(&mut self, value: u32, effects: &mut Effects) {
        let now = effects.now();
        if self.cr & CR_COMMANDS != 0 || !self.regulated(now) {
            effects.violation(value, "ADEN is set only while all other commands are 0 and the regulator is ready");
            return;
        }
        match self.calibrated_at {
            None => effects.violation(value, "ADEN is set after a calibration"),
            Some(at) if now < at + CALIBRATION_TO_ENABLE_CLOCKS * self.clock => {
                effects.violation(value, "ADEN is set at least four ADC clocks after ADCAL is cleared");
            }
            Some(_) => {}
        }
        if self.clock < MIN_CLOCK_TICKS {
            effects.violation(value, "the ADC clock is at most 60 MHz");
        }
        self.cr |= ADEN;
        self.command_at = now + STABILISATION_CLOCKS * self.clock;
    }

    pub fn start(&mut self, value: u32, effects: &mut Effects) {
        if self.cr & (ADEN | ADDIS) != ADEN || self.isr & ADRDY == 0 && self.command_at != Ticks::MAX {
            effects.violation(value, "ADSTART is set only while ADEN = 1, ADRDY = 1 and ADDIS = 0");
            return;
        }
        self.cr |= ADSTART;
        self.plan = self.plan_sequence();
        if self.plan.trigger_mask == 0 {
            self.begin(effects.now(), 0);
        }
    }

    pub fn finish_command(&mut self, now: Ticks) {
        self.command_at = Ticks::MAX;
        if self.cr & ADCAL != 0 {
            self.cr &= !ADCAL;
            self.calibrated_at = Some(now);
            self.last_conversion = now;
        } else if self.cr & ADSTP != 0 {
            self.cr &= !(ADSTP | ADSTART);
            self.was_stopped = true;
        } else if self.cr & ADDIS != 0 {
            self.cr &= !(ADDIS | ADEN);
            self.isr &= !ADRDY;
            self.was_stopped = false;
        } else if self.cr & ADEN != 0 {
            self.isr |= ADRDY;
        }
    }
}
