//! The trigger input: each edge at PC12 is captured by the device clock (TIM5, channel 2) and moved to a ring by DMA.
//!
//! An edge counts once the line has had its new level for eight ticks, and its time is that tick and a few more: 0.06 µs late.

use core::sync::atomic::{AtomicU32, Ordering};

use embassy_stm32::gpio::{AfType, Flex, Pull};
use embassy_stm32::pac::timer::vals::{CcmrInputCcs, FilterValue};
use embassy_stm32::peripherals::PC12;
use embassy_stm32::{Peri, pac};
use slitpose_protocol::Edge;

use crate::clock::Clock;
use crate::dma::{Channel, Table};

/// TIM5_CH2 (RM0440, DMAMUX requests).
const CAPTURE_DMA: Channel<true> = Channel::new(3, 73);

/// Channel 2, counted from 0.
const CHANNEL: usize = 1;

const PIN: usize = 12;

/// Alternate function TIM5_CH2 (DS12288, alternate functions of port C).
const FUNCTION: u8 = 1;

/// Edges that wait to be read: 25 ms at 10 000 a second.
const RING_EDGES: usize = 256;

/// Ticks from an edge until its time is in the ring, at the latest.
const CAPTURE_TICKS: u32 = 64;

/// Captured counts; zero where there is none yet.
static RING: [AtomicU32; RING_EDGES] = [const { AtomicU32::new(0) }; RING_EDGES];

/// The captured edges.
#[derive(Debug)]
pub struct Trigger {
    next: usize,
    is_high: bool,
    /// An edge has been read since the level was last compared with the line.
    is_unchecked: bool,
    /// Edges that came too fast.
    pub missed: u32,
}

impl Trigger {
    /// Begins to capture by the running clock.
    pub fn new(pin: Peri<'static, PC12>) -> Self {
        let mut pin = Flex::new(pin);
        pin.set_as_af_unchecked(FUNCTION, AfType::input(Pull::Down));
        // It stays what it is.
        core::mem::forget(pin);
        let timer = pac::TIM5;
        timer.ccmr_input(0).modify(|w| {
            w.set_ccs(CHANNEL, CcmrInputCcs::TI4);
            w.set_icf(CHANNEL, FilterValue::FCK_INT_N8);
        });
        CAPTURE_DMA.collect(timer.ccr(CHANNEL).as_ptr().cast(), Table::of_words(&RING));
        timer.ccer().modify(|w| {
            w.set_ccp(CHANNEL, true);
            w.set_ccnp(CHANNEL, true);
            w.set_cce(CHANNEL, true);
        });
        timer.dier().modify(|w| w.set_ccde(CHANNEL, true));
        Self { next: 0, is_high: is_pin_high(), is_unchecked: false, missed: 0 }
    }

    /// The oldest edge that has not been read.
    pub fn next_edge(&mut self, clock: &mut Clock) -> Option<Edge> {
        // The one before was read: if it is filled again, the ring has gone round.
        if RING[(self.next + RING_EDGES - 1) % RING_EDGES].load(Ordering::Relaxed) != 0 {
            RING.iter().for_each(|edge| edge.store(0, Ordering::Relaxed));
            self.next = (RING_EDGES - usize::from(CAPTURE_DMA.remaining())) % RING_EDGES;
            self.missed = self.missed.wrapping_add(RING_EDGES as u32);
            self.is_unchecked = true;
        }
        let count = RING[self.next].swap(0, Ordering::Relaxed);
        if count == 0 {
            if self.is_unchecked {
                self.check_level();
            }
            return None;
        }
        self.is_unchecked = true;
        self.next = (self.next + 1) % RING_EDGES;
        self.is_high = !self.is_high;
        let now = clock.now();
        Some(Edge::new(now - u64::from((now as u32).wrapping_sub(count)), self.is_high))
    }

    /// After the last edge the line has its level; if not, or if a capture was overwritten, an edge was missed.
    fn check_level(&mut self) {
        self.is_unchecked = false;
        let status = pac::TIM5.sr();
        let is_overwritten = status.read().ccof(CHANNEL);
        if is_overwritten {
            // The other bits are left as they are by ones.
            status.write(|w| {
                w.0 = u32::MAX;
                w.set_ccof(CHANNEL, false);
            });
        }
        let mut is_missed = is_overwritten;
        if is_pin_high() != self.is_high {
            cortex_m::asm::delay(CAPTURE_TICKS);
            if is_pin_high() != self.is_high && RING[self.next].load(Ordering::Relaxed) == 0 {
                (self.is_high, is_missed) = (!self.is_high, true);
            }
        }
        self.missed = self.missed.wrapping_add(is_missed.into());
    }
}

fn is_pin_high() -> bool {
    pac::GPIOC.idr().read().idr(PIN) == pac::gpio::vals::Idr::HIGH
}
