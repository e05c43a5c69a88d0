//! The peripherals of an STM32G474 and the wires between them.
//!
//! Each peripheral is a plain struct of its own file, held by value in the board
//! (`machine::Board`), without dynamic dispatch. All of them look alike:
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
//! * The present time is [`Effects::now`]. An event is never handled late: the board calls
//!   `advance` once for every instant a peripheral has asked for, in time order, with `now`
//!   equal to that instant; and before any register access all earlier events are done.
//!   `next_event` is asked after every access and every event, so it must be cheap
//!   (a field, computed when the state changes).
//! * The board checks the clock enable in RCC and records the violation; a peripheral is
//!   never called while its clock is off.
//! * Everything a peripheral does to others passes through [`Effects`]: interrupt lines are
//!   levels that the peripheral sets whenever they may have changed; DMA requests are
//!   latched until the DMA serves or the peripheral withdraws them; broken write rules of
//!   the reference manual (RM0440) are [`Effects::violation`]s; registers or modes that no
//!   model knows are [`Effects::unmodelled`].

pub mod adc;
pub mod backup;
pub mod crc;
pub mod crs;
pub mod dac;
pub mod dma;
mod effects;
pub mod exti;
pub mod flash;
pub mod gpio;
pub mod power;
pub mod rcc;
pub mod syscfg;
pub mod timer;
pub mod uart;
pub mod usb;
pub mod watchdog;

pub use effects::{Edge, Effects, Request, ResetCause, Trigger, Violation, interrupt};

/// Periods of the 170 MHz core clock since power-on. The core starts on the 16 MHz
/// oscillator until it selects the PLL; every core cycle counts as one tick all the same.
pub type Ticks = u64;

/// Ticks in one second: the core clock, and that of all buses, in hertz.
pub const TICKS_PER_SECOND: u64 = 170_000_000;
