//! The private peripheral bus: system control block, NVIC registers, cycle counter (DDI0403, B3 and C1.8). Registers
//! without a model read 0 and ignore writes, among them VTOR, identification, the debug components, SysTick, HFSR, the addresses of
//! faults, and what changes how exceptions are entered and left or which faults have handlers of their own: SCR, CCR, SHCSR, FPCCR. All is as after reset: unaligned
//! accesses and divisions by zero are no faults, stacks are aligned to eight bytes, floating-point state is stacked lazily.

use super::nvic::FIRST_INTERRUPT;
use super::{Cpu, Size};
use crate::st::DBGMCU;

/// Peripherals that stand still while a debugger halts the core (RM0440, "Debug support").
const DBGMCU_APB1FZR1: u32 = DBGMCU::BASE + DBGMCU::APB1FZR1;
/// AIRCR key of a write, and what it reads as.
const VECTKEY: u32 = 0x05fa;
const VECTKEYSTAT: u32 = 0xfa05;
/// The MPU (DDI0403, B3.5) as far as it is modelled: region 0, if it forbids all accesses.
#[derive(Clone, Debug, Default)]
pub(super) struct Mpu {
    control: u32,
    base: u32,
    attributes: u32,
    /// The last address behind the base that is forbidden, while the unit and the region are on.
    last: Option<u32>,
}

impl Mpu {
    #[inline(always)]
    pub fn guards(&self, address: u32) -> bool {
        self.last.is_some_and(|last| address.wrapping_sub(self.base) <= last)
    }

    fn write(&mut self, address: u32, value: u32) {
        match address {
            0xe000_ed94 => self.control = value & 7,
            // Its low bits choose the region.
            0xe000_ed9c => self.base = value & !0x1f,
            _ => self.attributes = value,
        }
        let (size, access) = (self.attributes >> 1 & 0x1f, self.attributes >> 24 & 7);
        let is_on = self.control & self.attributes & 1 != 0 && access == 0;
        self.last = is_on.then_some(u32::MAX >> (31 - size));
    }
}

#[derive(Clone, Debug, Default)]
pub(super) struct System {
    pub mpu: Mpu,
    pub cpacr: u32,
    pub cfsr: u32,
    pub frozen_in_halt: u32,
    demcr: u32,
    cycle_counter: CycleCounter,
    pub reset_requested: bool,
}

impl System {
    /// Whether CPACR grants coprocessors 10 and 11.
    #[inline(always)]
    pub fn float_enabled(&self) -> bool {
        self.cpacr >> 20 & 15 == 0b1111
    }
}

/// The part of a register that a write touches.
#[derive(Clone, Copy)]
struct Written {
    /// The written bits in place, others 0.
    value: u32,
    /// Ones where bits are written.
    mask: u32,
}

impl Written {
    fn over(self, old: u32) -> u32 {
        old & !self.mask | self.value
    }
}

impl Cpu {
    /// A read of the private peripheral bus at an address aligned to `size`.
    #[cold]
    #[inline(never)]
    pub(super) fn read_private(&mut self, address: u32, size: Size) -> u32 {
        let word = self.read_register(address & !3);
        let shifted = word >> (8 * (address & 3));
        shifted & u32::MAX >> (32 - 8 * size.bytes())
    }

    /// A write to the private peripheral bus at an address aligned to `size`.
    #[cold]
    #[inline(never)]
    pub(super) fn write_private(&mut self, address: u32, size: Size, value: u32) {
        let (mask, shift) = (u32::MAX >> (32 - 8 * size.bytes()), 8 * (address & 3));
        self.write_register(address & !3, Written { value: (value & mask) << shift, mask: mask << shift });
        self.attention = true;
    }

    fn read_register(&mut self, address: u32) -> u32 {
        match address {
            0xe000_1000 => 0x4000_0000 | u32::from(self.system.cycle_counter.enabled), // four comparators
            0xe000_1004 => self.system.cycle_counter.value(self.executed),
            0xe000_e100..=0xe000_e17c => self.interrupt_word(self.nvic.enabled, address),
            0xe000_e180..=0xe000_e1fc => self.interrupt_word(self.nvic.enabled, address),
            0xe000_e200..=0xe000_e27c => self.interrupt_word(self.nvic.pending, address),
            0xe000_e280..=0xe000_e2fc => self.interrupt_word(self.nvic.pending, address),
            0xe000_e300..=0xe000_e37c => self.interrupt_word(self.nvic.active, address),
            0xe000_e400..=0xe000_e46c => self.priority_word((address - 0xe000_e400) as u8 + FIRST_INTERRUPT),
            // ICSR: VECTACTIVE.
            0xe000_ed04 => self.registers.ipsr.into(),
            0xe000_ed0c => VECTKEYSTAT << 16,
            0xe000_ed28 => self.system.cfsr,
            0xe000_ed88 => self.system.cpacr,
            0xe000_ed94 => self.system.mpu.control,
            0xe000_ed9c => self.system.mpu.base,
            0xe000_eda0 => self.system.mpu.attributes,
            0xe000_edfc => self.system.demcr,
            DBGMCU_APB1FZR1 => self.system.frozen_in_halt,
            _ => 0,
        }
    }

    fn write_register(&mut self, address: u32, written: Written) {
        let value = written.value;
        match address {
            0xe000_1000 | 0xe000_1004 | 0xe000_edfc => self.write_cycle_counter(address, written),
            0xe000_e100..=0xe000_e17c => self.nvic.enabled |= interrupt_bits(address, value),
            0xe000_e180..=0xe000_e1fc => self.nvic.enabled &= !interrupt_bits(address, value),
            0xe000_e200..=0xe000_e27c => self.nvic.pend_all(interrupt_bits(address, value)),
            0xe000_e280..=0xe000_e2fc => self.nvic.unpend_all(interrupt_bits(address, value)),
            0xe000_e400..=0xe000_e46c => {
                self.set_priority_word((address - 0xe000_e400) as u8 + FIRST_INTERRUPT, written);
            }
            0xe000_ed0c => self.write_reset_control(value),
            0xe000_ed28 => self.system.cfsr &= !value,
            0xe000_ed88 => self.system.cpacr = written.over(self.system.cpacr) & 0x00f0_0000,
            0xe000_ed94 | 0xe000_ed9c | 0xe000_eda0 => self.system.mpu.write(address, value),
            DBGMCU_APB1FZR1 => self.system.frozen_in_halt = written.over(self.system.frozen_in_halt),
            _ => {}
        }
    }

    /// 32 interrupts of a set of exceptions, as the register at `address` shows them.
    fn interrupt_word(&self, exceptions: u128, address: u32) -> u32 {
        (exceptions >> FIRST_INTERRUPT).checked_shr(8 * (address & 0x7c)).unwrap_or(0) as u32
    }

    fn priority_word(&self, first: u8) -> u32 {
        u32::from_le_bytes([0, 1, 2, 3].map(|n| self.nvic.priority(first + n)))
    }

    fn set_priority_word(&mut self, first: u8, written: Written) {
        let word = written.over(self.priority_word(first));
        for (exception, priority) in (first..).zip(word.to_le_bytes()) {
            self.nvic.set_priority(exception, priority);
        }
    }

    /// AIRCR; a write without its key is ignored.
    fn write_reset_control(&mut self, value: u32) {
        if value >> 16 == VECTKEY {
            self.system.reset_requested |= value & 4 != 0;
        }
    }

    /// DWT_CTRL, DWT_CYCCNT and DEMCR.
    fn write_cycle_counter(&mut self, address: u32, written: Written) {
        let counter = &mut self.system.cycle_counter;
        let mut count = counter.value(self.executed);
        match address {
            0xe000_1000 => counter.enabled = written.over(counter.enabled.into()) & 1 != 0,
            0xe000_1004 => count = written.over(count),
            _ => self.system.demcr = written.over(self.system.demcr) & 0x0100_0000,
        }
        counter.set(count, counter.enabled && self.system.demcr != 0, self.executed);
    }
}

/// The exceptions of `value` written to a register of interrupt bits at `address`.
fn interrupt_bits(address: u32, value: u32) -> u128 {
    u128::from(value).checked_shl(8 * (address & 0x7c)).unwrap_or(0) << FIRST_INTERRUPT
}

/// DWT_CYCCNT: counts executed cycles while DEMCR.TRCENA and DWT_CTRL.CYCCNTENA are set.
#[derive(Clone, Debug, Default)]
pub(super) struct CycleCounter {
    /// DWT_CTRL.CYCCNTENA.
    pub enabled: bool,
    running: bool,
    /// Value minus executed cycles while running, value otherwise.
    base: u32,
}

impl CycleCounter {
    /// Value after `executed` cycles.
    pub fn value(&self, executed: u64) -> u32 {
        if self.running { self.base.wrapping_add(executed as u32) } else { self.base }
    }

    /// Counts on from `value`, or stands at it.
    pub fn set(&mut self, value: u32, running: bool, executed: u64) {
        self.running = running;
        self.base = if running { value.wrapping_sub(executed as u32) } else { value };
    }
}
