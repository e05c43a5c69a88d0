//! The peripherals of an STM32G474 and the wires between them.
//!
//! Each peripheral is a plain struct of its own file, held by value in the board
//! (`board::Board`), without dynamic dispatch. All of them look alike:
//!
//! ```ignore
//! pub fn new() -> Self;                                                  // state after power-on
//! pub fn reset(&mut self, effects: &mut Effects);                        // RCC reset bit or system reset
//! pub fn read(&mut self, offset: u32, effects: &mut Effects) -> u32;     // side effects included (DR clears EOC)
//! pub fn write(&mut self, offset: u32, value: u32, effects: &mut Effects);
//! pub fn next_event(&self) -> Ticks;                                     // Ticks::MAX: nothing will happen by itself
//! pub fn advance(&mut self, effects: &mut Effects);                      // called at exactly next_event(), or not at all
//! ```
//!
//! * `offset` counts from the peripheral's base and is word aligned; `value` is a word. The
//!   board widens narrow accesses as the AHB-APB bridge does: a byte or halfword written is
//!   repeated over the word; a narrow read returns the lane of the word addressed.
//! * Registers that do no more than hold bits are rows of a table, `effects::Bank`.
//! * The present time is `Effects::now`. An event is never handled late: the board calls
//!   `advance` once for every instant a peripheral has asked for, in time order, with `now`
//!   equal to that instant; and before any register access all earlier events are done.
//!   `next_event` is asked after every access and every event, so it must be cheap
//!   (a field, computed when the state changes).
//! * The board checks the clock enable in RCC and records the violation; a peripheral is
//!   never called while its clock is off.
//! * Everything a peripheral does to others passes through `Effects`: interrupt lines are
//!   levels that the peripheral sets whenever they may have changed; DMA requests are
//!   latched until the DMA serves or the peripheral withdraws them; broken write rules of
//!   the reference manual (RM0440) are `Effects::violation`s; registers or modes that no
//!   model knows are `Effects::unmodelled`.

pub(crate) mod adc;
pub(crate) mod dac;
pub(crate) mod dma;
mod effects;
pub(crate) mod exti;
pub(crate) mod flash;
pub(crate) mod gpio;
pub(crate) mod lab;
pub(crate) mod plain;
pub(crate) mod power;
pub(crate) mod rcc;
pub(crate) mod timer;
pub(crate) mod uart;
pub(crate) mod usb;
pub(crate) mod watchdog;

pub use uart::SentByte;
pub use usb::UsbPort;

pub use effects::ResetCause;
pub(crate) use effects::{Bank, Effects};

/// Periods of the 170 MHz core clock since power-on. The core starts on the 16 MHz
/// oscillator until it selects the PLL; every core cycle counts as one tick all the same.
pub type Ticks = u64;

/// Ticks in one second: the core clock, and that of all buses, in hertz.
pub const TICKS_PER_SECOND: u64 = 1_000_000 * crate::st::f::HCLK as u64;

/// What stands in the bits of `mask`.
fn field(word: u32, mask: u32) -> u32 {
    (word & mask) >> mask.trailing_zeros()
}

/// The ticks next to `time`, of which `per_second` are a second.
const fn ticks(time: f64, per_second: u64) -> Ticks {
    (time * TICKS_PER_SECOND as f64 / per_second as f64 + 0.5) as Ticks
}
