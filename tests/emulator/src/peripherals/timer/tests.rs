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
fn updates_come_every_period_to_the_tick() {
    let (mut timer, mut effects) = (Timer::tim2(), Effects::starting_at(7));
    start(&mut timer, &mut effects, &[(PSC, 2), (ARR, 9), (EGR, 1), (SR, 0), (DIER, UDE), (CR1, CR1_CEN)]);
    let at = run(&mut timer, &mut effects, 100, take(Request::TIM2_UP));
    assert_eq!(at, [37, 67, 97]);
    assert_eq!(timer.count(100), 1);
    assert_eq!(timer.sr, 0x1F);
}

#[test]
fn preloaded_arr_lengthens_only_the_next_period() {
    let (mut timer, mut effects) = (Timer::tim2(), Effects::default());
    start(&mut timer, &mut effects, &[(ARR, 9), (DIER, UDE), (CR1, CR1_CEN | CR1_ARPE)]);
    start(&mut timer, &mut effects, &[(EGR, 1), (ARR, 19)]);
    effects.withdraw(Request::TIM2_UP);
    assert_eq!(run(&mut timer, &mut effects, 50, take(Request::TIM2_UP)), [10, 30, 50]);
    let (mut timer, mut effects) = (Timer::tim2(), Effects::default());
    start(&mut timer, &mut effects, &[(ARR, 9), (DIER, UDE), (CR1, CR1_CEN), (ARR, 19)]);
    assert_eq!(run(&mut timer, &mut effects, 50, take(Request::TIM2_UP)), [20, 40]);
}

#[test]
fn an_arr_below_the_count_is_met_after_the_wrap_only() {
    let (mut timer, mut effects) = (Timer::tim3(), Effects::default());
    start(&mut timer, &mut effects, &[(DIER, UDE), (CR1, CR1_CEN)]);
    effects.now = 100;
    timer.write(ARR, 49, &mut effects);
    assert!(run(&mut timer, &mut effects, 65_700, take(Request::TIM3_CH1)).is_empty());
    assert_eq!(timer.sr & UIF, UIF);
    assert_eq!(run(&mut timer, &mut effects, 65_750, take(Request(Request::TIM3_CH1.0 + 4))), [65_736]);
}

#[test]
fn compare_requests_and_reference_edges_come_at_the_match() {
    let (mut timer, mut effects) = (Timer::tim2(), Effects::default());
    // CH2: PWM mode 2, OC2REF on TRGO; CH4 requests.
    start(&mut timer, &mut effects, &[(ARR, 99), (CCMR1, 7 << 12), (CR2, 5 << 4), (DIER, UDE << 4)]);
    start(&mut timer, &mut effects, &[(CCR1 + 4, 30), (CCR4, 80)]);
    effects.take_triggers();
    start(&mut timer, &mut effects, &[(CR1, CR1_CEN)]);
    let rising = run(&mut timer, &mut effects, 250, |effects| effects.take_triggers() & 1 != 0);
    assert_eq!(rising, [30, 130, 230]);
    assert_eq!(timer.sr & 0b10100, 0b10100);
    assert_ne!(effects.pending_requests() >> (Request::TIM2_CH1.0 + 3) & 1, 0);
    timer.write(DIER, 0, &mut effects);
    assert_eq!(effects.pending_requests(), 0);
}

#[test]
fn interrupt_line_follows_flag_and_enable() {
    let (mut timer, mut effects) = (Timer::tim4(), Effects::default());
    start(&mut timer, &mut effects, &[(ARR, 9), (DIER, 1), (CR1, CR1_CEN)]);
    run(&mut timer, &mut effects, 10, |_| false);
    assert_eq!(effects.lines()[0], 1 << interrupt::TIM4);
    timer.write(SR, !UIF, &mut effects);
    assert_eq!(effects.lines()[0], 0);
}

#[test]
fn a_preset_clock_wraps_when_it_should() {
    let (mut timer, mut effects) = (Timer::tim5(), Effects::starting_at(1_000));
    start(&mut timer, &mut effects, &[(CR1, CR1_CEN)]);
    assert_eq!(timer.origin(), Some(1_000));
    timer.preset(u32::MAX - 9, &effects);
    assert_eq!(timer.next_event(), 1_010);
    run(&mut timer, &mut effects, 1_015, |_| false);
    assert_eq!(timer.count(1_015), 5);
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
