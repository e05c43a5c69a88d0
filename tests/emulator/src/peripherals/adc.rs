//! Analog-to-digital converters: regular sequences (RM0440, "Analog-to-digital converters").
//!
//! Modelled: power-up (deep power down, regulator, calibration, ADRDY), regular sequences
//! started by software or by a timer's TRGO, single or continuous, sampling times, resolution,
//! oversampling with shift, DMA requests and overrun, and the rules of when a register may be
//! written. Not modelled: injected conversions, watchdogs, offsets, dual modes, discontinuous
//! mode, triggered oversampling. Results are right-aligned.
//!
//! # Timing
//! ```text
//! trigger ─2 clocks─▶ sampling ─SMP─▶ hold ─12.5 clocks─▶ next of this rank, or result and next rank
//! ```
//! A conversion takes SMP + 12.5 clocks (at 12 bits). The code is asked from the outside at the
//! hold instant, the end of the sampling time. The result, its flag and its DMA request come with
//! the end of the last conversion of a rank.

mod commands;
mod group;

pub use group::AdcGroup;

use super::{Effects, Request, Ticks};
use crate::faults::Fault;
use commands::*;

/// What the converter does by itself next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Idle,
    Hold,
    /// The end of a rank's last conversion.
    Result,
}

/// One rank of the sequence, in ticks.
#[derive(Clone, Copy, Debug, Default)]
struct Rank {
    channel: u8,
    sampling: Ticks,
}

/// The sequence as it was when conversions were started; it cannot change while they run.
#[derive(Clone, Debug, Default)]
struct Plan {
    ranks: [Rank; 16],
    length: usize,
    approximation: Ticks,
    oversampling: u32,
    shift: u32,
    trigger_delay: Ticks,
    /// Edges of the trigger line that start a sequence, as in `Effects::take_triggers`.
    trigger_mask: u16,
}

#[derive(Debug)]
pub struct Adc {
    number: u8,
    request: Request,
    isr: u32,
    ier: u32,
    cr: u32,
    cfgr: u32,
    cfgr2: u32,
    smpr: [u32; 2],
    sqr: [u32; 4],
    dr: u32,
    difsel: u32,
    calfact: u32,
    regulator_since: Ticks,
    calibrated_at: Option<Ticks>,
    /// Ticks of a converter clock.
    clock: u64,
    plan: Plan,
    phase: Phase,
    phase_at: Ticks,
    rank: usize,
    conversions: u32,
    sum: u32,
    /// When the pending command (ADCAL, ADEN, ADDIS, ADSTP) is done.
    command_at: Ticks,
    next: Ticks,
    swallow: bool,
    /// ADSTP was set since the converter was enabled.
    was_stopped: bool,
    /// End of the last calibration or conversion.
    last_conversion: Ticks,
}

impl Adc {
    fn new(number: u8, request: Request) -> Self {
        Self {
            number,
            request,
            isr: 0,
            ier: 0,
            cr: DEEPPWD,
            cfgr: 1 << 31,
            cfgr2: 0,
            smpr: [0; 2],
            sqr: [0; 4],
            dr: 0,
            difsel: 0,
            calfact: 0,
            regulator_since: 0,
            calibrated_at: None,
            clock: 4,
            plan: Plan::default(),
            phase: Phase::Idle,
            phase_at: Ticks::MAX,
            rank: 0,
            conversions: 0,
            sum: 0,
            command_at: Ticks::MAX,
            next: Ticks::MAX,
            swallow: false,
            was_stopped: false,
            last_conversion: 0,
        }
    }

    /// Fault injection: the next DMA request of this converter is not made.
    pub fn swallow_request(&mut self) {
        self.swallow = true;
    }

    /// Fault injection: the overrun flag as if a result had been lost.
    fn force_overrun(&mut self) {
        self.isr |= OVR;
    }

    fn read(&mut self, offset: u32, effects: &mut Effects) -> u32 {
        match offset {
            ISR => self.isr,
            IER => self.ier,
            CR => self.cr,
            CFGR => self.cfgr,
            CFGR2 => self.cfgr2,
            SMPR1 | SMPR2 => self.smpr[usize::from(offset == SMPR2)],
            SQR1..=SQR4 => self.sqr[((offset - SQR1) / 4) as usize],
            DR => {
                self.isr &= !EOC;
                self.dr
            }
            DIFSEL => self.difsel,
            CALFACT => self.calfact,
            _ => {
                effects.unmodelled();
                0
            }
        }
    }

    fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match offset {
            ISR => self.isr &= !value,
            IER => self.ier = value,
            CR => self.command(value, effects),
            CFGR => {
                self.while_stopped(value, self.cfgr, "ADC_CFGR is written only while ADSTART = 0", effects);
                effects.unmodelled_bits(value & !CFGR_MODELLED);
                if value & DMAEN == 0 {
                    effects.withdraw(self.request);
                }
                self.cfgr = value;
            }
            CFGR2 => {
                self.while_stopped(value, self.cfgr2, "ADC_CFGR2 is written only while ADSTART = 0", effects);
                effects.unmodelled_bits(value & !CFGR2_MODELLED);
                self.cfgr2 = value;
            }
            SMPR1 | SMPR2 => {
                let half = usize::from(offset == SMPR2);
                self.while_stopped(value, self.smpr[half], "ADC_SMPRx is written only while ADSTART = 0", effects);
                effects.unmodelled_bits(value >> 30);
                self.smpr[half] = value;
            }
            SQR1..=SQR4 => {
                let index = ((offset - SQR1) / 4) as usize;
                self.while_stopped(value, self.sqr[index], "ADC_SQRx is written only while ADSTART = 0", effects);
                self.sqr[index] = value;
            }
            DIFSEL => {
                if value != self.difsel && self.cr & CR_COMMANDS != 0 {
                    effects.violation(value, "ADC_DIFSEL is written only while the ADC is disabled");
                }
                self.difsel = value;
            }
            CALFACT => {
                if self.cr & ADEN == 0 || self.cr & ADSTART != 0 {
                    effects.violation(value, "ADC_CALFACT is written only while ADEN = 1 and ADSTART = 0");
                }
                self.calfact = value;
            }
            TR1..=TR3 => {}
            _ => effects.unmodelled_bits(value),
        }
    }

    fn plan_sequence(&self) -> Plan {
        let half_clock = |half_clocks: u64| half_clocks * self.clock / 2;
        let oversampled = self.cfgr2 & ROVSE != 0;
        let mut ranks = [Rank::default(); 16];
        for (index, rank) in ranks.iter_mut().enumerate() {
            let field = index + 1;
            rank.channel = (self.sqr[field / 5] >> (6 * (field % 5)) & 0x1F) as u8;
            let (half, position) = (usize::from(rank.channel / 10), u32::from(rank.channel % 10));
            let code = self.smpr[half] >> (3 * position) & 7;
            rank.sampling = half_clock(SAMPLE_HALF_CLOCKS[code as usize]);
        }
        Plan {
            ranks,
            length: (self.sqr[0] & 0xF) as usize + 1,
            approximation: half_clock(APPROXIMATION_HALF_CLOCKS[(self.cfgr >> 3 & 3) as usize]),
            oversampling: if oversampled { 2 << (self.cfgr2 >> 2 & 7) } else { 1 },
            shift: if oversampled { self.cfgr2 >> 5 & 0xF } else { 0 },
            trigger_delay: TRIGGER_CLOCKS * self.clock,
            trigger_mask: self.trigger_mask(),
        }
    }

    /// Which trigger edges start a sequence (RM0440, "ADC1/2: external triggers for regular channels").
    fn trigger_mask(&self) -> u16 {
        let trigger = match self.cfgr >> 5 & 0x1F {
            11 => 0,
            4 => 1,
            12 => 2,
            // A source that is not modelled never comes.
            _ => 7,
        };
        ((self.cfgr >> 10 & 3) as u16) << (2 * trigger)
    }

    /// A trigger edge, which the converter's clock sees `late` ticks later, or the software start.
    fn begin(&mut self, now: Ticks, late: Ticks) {
        // A trigger that finds the converter at work is lost.
        if self.phase != Phase::Idle {
            return;
        }
        self.rank = 0;
        self.sample_rank(now + late + self.plan.trigger_delay);
    }

    /// Sampling of the present rank starts at `at`.
    fn sample_rank(&mut self, at: Ticks) {
        self.sum = 0;
        self.conversions = 0;
        self.phase = Phase::Hold;
        self.phase_at = at + self.plan.ranks[self.rank].sampling;
    }

    fn advance(&mut self, effects: &mut Effects, sample: &mut impl FnMut(u8, u8) -> u16) {
        let now = effects.now();
        if self.phase_at == now {
            match self.phase {
                Phase::Hold => self.hold(effects, sample),
                Phase::Result => self.finish_rank(effects),
                Phase::Idle => {}
            }
        }
        if self.command_at == now {
            self.finish_command(now);
        }
    }

    #[inline]
    fn hold(&mut self, effects: &Effects, sample: &mut impl FnMut(u8, u8) -> u16) {
        let rank = self.plan.ranks[self.rank];
        let lost_bits = 2 * (self.cfgr >> 3 & 3);
        let is_zero = std::mem::take(&mut self.was_stopped) && effects.faults.has(Fault::AdcStop);
        let mut code = sample(self.number, if is_zero { 0 } else { rank.channel });
        if effects.now() - self.last_conversion > STALE_TICKS && effects.faults.has(Fault::AdcStale) {
            code = code.abs_diff(STALE_CODES);
        }
        self.last_conversion = effects.now();
        self.sum += u32::from(code >> lost_bits);
        self.conversions += 1;
        self.isr |= EOSMP;
        self.phase_at += self.plan.approximation;
        if self.conversions < self.plan.oversampling {
            self.phase_at += rank.sampling;
        } else {
            self.phase = Phase::Result;
        }
    }

    fn finish_rank(&mut self, effects: &mut Effects) {
        self.deliver(self.sum >> self.plan.shift & 0xFFFF, effects);
        self.rank += 1;
        if self.rank < self.plan.length {
            self.sample_rank(effects.now());
            return;
        }
        self.isr |= EOS;
        self.rank = 0;
        if self.cfgr & CONT != 0 {
            self.sample_rank(effects.now());
            return;
        }
        self.phase = Phase::Idle;
        self.phase_at = Ticks::MAX;
        if self.plan.trigger_mask == 0 {
            self.cr &= !ADSTART;
        }
    }

    /// Puts a result into ADC_DR. A result that was not fetched is an overrun, after which no
    /// DMA request is made until software clears OVR (RM0440, "ADC overrun").
    fn deliver(&mut self, result: u32, effects: &mut Effects) {
        if self.isr & EOC != 0 {
            self.isr |= OVR;
        }
        if self.isr & OVR != 0 && self.cfgr & OVRMOD == 0 {
            return;
        }
        self.dr = result;
        self.isr |= EOC;
        if self.cfgr & DMAEN != 0 && self.isr & OVR == 0 && !std::mem::take(&mut self.swallow) {
            effects.request(self.request);
        }
    }

    fn interrupt(&self) -> bool {
        self.isr & self.ier != 0
    }
}

#[cfg(test)]
mod tests;
