//! Emitter gates and level lines.

use core::sync::atomic::{AtomicU32, Ordering};

use embassy_stm32::gpio::Output;
use embassy_stm32::pac;
use embassy_stm32::pac::dac::Dac;
use embassy_stm32::peripherals::{DAC1, DAC2};
use embassy_stm32::{Peri, rcc};
use slitpose_firmware::pcb::TICK_HZ;
use slitpose_firmware::pcb::frame_plan::BOARD_SLOTS;
use slitpose_firmware::pcb::pins::FIRST_GATE;
use slitpose_firmware::pcb::wiring::{CHANNELS, LEVEL_LINES};

use crate::dma::{Channel, Table};

/// All gates, as bits of port C: emitter k is gated by the k-th pin from the first on.
pub const GATES: u32 = ((1 << CHANNELS) - 1) << FIRST_GATE;

/// Processor cycles within which a pin surely follows its register: a microsecond.
const PIN_CYCLES: u32 = TICK_HZ / 1_000_000;

/// The word for the port in each slot: gates to set in its lower half, gates to clear in
/// its upper half.
static SLOT_GATES: [AtomicU32; BOARD_SLOTS] = [const { AtomicU32::new(0) }; BOARD_SLOTS];

/// The word for the port near the end of each slot: all gates off in the last slot, no
/// change in the others.
static LATE_GATES: [AtomicU32; BOARD_SLOTS] = [const { AtomicU32::new(0) }; BOARD_SLOTS];

/// Switches all gates off near the end of the last slot, on compare 4 of the frame timer. Of channels of the same
/// priority the first is served first, so that on a busy bus this never comes after the gates of the next slot.
pub const LATE_GATE_DMA: Channel = Channel::new(2, 59);
/// Writes the gates of the slot that begins, on every update of the frame timer.
pub const GATE_DMA: Channel = Channel::new(3, 60);

/// Gates, as outputs, and the DACs behind the level lines.
pub struct Emitters {
    _gates: [Output<'static>; CHANNELS as usize],
    /// Switches the emitters' supply on: a pin that the MCU's boot loader leaves alone,
    /// unlike the gates.
    _supply: Output<'static>,
}

impl Emitters {
    pub fn new(
        gates: [Output<'static>; CHANNELS as usize],
        supply: Output<'static>,
        _first: Peri<'static, DAC1>,
        _second: Peri<'static, DAC2>,
    ) -> Self {
        rcc::enable_and_reset::<DAC1>();
        rcc::enable_and_reset::<DAC2>();
        for dac in lines() {
            // For a bus of more than 160 MHz (RM0440, DAC_MCR, HFSEL).
            dac.mcr().modify(|w| w.set_hfsel(2));
            dac.dhr12r(0).write(|w| w.set_dhr(0));
            dac.cr().write(|w| w.set_en(0, true));
        }
        Self { _gates: gates, _supply: supply }
    }

    /// Prepares the gates: at its next update the frame timer begins the first of `slots`.
    /// With `goes_dark`, the emitters of the last slot go off at compare 4.
    pub fn arm(&mut self, slots: &[u8], goes_dark: bool) {
        for (word, &lit) in SLOT_GATES.iter().zip(slots) {
            let set = u32::from(lit) << FIRST_GATE;
            word.store(set | (GATES & !set) << 16, Ordering::Relaxed);
        }
        let port = pac::GPIOC.bsrr().as_ptr().cast();
        GATE_DMA.feed(port, Table::of_words(&SLOT_GATES[..slots.len()]));
        if goes_dark {
            let late = &LATE_GATES[..slots.len()];
            for (slot, word) in late.iter().enumerate() {
                let is_last = slot + 1 == slots.len();
                word.store(if is_last { GATES << 16 } else { 0 }, Ordering::Relaxed);
            }
            LATE_GATE_DMA.feed(port, Table::of_words(late));
        }
    }

    /// Sets a level line to a code of its DAC.
    pub fn set_level(&mut self, line: usize, code: u16) {
        lines()[line].dhr12r(0).write(|w| w.set_dhr(code));
    }

    /// Switches all emitters off and sets the level lines to zero. Gives whether the gates,
    /// read back at their pins, are low.
    pub fn darken(&mut self) -> bool {
        darken();
        for line in lines() {
            line.dhr12r(0).write(|w| w.set_dhr(0));
        }
        cortex_m::asm::delay(PIN_CYCLES);
        pac::GPIOC.idr().read().0 & GATES == 0
    }

    /// Address of the register that sets a level line.
    pub fn level_register(line: usize) -> *mut () {
        lines()[line].dhr12r(0).as_ptr().cast()
    }
}

fn lines() -> [Dac; LEVEL_LINES] {
    [pac::DAC1, pac::DAC2]
}

/// Stops the frame timer and the DMA of the gates, and switches all emitters off. Valid at
/// any time, also in an interrupt or after a fault.
#[inline(never)]
pub fn darken() {
    pac::TIM2.cr1().modify(|w| w.set_cen(false));
    GATE_DMA.stop();
    LATE_GATE_DMA.stop();
    pac::GPIOC.bsrr().write_value(pac::gpio::regs::Bsrr(GATES << 16));
}
