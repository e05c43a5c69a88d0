//! The private peripheral bus: system control block, NVIC registers, cycle counter (DDI0403, B3 and C1.8). Registers
//! without a model read 0 and ignore writes, among them the debug components and SysTick.

use super::nvic::{BUS_FAULT, FIRST_INTERRUPT, MEM_MANAGE, NMI, PEND_SV, SV_CALL, SYS_TICK, USAGE_FAULT};
use super::{Cpu, Fault, Size};
use crate::st::DBGMCU;

/// CCR bits.
const UNALIGN_TRP: u32 = 1 << 3;
const DIV_0_TRP: u32 = 1 << 4;
const STKALIGN: u32 = 1 << 9;
/// SCR bits.
const SLEEPONEXIT: u32 = 1 << 1;
const SEVONPEND: u32 = 1 << 4;
/// FPCCR bits.
const LSPEN: u32 = 1 << 30;
const ASPEN: u32 = 1 << 31;
/// Peripherals that stand still while a debugger halts the core (RM0440, "Debug support").
const DBGMCU_APB1FZR1: u32 = DBGMCU::BASE + DBGMCU::APB1FZR1;
/// AIRCR key of a write, and what it reads as.
const VECTKEY: u32 = 0x05fa;
const VECTKEYSTAT: u32 = 0xfa05;
/// CFSR bits telling that MMFAR or BFAR holds an address.
const MMARVALID: u32 = 1 << 7;
const BFARVALID: u32 = 1 << 15;

/// Registers read as constants: identification of a Cortex-M4 r0p1 with FPU (DDI0439, 4.1).
const IDENTIFICATION: [(u32, u32); 16] = [
    (0xe000_e004, 3), // ICTR: 128 lines
    (0xe000_ed00, 0x410f_c241),
    (0xe000_ed40, 0x0000_0030),
    (0xe000_ed44, 0x0000_0200),
    (0xe000_ed48, 0x0010_0000),
    (0xe000_ed50, 0x0010_0030),
    (0xe000_ed58, 0x0100_0000),
    (0xe000_ed60, 0x0110_1110),
    (0xe000_ed64, 0x0211_2000),
    (0xe000_ed68, 0x2023_2231),
    (0xe000_ed6c, 0x0111_1131),
    (0xe000_ed70, 0x0131_0132),
    (0xe000_ed90, 8 << 8),      // MPU_TYPE: eight regions
    (0xe000_ef40, 0x1011_0021), // MVFR0
    (0xe000_ef44, 0x1100_0011), // MVFR1
    (0xe000_0000, 1),           // ITM_STIM0: ready, so that nobody waits for a trace port
];

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

#[derive(Clone, Debug)]
pub(super) struct System {
    pub mpu: Mpu,
    pub vtor: u32,
    ccr: u32,
    scr: u32,
    pub cpacr: u32,
    pub cfsr: u32,
    pub hfsr: u32,
    fault_address: u32,
    fpccr: u32,
    fpcar: u32,
    pub(super) fpdscr: u32,
    frozen_in_halt: u32,
    demcr: u32,
    cycle_counter: CycleCounter,
    pub reset_requested: bool,
}

impl System {
    pub(super) fn frozen_in_halt(&self) -> u32 {
        self.frozen_in_halt
    }

    pub fn new() -> Self {
        Self {
            mpu: Mpu::default(),
            frozen_in_halt: 0,
            vtor: 0,
            ccr: STKALIGN,
            scr: 0,
            cpacr: 0,
            cfsr: 0,
            hfsr: 0,
            fault_address: 0,
            fpccr: ASPEN | LSPEN,
            fpcar: 0,
            fpdscr: 0,
            demcr: 0,
            cycle_counter: CycleCounter::default(),
            reset_requested: false,
        }
    }

    pub fn traps_division_by_zero(&self) -> bool {
        self.ccr & DIV_0_TRP != 0
    }

    pub fn traps_unaligned(&self) -> bool {
        self.ccr & UNALIGN_TRP != 0
    }

    pub fn aligns_stack(&self) -> bool {
        self.ccr & STKALIGN != 0
    }

    /// CCR.NONBASETHRDENA.
    pub fn thread_from_any_level(&self) -> bool {
        self.ccr & 1 != 0
    }

    pub fn sleeps_on_exit(&self) -> bool {
        self.scr & SLEEPONEXIT != 0
    }

    pub fn event_on_pending(&self) -> bool {
        self.scr & SEVONPEND != 0
    }

    /// FPCCR.LSPEN.
    pub fn lazy_stacking(&self) -> bool {
        self.fpccr & LSPEN != 0
    }

    /// FPCCR.ASPEN: using the floating-point unit makes its registers part of the context.
    pub fn tracks_float(&self) -> bool {
        self.fpccr & ASPEN != 0
    }

    /// Whether CPACR grants coprocessors 10 and 11.
    #[inline(always)]
    pub fn float_enabled(&self, privileged: bool) -> bool {
        match self.cpacr >> 20 & 15 {
            0b1111 => true,
            0b0101 => privileged,
            _ => false,
        }
    }

    /// Sets the bits of CFSR and the fault address.
    pub fn record_fault(&mut self, fault: Fault) {
        self.cfsr |= fault.class().1;
        let (valid, address) = match fault {
            Fault::DataBus { address } => (BFARVALID, address),
            Fault::Guarded { address } => (MMARVALID, address),
            _ => return,
        };
        self.cfsr |= valid;
        self.fault_address = address;
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

/// Exceptions whose enable, active and pending bits SHCSR shows: (exception, enable, active, pending bit).
const HANDLER_CONTROL: [(u8, Option<u32>, u32, Option<u32>); 6] = [
    (MEM_MANAGE, Some(16), 0, Some(13)),
    (BUS_FAULT, Some(17), 1, Some(14)),
    (USAGE_FAULT, Some(18), 3, Some(12)),
    (SV_CALL, None, 7, Some(15)),
    (PEND_SV, None, 10, None),
    (SYS_TICK, None, 11, None),
];

impl Cpu {
    /// A read of the private peripheral bus at an address aligned to `size`.
    #[cold]
    #[inline(never)]
    pub(super) fn read_private(&mut self, address: u32, size: Size) -> Result<u32, Fault> {
        if !self.registers.privileged() {
            return Err(Fault::DataBus { address });
        }
        let word = self.read_register(address & !3);
        let shifted = word >> (8 * (address & 3));
        Ok(shifted & u32::MAX >> (32 - 8 * size.bytes()))
    }

    /// A write to the private peripheral bus at an address aligned to `size`.
    #[cold]
    #[inline(never)]
    pub(super) fn write_private(&mut self, address: u32, size: Size, value: u32) -> Result<(), Fault> {
        // STIR alone may be opened to unprivileged code (CCR.USERSETMPEND).
        let open = address == 0xe000_ef00 && self.system.ccr & 2 != 0;
        if !self.registers.privileged() && !open {
            return Err(Fault::DataBus { address });
        }
        let (mask, shift) = (u32::MAX >> (32 - 8 * size.bytes()), 8 * (address & 3));
        self.write_register(address & !3, Written { value: (value & mask) << shift, mask: mask << shift });
        self.attention = true;
        Ok(())
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
            0xe000_ed04 => self.interrupt_control(),
            0xe000_ed08 => self.system.vtor,
            0xe000_ed0c => VECTKEYSTAT << 16 | u32::from(self.nvic.group_position) << 8,
            0xe000_ed10 => self.system.scr,
            0xe000_ed14 => self.system.ccr,
            0xe000_ed18..=0xe000_ed20 => self.priority_word((address - 0xe000_ed18) as u8 + 4),
            0xe000_ed24 => self.handler_control(),
            0xe000_ed28 => self.system.cfsr,
            0xe000_ed2c => self.system.hfsr,
            0xe000_ed34 | 0xe000_ed38 => self.system.fault_address,
            0xe000_ed88 => self.system.cpacr,
            0xe000_ed94 => self.system.mpu.control,
            0xe000_ed9c => self.system.mpu.base,
            0xe000_eda0 => self.system.mpu.attributes,
            0xe000_edfc => self.system.demcr,
            0xe000_ef34 => self.system.fpccr,
            0xe000_ef38 => self.system.fpcar,
            0xe000_ef3c => self.system.fpdscr,
            DBGMCU_APB1FZR1 => self.system.frozen_in_halt,
            _ => IDENTIFICATION.iter().find(|&&(register, _)| register == address).map_or(0, |&(_, value)| value),
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
            0xe000_ed04 => self.write_interrupt_control(value),
            0xe000_ed08 => self.system.vtor = written.over(self.system.vtor) & 0x3fff_ff80,
            0xe000_ed0c => self.write_reset_control(value),
            0xe000_ed10 => self.system.scr = written.over(self.system.scr) & 0x16,
            0xe000_ed14 => self.system.ccr = written.over(self.system.ccr) & 0x31b,
            0xe000_ed18..=0xe000_ed20 => self.set_priority_word((address - 0xe000_ed18) as u8 + 4, written),
            0xe000_ed24 => self.write_handler_control(written),
            0xe000_ed28 => self.system.cfsr &= !value,
            0xe000_ed2c => self.system.hfsr &= !value,
            0xe000_ed34 | 0xe000_ed38 => self.system.fault_address = written.over(self.system.fault_address),
            0xe000_ed88 => self.system.cpacr = written.over(self.system.cpacr) & 0x00f0_0000,
            0xe000_ed94 | 0xe000_ed9c | 0xe000_eda0 => self.system.mpu.write(address, value),
            0xe000_ef00 => self.nvic.pend_all(interrupt_bits(value >> 3 & 0x3c, 1 << (value & 31))),
            0xe000_ef34 => self.system.fpccr = written.over(self.system.fpccr) & (ASPEN | LSPEN),
            0xe000_ef38 => self.system.fpcar = written.over(self.system.fpcar) & !7,
            DBGMCU_APB1FZR1 => self.system.frozen_in_halt = written.over(self.system.frozen_in_halt),
            0xe000_ef3c => self.system.fpdscr = written.over(self.system.fpdscr) & 0x07c0_0000,
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

    /// ICSR.
    fn interrupt_control(&self) -> u32 {
        let pending = |exception: u8, bit: u32| ((self.nvic.pending >> exception) as u32 & 1) << bit;
        let others_active = self.nvic.active & !(1 << (self.registers.ipsr & 127)) != 0;
        pending(NMI, 31)
            | pending(PEND_SV, 28)
            | pending(SYS_TICK, 26)
            | u32::from(self.nvic.pending >> FIRST_INTERRUPT != 0) << 22
            | u32::from(self.nvic.most_urgent().unwrap_or(0)) << 12
            | u32::from(!others_active) << 11
            | u32::from(self.registers.ipsr)
    }

    fn write_interrupt_control(&mut self, value: u32) {
        for (exception, set, clear) in [(NMI, 31, None), (PEND_SV, 28, Some(27)), (SYS_TICK, 26, Some(25))] {
            if value >> set & 1 != 0 {
                self.nvic.pend(exception);
            }
            if clear.is_some_and(|bit: u32| value >> bit & 1 != 0) {
                self.nvic.unpend_all(1 << exception);
            }
        }
    }

    /// AIRCR; a write without its key is ignored.
    fn write_reset_control(&mut self, value: u32) {
        if value >> 16 == VECTKEY {
            self.nvic.group_position = (value >> 8 & 7) as u8;
            self.system.reset_requested |= value & 4 != 0;
        }
    }

    /// SHCSR.
    fn handler_control(&self) -> u32 {
        let bit = |set: u128, exception: u8, position: Option<u32>| {
            position.map_or(0, |position| ((set >> exception) as u32 & 1) << position)
        };
        HANDLER_CONTROL.iter().fold(0, |word, &(exception, enable, active, pending)| {
            word | bit(self.nvic.enabled, exception, enable)
                | bit(self.nvic.active, exception, Some(active))
                | bit(self.nvic.pending, exception, pending)
        })
    }

    fn write_handler_control(&mut self, written: Written) {
        let word = written.over(self.handler_control());
        let assign = |set: &mut u128, exception: u8, position: Option<u32>| {
            if let Some(position) = position {
                *set = *set & !(1 << exception) | u128::from(word >> position & 1) << exception;
            }
        };
        for (exception, enable, active, pending) in HANDLER_CONTROL {
            assign(&mut self.nvic.enabled, exception, enable);
            assign(&mut self.nvic.active, exception, Some(active));
            assign(&mut self.nvic.pending, exception, pending);
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
