//! 170 MHz for the processor, the buses, the timers and the converters: from the board's crystal, or from the MCU's
//! own oscillator if the crystal does not start.

use embassy_stm32::pac::flash::vals::Latency;
use embassy_stm32::pac::timer::vals::Urs;
use embassy_stm32::peripherals::RCC;
use embassy_stm32::rcc::{self, AHBPrescaler, Config, Hse, HseMode, Hsi48Config, Pll, PllMul, PllPreDiv, PllRDiv};
use embassy_stm32::rcc::{PllSource, Sysclk, mux};
use embassy_stm32::time::Hertz;
use embassy_stm32::{Peri, pac};
use slitpose_firmware::pcb::TICK_HZ;
use slitpose_protocol::ClockSource;

use crate::supply;

/// The crystal of the NUCLEO-G474RE (UM2505, X3).
const CRYSTAL: Hertz = Hertz(24_000_000);

/// The MCU's own oscillator, from which it starts.
const START_HZ: u32 = 16_000_000;

/// Looks for the crystal's ready flag, 10 µs apart, before the crystal is given up: five times its typical start-up
/// of 2 ms (DS12288, HSE oscillator characteristics, t_SU).
const CRYSTAL_LOOKS: u32 = 1_000;

/// Ticks of embassy's clock, per second.
const TIME_HZ: u32 = embassy_time::TICK_HZ as u32;

/// Raises the clock. To be called once, while the MCU runs at 16 MHz.
///
/// Above 80 MHz the bus clock must be half of the system clock for a microsecond while the system clock changes
/// (RM0440, RCC, "Clock switching"; ST's `HAL_RCC_ClockConfig` does the same). The HAL (embassy-stm32 0.6.0) changes both
/// in one store. It is therefore asked for half of the bus clock, and the rest is done here.
pub fn raise(control: &mut Peri<'static, RCC>) -> ClockSource {
    supply::boost();
    let has_crystal = crystal_starts();
    rcc::reinit(half_speed(has_crystal), control);
    cortex_m::asm::delay(TICK_HZ / 1_000_000);
    pac::FLASH.acr().modify(|w| w.set_latency(Latency::WS4));
    while pac::FLASH.acr().read().latency() != Latency::WS4 {}
    pac::RCC.cfgr().modify(|w| w.set_hpre(AHBPrescaler::DIV1));
    set_time_driver();
    if has_crystal {
        // A crystal that stops later switches the MCU to its own oscillator and raises the non-maskable interrupt.
        pac::RCC.cr().modify(|w| w.set_csson(true));
        ClockSource::Crystal
    } else {
        ClockSource::CrystalFailed
    }
}

/// Whether the crystal oscillates. It is left running.
fn crystal_starts() -> bool {
    pac::RCC.cr().modify(|w| w.set_hseon(true));
    (0..CRYSTAL_LOOKS).any(|_| {
        cortex_m::asm::delay(START_HZ / 100_000);
        pac::RCC.cr().read().hserdy()
    })
}

/// System clock 170 MHz, bus clock 85 MHz. USB has an oscillator of its own, trimmed by the host's frames.
fn half_speed(has_crystal: bool) -> Config {
    let mut config = Config::new();
    // 4 MHz into the PLL either way.
    let (source, prediv) =
        if has_crystal { (PllSource::HSE, PllPreDiv::DIV6) } else { (PllSource::HSI, PllPreDiv::DIV4) };
    config.pll = Some(Pll { source, prediv, mul: PllMul::MUL85, divp: None, divq: None, divr: Some(PllRDiv::DIV2) });
    config.hse = has_crystal.then_some(Hse { freq: CRYSTAL, mode: HseMode::Oscillator });
    config.hsi = true;
    config.sys = Sysclk::PLL1_R;
    config.ahb_pre = AHBPrescaler::DIV2;
    config.boost = true;
    config.hsi48 = Some(Hsi48Config { sync_from_usb: true });
    config.mux.clk48sel = mux::Clk48sel::HSI48;
    // Both count by the system clock, which the HAL knows rightly.
    config.mux.lpuart1sel = mux::Uartsel::SYS;
    config.mux.adc345sel = mux::Adcsel::SYS;
    config
}

/// embassy's clock has been set for a bus of 85 MHz: its timer, TIM4, divides by twice as much from now on.
fn set_time_driver() {
    let timer = pac::TIM4;
    timer.psc().write_value((TICK_HZ / TIME_HZ - 1) as u16);
    // The prescaler takes effect at an update, here one that raises no flag.
    timer.cr1().modify(|w| w.set_urs(Urs::COUNTER_ONLY));
    timer.egr().write(|w| w.set_ug(true));
    timer.cr1().modify(|w| w.set_urs(Urs::ANY_EVENT));
}
