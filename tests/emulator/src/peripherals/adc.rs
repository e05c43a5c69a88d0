//! Analog-to-digital converters: regular sequences (RM0440, "Analog-to-digital converters").
//!
//! Modelled: power-up (deep power down, regulator, calibration, ADRDY), regular sequences
//! started by software or by a rising edge of TIM2's TRGO, sampling times, oversampling, DMA requests and overrun,
//! and the rules of when a register may be written. Not modelled: interrupts, continuous and injected conversions,
//! other resolutions than 12 bits, shifts, watchdogs, offsets, dual modes, discontinuous mode, triggered
//! oversampling. Results are right-aligned.
//!
//! # Timing
//! ```text
//! trigger ─2 clocks─▶ sampling ─SMP─▶ hold ─12.5 clocks─▶ next of this rank, or result and next rank
//! ```
//! A conversion takes SMP + 12.5 clocks (at 12 bits). The code is asked from the outside at the
//! hold instant, the end of the sampling time. The result, its flag and its DMA request come with
//! the end of the last conversion of a rank.

mod group;

pub use group::AdcGroup;

use super::effects::{ALL, Bank, Register};
use super::{Effects, TICKS_PER_SECOND, Ticks};
use crate::faults::Fault;
use crate::st::ADC::{
    CFGR, CFGR_DMAEN as DMAEN, CFGR_OVRMOD as OVRMOD, CFGR2, CFGR2_ROVSE as ROVSE, CR, CR_ADCAL as ADCAL,
    CR_ADCALDIF as ADCALDIF, CR_ADDIS as ADDIS, CR_ADEN as ADEN, CR_ADSTART as ADSTART, CR_ADSTP as ADSTP,
    CR_ADVREGEN as ADVREGEN, CR_DEEPPWD as DEEPPWD, CR_JADSTART as JADSTART, CR_JADSTP as JADSTP, DIFSEL, DR, IER, ISR,
    ISR_ADRDY as ADRDY, ISR_EOC as EOC, ISR_EOS as EOS, ISR_EOSMP as EOSMP, ISR_OVR as OVR, SMPR1, SMPR2, SQR1, SQR4,
    TR1, TR3,
};
use crate::st::{self, ADC, ADC1, ADC12, LL, approximation, sampling};

/// The register common to a group of converters, from the group's base.
const CCR: u32 = ADC12::COMMON_BASE - ADC1::BASE + ADC::Common_CCR;

/// Bits of ADC_CR that software only sets and hardware clears.
const CR_COMMANDS: u32 = ADEN | ADDIS | ADSTART | JADSTART | ADSTP | JADSTP | ADCAL;

const CFGR_MODELLED: u32 = DMAEN | ADC::CFGR_DMACFG | ADC::CFGR_EXTSEL | ADC::CFGR_EXTEN | OVRMOD | ADC::CFGR_JQDIS;
/// EXTEN and EXTSEL: each rising edge of TIM2's TRGO (RM0440, "ADC1/2: external triggers for regular channels").
const RISING_TIM2: u32 = LL::ADC_REG_TRIG_EXT_RISING | LL::ADC_REG_TRIG_EXT_TIM2_TRGO & ADC::CFGR_EXTSEL;
/// Without injected conversions both modes of ROVSM are the same.
const CFGR2_MODELLED: u32 = ROVSE | ADC::CFGR2_OVSR | ADC::CFGR2_ROVSM;
/// Of SMPR1 and SMPR2: three bits for each of ten channels.
const TEN_CHANNELS: u32 = (1 << 30) - 1;
/// The clock, and the switches of the internal channels.
const CCR_MODELLED: u32 = ADC::CCR_CKMODE | ADC::CCR_VREFEN | ADC::CCR_VSENSESEL | ADC::CCR_VBATSEL;

/// The sampling time in converter clocks, by SMP code.
const SAMPLING_CLOCKS: [f64; 8] = [
    sampling::clocks_0,
    sampling::clocks_1,
    sampling::clocks_2,
    sampling::clocks_3,
    sampling::clocks_4,
    sampling::clocks_5,
    sampling::clocks_6,
    sampling::clocks_7,
];
/// Trigger to start of sampling, in clocks; the data sheet's eighth of a clock is fault trigger-phase's.
const TRIGGER_CLOCKS: u64 = st::t::LATR_ckmode_11 as u64;
/// Calibration, in clocks (STM32G474 data sheet, "ADC characteristics", t_CAL).
const CALIBRATION_CLOCKS: u64 = st::t::CAL as u64;
/// From ADEN to ADRDY: one conversion (data sheet, t_STAB), in clocks.
const STABILISATION_CLOCKS: u64 = st::t::STAB as u64 * (SAMPLING_CLOCKS[0] + approximation::clocks_12_bits) as u64;
/// From ADSTP or ADDIS to the end of the command, in clocks.
const STOP_CLOCKS: u64 = 2;
/// Wait between ADCAL cleared and ADEN, in clocks (RM0440, "Software procedure to enable the ADC").
const CALIBRATION_TO_ENABLE_CLOCKS: u64 = st::calibration::to_enable_clocks as u64;
/// Start-up of the regulator.
const REGULATOR_TICKS: Ticks = st::t::ADCVREG_STUP as u64 * TICKS_PER_SECOND / 1_000_000;
/// Fault adc-stale: a conversion this long after the one before is wrong.
const STALE_TICKS: Ticks = st::T::TRIG as u64 * TICKS_PER_SECOND / 1_000;
/// Fault adc-stale: by so many codes.
const STALE_CODES: u16 = 700;
/// Fault adc-neighbour: the most codes that a conversion is off by.
const NEIGHBOUR_CODES: u64 = 8;
/// Shortest clock period in ticks that the converter follows.
const MIN_CLOCK_TICKS: u64 = TICKS_PER_SECOND.div_ceil(1_000_000 * st::f::ADC_single as u64);

const REGISTERS: &[Register] = &[
    (ISR, 1, 0, 0),
    (IER, 1, 0, 0),
    (CR, 1, DEEPPWD, 0),
    (CFGR, 1, ADC::CFGR_JQDIS, CFGR_MODELLED),
    (CFGR2, 1, 0, CFGR2_MODELLED),
    (SMPR1, 2, 0, TEN_CHANNELS),
    (SQR1, 4, 0, ALL),
    (DR, 1, 0, 0),
    (DIFSEL, 1, 0, 0),
];

/// What the converter does by itself next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Phase {
    #[default]
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
    trigger_delay: Ticks,
    /// TIM2 starts a sequence, not software.
    is_triggered: bool,
}

#[derive(Debug, Default)]
pub struct Adc {
    number: u8,
    request: u32,
    bank: Bank,
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
    fn new(number: u8, request: u32) -> Self {
        Self {
            number,
            request,
            bank: Bank::new(REGISTERS),
            clock: 4,
            phase_at: Ticks::MAX,
            command_at: Ticks::MAX,
            next: Ticks::MAX,
            ..Self::default()
        }
    }

    /// Fault injection: the next DMA request of this converter is not made.
    pub fn swallow_request(&mut self) {
        self.swallow = true;
    }

    /// Fault injection: the overrun flag as if a result had been lost.
    pub fn force_overrun(&mut self) {
        self.bank[ISR] |= OVR;
    }

    fn read(&mut self, offset: u32, effects: &mut Effects) -> u32 {
        if offset == DR {
            self.bank[ISR] &= !EOC;
        }
        self.bank.read(offset, effects)
    }

    fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        let rule = match offset {
            CFGR => Some("ADC_CFGR is written only while ADSTART = 0"),
            CFGR2 => Some("ADC_CFGR2 is written only while ADSTART = 0"),
            SMPR1 | SMPR2 => Some("ADC_SMPRx is written only while ADSTART = 0"),
            SQR1..=SQR4 => Some("ADC_SQRx is written only while ADSTART = 0"),
            _ => None,
        };
        // A write that changes nothing breaks no rule.
        if let Some(rule) = rule.filter(|_| value != self.bank[offset] && self.bank[CR] & ADSTART != 0) {
            effects.violation(value, rule);
        }
        match offset {
            ISR => return self.bank[ISR] &= !value,
            CR => return self.command(value, effects),
            CFGR => {
                let trigger = value & (ADC::CFGR_EXTEN | ADC::CFGR_EXTSEL);
                effects.unmodelled_bits(if trigger == RISING_TIM2 { 0 } else { trigger & ADC::CFGR_EXTEN });
                if value & DMAEN == 0 {
                    effects.withdraw(self.request);
                }
            }
            TR1..=TR3 => return,
            _ => {}
        }
        self.bank.write(offset, value, effects);
    }

    fn plan_sequence(&self) -> Plan {
        let ticks = |clocks: f64| (clocks * self.clock as f64) as Ticks;
        let oversampled = self.bank[CFGR2] & ROVSE != 0;
        let mut ranks = [Rank::default(); 16];
        for (index, rank) in ranks.iter_mut().enumerate() {
            let field = index + 1;
            rank.channel = (self.bank[SQR1 + 4 * (field / 5) as u32] >> (6 * (field % 5)) & 0x1F) as u8;
            let half = if rank.channel < 10 { SMPR1 } else { SMPR2 };
            let code = self.bank[half] >> (3 * (rank.channel % 10)) & 7;
            rank.sampling = ticks(SAMPLING_CLOCKS[code as usize]);
        }
        Plan {
            ranks,
            length: (self.bank[SQR1] & 0xF) as usize + 1,
            approximation: ticks(approximation::clocks_12_bits),
            oversampling: if oversampled { 2 << (self.bank[CFGR2] >> 2 & 7) } else { 1 },
            trigger_delay: TRIGGER_CLOCKS * self.clock,
            is_triggered: self.bank[CFGR] & ADC::CFGR_EXTEN != 0,
        }
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

    fn sample_rank(&mut self, at: Ticks) {
        self.sum = 0;
        self.conversions = 0;
        self.phase = Phase::Hold;
        self.phase_at = at + self.plan.ranks[self.rank].sampling;
    }

    fn advance(&mut self, effects: &mut Effects, sample: &mut impl FnMut(u8, u8) -> u16) {
        let now = effects.now;
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
        let is_zero = std::mem::take(&mut self.was_stopped) && effects.faults.has(Fault::AdcStop);
        let mut code = sample(self.number, if is_zero { 0 } else { rank.channel });
        if effects.now - self.last_conversion > STALE_TICKS && effects.faults.has(Fault::AdcStale) {
            code = code.abs_diff(STALE_CODES);
        }
        self.last_conversion = effects.now;
        self.sum += u32::from(code);
        self.conversions += 1;
        self.bank[ISR] |= EOSMP;
        self.phase_at += self.plan.approximation;
        if self.conversions < self.plan.oversampling {
            self.phase_at += rank.sampling;
        } else {
            self.phase = Phase::Result;
        }
    }

    fn finish_rank(&mut self, effects: &mut Effects) {
        self.deliver(self.sum & 0xFFFF, effects);
        self.rank += 1;
        if self.rank < self.plan.length {
            self.sample_rank(effects.now);
            return;
        }
        self.bank[ISR] |= EOS;
        self.rank = 0;
        self.phase = Phase::Idle;
        self.phase_at = Ticks::MAX;
        if !self.plan.is_triggered {
            self.bank[CR] &= !ADSTART;
        }
    }

    /// Puts a result into ADC_DR. A result that was not fetched is an overrun, after which no
    /// DMA request is made until software clears OVR (RM0440, "ADC overrun").
    fn deliver(&mut self, result: u32, effects: &mut Effects) {
        if self.bank[ISR] & EOC != 0 {
            self.bank[ISR] |= OVR;
        }
        if self.bank[ISR] & OVR != 0 && self.bank[CFGR] & OVRMOD == 0 {
            return;
        }
        self.bank[DR] = result;
        self.bank[ISR] |= EOC;
        if self.bank[CFGR] & DMAEN != 0 && self.bank[ISR] & OVR == 0 && !std::mem::take(&mut self.swallow) {
            effects.request(self.request);
        }
    }

    /// Writes ADC_CR.
    fn command(&mut self, value: u32, effects: &mut Effects) {
        let now = effects.now;
        self.write_supply(value, effects);
        let commands = value & CR_COMMANDS & !self.bank[CR];
        effects.unmodelled_bits(commands & (JADSTART | JADSTP));
        if commands & ADCAL != 0 {
            self.calibrate(value, effects);
        }
        if commands & ADEN != 0 {
            self.enable(value, effects);
        }
        if commands & ADDIS != 0 {
            if self.bank[CR] & ADEN == 0 || self.bank[CR] & ADSTART != 0 {
                effects.violation(value, "ADDIS is set only while ADEN = 1 and ADSTART = 0");
            } else {
                self.bank[CR] |= ADDIS;
                self.command_at = now + STOP_CLOCKS * self.clock;
            }
        }
        if commands & ADSTART != 0 {
            self.start(value, effects);
        }
        if commands & ADSTP != 0 {
            if self.bank[CR] & ADSTART == 0 || self.bank[CR] & ADDIS != 0 {
                effects.violation(value, "ADSTP is set only while ADSTART = 1 and ADDIS = 0");
            } else {
                self.bank[CR] |= ADSTP;
                self.phase = Phase::Idle;
                self.phase_at = Ticks::MAX;
                self.command_at = now + STOP_CLOCKS * self.clock;
            }
        }
    }

    /// DEEPPWD, ADVREGEN and ADCALDIF.
    fn write_supply(&mut self, value: u32, effects: &mut Effects) {
        let bits = DEEPPWD | ADVREGEN | ADCALDIF;
        if (value ^ self.bank[CR]) & bits != 0 && self.bank[CR] & CR_COMMANDS != 0 {
            effects.violation(value, "DEEPPWD, ADVREGEN and ADCALDIF are written only while the ADC is disabled");
        }
        if value & ADVREGEN != 0 && self.bank[CR] & ADVREGEN == 0 {
            self.regulator_since = effects.now;
            if value & DEEPPWD != 0 {
                effects.violation(value, "ADVREGEN is set only after DEEPPWD is cleared");
            }
        }
        self.bank[CR] = self.bank[CR] & !bits | value & bits;
    }

    fn regulated(&self, now: Ticks) -> bool {
        self.bank[CR] & (ADVREGEN | DEEPPWD) == ADVREGEN && now - self.regulator_since >= REGULATOR_TICKS
    }

    fn calibrate(&mut self, value: u32, effects: &mut Effects) {
        if !self.regulated(effects.now) {
            effects.violation(value, "ADCAL is set only 20 µs after ADVREGEN");
        }
        if self.bank[CR] & CR_COMMANDS != 0 {
            effects.violation(value, "ADCAL is set only while the ADC is disabled");
            return;
        }
        self.bank[CR] |= ADCAL;
        self.command_at = effects.now + CALIBRATION_CLOCKS * self.clock;
    }

    fn enable(&mut self, value: u32, effects: &mut Effects) {
        let now = effects.now;
        if self.bank[CR] & CR_COMMANDS != 0 || !self.regulated(now) {
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
        self.bank[CR] |= ADEN;
        self.command_at = now + STABILISATION_CLOCKS * self.clock;
    }

    fn start(&mut self, value: u32, effects: &mut Effects) {
        if self.bank[CR] & (ADEN | ADDIS) != ADEN || self.bank[ISR] & ADRDY == 0 && self.command_at != Ticks::MAX {
            effects.violation(value, "ADSTART is set only while ADEN = 1, ADRDY = 1 and ADDIS = 0");
            return;
        }
        self.bank[CR] |= ADSTART;
        self.plan = self.plan_sequence();
        if !self.plan.is_triggered {
            self.begin(effects.now, 0);
        }
    }

    fn finish_command(&mut self, now: Ticks) {
        self.command_at = Ticks::MAX;
        if self.bank[CR] & ADCAL != 0 {
            self.bank[CR] &= !ADCAL;
            self.calibrated_at = Some(now);
            self.last_conversion = now;
        } else if self.bank[CR] & ADSTP != 0 {
            self.bank[CR] &= !(ADSTP | ADSTART);
            self.was_stopped = true;
        } else if self.bank[CR] & ADDIS != 0 {
            self.bank[CR] &= !(ADDIS | ADEN);
            self.bank[ISR] &= !ADRDY;
            self.was_stopped = false;
        } else if self.bank[CR] & ADEN != 0 {
            self.bank[ISR] |= ADRDY;
        }
    }
}
