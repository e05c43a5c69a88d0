//! The device clock: a 170 MHz counter that never stops, widened to 64 bits.

use embassy_stm32::peripherals::TIM5;
use embassy_stm32::{Peri, pac, rcc};

/// Ticks since reset.
#[derive(Debug)]
pub struct Clock {
    last: u64,
}

impl Clock {
    /// Starts the counter. Its owner must read it at least every 25 seconds, before it wraps.
    pub fn start(_timer: Peri<'static, TIM5>) -> Self {
        rcc::enable_and_reset::<TIM5>();
        let timer = pac::TIM5;
        timer.psc().write_value(0);
        timer.arr().write_value(u32::MAX);
        timer.egr().write(|w| w.set_ug(true));
        timer.cr1().write(|w| w.set_cen(true));
        Self { last: 0 }
    }

    /// Ticks since reset, now.
    pub fn now(&mut self) -> u64 {
        let count = pac::TIM5.cnt().read();
        self.last += u64::from(count.wrapping_sub(self.last as u32));
        self.last
    }
}
