//! 170 MHz for the processor, the buses, the timers and the converters: from the board's crystal, or from the MCU's
//! own oscillator if the crystal does not start.
//!
//! The HAL (embassy-stm32 0.6.0) cannot do this: it waits for a crystal for ever, changes system clock and bus clock in
//! one store, and does not raise the core voltage. It is left to believe in the 16 MHz from which
//! the MCU starts, and the two that ask it are told otherwise: its own time driver here, and the serial port by
//! [`believed_baud`].
//!
//! The device clock counts them: a counter that never stops, widened to 64 bits.

use embassy_stm32::pac::flash::vals::Latency;
use embassy_stm32::pac::rcc::vals::{Hpre, Pllm, Plln, Pllr, Pllsrc, Sw};
use embassy_stm32::pac::timer::vals::Urs;
use embassy_stm32::peripherals::TIM5;
use embassy_stm32::{Peri, pac, rcc};
use slitpose_firmware::pcb::TICK_HZ;
use slitpose_protocol::ClockSource;

/// The MCU's own oscillator, from which it starts.
const START_HZ: u32 = 16_000_000;

/// Looks for the crystal's ready flag, 10 µs apart, before the crystal is given up: five times its typical start-up
/// of 2 ms (DS12288, HSE oscillator characteristics, t_SU).
const CRYSTAL_LOOKS: u32 = 1_000;

/// R1MODE of PWR_CR5: clear for the core voltage that more than 150 MHz need. The register map (stm32-metapac 21.0.0)
/// has the bit in the wrong place.
const NORMAL_MODE: u32 = 1 << 8;

/// Ticks of embassy's clock, per second.
const TIME_HZ: u32 = embassy_time::TICK_HZ as u32;

/// What the HAL must be asked for, so that a port that runs from the system clock has `baud`.
pub const fn believed_baud(baud: u32) -> u32 {
    (baud as u64 * START_HZ as u64 / TICK_HZ as u64) as u32
}

/// Raises the clock. To be called once, while the MCU runs at 16 MHz.
///
/// In the order of RM0440 (PWR, range 1 boost mode; RCC, clock switching): above 80 MHz the bus clock is half of the
/// system clock until a microsecond after the switch. ST's `HAL_RCC_ClockConfig` does the same.
pub fn raise() -> ClockSource {
    let has_crystal = crystal_starts();
    // The crystal of the NUCLEO-G474RE has 24 MHz (UM2505, X3): 4 MHz into the PLL either way.
    let (source, divider) = if has_crystal { (Pllsrc::HSE, Pllm::DIV6) } else { (Pllsrc::HSI, Pllm::DIV4) };
    pac::RCC.pllcfgr().write(|w| {
        w.set_pllsrc(source);
        w.set_pllm(divider);
        w.set_plln(Plln::MUL85);
        w.set_pllr(Pllr::DIV2);
        w.set_pllren(true);
    });
    pac::RCC.cr().modify(|w| w.set_pllon(true));
    while !pac::RCC.cr().read().pllrdy() {}
    pac::RCC.cfgr().modify(|w| w.set_hpre(Hpre::DIV2));
    pac::PWR.cr5().modify(|w| w.0 &= !NORMAL_MODE);
    pac::FLASH.acr().modify(|w| w.set_latency(Latency::WS4));
    while pac::FLASH.acr().read().latency() != Latency::WS4 {}
    pac::RCC.cfgr().modify(|w| w.set_sw(Sw::PLL1_R));
    while pac::RCC.cfgr().read().sws() != Sw::PLL1_R {}
    cortex_m::asm::delay(TICK_HZ / 1_000_000);
    pac::RCC.cfgr().modify(|w| w.set_hpre(Hpre::DIV1));
    set_time_driver();
    if has_crystal {
        // A crystal that stops later switches the MCU to its own oscillator and raises the non-maskable interrupt.
        pac::RCC.cr().modify(|w| w.set_csson(true));
        ClockSource::Crystal
    } else {
        ClockSource::CrystalFailed
    }
}

/// Whether the crystal oscillates. If not, it is switched off.
fn crystal_starts() -> bool {
    pac::RCC.cr().modify(|w| w.set_hseon(true));
    let has_started = (0..CRYSTAL_LOOKS).any(|_| {
        cortex_m::asm::delay(START_HZ / 100_000);
        pac::RCC.cr().read().hserdy()
    });
    if !has_started {
        pac::RCC.cr().modify(|w| w.set_hseon(false));
    }
    has_started
}

/// embassy's clock has been set for 16 MHz: its timer, TIM4, divides by more from now on.
///
/// The count goes on where it was. The driver numbers the halves of the counter's range as it enters them, and a count that
/// began at zero again in an odd half would be half a range off at every border between two: an alarm set in the last
/// microsecond before one would come a whole range, 65.5 ms, late.
fn set_time_driver() {
    let timer = pac::TIM4;
    timer.psc().write_value((TICK_HZ / TIME_HZ - 1) as u16);
    cortex_m::interrupt::free(|_| {
        // A count that is written at a border might enter the half twice.
        let mut count = timer.cnt().read().0;
        while count & 0x7FFF == 0 {
            count = timer.cnt().read().0;
        }
        // The prescaler takes effect at an update, here one that raises no flag.
        timer.cr1().modify(|w| w.set_urs(Urs::COUNTER_ONLY));
        timer.egr().write(|w| w.set_ug(true));
        timer.cr1().modify(|w| w.set_urs(Urs::ANY_EVENT));
        timer.cnt().modify(|w| w.0 = count);
    });
}

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
