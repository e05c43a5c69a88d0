use super::*;
use crate::facts::assert_facts;

/// Runs `timer` to `end` and returns the ticks at which `seen` became true.
fn run(timer: &mut Timer, effects: &mut Effects, end: Ticks, mut seen: impl FnMut(&mut Effects) -> bool) -> Vec<Ticks> {
    let mut at = Vec::new();
    while timer.next_event() <= end {
        effects.now = timer.next_event();
        timer.advance(effects);
        if seen(effects) {
            at.push(effects.now);
        }
    }
    effects.now = end;
    at
}

fn take(request: Request) -> impl FnMut(&mut Effects) -> bool {
    move |effects| {
        let pending = effects.pending_requests() >> request.0 & 1 != 0;
        effects.withdraw(request);
        pending
    }
}

fn start(timer: &mut Timer, effects: &mut Effects, registers: &[(u32, u32)]) {
    for &(offset, value) in registers {
        timer.write(offset, value, effects);
    }
}

#[test]
fn preloaded_arr_lengthens_only_the_next_period() {
    let (mut timer, mut effects) = (Timer::new(0), Effects::default());
    start(&mut timer, &mut effects, &[(ARR, 9), (DIER, UDE), (CR1, CR1_CEN | CR1_ARPE)]);
    start(&mut timer, &mut effects, &[(EGR, 1), (ARR, 19)]);
    effects.withdraw(request::TIM2_CH1.after(4));
    assert_eq!(run(&mut timer, &mut effects, 50, take(request::TIM2_CH1.after(4))), [10, 30, 50]);
    let (mut timer, mut effects) = (Timer::new(0), Effects::default());
    start(&mut timer, &mut effects, &[(ARR, 9), (DIER, UDE), (CR1, CR1_CEN), (ARR, 19)]);
    assert_eq!(run(&mut timer, &mut effects, 50, take(request::TIM2_CH1.after(4))), [20, 40]);
}

#[test]
fn an_arr_below_the_count_is_met_after_the_wrap_only() {
    let (mut timer, mut effects) = (Timer::new(1), Effects::default());
    start(&mut timer, &mut effects, &[(DIER, UDE), (CR1, CR1_CEN)]);
    effects.now = 100;
    timer.write(ARR, 49, &mut effects);
    assert!(run(&mut timer, &mut effects, 65_700, take(request::TIM3_CH1)).is_empty());
    assert_eq!(timer.sr & UIF, UIF);
    assert_eq!(run(&mut timer, &mut effects, 65_750, take(request::TIM3_CH1.after(4))), [65_736]);
}

#[test]
fn registers_are_those_of_st() {
    assert_facts!("TIM_TypeDef."; CR1, CR2, SMCR, DIER, SR, EGR, CCMR1, CCMR2, CCER, CNT, PSC, ARR, CCR1, CCR4);
    assert_facts!("TIM_"; CR1_CEN, CR1_UDIS, CR1_URS, CR1_ARPE, CR1_UIFREMAP, CR2_CCDS);
    // MMS[3], for encoders, stands apart.
    assert_eq!(CR2_MMS, crate::facts::bits("TIM_CR2_MMS") & 0xFFFF);
    assert_facts!("TIM_"; UIF = "SR_UIF", UDE = "DIER_UDE");
    assert_eq!(FLAGS + 1, 2 * crate::facts::bits("TIM_SR_CC4IF"));
}
