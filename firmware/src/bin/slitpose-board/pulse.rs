//! The frame output: a timer (TIM1) counts the slots by the frame timer's triggers, and is high at PA10 for one of them.

use embassy_stm32::gpio::{AfType, Flex, OutputType, Speed};
use embassy_stm32::pac::timer::vals::{Ocm, Sms, Ts};
use embassy_stm32::peripherals::{PA10, TIM1};
use embassy_stm32::{Peri, pac, rcc};
use slitpose_protocol::{HardwareFault, Pulse, Schedule};

/// Channel 3, counted from 0.
const CHANNEL: usize = 2;

/// Alternate function TIM1_CH3 (DS12288, alternate functions of port A).
const FUNCTION: u8 = 6;

#[derive(Debug)]
pub struct FrameOutput {
    pulse: Pulse,
}

impl FrameOutput {
    pub fn new(pin: Peri<'static, PA10>, _timer: Peri<'static, TIM1>) -> Self {
        rcc::enable_and_reset::<TIM1>();
        let timer = pac::TIM1;
        timer.ccmr_output(CHANNEL / 2).modify(|w| w.set_ocm(CHANNEL % 2, Ocm::FORCE_INACTIVE));
        timer.ccer().modify(|w| w.set_cce(CHANNEL, true));
        timer.bdtr().modify(|w| w.set_moe(true));
        let mut pin = Flex::new(pin);
        pin.set_as_af_unchecked(FUNCTION, AfType::output(OutputType::PushPull, Speed::Medium));
        // It stays what it is.
        core::mem::forget(pin);
        Self { pulse: Pulse::NONE }
    }

    pub fn set(&mut self, pulse: Pulse, schedule: &Schedule) -> Result<(), HardwareFault> {
        let count = usize::from(pulse.every) * schedule.slots.len();
        if pulse.every != 0 && !(2..=0x1_0000).contains(&count) {
            return Err(HardwareFault::Timing);
        }
        self.pulse = pulse;
        Ok(())
    }

    /// Begins to count, before the frame timer starts frame `sequence` of `slots` slots.
    pub fn start(&self, slots: usize, sequence: u64) {
        self.stop();
        let Pulse { every, slot } = self.pulse;
        if every == 0 {
            return;
        }
        let timer = pac::TIM1;
        let count = u32::from(every) * slots as u32;
        timer.arr().write(|w| w.set_arr((count - 1) as u16));
        // High while the count is below the compare value: never before the count begins anew, when 1 takes effect.
        let mode = timer.ccmr_output(CHANNEL / 2);
        mode.modify(|w| w.set_ocpe(CHANNEL % 2, true));
        timer.ccr(CHANNEL).write(|w| w.set_ccr(0));
        timer.egr().write(|w| w.set_ug(true));
        timer.ccr(CHANNEL).write(|w| w.set_ccr(1));
        // The first trigger is that of slot 0.
        let ahead = (sequence % u64::from(every)) as u32 * slots as u32 + count - 1 - u32::from(slot);
        timer.cnt().write(|w| w.set_cnt((ahead % count) as u16));
        mode.modify(|w| w.set_ocm(CHANNEL % 2, Ocm::PWM_MODE1));
        // Each trigger of TIM2 counts (RM0440, TIM1 internal trigger connections: ITR1).
        timer.smcr().write(|w| {
            w.set_ts(Ts::ITR1);
            w.set_sms(Sms::EXT_CLOCK_MODE);
        });
        timer.cr1().modify(|w| w.set_cen(true));
    }

    /// Low from now on.
    pub fn stop(&self) {
        let timer = pac::TIM1;
        timer.cr1().modify(|w| w.set_cen(false));
        timer.ccmr_output(CHANNEL / 2).modify(|w| w.set_ocm(CHANNEL % 2, Ocm::FORCE_INACTIVE));
    }
}
