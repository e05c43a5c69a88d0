//! What connects the board to a lab's clock: the line at its trigger input with the filter behind it, and the timer of its
//! frame output (TIM1; RM0440, "Advanced-control timers").

use std::collections::VecDeque;

use super::effects::{ALL, Bank, Register};
use super::{Effects, Ticks};
use crate::st::TIM::{
    ARR, BDTR, BDTR_MOE, CCER, CCER_CC3E, CCMR1, CCMR2, CCMR2_OC3PE, CCR1, CCR3, CNT, CR1, CR1_CEN, CR2, DIER, EGR,
    PSC, SMCR, SR, SR_UIF,
};
use crate::st::{LL, TIM1};

/// Samples of the filter, and clocks of the synchroniser ahead of it (RM0440, TIMx_CCMR1, IC1F: eight; an estimate: two).
const FILTER_TICKS: Ticks = 8 + 2;

/// A line whose edges come at ticks that are known beforehand.
#[derive(Debug, Default)]
pub struct TriggerLine {
    /// Edges to come, in order: the line is high from then on, or low.
    pub edges: VecDeque<(Ticks, bool)>,
    pub is_high: bool,
    filtered: bool,
    /// When the filter has seen the present level for long enough.
    settled_at: Option<Ticks>,
}

impl TriggerLine {
    pub fn next_event(&self) -> Ticks {
        let edge = self.edges.front().map(|edge| edge.0);
        edge.into_iter().chain(self.settled_at).min().unwrap_or(Ticks::MAX)
    }

    /// Whether an edge has come out of the filter `now`.
    pub fn advance(&mut self, now: Ticks) -> bool {
        let is_settled = self.settled_at.take_if(|at| *at <= now).is_some();
        let has_passed = is_settled && std::mem::replace(&mut self.filtered, self.is_high) != self.is_high;
        while let Some((_, is_high)) = self.edges.front().copied().filter(|edge| edge.0 <= now) {
            self.edges.pop_front();
            self.is_high = is_high;
            self.settled_at = Some(now + FILTER_TICKS);
        }
        has_passed
    }
}

const REGISTERS: &[Register] = &[
    (CR1, 1, 0, CR1_CEN),
    (CR2, 1, 0, 0),
    (SMCR, 1, 0, ALL),
    (DIER, 1, 0, 0),
    (SR, 1, 0, 0),
    (EGR, 1, 0, 0),
    (CCMR1, 1, 0, 0),
    (CCMR2, 1, 0, CCMR2_OC3PE | LL::TIM_OCMODE_PWM1),
    (CCER, 1, 0, CCER_CC3E),
    (CNT, 1, 0, 0xFFFF),
    (PSC, 1, 0, 0),
    (ARR, 1, 0xFFFF, 0xFFFF),
    (CCR1, 4, 0, 0xFFFF),
    (BDTR, 1, 0, BDTR_MOE),
];

/// TIM1, counting the triggers of TIM2; channel 3 is low, or in PWM mode 1.
#[derive(Debug)]
pub struct FrameTimer {
    bank: Bank,
    /// The compare value in force.
    compare: u32,
    pub is_high: bool,
    pub edges: Vec<(Ticks, bool)>,
}

impl Default for FrameTimer {
    fn default() -> Self {
        Self { bank: Bank::new(REGISTERS), compare: 0, is_high: false, edges: Vec::new() }
    }
}

impl FrameTimer {
    pub fn reset(&mut self) {
        *self = Self { edges: std::mem::take(&mut self.edges), ..Self::default() };
    }

    pub fn read(&self, offset: u32, effects: &mut Effects) -> u32 {
        self.bank.read(offset, effects)
    }

    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        match offset {
            EGR => {
                effects.unmodelled_bits(value & !SR_UIF);
                self.bank[CNT] = 0;
                self.compare = self.bank[CCR3];
            }
            SR => self.bank[SR] &= value,
            _ => self.bank.write(offset, value, effects),
        }
        if self.bank[CCMR2] & CCMR2_OC3PE == 0 {
            self.compare = self.bank[CCR3];
        }
        self.settle(effects.now);
    }

    /// A rising edge of TIM2's trigger output.
    pub fn trigger(&mut self, now: Ticks) {
        let counts = self.bank[SMCR] == (TIM1::by_TIM2_TRGO | LL::TIM_CLOCKSOURCE_EXT_MODE1);
        if self.bank[CR1] & CR1_CEN == 0 || !counts {
            return;
        }
        if self.bank[CNT] == self.bank[ARR] {
            self.bank[CNT] = 0;
            self.compare = self.bank[CCR3];
        } else {
            self.bank[CNT] = (self.bank[CNT] + 1) & 0xFFFF;
        }
        self.settle(now);
    }

    fn settle(&mut self, now: Ticks) {
        let is_driven = self.bank[BDTR] & BDTR_MOE != 0 && self.bank[CCER] & CCER_CC3E != 0;
        let is_pwm = self.bank[CCMR2] & LL::TIM_OCMODE_PWM1 == LL::TIM_OCMODE_PWM1;
        let is_high = is_driven && is_pwm && self.bank[CNT] < self.compare;
        if std::mem::replace(&mut self.is_high, is_high) != is_high {
            self.edges.push((now, is_high));
        }
    }
}
