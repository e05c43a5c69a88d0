//! General-purpose timers TIM2 to TIM5 (RM0440, "General-purpose timers").
//!
//! Modelled: up-counting with prescaler, auto-reload and compare registers with or without
//! preload, update and compare flags, interrupts and DMA requests, the reference signals
//! OC1REF–OC4REF of PWM mode 2, which may be TIM2's trigger output TRGO, TIM3's reset by it, and channel 2 capturing both
//! edges of its pin. Not modelled: other captures, other counting modes, other compare, master and slave modes, one-pulse
//! mode, dithering, and the output pins. A debugger may halt a timer.
//!
//! The counter is not stepped. It follows from the tick at which it was zero:
//! CNT = (now − zero_at) / (PSC + 1). The timer asks to be called at the next compare match
//! or overflow, so flags, requests and triggers come at their exact ticks.

use super::effects::{ALL, Bank, Register};
use super::{Effects, Ticks};
use crate::st::TIM::{
    self, ARR, CCER, CCER_CC2E, CCER_CC2NP, CCER_CC2P, CCMR1, CCMR1_CC2S, CCMR1_CC2S_0, CCMR2, CCR1, CCR2, CCR4, CNT,
    CR1, CR1_ARPE, CR1_CEN, CR1_URS, CR2, DIER, DIER_UDE as UDE, EGR, PSC, SMCR, SR, SR_CC2IF, SR_CC2OF, SR_UIF as UIF,
};
use crate::st::{LL, TIM2, TIM3, TIM4, TIM5};

const CR1_MODELLED: u32 = CR1_CEN | CR1_URS | CR1_ARPE;
/// Without MMS[3], which is for encoders.
const CR2_MMS: u32 = TIM::CR2_MMS & 0xFFFF;
/// SMCR: reset mode (SMS = 4) by ITR1 (TS = 1), the trigger of TIM2 for TIM3 (RM0440, "TIM3 internal trigger connection").
const RESET_BY_ITR1: u32 = 4 | 1 << 4;
/// UIF and CC1IF to CC4IF.
const FLAGS: u32 = 2 * TIM::SR_CC4IF - 1;
/// Enable bits of the five interrupts and five DMA requests.
const DIER_MODELLED: u32 = FLAGS | FLAGS << 8;
/// CCMR1 and CCER while channel 2 captures both edges of its pin, behind a filter of eight samples at the timer's clock.
const CAPTURE: u32 = CCMR1_CC2S_0 | (LL::TIM_IC_FILTER_FDIV1_N8 >> 16) << 8;
const BOTH_EDGES: u32 = CCER_CC2E | CCER_CC2P | CCER_CC2NP;
/// OCxPE and OCxM. OCxCE and OCxFE need pins; OCxM bit 3 selects modes beyond PWM 2.
const CCMR_MODELLED: u32 = 0x7878;

const REGISTERS: &[Register] = &[
    (CR1, 1, 0, CR1_MODELLED),
    (CR2, 1, 0, CR2_MMS),
    (SMCR, 1, 0, 0),
    (DIER, 1, 0, DIER_MODELLED),
    (SR, 1, 0, 0),
    (EGR, 1, 0, 0),
    (CCMR1, 2, 0, CCMR_MODELLED),
    (CCER, 1, 0, ALL),
    (PSC, 1, 0, 0xFFFF),
    (ARR, 1, 0, 0),
    (CCR1, 4, 0, 0),
];

#[derive(Clone, Copy, Debug, Default)]
struct Wiring {
    interrupt: u32,
    /// DMA request of compare channel 1; channels 2 to 4 and the update follow.
    first_request: u32,
    /// Largest count: 16 or 32 bits.
    maximum: u32,
}

#[derive(Debug, Default)]
pub struct Timer {
    wiring: Wiring,
    bank: Bank,
    psc_active: u32,
    arr_active: u32,
    ccr_active: [u32; 4],
    /// OC1REF to OC4REF.
    reference: [bool; 4],
    /// Tick at which the running counter was zero (modulo 2⁶⁴).
    zero_at: Ticks,
    /// The counter while it stands.
    held: u32,
    /// Compare matches up to this count of the present period are done.
    done: u32,
    /// Last count of the present period: ARR, or the maximum if ARR was passed already.
    top: u32,
    /// Tick at which the counter, never wrapping, would have been zero.
    origin: Option<Ticks>,
    is_halted: bool,
    next: Ticks,
}

impl Timer {
    /// TIM2 to TIM5 for `index` 0 to 3; the outer two count 32 bits.
    pub fn new(index: usize) -> Self {
        let wiring = |interrupt, first_request, maximum| Wiring { interrupt, first_request, maximum };
        Self::at_reset(match index {
            0 => wiring(TIM2::IRQn, LL::DMAMUX_REQ_TIM2_CH1, u32::MAX),
            1 => wiring(TIM3::IRQn, LL::DMAMUX_REQ_TIM3_CH1, 0xFFFF),
            2 => wiring(TIM4::IRQn, LL::DMAMUX_REQ_TIM4_CH1, 0xFFFF),
            _ => wiring(TIM5::IRQn, LL::DMAMUX_REQ_TIM5_CH1, u32::MAX),
        })
    }

    fn at_reset(wiring: Wiring) -> Self {
        let mut bank = Bank::new(REGISTERS);
        bank[ARR] = wiring.maximum;
        Self { wiring, bank, arr_active: wiring.maximum, top: wiring.maximum, next: Ticks::MAX, ..Self::default() }
    }

    pub fn reset(&mut self, effects: &mut Effects) {
        self.withdraw(self.bank[DIER], effects);
        *self = Self::at_reset(self.wiring);
        self.update_line(effects);
    }

    pub fn read(&mut self, offset: u32, effects: &mut Effects) -> u32 {
        match offset {
            CNT => self.count(effects.now),
            CCR2 if self.captures() => {
                // What was captured has been read.
                self.bank[SR] &= !SR_CC2IF;
                self.bank[CCR2]
            }
            _ => self.bank.read(offset, effects),
        }
    }

    /// Whether channel 2 captures edges of its pin.
    pub fn captures(&self) -> bool {
        self.bank[CCMR1] & CCMR1_CC2S != 0
    }

    /// An edge behind the filter of channel 2.
    pub fn capture(&mut self, effects: &mut Effects) {
        if !self.captures() || self.bank[CCER] & CCER_CC2E == 0 {
            return;
        }
        if self.bank[SR] & SR_CC2IF != 0 {
            self.bank[SR] |= SR_CC2OF;
        }
        self.bank[CCR2] = self.count(effects.now);
        self.raise(2, effects);
        self.update_line(effects);
    }

    pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        self.done = self.count(effects.now);
        match offset {
            CR1 => self.write_cr1(value, effects),
            CR2 => {
                effects.unmodelled_bits(if self.is_tim2() && value & 0x40 != 0 { 0 } else { value });
                self.bank.write(CR2, value, effects);
            }
            SMCR => {
                effects.unmodelled_bits(if self.wiring.interrupt == TIM3::IRQn && value == RESET_BY_ITR1 {
                    0
                } else {
                    value
                });
                self.bank[SMCR] = value;
            }
            DIER => self.write_dier(value, effects),
            SR => self.bank[SR] &= value,
            EGR => self.generate(value, effects),
            CCMR1 | CCMR2 => self.write_ccmr(offset, value, effects),
            CCER => {
                if self.captures() && value & CCER_CC2E != 0 {
                    effects.unmodelled_bits(!value & BOTH_EDGES);
                }
                self.bank.write(offset, value, effects);
            }
            // A narrow write is repeated over the word.
            PSC => self.bank.write(offset, value & 0xFFFF, effects),
            CNT => self.preset(value & self.wiring.maximum, effects),
            ARR => self.write_arr(value & self.wiring.maximum),
            CCR1..=CCR4 => self.write_ccr(((offset - CCR1) / 4) as usize, value & self.wiring.maximum, effects),
            _ => effects.unmodelled_bits(value),
        }
        self.update_line(effects);
        self.schedule();
    }

    /// A rising edge of TIM2's trigger output: a slave begins anew.
    pub fn trigger(&mut self, effects: &mut Effects) {
        if self.bank[SMCR] == RESET_BY_ITR1 && self.running() {
            self.begin_anew(effects);
            self.schedule();
        }
    }

    /// A debugger halts the counter, or lets it go on.
    pub fn halt(&mut self, is_halted: bool, effects: &Effects) {
        if self.is_halted == is_halted {
            return;
        }
        if is_halted {
            self.held = self.count(effects.now);
        }
        self.is_halted = is_halted;
        if !is_halted && self.bank[CR1] & CR1_CEN != 0 {
            let done = self.done;
            self.restart(self.held, effects.now);
            self.done = done;
        }
        self.schedule();
    }

    #[inline]
    pub fn next_event(&self) -> Ticks {
        self.next
    }

    pub fn advance(&mut self, effects: &mut Effects) {
        let elapsed = effects.now.wrapping_sub(self.zero_at) / self.period();
        let reached = elapsed.min(u64::from(self.top)) as u32;
        let before = std::mem::replace(&mut self.done, reached);
        for channel in 0..4 {
            let compare = self.ccr_active[channel];
            if before < compare && compare <= reached {
                self.compare_match(channel, effects);
            }
        }
        if elapsed > u64::from(self.top) {
            self.overflow(effects);
        }
        self.update_line(effects);
        self.schedule();
    }

    pub fn count(&self, now: Ticks) -> u32 {
        if self.running() { (now.wrapping_sub(self.zero_at) / self.period()) as u32 } else { self.held }
    }

    /// Sets the counter, as a write to CNT does. A running device clock can so be brought
    /// close to its wrap.
    pub fn preset(&mut self, count: u32, effects: &Effects) {
        self.restart(count, effects.now);
        self.schedule();
    }

    /// Tick at which the running counter was zero for the first time, counted back from where
    /// it was started or preset (modulo 2⁶⁴); `None` while it stands.
    pub fn origin(&self) -> Option<Ticks> {
        self.origin
    }

    fn running(&self) -> bool {
        self.bank[CR1] & CR1_CEN != 0 && !self.is_halted
    }

    /// Ticks per count.
    fn period(&self) -> u64 {
        u64::from(self.psc_active) + 1
    }

    fn restart(&mut self, count: u32, now: Ticks) {
        self.held = count;
        self.zero_at = now.wrapping_sub(u64::from(count) * self.period());
        self.origin = self.running().then_some(self.zero_at);
        self.done = count;
        self.find_top(count);
    }

    /// A counter beyond ARR does not meet it any more: it runs to its maximum.
    fn find_top(&mut self, count: u32) {
        self.top = if count > self.arr_active { self.wiring.maximum } else { self.arr_active };
    }

    fn write_cr1(&mut self, value: u32, effects: &mut Effects) {
        let (was_running, count) = (self.running(), self.done);
        self.bank.write(CR1, value, effects);
        if self.running() != was_running {
            self.restart(count, effects.now);
        }
    }

    fn write_dier(&mut self, value: u32, effects: &mut Effects) {
        self.withdraw(self.bank[DIER] & !value, effects);
        self.bank.write(DIER, value, effects);
    }

    /// Takes back the requests whose enable bits are in `cleared`.
    fn withdraw(&self, cleared: u32, effects: &mut Effects) {
        for event in 0..5 {
            if cleared & UDE << event != 0 {
                effects.withdraw(self.request_of(event));
            }
        }
    }

    fn write_ccmr(&mut self, offset: u32, value: u32, effects: &mut Effects) {
        if offset == CCMR1 && value & CCMR1_CC2S != 0 {
            effects.unmodelled_bits(value ^ CAPTURE);
            self.bank[CCMR1] = value;
            self.ccr_active[1] = self.compare(1);
            return;
        }
        effects.unmodelled_bits(u32::from([value >> 4, value >> 12].iter().any(|mode| matches!(mode & 7, 1..=6))));
        self.bank.write(offset, value, effects);
        let first = if offset == CCMR1 { 0 } else { 2 };
        for channel in [first, first + 1] {
            if !self.preloaded(channel) {
                self.ccr_active[channel] = self.compare(channel);
            }
            self.settle_reference(channel, effects);
        }
    }

    fn write_arr(&mut self, value: u32) {
        self.bank[ARR] = value;
        if self.bank[CR1] & CR1_ARPE == 0 {
            self.arr_active = value;
            self.find_top(self.done);
        }
    }

    fn write_ccr(&mut self, channel: usize, value: u32, effects: &mut Effects) {
        self.bank[CCR1 + 4 * channel as u32] = value;
        if !self.preloaded(channel) {
            self.ccr_active[channel] = value;
            self.settle_reference(channel, effects);
        }
    }

    /// CCRx; of a channel that captures, a count that is never reached.
    fn compare(&self, channel: usize) -> u32 {
        if channel == 1 && self.captures() { u32::MAX } else { self.bank[CCR1 + 4 * channel as u32] }
    }

    /// OCxPE and OCxM, from bit 3 on.
    fn output(&self, channel: usize) -> u32 {
        self.bank[if channel < 2 { CCMR1 } else { CCMR2 }] >> (8 * (channel % 2) + 3)
    }

    fn preloaded(&self, channel: usize) -> bool {
        self.output(channel) & 1 != 0
    }

    fn mode(&self, channel: usize) -> u32 {
        self.output(channel) >> 1 & 0b111
    }

    fn is_tim2(&self) -> bool {
        self.wiring.interrupt == TIM2::IRQn
    }

    fn master_mode(&self) -> u32 {
        (self.bank[CR2] & CR2_MMS) >> 4
    }

    /// EGR: events by software.
    fn generate(&mut self, value: u32, effects: &mut Effects) {
        effects.unmodelled_bits(value & !UIF);
        if value & UIF != 0 {
            self.begin_anew(effects);
            self.settle_references(effects);
            effects.triggered |= self.is_tim2() && self.master_mode() == 0;
        }
    }

    /// An update that is not an overflow.
    fn begin_anew(&mut self, effects: &mut Effects) {
        self.load_preloads();
        self.restart(0, effects.now);
        if self.bank[CR1] & CR1_URS == 0 {
            self.raise(0, effects);
        }
    }

    fn load_preloads(&mut self) {
        self.psc_active = self.bank[PSC];
        self.arr_active = self.bank[ARR];
        self.ccr_active = std::array::from_fn(|channel| self.compare(channel));
    }

    fn overflow(&mut self, effects: &mut Effects) {
        let regular = self.top == self.arr_active;
        if regular {
            for channel in 0..4 {
                // RM0440, "TIMx status register": CCRx > ARR matches at the overflow.
                if self.ccr_active[channel] > self.arr_active {
                    self.raise(channel + 1, effects);
                }
            }
            self.load_preloads();
            self.raise(0, effects);
        }
        self.zero_at = effects.now;
        self.done = 0;
        self.top = self.arr_active;
        for channel in 0..4 {
            if self.ccr_active[channel] == 0 {
                self.compare_match(channel, effects);
            }
        }
        self.settle_references(effects);
    }

    fn compare_match(&mut self, channel: usize, effects: &mut Effects) {
        self.raise(channel + 1, effects);
        self.settle_reference(channel, effects);
    }

    /// Sets flag `event` (0: update, 1 to 4: compare channel) and raises its request.
    fn raise(&mut self, event: usize, effects: &mut Effects) {
        self.bank[SR] |= 1 << event;
        if self.bank[DIER] & UDE << event != 0 {
            effects.request(self.request_of(event));
        }
    }

    fn request_of(&self, event: usize) -> u32 {
        self.wiring.first_request + if event == 0 { 4 } else { event as u32 - 1 }
    }

    fn settle_references(&mut self, effects: &mut Effects) {
        for channel in 0..4 {
            self.settle_reference(channel, effects);
        }
    }

    /// Reference signal in PWM mode 2.
    fn settle_reference(&mut self, channel: usize, effects: &mut Effects) {
        if self.mode(channel) != 7 {
            return;
        }
        let level = self.done >= self.ccr_active[channel];
        let rises = !std::mem::replace(&mut self.reference[channel], level) && level;
        effects.triggered |= rises && self.is_tim2() && self.master_mode() == 4 + channel as u32;
    }

    fn update_line(&self, effects: &mut Effects) {
        effects.set_line(self.wiring.interrupt, self.bank[SR] & self.bank[DIER] & FLAGS != 0);
    }

    fn schedule(&mut self) {
        if !self.running() {
            self.next = Ticks::MAX;
            return;
        }
        let mut count = u64::from(self.top) + 1;
        for compare in self.ccr_active {
            if compare > self.done && compare <= self.top {
                count = count.min(u64::from(compare));
            }
        }
        self.next = self.zero_at.wrapping_add(count * self.period());
    }
}
