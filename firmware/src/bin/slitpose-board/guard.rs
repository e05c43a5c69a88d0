//! Switches the emitters off when the frame timer stands still, by itself, without the firmware; and when the supply falls,
//! before measurements become wrong.
//!
//! The guard timer (TIM3) begins anew at every trigger of the frame timer. If it comes to its end, the DMA clears all
//! gates. A debugger that halts the processor halts the frame timer and not the guard, so the emitters go dark.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use embassy_stm32::interrupt::InterruptExt;
use embassy_stm32::pac::timer::vals::{Sms, Ts, Urs};
use embassy_stm32::peripherals::TIM3;
use embassy_stm32::{Peri, interrupt, pac, rcc};
use slitpose_firmware::pcb::frame_plan::FramePlan;

use crate::dma::{Channel, Table};
use crate::emitters::{self, GATES};

/// Clears all gates at the guard timer's update.
const GUARD_DMA: Channel = Channel::new(7, 65);

static ALL_OFF: [AtomicU32; 1] = [AtomicU32::new(GATES << 16)];

#[derive(Debug)]
pub struct Guard {
    /// The guard comes to its end in the idle rest of every frame.
    fires_in_rest: bool,
}

impl Guard {
    /// Takes the timer, and lets a debugger that halts the processor halt the frame timer, and with it the clock of
    /// embassy (TIM4), which would lose count.
    pub fn new(_timer: Peri<'static, TIM3>) -> Self {
        rcc::enable_and_reset::<TIM3>();
        pac::DBGMCU.apb1lfzr().modify(|w| {
            w.set_tim2(true);
            w.set_tim4(true);
        });
        Self { fires_in_rest: false }
    }

    /// Watches from now on, while frames are made by `plan`.
    pub fn start(&mut self, plan: &FramePlan) {
        self.fires_in_rest = plan.guard_fires_in_rest;
        let timer = pac::TIM3;
        self.stop();
        let divider = plan.guard_ticks >> 16;
        timer.psc().write_value(divider as u16);
        timer.arr().write(|w| w.set_arr((plan.guard_ticks / (divider + 1) - 1) as u16));
        // An end counts as an update, a new beginning does not.
        timer.cr1().write(|w| w.set_urs(Urs::COUNTER_ONLY));
        timer.egr().write(|w| w.set_ug(true));
        // The trigger of TIM2 (RM0440, TIM3 internal trigger connections) sets the counter to zero.
        timer.smcr().write(|w| {
            w.set_ts(Ts::ITR1);
            w.set_sms(Sms::RESET_MODE);
        });
        timer.sr().write(|_| {});
        GUARD_DMA.feed(pac::GPIOC.bsrr().as_ptr().cast(), Table::of_words(&ALL_OFF));
        timer.dier().write(|w| w.set_ude(true));
        timer.cr1().modify(|w| w.set_cen(true));
    }

    pub fn stop(&mut self) {
        pac::TIM3.cr1().modify(|w| w.set_cen(false));
        pac::TIM3.dier().write(|_| {});
        GUARD_DMA.stop();
    }

    /// Whether the emitters were switched off although they should be lit.
    pub fn has_fired(&self) -> bool {
        !self.fires_in_rest && pac::TIM3.sr().read().uif() || GUARD_DMA.has_failed()
    }
}

/// The detector's highest threshold, 2.9 V (RM0440, PWR_CR2, PLS).
const THRESHOLD: u8 = 6;

/// The detector's line among the external interrupts.
const LINE: usize = 16;

static FELL: AtomicBool = AtomicBool::new(false);

pub fn watch_supply() {
    pac::PWR.cr2().modify(|w| {
        w.set_pls(THRESHOLD);
        w.set_pvde(true);
    });
    // The detector's output rises when the supply falls.
    pac::EXTI.rtsr(0).modify(|w| w.set_line(LINE, true));
    pac::EXTI.imr(0).modify(|w| w.set_line(LINE, true));
    // SAFETY: the handler below only switches emitters off; no critical section relies on
    // this interrupt being masked.
    #[allow(unsafe_code)]
    unsafe {
        interrupt::PVD_PVM.enable();
    }
}

/// Whether the supply is too low, or has been too low since the last [`clear_low_supply`].
pub fn is_supply_low() -> bool {
    pac::PWR.sr2().read().pvdo() || FELL.load(Ordering::Relaxed)
}

/// Clears the record of a low supply in the past.
pub fn clear_low_supply() {
    FELL.store(false, Ordering::Relaxed);
}

#[interrupt]
fn PVD_PVM() {
    emitters::darken();
    FELL.store(true, Ordering::Relaxed);
    pac::EXTI.pr(0).write(|w| w.set_line(LINE, true));
}
