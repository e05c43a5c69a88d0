//! The cause of the last reset, and the ways to the next one: always with emitters off.
//!
//! Words that survive resets but not the loss of supply record how the last run ended, and how many starts in a row
//! have failed.

use core::panic::PanicInfo;

use cortex_m::peripheral::SCB;
use cortex_m_rt::exception;
use embassy_stm32::pac;
use slitpose_protocol::{BootTarget, ResetCause};

use crate::emitters;

/// The board has been running.
const RUNNING: u32 = 0x736c_6974;
/// The run ended in a panic or a fault.
const PANICKED: u32 = 0x736c_6970;
/// The stack had no room.
const OVERFLOWED: u32 = 0x736c_696f;
/// The run ended to start the boot loader.
const BOOT_LOADER: u32 = 0x736c_6962;

/// Where the count of failed starts ends.
const FAILED_MASK: u32 = 0xff;

/// Number of polls of the write access to the word before it is taken for granted.
const WRITE_ACCESS_LOOKS: u32 = 100;

/// Vector table of the MCU's boot loader in system memory.
const BOOT_LOADER_VECTORS: *const u32 = 0x1fff_0000 as *const u32;

/// Why the board has started. To be called first. Does not return if the last run ended to
/// start the boot loader.
pub fn reset_cause() -> ResetCause {
    let flags = pac::RCC.csr().read();
    pac::RCC.csr().modify(|w| w.set_rmvf(true));
    let last = recall(0);
    if last == BOOT_LOADER {
        remember(RUNNING);
        start_boot_loader();
    }
    if flags.iwdgrstf() {
        ResetCause::Watchdog
    } else if flags.sftrstf() {
        match last {
            PANICKED => ResetCause::Panic,
            OVERFLOWED => ResetCause::StackOverflow,
            _ => ResetCause::Software,
        }
    } else if flags.borrstf() {
        if last == 0 { ResetCause::PowerOn } else { ResetCause::BrownOut }
    } else if flags.pinrstf() {
        ResetCause::Pin
    } else {
        ResetCause::Unknown
    }
}

/// Starts in a row that ended in a panic, a fault or a hang before [`started_well`]; `cause`: that of this start. To be
/// called before the HAL, whose start resets the backup registers.
pub fn failed_starts(cause: ResetCause) -> u32 {
    let has_failed = matches!(cause, ResetCause::Panic | ResetCause::StackOverflow | ResetCause::Watchdog);
    if has_failed { (recall(1) & FAILED_MASK) + 1 } else { 0 }
}

pub fn started_well() {
    write_backup(1, 0);
}

/// Records that the board is running, after `failed_starts`.
pub fn running(failed_starts: u32) {
    // A debugger that halts the processor halts the watchdog, too.
    #[cfg(feature = "defmt")]
    pac::DBGMCU.apb1lfzr().modify(|w| w.set_iwdg(true));
    write_backup(1, failed_starts.min(FAILED_MASK));
    remember(RUNNING);
}

/// Switches the emitters off and resets the board into `target`.
pub fn restart(target: BootTarget) -> ! {
    emitters::darken();
    remember(match target {
        BootTarget::Firmware => RUNNING,
        BootTarget::BootLoader => BOOT_LOADER,
    });
    SCB::sys_reset()
}

/// Switches the emitters off and resets the board as after a panic.
pub fn give_up() -> ! {
    end(PANICKED)
}

#[inline(never)]
fn end(why: u32) -> ! {
    emitters::darken();
    remember(why);
    SCB::sys_reset()
}

#[inline(never)]
fn recall(index: usize) -> u32 {
    pac::RCC.apb1enr1().modify(|w| w.set_rtcapben(true));
    let _ = pac::RCC.apb1enr1().read();
    pac::TAMP.bkpr(index).read().bkp()
}

fn remember(word: u32) {
    write_backup(0, word);
}

#[inline(never)]
fn write_backup(index: usize, word: u32) {
    pac::RCC.apb1enr1().modify(|w| {
        w.set_rtcapben(true);
        w.set_pwren(true);
    });
    // The read makes sure that both clocks are on.
    let _ = pac::RCC.apb1enr1().read();
    pac::PWR.cr1().modify(|w| w.set_dbp(true));
    // The write access takes effect a few cycles later.
    let _ = (0..WRITE_ACCESS_LOOKS).any(|_| pac::PWR.cr1().read().dbp());
    pac::TAMP.bkpr(index).write(|w| w.set_bkp(word));
    // The read makes sure that the word has been written.
    let _ = pac::TAMP.bkpr(index).read();
}

fn start_boot_loader() -> ! {
    // The boot loader takes its interrupt vectors from address 0, so system memory must
    // appear there (RM0440, SYSCFG_MEMRMP).
    pac::RCC.apb2enr().modify(|w| w.set_syscfgen(true));
    let _ = pac::RCC.apb2enr().read();
    pac::SYSCFG.memrmp().modify(|w| w.set_mem_mode(1));
    // SAFETY: no interrupt is enabled, and the table at 0 is the boot loader's.
    #[allow(unsafe_code)]
    unsafe {
        (*SCB::PTR).vtor.write(0);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
    // SAFETY: system memory starts with a vector table, and the firmware has not set up
    // anything yet that the boot loader expects in its reset state.
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

// The handler of a fault. It does not return, so that it may begin the stack anew, which may have no room left.
#[allow(unsafe_code, reason = "a symbol that the runtime calls")]
mod hard_fault {
    core::arch::global_asm!(
        ".syntax unified",
        ".section .text.HardFault,\"ax\",%progbits",
        ".global HardFault",
        ".type HardFault,%function",
        ".thumb_func",
        "HardFault:",
        "    ldr r0, =_stack_start",
        "    mov sp, r0",
        "    b {fault}",
        "    .ltorg",
        ".text",
        fault = sym super::fault,
    );
}

/// Data accesses and frames of exceptions that the memory protection unit forbids, in CFSR (DDI0403, B3.2.15).
const GUARDED: u32 = 0b11_1010;

extern "C" fn fault() -> ! {
    // SAFETY: a register is read.
    #[allow(unsafe_code)]
    let status = unsafe { (*SCB::PTR).cfsr.read() };
    // The only memory that is forbidden is that below the stack.
    end(if status & GUARDED == 0 { PANICKED } else { OVERFLOWED })
}

/// The crystal has stopped, and every time is wrong from now on: a start anew finds another clock.
fn has_lost_clock() -> bool {
    pac::RCC.cifr().read().cssf()
}

/// Flash memory that was torn by a power cut reports an error of two bits. While the settings are read, their checksum
/// shows the damage. At any other time it is the firmware that cannot be trusted. The bank that the memory names is
/// not asked for: no source says that it is always right.
// SAFETY: the handler only accesses the error flags of the flash memory.
#[allow(unsafe_code)]
#[exception]
unsafe fn NonMaskableInt() {
    if has_lost_clock() {
        give_up();
    }
    let errors = pac::FLASH.eccr().read();
    #[cfg(feature = "storage")]
    let is_settings = crate::storage::is_reading();
    #[cfg(not(feature = "storage"))]
    let is_settings = false;
    if (errors.eccd() || errors.eccd2()) && !is_settings {
        give_up();
    }
    pac::FLASH.eccr().modify(|w| {
        w.set_eccd(true);
        w.set_eccd2(true);
    });
    // Cleared before the return, or the interrupt would come again.
    let _ = pac::FLASH.eccr().read();
    cortex_m::asm::dsb();
}
