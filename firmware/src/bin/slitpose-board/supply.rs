//! Switches the emitters off when the supply falls, before measurements become wrong.

use core::sync::atomic::{AtomicBool, Ordering};

use embassy_stm32::interrupt::InterruptExt;
use embassy_stm32::{interrupt, pac};

use crate::emitters;

/// The detector's highest threshold, 2.9 V (RM0440, PWR_CR2, PLS).
const THRESHOLD: u8 = 6;

/// The detector's line among the external interrupts.
const LINE: usize = 16;

static FELL: AtomicBool = AtomicBool::new(false);

/// Watches the supply from now on.
pub fn watch() {
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

/// Whether the supply is too low, or has been too low since the last [`clear`].
pub fn is_low() -> bool {
    pac::PWR.sr2().read().pvdo() || FELL.load(Ordering::Relaxed)
}

/// Clears the record of a low supply in the past.
pub fn clear() {
    FELL.store(false, Ordering::Relaxed);
}

#[interrupt]
fn PVD_PVM() {
    emitters::darken();
    FELL.store(true, Ordering::Relaxed);
    pac::EXTI.pr(0).write(|w| w.set_line(LINE, true));
}
