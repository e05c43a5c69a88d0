//! What a write to the control register sets going, and the rules of when it may.

use super::registers::*;
use super::{Adc, Phase};
use crate::peripherals::{Effects, Ticks};

impl Adc {
    /// A write that changes nothing breaks no rule.
    pub(super) fn while_stopped(&self, value: u32, before: u32, rule: &'static str, effects: &mut Effects) {
        if value != before && self.cr & ADSTART != 0 {
            effects.violation(value, rule);
        }
    }

    /// Writes ADC_CR.
    pub(super) fn command(&mut self, value: u32, effects: &mut Effects) {
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
    pub(super) fn write_supply(&mut self, value: u32, effects: &mut Effects) {
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

    pub(super) fn regulated(&self, now: Ticks) -> bool {
        self.cr & (ADVREGEN | DEEPPWD) == ADVREGEN && now - self.regulator_since >= REGULATOR_TICKS
    }

    pub(super) fn calibrate(&mut self, value: u32, effects: &mut Effects) {
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

    pub(super) fn enable(&mut self, value: u32, effects: &mut Effects) {
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
        if self.clock < SHORTEST_CLOCK_TICKS {
            effects.violation(value, "the ADC clock is at most 60 MHz");
        }
        self.cr |= ADEN;
        self.command_at = now + STABILISATION_CLOCKS * self.clock;
    }

    pub(super) fn start(&mut self, value: u32, effects: &mut Effects) {
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

    pub(super) fn finish_command(&mut self, now: Ticks) {
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
