use super::super::TICKS_PER_SECOND;
use super::group::{clock_ticks, late_ticks};
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
    assert_eq!(MIN_CLOCK_TICKS as f64, (tick_mhz / facts::number("f_ADC_single")).ceil());
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
    effects.faults = [Fault::TriggerPhase].into_iter().collect();
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
