//! Converters that share a clock, the common registers and interrupts.

use super::commands::*;
use super::{Adc, Phase};
use crate::faults::Fault;
use crate::peripherals::{Effects, Ticks, interrupt, request};

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
        let adcs = [Adc::new(1, request::ADC1), Adc::new(2, request::ADC2)];
        Self::new(adcs, [interrupt::ADC1_2; 2])
    }
}

impl AdcGroup<3> {
    /// ADC3, ADC4 and ADC5.
    pub fn adc345() -> Self {
        let adcs = [0, 1, 2].map(|index| Adc::new(3 + index, request::ADC3.after(index)));
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
pub(super) fn late_ticks(effects: &Effects, clock: u64) -> Ticks {
    if !effects.faults.has(Fault::TriggerPhase) {
        return 0;
    }
    (effects.clock_phase + clock - effects.now() % clock) % clock + clock.div_ceil(8)
}

fn prescaler(ccr: u32) -> u64 {
    PRESCALERS.get((ccr >> 18 & 0xF) as usize).copied().unwrap_or(1)
}

/// Ticks of a converter clock; 0: no clock, or none of whole ticks.
pub(super) fn clock_ticks(ccr: u32, kernel_half_ticks: u64) -> u64 {
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
