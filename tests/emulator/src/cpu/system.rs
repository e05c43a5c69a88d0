//! The private peripheral bus: system control block, NVIC registers, cycle counter (DDI0403, B3 and C1.8). Registers
//! without a model read 0 and ignore writes, among them identification, the debug components, SysTick, HFSR, the
//! addresses of faults, and what changes how exceptions are entered and left or which faults have handlers of their own:
//! SCR, CCR, SHCSR, FPCCR. All is as after reset: unaligned accesses and divisions by zero are no faults, stacks are aligned
//! to eight bytes, floating-point state is stacked lazily. Which interrupts are enabled, pending and active is not read.

use super::nvic::FIRST_INTERRUPT;
use super::{Cpu, Size};
use crate::st::DBGMCU;

/// Peripherals that stand still while a debugger halts the core (RM0440, "Debug support").
const DBGMCU_APB1FZR1: u32 = DBGMCU::BASE + DBGMCU::APB1FZR1;
const DWT_CTRL: u32 = 0xe000_1000;
const DWT_CYCCNT: u32 = 0xe000_1004;
const DEMCR: u32 = 0xe000_edfc;
/// NVIC_IPR: a byte for each interrupt.
const PRIORITIES: u32 = 0xe000_e400;
const LAST_PRIORITY: u32 = 0xe000_e46f;
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
    /// VTOR: where the vector table lies, but for a reset.
    pub vectors: u32,
    pub frozen_in_halt: u32,
    demcr: u32,
    dwt_control: u32,
    /// Executed cycles when DWT_CYCCNT was zero, while DEMCR.TRCENA and DWT_CTRL.CYCCNTENA are set; otherwise it reads 0.
    cycles_from: Option<u64>,
    pub reset_requested: bool,
}

impl Cpu {
    /// A read of the private peripheral bus at an address aligned to `size`.
    #[cold]
    #[inline(never)]
    pub(super) fn read_private(&mut self, address: u32, size: Size) -> u32 {
        let shifted = self.read_register(address & !3) >> (8 * (address & 3));
        shifted & u32::MAX >> (32 - 8 * size.bytes())
    }

    fn read_register(&mut self, address: u32) -> u32 {
        match address {
            DWT_CTRL => 0x4000_0000 | self.system.dwt_control, // four comparators
            DWT_CYCCNT => self.system.cycles_from.map_or(0, |from| (self.executed - from) as u32),
            PRIORITIES..=LAST_PRIORITY => {
                let first = (address - PRIORITIES) as u8 + FIRST_INTERRUPT;
                u32::from_le_bytes([0, 1, 2, 3].map(|n| self.nvic.priority(first + n)))
            }
            // ICSR: VECTACTIVE.
            0xe000_ed04 => self.registers.ipsr.into(),
            0xe000_ed08 => self.system.vectors,
            0xe000_ed0c => VECTKEYSTAT << 16,
            0xe000_ed28 => self.system.cfsr,
            0xe000_ed88 => self.system.cpacr,
            0xe000_ed94 => self.system.mpu.control,
            0xe000_ed9c => self.system.mpu.base,
            0xe000_eda0 => self.system.mpu.attributes,
            DEMCR => self.system.demcr,
            DBGMCU_APB1FZR1 => self.system.frozen_in_halt,
            _ => 0,
        }
    }

    /// A write to the private peripheral bus at an address aligned to `size`: of a word but for priorities.
    #[cold]
    #[inline(never)]
    pub(super) fn write_private(&mut self, address: u32, size: Size, value: u32) {
        self.attention = true;
        match address {
            DWT_CTRL | DEMCR => {
                let register = if address == DEMCR { &mut self.system.demcr } else { &mut self.system.dwt_control };
                *register = value & if address == DEMCR { 1 << 24 } else { 1 };
                let runs = self.system.demcr != 0 && self.system.dwt_control != 0;
                self.system.cycles_from = self.system.cycles_from.or(Some(self.executed)).filter(|_| runs);
            }
            0xe000_e100..=0xe000_e17c => self.nvic.enabled |= interrupt_bits(address, value),
            0xe000_e180..=0xe000_e1fc => self.nvic.enabled &= !interrupt_bits(address, value),
            0xe000_e200..=0xe000_e27c => self.nvic.pend_all(interrupt_bits(address, value)),
            0xe000_e280..=0xe000_e2fc => self.nvic.unpend_all(interrupt_bits(address, value)),
            PRIORITIES..=LAST_PRIORITY => {
                let exceptions = (address - PRIORITIES) as u8 + FIRST_INTERRUPT..;
                for (exception, priority) in exceptions.zip(value.to_le_bytes()).take(size.bytes() as usize) {
                    self.nvic.set_priority(exception, priority);
                }
            }
            // VTOR (DDI0403, B3.2.5): TBLOFF.
            0xe000_ed08 => self.system.vectors = value & !0x7f,
            // AIRCR; a write without its key is ignored.
            0xe000_ed0c => self.system.reset_requested |= value >> 16 == VECTKEY && value & 4 != 0,
            0xe000_ed28 => self.system.cfsr &= !value,
            0xe000_ed88 => self.system.cpacr = value & 0x00f0_0000,
            0xe000_ed94 | 0xe000_ed9c | 0xe000_eda0 => self.system.mpu.write(address, value),
            DBGMCU_APB1FZR1 => self.system.frozen_in_halt = value,
            _ => {}
        }
    }
}

/// The exceptions of `value` written to a register of interrupt bits at `address`.
fn interrupt_bits(address: u32, value: u32) -> u128 {
    u128::from(value).checked_shl(8 * (address & 0x7c)).unwrap_or(0) << FIRST_INTERRUPT
}
