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

use super::{Effects, Request, TICKS_PER_SECOND, Ticks, interrupt};
use crate::silicon::Fault;

const ISR: u32 = 0x00;
const IER: u32 = 0x04;
const CR: u32 = 0x08;
const CFGR: u32 = 0x0C;
const CFGR2: u32 = 0x10;
const SMPR1: u32 = 0x14;
const SMPR2: u32 = 0x18;
const TR1: u32 = 0x20;
const TR3: u32 = 0x28;
const SQR1: u32 = 0x30;
const SQR4: u32 = 0x3C;
const DR: u32 = 0x40;
const DIFSEL: u32 = 0xB0;
const CALFACT: u32 = 0xB4;
/// Registers common to a group of converters, from the group's base.
const COMMON: u32 = 0x300;
const CSR: u32 = COMMON;
const CCR: u32 = COMMON + 0x08;

const ADRDY: u32 = 1;
const EOSMP: u32 = 1 << 1;
const EOC: u32 = 1 << 2;
const EOS: u32 = 1 << 3;
const OVR: u32 = 1 << 4;

const ADEN: u32 = 1;
const ADDIS: u32 = 1 << 1;
const ADSTART: u32 = 1 << 2;
const JADSTART: u32 = 1 << 3;
const ADSTP: u32 = 1 << 4;
const JADSTP: u32 = 1 << 5;
const ADVREGEN: u32 = 1 << 28;
const DEEPPWD: u32 = 1 << 29;
const ADCALDIF: u32 = 1 << 30;
const ADCAL: u32 = 1 << 31;
/// Bits of ADC_CR that software only sets and hardware clears.
const CR_COMMANDS: u32 = ADEN | ADDIS | ADSTART | JADSTART | ADSTP | JADSTP | ADCAL;

const DMAEN: u32 = 1;
const OVRMOD: u32 = 1 << 12;
const CONT: u32 = 1 << 13;
/// DMAEN, DMACFG, RES, EXTSEL, EXTEN, OVRMOD, CONT, and JQDIS (set after reset).
const CFGR_MODELLED: u32 = 0x8000_3FFF & !(1 << 2);
const ROVSE: u32 = 1;
/// ROVSE, OVSR, OVSS and ROVSM (without injected conversions both modes are the same).
const CFGR2_MODELLED: u32 = ROVSE | 0b111 << 2 | 0b1111 << 5 | 1 << 10;
/// CKMODE, PRESC, and the switches of the internal channels.
const CCR_MODELLED: u32 = 0b11 << 16 | 0b1111 << 18 | 0b111 << 22;
const CCR_CLOCK: u32 = 0b11 << 16 | 0b1111 << 18;

/// Twice the sampling time in converter clocks, by SMP code.
const SAMPLE_HALF_CLOCKS: [u64; 8] = [5, 13, 25, 49, 95, 185, 495, 1281];
/// Twice the duration of the successive approximation in clocks, by RES code.
const APPROXIMATION_HALF_CLOCKS: [u64; 4] = [25, 21, 17, 13];
const PRESCALERS: [u64; 12] = [1, 2, 4, 6, 8, 10, 12, 16, 32, 64, 128, 256];
/// Trigger to start of sampling, in clocks.
const TRIGGER_CLOCKS: u64 = 2;
/// Calibration, in clocks (STM32G474 data sheet, "ADC characteristics", t_CAL).
const CALIBRATION_CLOCKS: u64 = 116;
/// From ADEN to ADRDY: one conversion (data sheet, t_STAB), in clocks.
const STABILISATION_CLOCKS: u64 = 15;
/// From ADSTP or ADDIS to the end of the command, in clocks.
const STOP_CLOCKS: u64 = 2;
/// Wait between ADCAL cleared and ADEN, in clocks (RM0440, "Software procedure to enable the ADC").
const CALIBRATION_TO_ENABLE_CLOCKS: u64 = 4;
/// Start-up of the regulator: 20 µs (data sheet, t_ADCVREG_STUP).
const REGULATOR_TICKS: Ticks = 3_400;
/// Fault adc-stale: a conversion this long after the one before is wrong.
const STALE_TICKS: Ticks = TICKS_PER_SECOND / 1_000;
/// Fault adc-stale: by so many codes.
const STALE_CODES: u16 = 700;
/// Fault adc-neighbour: the most codes that a conversion is off by.
const NEIGHBOUR_CODES: u64 = 8;
/// Shortest clock period in ticks that the converter follows (60 MHz).
const SHORTEST_CLOCK_TICKS: u64 = 3;

/// What the converter does by itself next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Idle,
    /// The end of a sampling time.
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

/// One converter.
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
    missed_triggers: u64,
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
            missed_triggers: 0,
            swallow: false,
            was_stopped: false,
            last_conversion: 0,
        }
    }

    /// Triggers that found the converter at work and were lost, since the last reset.
    pub fn missed_triggers(&self) -> u64 {
        self.missed_triggers
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

    /// A write that changes nothing breaks no rule.
    fn while_stopped(&self, value: u32, before: u32, rule: &'static str, effects: &mut Effects) {
        if value != before && self.cr & ADSTART != 0 {
            effects.violation(value, rule);
        }
    }

    /// Writes ADC_CR.
    fn command(&mut self, value: u32, effects: &mut Effects) {
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
    fn write_supply(&mut self, value: u32, effects: &mut Effects) {
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

    fn regulated(&self, now: Ticks) -> bool {
        self.cr & (ADVREGEN | DEEPPWD) == ADVREGEN && now - self.regulator_since >= REGULATOR_TICKS
    }

    fn calibrate(&mut self, value: u32, effects: &mut Effects) {
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

    fn enable(&mut self, value: u32, effects: &mut Effects) {
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

    fn start(&mut self, value: u32, effects: &mut Effects) {
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
        if self.phase != Phase::Idle {
            self.missed_triggers += 1;
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
        let is_zero = std::mem::take(&mut self.was_stopped) && effects.silicon.has(Fault::AdcStop);
        let mut code = sample(self.number, if is_zero { 0 } else { rank.channel });
        if effects.now() - self.last_conversion > STALE_TICKS && effects.silicon.has(Fault::AdcStale) {
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

    fn finish_command(&mut self, now: Ticks) {
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

    fn interrupt(&self) -> bool {
        self.isr & self.ier != 0
    }
}

/// Converters that share a clock and the common registers: ADC1 and ADC2, or ADC3 to ADC5.
#[derive(Debug)]
pub struct AdcGroup<const N: usize> {
    adcs: [Adc; N],
    lines: [u8; N],
    ccr: u32,
    /// Period of the asynchronous clock in half ticks; 0: none is selected.
    kernel_half_ticks: u64,
    next: Ticks,
}

impl AdcGroup<2> {
    /// ADC1 and ADC2.
    pub fn adc12() -> Self {
        let adcs = [Adc::new(1, Request::ADC1), Adc::new(2, Request::ADC2)];
        Self::new(adcs, [interrupt::ADC1_2; 2])
    }
}

impl AdcGroup<3> {
    /// ADC3, ADC4 and ADC5.
    pub fn adc345() -> Self {
        let adcs = [0, 1, 2].map(|index| Adc::new(3 + index, Request(Request::ADC3.0 + index)));
        Self::new(adcs, [interrupt::ADC3, interrupt::ADC4, interrupt::ADC5])
    }
}

impl<const N: usize> AdcGroup<N> {
    fn new(adcs: [Adc; N], lines: [u8; N]) -> Self {
        Self { adcs, lines, ccr: 0, kernel_half_ticks: 0, next: Ticks::MAX }
    }

    /// State after reset; the clock selection belongs to RCC and stays.
    pub fn reset(&mut self, effects: &mut Effects) {
        for adc in &mut self.adcs {
            effects.withdraw(adc.request);
            *adc = Adc::new(adc.number, adc.request);
        }
        self.ccr = 0;
        self.update(effects);
    }

    /// Period of the asynchronous kernel clock that RCC_CCIPR selects, in half ticks; 0: none.
    pub fn set_kernel_clock(&mut self, half_ticks: u64) {
        self.kernel_half_ticks = half_ticks;
    }

    /// Converter `index` of the group.
    pub fn adc(&self, index: usize) -> &Adc {
        &self.adcs[index]
    }

    /// Converter `index` of the group, for fault injection.
    pub fn adc_mut(&mut self, index: usize) -> &mut Adc {
        &mut self.adcs[index]
    }

    /// Fault injection: sets OVR of converter `index`.
    pub fn force_overrun(&mut self, index: usize, effects: &mut Effects) {
        self.adcs[index].force_overrun();
        self.update(effects);
    }

    /// Value of a register.
    pub fn read(&mut self, offset: u32, effects: &mut Effects) -> u32 {
        match offset {
            CSR => self.status(),
            CCR => self.ccr,
            _ => match self.adcs.get_mut((offset / 0x100) as usize) {
                Some(adc) => {
                    let value = adc.read(offset % 0x100, effects);
                    if offset % 0x100 == DR {
                        self.update_lines(effects);
                    }
                    value
                }
                None => {
                    effects.unmodelled();
                    0
                }
            },
        }
    }

    /// Writes a register.
    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match offset {
            CCR => self.write_ccr(value, effects),
            _ => match self.adcs.get_mut((offset / 0x100) as usize) {
                Some(adc) => {
                    // The ratio of the clocks is fixed by the time a converter is commanded.
                    adc.clock = clock_ticks(self.ccr, self.kernel_half_ticks);
                    if offset % 0x100 == CR && value & (ADEN | ADCAL) != 0 && adc.clock == 0 {
                        effects.violation(value, "an ADC needs a clock (RCC_CCIPR.ADCxSEL or ADC_CCR.CKMODE)");
                    }
                    adc.write(offset % 0x100, value, effects);
                }
                None => effects.unmodelled(),
            },
        }
        self.update(effects);
    }

    /// Tick of the next hold, result or end of a command.
    #[inline]
    pub fn next_event(&self) -> Ticks {
        self.next
    }

    /// Does what is due now. `sample` gives the code of (converter number, channel) held now.
    pub fn advance(&mut self, effects: &mut Effects, sample: &mut impl FnMut(u8, u8) -> u16) {
        let now = effects.now();
        let mut quiet = true;
        for adc in &mut self.adcs {
            if adc.next == now {
                quiet &= adc.phase == Phase::Hold && adc.ier == 0;
                adc.advance(effects, sample);
                adc.next = adc.phase_at.min(adc.command_at);
            }
        }
        self.find_next();
        if !quiet {
            self.update_lines(effects);
        }
    }

    /// Whether one of the converters samples or converts.
    #[inline]
    pub fn is_converting(&self) -> bool {
        self.adcs.iter().any(|adc| adc.phase != Phase::Idle)
    }

    /// Fault adc-neighbour: converters of the other group are at work, too.
    pub fn disturb(&mut self, effects: &mut Effects) {
        for adc in self.adcs.iter_mut().filter(|adc| adc.phase != Phase::Idle) {
            adc.sum += effects.chance.within(0..=NEIGHBOUR_CODES) as u32;
        }
    }

    /// Timer trigger edges, as `Effects::take_triggers` returns them.
    pub fn trigger(&mut self, edges: u16, effects: &Effects) {
        for adc in &mut self.adcs {
            if adc.cr & (ADSTART | ADSTP) == ADSTART && adc.plan.trigger_mask & edges != 0 {
                adc.begin(effects.now(), late_ticks(effects, adc.clock));
                adc.next = adc.phase_at.min(adc.command_at);
            }
        }
        self.find_next();
    }

    /// ADC_CSR: the flags of both converters of a pair.
    fn status(&self) -> u32 {
        self.adcs.iter().take(2).enumerate().map(|(index, adc)| adc.isr << (16 * index)).sum()
    }

    fn write_ccr(&mut self, value: u32, effects: &mut Effects) {
        let busy = self.adcs.iter().any(|adc| adc.cr & CR_COMMANDS != 0);
        if busy && (value ^ self.ccr) & CCR_CLOCK != 0 {
            effects.violation(value, "ADC_CCR.CKMODE and PRESC are written only while all ADCs are disabled");
        }
        effects.unmodelled_bits(value & !CCR_MODELLED);
        self.ccr = value;
        let clock = clock_ticks(value, self.kernel_half_ticks);
        if clock == 0 && value >> 16 & 3 == 0 && !(self.kernel_half_ticks * prescaler(value)).is_multiple_of(2) {
            // Only whole ticks are modelled.
            effects.unmodelled();
        }
    }

    fn update(&mut self, effects: &mut Effects) {
        for adc in &mut self.adcs {
            adc.next = adc.phase_at.min(adc.command_at);
        }
        self.find_next();
        self.update_lines(effects);
    }

    #[inline]
    fn find_next(&mut self) {
        self.next = self.adcs.iter().map(|adc| adc.next).min().unwrap_or(Ticks::MAX);
    }

    fn update_lines(&self, effects: &mut Effects) {
        for line in self.lines {
            let level = self.adcs.iter().zip(self.lines).any(|(adc, other)| other == line && adc.interrupt());
            effects.set_line(line, level);
        }
    }
}

/// Fault trigger-phase: ticks to the next edge of the converters' clock, whose phase is that of the power-on, and an
/// eighth of a clock, rounded up.
fn late_ticks(effects: &Effects, clock: u64) -> Ticks {
    if !effects.silicon.has(Fault::TriggerPhase) {
        return 0;
    }
    (effects.clock_phase + clock - effects.now() % clock) % clock + clock.div_ceil(8)
}

fn prescaler(ccr: u32) -> u64 {
    PRESCALERS.get((ccr >> 18 & 0xF) as usize).copied().unwrap_or(1)
}

/// Ticks of a converter clock; 0: no clock, or none of whole ticks.
fn clock_ticks(ccr: u32, kernel_half_ticks: u64) -> u64 {
    match ccr >> 16 & 3 {
        0 => {
            let half_ticks = kernel_half_ticks * prescaler(ccr);
            if half_ticks.is_multiple_of(2) { half_ticks / 2 } else { 0 }
        }
        1 => 1,
        2 => 2,
        _ => 4,
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Edge, Trigger};
    use super::*;
    use crate::facts::{self, assert_facts};

    const SMP_24_5: u32 = 3;
    const EXTERNAL: u32 = 1 << 10 | 11 << 5;

    /// ADC1 and ADC2 enabled at HCLK/4 without a broken rule.
    fn enabled() -> (AdcGroup<2>, Effects) {
        let (mut group, mut effects) = (AdcGroup::adc12(), Effects::default());
        group.write(CCR, 3 << 16, &mut effects);
        for base in [0, 0x100] {
            group.write(base + CR, 0, &mut effects);
            group.write(base + CR, ADVREGEN, &mut effects);
        }
        effects.now = 10_000;
        for command in [ADCAL, ADEN] {
            for base in [0, 0x100] {
                group.write(base + CR, ADVREGEN | command, &mut effects);
            }
            drain(&mut group, &mut effects, 1_000);
        }
        assert_eq!(effects.violations(), []);
        assert_eq!(group.read(ISR, &mut effects), ADRDY);
        (group, effects)
    }

    /// Lets `ticks` pass; returns (tick, ADC, channel) of every hold.
    fn drain(group: &mut AdcGroup<2>, effects: &mut Effects, ticks: Ticks) -> Vec<(Ticks, u8, u8)> {
        let end = effects.now + ticks;
        let mut holds = Vec::new();
        while group.next_event() <= end {
            effects.now = group.next_event();
            let now = effects.now;
            group.advance(effects, &mut |adc, channel| {
                holds.push((now, adc, channel));
                100 * u16::from(channel) + holds.len() as u16
            });
        }
        effects.now = end;
        holds
    }

    /// Two ranks (IN1, IN6) at 24.5 clocks, oversampled ×2, triggered by TIM2.
    fn armed() -> (AdcGroup<2>, Effects) {
        let (mut group, mut effects) = enabled();
        for base in [0, 0x100] {
            group.write(base + SMPR1, SMP_24_5 << 3 | SMP_24_5 << 18, &mut effects);
            group.write(base + SQR1, 1 | 1 << 6 | 6 << 12, &mut effects);
            group.write(base + CFGR2, ROVSE, &mut effects);
            group.write(base + CFGR, EXTERNAL | DMAEN | 2, &mut effects);
            group.write(base + CR, ADVREGEN | ADEN | ADSTART, &mut effects);
        }
        (group, effects)
    }

    fn fire(group: &mut AdcGroup<2>, effects: &mut Effects) {
        effects.trigger(Trigger::Tim2, Edge::Rising);
        let edges = effects.take_triggers();
        group.trigger(edges, effects);
    }

    #[test]
    fn oversampled_sequence_holds_at_the_calculated_ticks() {
        let (mut group, mut effects) = armed();
        let start = effects.now();
        fire(&mut group, &mut effects);
        let mut holds = Vec::new();
        for _ in 0..1_000 {
            holds.extend(drain(&mut group, &mut effects, 1));
            for adc in 0..2 {
                if effects.pending_requests() & 1 << [5, 36][adc] != 0 {
                    effects.withdraw([Request::ADC1, Request::ADC2][adc]);
                    holds.push((effects.now(), 0, group.read(0x100 * adc as u32 + DR, &mut effects) as u8));
                }
            }
        }
        // 8 ticks to the start, 98 of sampling, 50 of conversion, 148 to the next hold.
        let expected = [106, 254, 402, 550].map(|at| start + at);
        let of_adc = |number| holds.iter().filter(|hold| hold.1 == number).map(|hold| hold.0).collect::<Vec<_>>();
        assert_eq!(of_adc(1), expected);
        assert_eq!(of_adc(2), expected);
        assert_eq!(of_adc(0), [304, 304, 600, 600].map(|at| start + at));
        assert_eq!(group.read(ISR, &mut effects) & (EOS | OVR), EOS);
    }

    #[test]
    fn results_are_sums_and_unfetched_ones_overrun() {
        let (mut group, mut effects) = armed();
        fire(&mut group, &mut effects);
        drain(&mut group, &mut effects, 400);
        assert_eq!(effects.pending_requests(), 1 << 5 | 1 << 36);
        drain(&mut group, &mut effects, 400);
        assert_eq!(group.read(ISR, &mut effects) & OVR, OVR);
        // Old data are kept (OVRMOD = 0): holds 1 and 3 of channel 1.
        assert_eq!(group.read(DR, &mut effects), 100 + 1 + 100 + 3);
        effects.withdraw(Request::ADC1);
        effects.withdraw(Request::ADC2);
        fire(&mut group, &mut effects);
        drain(&mut group, &mut effects, 1_000);
        assert_eq!(effects.pending_requests(), 0, "no request before OVR is cleared");
    }

    #[test]
    fn overrun_interrupts_and_can_be_forced() {
        let (mut group, mut effects) = enabled();
        group.write(0x100 + IER, OVR, &mut effects);
        assert_eq!(effects.lines()[0], 0);
        group.force_overrun(1, &mut effects);
        assert_eq!(effects.lines()[0], 1 << interrupt::ADC1_2);
        group.write(0x100 + ISR, OVR, &mut effects);
        assert_eq!(effects.lines()[0], 0);
    }

    #[test]
    fn a_swallowed_request_is_an_overrun_later() {
        let (mut group, mut effects) = armed();
        group.adc_mut(0).swallow_request();
        fire(&mut group, &mut effects);
        drain(&mut group, &mut effects, 1_000);
        assert_eq!(effects.pending_requests(), 1 << 36);
        assert_eq!(group.read(ISR, &mut effects) & OVR, OVR);
    }

    #[test]
    fn a_trigger_during_a_sequence_is_missed() {
        let (mut group, mut effects) = armed();
        fire(&mut group, &mut effects);
        drain(&mut group, &mut effects, 100);
        fire(&mut group, &mut effects);
        assert_eq!(drain(&mut group, &mut effects, 1_000).len(), 8);
        assert_eq!(group.adc(0).missed_triggers(), 1);
    }

    #[test]
    fn software_start_converts_once() {
        let (mut group, mut effects) = enabled();
        group.write(SQR1, 4 << 6, &mut effects);
        group.write(CR, ADVREGEN | ADEN | ADSTART, &mut effects);
        assert_eq!(drain(&mut group, &mut effects, 1_000).len(), 1);
        assert_eq!(group.read(CR, &mut effects), ADVREGEN | ADEN);
        assert_eq!(group.read(DR, &mut effects), 401);
    }

    #[test]
    fn stop_ends_a_sequence() {
        let (mut group, mut effects) = armed();
        fire(&mut group, &mut effects);
        drain(&mut group, &mut effects, 200);
        group.write(CR, ADVREGEN | ADEN | ADSTART | ADSTP, &mut effects);
        assert_eq!(group.read(CR, &mut effects) & ADSTP, ADSTP);
        let holds = drain(&mut group, &mut effects, 1_000);
        assert!(holds.iter().all(|hold| hold.1 == 2));
        assert_eq!(group.read(CR, &mut effects) & (ADSTP | ADSTART), 0);
    }

    #[test]
    fn write_rules_are_watched() {
        let (mut group, mut effects) = armed();
        for (count, (offset, value)) in
            [(CFGR, 0), (CFGR2, 0), (SMPR1, 0), (SQR1, 0), (DIFSEL, 2), (CCR, 2 << 16)].into_iter().enumerate()
        {
            group.write(offset, value, &mut effects);
            assert_eq!(effects.violation_count(), count as u64 + 1, "register {offset:#x}");
        }
        let (mut group, mut effects) = (AdcGroup::adc12(), Effects::default());
        group.write(CCR, 3 << 16, &mut effects);
        group.write(CR, ADVREGEN, &mut effects);
        group.write(CR, ADVREGEN | ADCAL, &mut effects);
        assert_eq!(effects.violation_count(), 1, "calibrated before the regulator is up");
    }

    #[test]
    fn asynchronous_clock_counts_half_ticks() {
        assert_eq!(clock_ticks(0, 0), 0);
        assert_eq!(clock_ticks(2 << 18, 2), 4);
        assert_eq!(clock_ticks(1 << 18, 7), 7);
        assert_eq!(clock_ticks(0, 7), 0);
    }

    #[test]
    fn registers_and_times_are_those_of_st() {
        assert_facts!("ADC_TypeDef."; ISR, IER, CR, CFGR, CFGR2, SMPR1, SMPR2, TR1, TR3, SQR1, SQR4, DR, DIFSEL, CALFACT);
        let common = facts::bits("ADC12_COMMON_BASE") - facts::bits("ADC1_BASE");
        assert_eq!(CSR, common + facts::bits("ADC_Common_TypeDef.CSR"));
        assert_eq!(CCR, common + facts::bits("ADC_Common_TypeDef.CCR"));
        assert_facts!("ADC_ISR_"; ADRDY, EOSMP, EOC, EOS, OVR);
        assert_facts!("ADC_CR_"; ADEN, ADDIS, ADSTART, JADSTART, ADSTP, JADSTP, ADVREGEN, DEEPPWD, ADCALDIF, ADCAL);
        assert_facts!("ADC_CFGR_"; DMAEN, OVRMOD, CONT);
        let fields = ["DMAEN", "DMACFG", "RES", "EXTSEL", "EXTEN", "OVRMOD", "CONT", "JQDIS"];
        assert_eq!(CFGR_MODELLED, fields.map(|field| facts::bits(&format!("ADC_CFGR_{field}"))).iter().sum());
        assert_facts!("ADC_CFGR2_"; ROVSE);
        let fields = ["ROVSE", "OVSR", "OVSS", "ROVSM"];
        assert_eq!(CFGR2_MODELLED, fields.map(|field| facts::bits(&format!("ADC_CFGR2_{field}"))).iter().sum());
        let [ckmode, prescaler] = ["CKMODE", "PRESC"].map(|field| facts::bits(&format!("ADC_CCR_{field}")));
        assert_eq!(CCR_CLOCK, ckmode | prescaler);
        let switches = ["VREFEN", "VSENSESEL", "VBATSEL"].map(|field| facts::bits(&format!("ADC_CCR_{field}")));
        assert_eq!(CCR_MODELLED, CCR_CLOCK | switches.iter().sum::<u32>());

        let half_clocks = |name: &str| (2.0 * facts::number(name)) as u64;
        let sampling = [0, 1, 2, 3, 4, 5, 6, 7].map(|code| half_clocks(&format!("sampling_clocks_{code}")));
        assert_eq!(SAMPLE_HALF_CLOCKS, sampling);
        let approximation = [12, 10, 8, 6].map(|bits| half_clocks(&format!("approximation_clocks_{bits}_bits")));
        assert_eq!(APPROXIMATION_HALF_CLOCKS, approximation);
        assert_eq!(CALIBRATION_CLOCKS, u64::from(facts::bits("t_CAL")));
        let conversion = sampling[0] + approximation[0];
        assert_eq!(2 * STABILISATION_CLOCKS, u64::from(facts::bits("t_STAB")) * conversion);
        assert_eq!(CALIBRATION_TO_ENABLE_CLOCKS, u64::from(facts::bits("calibration_to_enable_clocks")));
        let us = |name| (facts::number(name) * TICKS_PER_SECOND as f64 / 1e6) as Ticks;
        assert_eq!(REGULATOR_TICKS, us("t_ADCVREG_STUP"));
        assert_eq!(STALE_TICKS, 1_000 * us("T_TRIG"));
        let tick_mhz = TICKS_PER_SECOND as f64 / 1e6;
        assert_eq!(SHORTEST_CLOCK_TICKS as f64, (tick_mhz / facts::number("f_ADC_single")).ceil());
    }

    /// Without fault trigger-phase the latency is that of the data sheet in whole clocks; the fault adds the eighth that
    /// is left at a quarter of the bus clock, and the way to the clock's next edge.
    #[test]
    fn the_triggers_latency_is_that_of_the_data_sheet_less_an_eighth() {
        let latency = facts::number("t_LATR_ckmode_11");
        assert_eq!((TRIGGER_CLOCKS as f64, latency.fract()), (latency.trunc(), 0.125));
        let (group, _) = enabled();
        let clock = group.adc(0).clock;
        let mut effects = Effects::default();
        effects.silicon = [Fault::TriggerPhase].into_iter().collect();
        let mut late: Vec<_> = (0..clock)
            .map(|now| {
                effects.now = now;
                late_ticks(&effects, clock)
            })
            .collect();
        late.sort_unstable();
        // Half a tick in whole ones, and up to three.
        assert_eq!(late, [1, 2, 3, 4]);
    }

    #[test]
    fn triggers_are_selected_by_st_s_numbers() {
        for (index, timer) in ["TIM2", "TIM3", "TIM4"].into_iter().enumerate() {
            let (mut group, mut effects) = enabled();
            let select = facts::bits(&format!("LL_ADC_REG_TRIG_EXT_{timer}_TRGO")) & facts::bits("ADC_CFGR_EXTSEL");
            group.write(CFGR, select | facts::bits("LL_ADC_REG_TRIG_EXT_RISING"), &mut effects);
            assert_eq!(group.adc(0).trigger_mask(), 1 << (2 * index), "{timer}");
        }
        for (divider, mode) in [(1, 1), (2, 2), (4, facts::bits("LL_ADC_CLOCK_SYNC_PCLK_DIV4") >> 16)] {
            assert_eq!(clock_ticks(mode << 16, 0), divider);
        }
    }
}
