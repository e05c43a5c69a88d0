//! Why the board started, and how it ends: always dark.
//!
//! A word that survives resets but not the loss of supply says what the last start did.

use core::panic::PanicInfo;

use cortex_m::peripheral::SCB;
use cortex_m_rt::{ExceptionFrame, exception};
use embassy_stm32::pac;
use slitpose_protocol::{BootTarget, ResetCause};

use crate::emitters;

/// The board has been running.
const RUNNING: u32 = 0x736c_6974;
/// It ended in a panic or a fault.
const PANICKED: u32 = 0x736c_6970;
/// It ended to start the boot loader.
const BOOT_LOADER: u32 = 0x736c_6962;

/// How often the access to the word is looked at before it is taken for granted.
const WRITE_ACCESS_LOOKS: u32 = 100;

/// The controller's boot loader in system memory.
const BOOT_LOADER_VECTORS: *const u32 = 0x1fff_0000 as *const u32;

/// Why the board has started. Comes first: does not return if the boot loader was asked for.
pub fn reset_cause() -> ResetCause {
    let flags = pac::RCC.csr().read();
    pac::RCC.csr().modify(|w| w.set_rmvf(true));
    let last = recall();
    if last == BOOT_LOADER {
        remember(RUNNING);
        start_boot_loader();
    }
    if flags.iwdgrstf() {
        ResetCause::Watchdog
    } else if flags.sftrstf() {
        if last == PANICKED { ResetCause::Panic } else { ResetCause::Software }
    } else if flags.borrstf() {
        if last == 0 { ResetCause::PowerOn } else { ResetCause::BrownOut }
    } else if flags.pinrstf() {
        ResetCause::Pin
    } else {
        ResetCause::Unknown
    }
}

/// From now on the board counts as running.
pub fn running() {
    // A debugger that halts the core halts the watchdog, too.
    #[cfg(feature = "defmt")]
    pac::DBGMCU.apb1lfzr().modify(|w| w.set_iwdg(true));
    remember(RUNNING);
}

/// Starts anew.
pub fn restart(target: BootTarget) -> ! {
    emitters::darken();
    remember(match target {
        BootTarget::Firmware => RUNNING,
        BootTarget::BootLoader => BOOT_LOADER,
    });
    SCB::sys_reset()
}

/// Ends what cannot go on, in the dark, and starts anew.
pub fn give_up() -> ! {
    emitters::darken();
    remember(PANICKED);
    SCB::sys_reset()
}

fn recall() -> u32 {
    pac::RCC.apb1enr1().modify(|w| w.set_rtcapben(true));
    let _ = pac::RCC.apb1enr1().read();
    pac::TAMP.bkpr(0).read().bkp()
}

fn remember(word: u32) {
    pac::RCC.apb1enr1().modify(|w| {
        w.set_rtcapben(true);
        w.set_pwren(true);
    });
    // Read back, so that the clocks are on before they are needed.
    let _ = pac::RCC.apb1enr1().read();
    pac::PWR.cr1().modify(|w| w.set_dbp(true));
    // Takes effect a few cycles later.
    let _ = (0..WRITE_ACCESS_LOOKS).any(|_| pac::PWR.cr1().read().dbp());
    pac::TAMP.bkpr(0).write(|w| w.set_bkp(word));
    // Read back, so that it has been written before anything else happens.
    let _ = pac::TAMP.bkpr(0).read();
}

fn start_boot_loader() -> ! {
    // It takes its interrupts from address 0, where system memory is to be seen for that
    // (RM0440, SYSCFG_MEMRMP).
    pac::RCC.apb2enr().modify(|w| w.set_syscfgen(true));
    let _ = pac::RCC.apb2enr().read();
    pac::SYSCFG.memrmp().modify(|w| w.set_mem_mode(1));
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
    // SAFETY: system memory starts with a vector table, and nothing has been set up yet
    // that the boot loader would have to find undone.
    #[allow(unsafe_code)]
    unsafe {
        cortex_m::asm::bootload(BOOT_LOADER_VECTORS)
    }
}

#[panic_handler]
fn panic(_info: &PanicInfo<'_>) -> ! {
    emitters::darken();
    #[cfg(feature = "defmt")]
    defmt::error!("{}", defmt::Display2Format(_info));
    give_up()
}

// SAFETY: it neither returns nor uses what the fault may have left broken.
#[allow(unsafe_code)]
#[exception]
unsafe fn HardFault(_frame: &ExceptionFrame) -> ! {
    give_up()
}

/// Flash memory that was torn by a power cut answers with two wrong bits. In the second
/// bank, which holds settings only, what is read is rubbish, and its reader finds out. In
/// the first bank it is the program itself that cannot be trusted.
// SAFETY: it only looks at the memory's error flags.
#[allow(unsafe_code)]
#[exception]
unsafe fn NonMaskableInt() {
    let errors = pac::FLASH.eccr().read();
    let is_settings = errors.bk_ecc() && !errors.sysf_ecc();
    if (errors.eccd() || errors.eccd2()) && !is_settings {
        give_up();
    }
    pac::FLASH.eccr().modify(|w| {
        w.set_eccd(true);
        w.set_eccd2(true);
    });
    // Cleared before the way back, or it would come again.
    let _ = pac::FLASH.eccr().read();
    cortex_m::asm::dsb();
}
