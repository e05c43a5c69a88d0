use super::*;
use crate::facts::{self, assert_facts};
use crate::faults::Faults;

/// HSI / 4 × 85 / 2.
const PLL_170_MHZ: u32 = 2 | 3 << 4 | 85 << 8 | 1 << 24;

#[test]
fn oscillators_become_ready_and_the_switch_follows() {
    let (mut rcc, mut effects) = (Rcc::new(), Effects::default());
    rcc.write(PLLCFGR, PLL_170_MHZ, false, &mut effects);
    rcc.write(CR, 1 << 8 | PLLON, false, &mut effects);
    assert_eq!(rcc.read(CR, &mut effects), 1 << 8 | 1 << 10 | PLLON | 1 << 25);
    rcc.write(CFGR, HPRE_HALF | 3, false, &mut effects);
    effects.now += HALF_SPEED_TICKS;
    rcc.write(CFGR, 3, false, &mut effects);
    assert_eq!(rcc.read(CFGR, &mut effects), 0b1111);
    assert_eq!((effects.violation_count(), effects.unmodelled_accesses().len()), (0, 0));
    rcc.write(PLLCFGR, PLL_170_MHZ + (1 << 8), false, &mut effects);
    rcc.write(CR, 1 << 8, false, &mut effects);
    assert_eq!(effects.violation_count(), 2);
}

#[test]
fn another_core_clock_is_unmodelled() {
    let (mut rcc, mut effects) = (Rcc::new(), Effects::default());
    rcc.write(PLLCFGR, PLL_170_MHZ - (1 << 8), false, &mut effects);
    rcc.write(CR, 1 << 8 | PLLON, false, &mut effects);
    rcc.write(CFGR, 3, false, &mut effects);
    assert_eq!(effects.unmodelled_accesses().len(), 1);
}

#[test]
fn the_clock_is_raised_by_way_of_half_the_bus_clock() {
    for (steps, broken) in [
        // (value of CFGR, ticks until then)
        (&[(HPRE_HALF | 3, 0), (3, HALF_SPEED_TICKS)][..], 0),
        (&[(HPRE_HALF | 3, 0), (3, HALF_SPEED_TICKS - 1)], 1),
        (&[(3, 0)], 1),
    ] {
        let (mut rcc, mut effects) = (Rcc::new(), Effects::default());
        rcc.write(PLLCFGR, PLL_170_MHZ, false, &mut effects);
        rcc.write(CR, 1 << 8 | PLLON, false, &mut effects);
        for &(value, ticks) in steps {
            effects.now += ticks;
            rcc.write(CFGR, value, false, &mut effects);
        }
        assert_eq!(effects.violation_count(), broken, "{steps:?}");
        assert!(rcc.is_at_full_speed());
    }
}

#[test]
fn the_crystal_takes_its_time_or_does_not_start() {
    for (silicon, is_ready) in [(Faults::default(), true), ([Fault::HseDead].into_iter().collect(), false)] {
        let (mut rcc, mut effects) = (Rcc::new(), Effects::default());
        effects.faults = silicon;
        rcc.write(CR, 1 << 8 | HSEON, false, &mut effects);
        assert_eq!(rcc.read(CR, &mut effects) & HSERDY, 0);
        effects.now += CRYSTAL_TICKS;
        assert_eq!(rcc.read(CR, &mut effects) & HSERDY != 0, is_ready);
    }
}

#[test]
fn backup_domain_is_guarded_and_survives() {
    let (mut rcc, mut effects) = (Rcc::new(), Effects::default());
    rcc.write(BDCR, 0x8200, false, &mut effects);
    assert_eq!((rcc.read(BDCR, &mut effects), effects.violation_count()), (0, 1));
    rcc.write(BDCR, 0x8200, true, &mut effects);
    rcc.reset(ResetCause::Pin);
    assert_eq!(rcc.read(BDCR, &mut effects), 0x8200);
}

#[test]
fn gates_and_reset_lines_match() {
    let (mut rcc, mut effects) = (Rcc::new(), Effects::default());
    let timer = |bit| Gate { register: APB1ENR1, bit };
    rcc.write(APB1ENR1, 0b1001, false, &mut effects);
    assert!(rcc.is_on(timer(3)) && !rcc.is_on(timer(1)));
    let pulled = rcc.write(0x38, 0b1000, false, &mut effects);
    assert!(pulled.includes(timer(3)) && !pulled.includes(timer(0)));
    assert!(rcc.write(0x38, 0b1000, false, &mut effects).is_empty());
}

#[test]
fn registers_are_those_of_st() {
    assert_facts!("RCC_TypeDef."; CR, ICSCR, CFGR, PLLCFGR, CIER, CIFR, CICR, AHB1RSTR, APB2RSTR, AHB1ENR, AHB2ENR);
    assert_facts!("RCC_TypeDef."; APB1ENR1, APB1ENR2, APB2ENR, AHB1SMENR, APB2SMENR, CCIPR, BDCR, CSR, CRRCR, CCIPR2);
    assert_facts!("RCC_CR_"; HSEON, HSERDY, PLLON);
    let pairs = [("HSION", "HSIRDY"), ("HSEON", "HSERDY"), ("PLLON", "PLLRDY")];
    let bit = |name: &str| facts::bits(&format!("RCC_CR_{name}"));
    assert_eq!(CR_READY, pairs.map(|(on, ready)| (bit(on), bit(ready))));
    assert_facts!("RCC_CFGR_"; SW, SW_PLL, HPRE, HPRE_HALF = "HPRE_DIV2");
    assert_eq!(PPRE, facts::bits("RCC_CFGR_PPRE1") | facts::bits("RCC_CFGR_PPRE2"));
    assert_facts!("RCC_PLLCFGR_"; PLLPEN, PLLQEN);
    let pllcfgr = |name: &str| facts::bits(&format!("RCC_PLLCFGR_{name}"));
    assert_eq!(PLLPEN_AND_DIVIDER, pllcfgr("PLLPEN") | pllcfgr("PLLP") | pllcfgr("PLLPDIV"));
    assert_facts!("RCC_"; BDRST = "BDCR_BDRST", RMVF = "CSR_RMVF", PINRSTF = "CSR_PINRSTF", BORRSTF = "CSR_BORRSTF");
    assert_facts!("RCC_"; SFTRSTF = "CSR_SFTRSTF", IWDGRSTF = "CSR_IWDGRSTF");
    let timers = ["TIM2EN", "TIM5EN"].map(|name| facts::bits(&format!("RCC_APB1ENR1_{name}")));
    assert_eq!(FRAME_TIMERS, timers[0] | timers[1]);
}

#[test]
fn clocks_are_those_of_data_sheet_and_board() {
    let hertz = |name| (facts::number(name) * 1e6) as u64;
    assert_eq!((HSI_HZ, HSE_HZ), (hertz("HSI16"), hertz("HSE_nucleo")));
    assert_eq!(CRYSTAL_TICKS as f64, facts::number("t_SU_HSE") * 1e-3 * TICKS_PER_SECOND as f64);
    assert_eq!(HALF_SPEED_TICKS as f64, facts::number("half_speed_time") * 1e-6 * TICKS_PER_SECOND as f64);
    let mut rcc = Rcc::new();
    let field = |name: &str, value: u32| value << facts::bits(&format!("RCC_PLLCFGR_{name}")).trailing_zeros();
    let loops = field("PLLM", 6 - 1) | field("PLLN", 85) | field("PLLR", 0) | field("PLLREN", 1);
    rcc.set(PLLCFGR, loops | facts::bits("RCC_PLLCFGR_PLLSRC_HSE"));
    assert_eq!(rcc.pll_hz(), hertz("f_HCLK"));
    rcc.set(PLLCFGR, loops | facts::bits("RCC_PLLCFGR_PLLSRC_HSI"));
    assert_eq!(rcc.pll_hz(), hertz("f_HCLK") * HSI_HZ / HSE_HZ);
}

#[test]
fn kernel_clocks_are_selected_by_st_s_bits() {
    let mut rcc = Rcc::new();
    let system_clock = |field: &str| 2 << facts::bits(&format!("RCC_CCIPR_{field}")).trailing_zeros();
    rcc.set(CCIPR, system_clock("ADC12SEL"));
    assert_eq!([0, 1].map(|group| rcc.adc_clock_half_ticks(group)), [2, 0]);
    rcc.set(CCIPR, system_clock("ADC345SEL"));
    assert_eq!([0, 1].map(|group| rcc.adc_clock_half_ticks(group)), [0, 2]);
    rcc.set(CRRCR, facts::bits("RCC_CRRCR_HSI48ON"));
    assert!(rcc.has_usb_clock());
    let ready = facts::bits("RCC_CRRCR_HSI48RDY");
    assert_eq!(rcc.read(CRRCR, &mut Effects::default()) & ready, ready);
    rcc.set(CCIPR, 1 << facts::bits("RCC_CCIPR_CLK48SEL").trailing_zeros());
    assert!(!rcc.has_usb_clock(), "01 is reserved");
}
