//! Converters that share a clock and the common registers.

use super::*;
use crate::st::LL;

/// Converters that share a clock and the common registers: ADC1 and ADC2, or ADC3 to ADC5.
#[derive(Debug)]
pub struct AdcGroup<const N: usize> {
    pub adcs: [Adc; N],
    ccr: u32,
    next: Ticks,
}

impl AdcGroup<2> {
    /// ADC1 and ADC2.
    pub fn adc12() -> Self {
        Self::new([Adc::new(1, LL::DMAMUX_REQ_ADC1), Adc::new(2, LL::DMAMUX_REQ_ADC2)])
    }
}

impl AdcGroup<3> {
    /// ADC3, ADC4 and ADC5.
    pub fn adc345() -> Self {
        Self::new([0, 1, 2].map(|index| Adc::new(3 + index, LL::DMAMUX_REQ_ADC3 + u32::from(index))))
    }
}

impl<const N: usize> AdcGroup<N> {
    fn new(adcs: [Adc; N]) -> Self {
        Self { adcs, ccr: 0, next: Ticks::MAX }
    }

    /// State after reset.
    pub fn reset(&mut self, effects: &mut Effects) {
        for adc in &mut self.adcs {
            effects.withdraw(adc.request);
            *adc = Adc::new(adc.number, adc.request);
        }
        self.ccr = 0;
        self.update();
    }

    pub fn read(&mut self, offset: u32, effects: &mut Effects) -> u32 {
        match offset {
            CCR => self.ccr,
            _ => match self.adcs.get_mut((offset / 0x100) as usize) {
                Some(adc) => adc.read(offset % 0x100, effects),
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
                    adc.clock = clock_ticks(self.ccr);
                    if offset % 0x100 == CR && value & (ADEN | ADCAL) != 0 && adc.clock == 0 {
                        effects.violation(value, "an ADC needs a clock (ADC_CCR.CKMODE)");
                    }
                    adc.write(offset % 0x100, value, effects);
                }
                None => effects.unmodelled(),
            },
        }
        self.update();
    }

    /// Tick of the next hold, result or end of a command.
    #[inline]
    pub fn next_event(&self) -> Ticks {
        self.next
    }

    /// Does what is due now. `sample` gives the code of (converter number, channel) held now.
    pub fn advance(&mut self, effects: &mut Effects, sample: &mut impl FnMut(u8, u8) -> u16) {
        let now = effects.now;
        for adc in &mut self.adcs {
            if adc.next == now {
                adc.advance(effects, sample);
                adc.next = adc.phase_at.min(adc.command_at);
            }
        }
        self.find_next();
    }

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

    /// A rising edge of TIM2's trigger output.
    pub fn trigger(&mut self, effects: &Effects) {
        for adc in &mut self.adcs {
            if adc.bank[CR] & (ADSTART | ADSTP) == ADSTART && adc.plan.is_triggered {
                adc.begin(effects.now, late_ticks(effects, adc.clock));
                adc.next = adc.phase_at.min(adc.command_at);
            }
        }
        self.find_next();
    }

    fn write_ccr(&mut self, value: u32, effects: &mut Effects) {
        let busy = self.adcs.iter().any(|adc| adc.bank[CR] & CR_COMMANDS != 0);
        if busy && (value ^ self.ccr) & ADC::CCR_CKMODE != 0 {
            effects.violation(value, "ADC_CCR.CKMODE is written only while all ADCs are disabled");
        }
        effects.unmodelled_bits(value & !CCR_MODELLED);
        self.ccr = value;
    }

    fn update(&mut self) {
        for adc in &mut self.adcs {
            adc.next = adc.phase_at.min(adc.command_at);
        }
        self.find_next();
    }

    #[inline]
    fn find_next(&mut self) {
        self.next = self.adcs.iter().map(|adc| adc.next).min().unwrap_or(Ticks::MAX);
    }
}

/// Fault trigger-phase: ticks to the next edge of the converters' clock, whose phase is that of the power-on, and an
/// eighth of a clock, rounded up.
fn late_ticks(effects: &Effects, clock: u64) -> Ticks {
    if !effects.faults.has(Fault::TriggerPhase) {
        return 0;
    }
    (effects.clock_phase + clock - effects.now % clock) % clock + clock.div_ceil(8)
}

/// Ticks of a converter clock, by CKMODE; 0: none, as the asynchronous clock is not modelled.
fn clock_ticks(ccr: u32) -> u64 {
    [0, 1, 2, 4][(ccr >> 16 & 3) as usize]
}

#[cfg(test)]
mod tests {
    use super::*;

    const SMP_24_5: u32 = 3;

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
            let end = effects.now + 1_000;
            while group.next_event() <= end {
                effects.now = group.next_event();
                group.advance(&mut effects, &mut |_, _| 0);
            }
            effects.now = end;
        }
        assert_eq!(effects.violations, []);
        assert_eq!(group.read(ISR, &mut effects), ADRDY);
        (group, effects)
    }

    /// Two ranks (IN1, IN6) at 24.5 clocks, oversampled ×2, triggered by TIM2.
    fn armed() -> (AdcGroup<2>, Effects) {
        let (mut group, mut effects) = enabled();
        for base in [0, 0x100] {
            group.write(base + SMPR1, SMP_24_5 << 3 | SMP_24_5 << 18, &mut effects);
            group.write(base + SQR1, 1 | 1 << 6 | 6 << 12, &mut effects);
            group.write(base + CFGR2, ROVSE, &mut effects);
            group.write(base + CFGR, RISING_TIM2 | DMAEN | 2, &mut effects);
            group.write(base + CR, ADVREGEN | ADEN | ADSTART, &mut effects);
        }
        (group, effects)
    }

    #[test]
    fn write_rules_are_watched() {
        let (mut group, mut effects) = armed();
        for (count, (offset, value)) in
            [(CFGR, 0), (CFGR2, 0), (SMPR1, 0), (SQR1, 0), (CCR, 2 << 16)].into_iter().enumerate()
        {
            group.write(offset, value, &mut effects);
            assert_eq!(effects.violation_count, count as u64 + 1, "register {offset:#x}");
        }
        let (mut group, mut effects) = (AdcGroup::adc12(), Effects::default());
        group.write(CCR, 3 << 16, &mut effects);
        group.write(CR, ADVREGEN, &mut effects);
        group.write(CR, ADVREGEN | ADCAL, &mut effects);
        assert_eq!(effects.violation_count, 1, "calibrated before the regulator is up");
    }

    /// At a quarter of the bus clock: the way to its next edge, and the eighth of a clock that the data sheet has more.
    #[test]
    fn the_fault_of_triggers_makes_them_late_by_the_phase_and_an_eighth_of_the_clock() {
        let (group, _) = enabled();
        let clock = group.adcs[0].clock;
        let faults = [Fault::TriggerPhase].into_iter().collect();
        let mut effects = Effects { faults, ..Effects::default() };
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
}
