//! The whole device: core, memories, peripherals, the wires between them, and what is plugged in.
//!
//! ```text
//! Machine ─┬─ Cpu
//!          └─ Board (the bus) ─┬─ flash, RAM, system memory
//!                              ├─ peripherals ─▶ Effects ─▶ DMA, triggers, interrupt lines, resets
//!                              ├─ World: gates and levels out, conversions in
//!                              └─ UsbHost, and the far end of the serial port
//! ```
//! Time is counted in [`Ticks`]. Before each instruction everything is done that is due, event by
//! event; an instruction and its accesses then happen at one instant, and take their cycles.

use crate::cpu::{Bus, BusFault, Cpu, FaultReport, Size, Step};
use crate::memory::{
    BOOT_LOADER_BASE, BOOT_LOADER_END, CCM_BASE, CCM_BYTES, FlashArray, RAM_BASE, RAM_BYTES, TS_CAL1, VREFINT_CAL,
    load, store, system_word,
};
use crate::peripherals::adc::AdcGroup;
use crate::peripherals::dac::Dac;
use crate::peripherals::dma::Dma;
use crate::peripherals::flash::{Flash, offset_of};
use crate::peripherals::gpio::{PORTS, Port};
use crate::peripherals::lpuart::Lpuart;
use crate::peripherals::power::{BROWN_OUT_V, Power};
use crate::peripherals::rcc::{Gate, Order, Rcc};
use crate::peripherals::store::Registers;
use crate::peripherals::timer::Timer;
use crate::peripherals::usb::Usb;
use crate::peripherals::watchdog::Watchdog;
use crate::peripherals::{Effects, ResetCause, Ticks};
use crate::usb_host::UsbHost;
use crate::world::World;

/// Supply of a healthy board, in volts.
pub const SUPPLY_V: f64 = 3.3;

/// The factory measured its constants at this supply, in volts.
const FACTORY_V: f64 = 3.0;

/// First emitter gate on port C.
const FIRST_GATE: u32 = 6;
const GATES: u16 = 0x3F;

/// Extra cycles of an access over the bridge to the slow buses (APB), about.
const BRIDGE_CYCLES: u32 = 2;

/// Why [`Machine::run_until`] returned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// The time is there.
    Reached,
    /// The program has jumped to the factory's boot loader.
    BootLoader,
    /// The core met a fault it cannot handle; only a reset helps.
    Lockup(FaultReport),
}

/// A change at the emitter gates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GateEdge {
    /// When.
    pub at: Ticks,
    /// Emitters lit from then on, bit k for emitter k.
    pub gates: u8,
    /// Codes of the level lines from then on.
    pub levels: [u16; 2],
}

/// A device and its surroundings.
#[derive(Debug)]
pub struct Machine<W> {
    cpu: Cpu,
    board: Board<W>,
    /// Ticks the core was awake and asleep since the last look.
    awake: Ticks,
    asleep: Ticks,
    resets: Vec<(Ticks, ResetCause)>,
    powered: bool,
}

/// Everything but the core.
#[derive(Debug)]
pub struct Board<W> {
    /// Light and electronics.
    pub world: W,
    /// What the USB cable leads to.
    pub usb_host: UsbHost,
    effects: Effects,
    ram: Box<[u8]>,
    flash: Flash,
    rcc: Rcc,
    power: Power,
    ports: [Port; PORTS],
    timers: [Timer; 4],
    adc12: AdcGroup<2>,
    adc345: AdcGroup<3>,
    dacs: [Dac; 2],
    dma: Dma,
    watchdog: Watchdog,
    usb: Usb,
    lpuart: Lpuart,
    /// Backup registers and real-time clock; outlive resets.
    backup: Registers,
    syscfg: Registers,
    crs: Registers,
    next: Ticks,
    driven: (u8, [u16; 2]),
    gate_log: Option<Vec<GateEdge>>,
    device_clock: Option<Ticks>,
    boot_loader: bool,
}

impl<W: World> Machine<W> {
    /// A device with `flash`, just powered, in `world`. The USB cable is plugged in.
    pub fn new(flash: FlashArray, world: W) -> Self {
        let mut machine = Self {
            cpu: Cpu::new(),
            board: Board::new(flash, world),
            awake: 0,
            asleep: 0,
            resets: Vec::new(),
            powered: true,
        };
        machine.cpu.reset(&mut machine.board);
        machine
    }

    /// The present.
    pub fn now(&self) -> Ticks {
        self.board.effects.now
    }

    /// Everything but the core.
    pub fn board(&self) -> &Board<W> {
        &self.board
    }

    /// Everything but the core. What is done to its parts takes effect from now on.
    pub fn board_mut(&mut self) -> &mut Board<W> {
        self.board.next = 0;
        &mut self.board
    }

    /// The core.
    pub fn cpu(&self) -> &Cpu {
        &self.cpu
    }

    /// Resets so far, with their times.
    pub fn resets(&self) -> &[(Ticks, ResetCause)] {
        &self.resets
    }

    /// Share of time the core was awake since the last call.
    pub fn take_load(&mut self) -> f64 {
        let (awake, asleep) = (std::mem::take(&mut self.awake), std::mem::take(&mut self.asleep));
        awake as f64 / (awake + asleep).max(1) as f64
    }

    /// Runs until `end` or until something stops it.
    pub fn run_until(&mut self, end: Ticks) -> Stop {
        while self.board.effects.now < end {
            if let Some(cause) = self.board.effects.reset.take() {
                self.reset(cause);
            }
            if !self.runs() {
                self.pass_to(end);
                continue;
            }
            if self.board.effects.now >= self.board.next {
                self.board.run_events();
            }
            if self.board.effects.lines_changed {
                self.board.effects.lines_changed = false;
                let lines = *self.board.effects.lines();
                self.cpu.set_lines(&lines);
            }
            if std::mem::take(&mut self.board.effects.nmi) {
                self.cpu.raise_nmi();
            }
            if self.board.flash.take_changed() {
                self.cpu.invalidate_code();
            }
            self.board.effects.pc = self.cpu.pc();
            match self.cpu.step(&mut self.board) {
                Step::Ran { cycles } => self.pass(cycles),
                Step::Asleep => self.sleep(end),
                Step::ResetRequested => self.board.effects.request_reset(ResetCause::Software),
                Step::Lockup(_) if self.board.boot_loader => return Stop::BootLoader,
                Step::Lockup(report) => {
                    // The watchdog may still end it.
                    if self.board.watchdog.next_event() == Ticks::MAX {
                        return Stop::Lockup(report);
                    }
                    self.pass_to(end);
                }
            }
        }
        Stop::Reached
    }

    fn runs(&self) -> bool {
        self.powered && self.board.power.supply_v() >= BROWN_OUT_V
    }

    fn pass(&mut self, cycles: u32) {
        let effects = &mut self.board.effects;
        let before = effects.now;
        effects.now = (before + Ticks::from(cycles)).max(effects.stalled_until);
        self.awake += effects.now - before;
    }

    fn sleep(&mut self, end: Ticks) {
        let now = self.board.effects.now;
        let tick = self.cpu.next_tick().map_or(Ticks::MAX, |cycles| now + cycles.max(1));
        let until = self.board.next.min(end).min(tick).max(now);
        self.cpu.sleep_for(until - now);
        self.asleep += until - now;
        self.board.effects.now = until;
    }

    /// Lets time pass without the core, up to the next event at most.
    fn pass_to(&mut self, end: Ticks) {
        if self.board.effects.now >= self.board.next {
            self.board.run_events();
        }
        let until = self.board.next.min(end).max(self.board.effects.now);
        self.asleep += until - self.board.effects.now;
        self.board.effects.now = until;
    }

    /// Resets the device, as its pin or a debugger does.
    pub fn reset(&mut self, cause: ResetCause) {
        self.resets.push((self.now(), cause));
        self.board.reset(cause);
        if self.runs() {
            self.cpu.reset(&mut self.board);
        }
    }

    /// Sets the supply. Below 1.7 V the device is held in reset, with all pins floating.
    pub fn set_supply(&mut self, volts: f64) {
        let was_running = self.runs();
        self.board.power.set_supply(volts, &mut self.board.effects);
        match (was_running, self.runs()) {
            (true, false) => self.board.reset(ResetCause::BrownOut),
            (false, true) if self.powered => self.reset(ResetCause::BrownOut),
            _ => {}
        }
    }

    /// Takes the supply away at once; what is being written in flash is torn.
    pub fn cut_power(&mut self) {
        self.board.flash.cut(self.board.effects.now);
        self.board.lose_power();
        self.powered = false;
    }

    /// Gives the supply back after [`cut_power`](Self::cut_power).
    pub fn restore_power(&mut self) {
        self.powered = true;
        self.resets.push((self.now(), ResetCause::PowerOn));
        self.cpu.reset(&mut self.board);
    }

    /// The word of RAM at `address`.
    pub fn ram_word(&self, address: u32) -> Option<u32> {
        load(&self.board.ram, address.checked_sub(RAM_BASE)? as usize, 4)
    }

    /// Deepest the stack has been since reset, in bytes.
    pub fn stack_bytes(&self) -> u32 {
        (RAM_BASE + RAM_BYTES as u32).saturating_sub(self.cpu.min_sp())
    }
}

impl<W: World> Board<W> {
    fn new(flash: FlashArray, world: W) -> Self {
        Self {
            world,
            usb_host: UsbHost::new(),
            effects: Effects::default(),
            ram: vec![0xA5; RAM_BYTES].into_boxed_slice(),
            flash: Flash::new(flash),
            rcc: Rcc::new(),
            power: Power::new(SUPPLY_V),
            ports: std::array::from_fn(Port::new),
            timers: [Timer::tim2(), Timer::tim3(), Timer::tim4(), Timer::tim5()],
            adc12: AdcGroup::adc12(),
            adc345: AdcGroup::adc345(),
            dacs: [Dac::new(), Dac::new()],
            dma: Dma::new(),
            watchdog: Watchdog::new(),
            usb: Usb::new(),
            lpuart: Lpuart::new(),
            backup: Registers::new(),
            syscfg: Registers::new(),
            crs: Registers::new(),
            next: 0,
            driven: (0, [0; 2]),
            gate_log: None,
            device_clock: None,
            boot_loader: false,
        }
    }

    /// The far end of the serial port.
    pub fn send_serial(&mut self, bytes: &[u8]) {
        self.lpuart.send(bytes, &self.effects);
    }

    /// What has come out of the serial port since the last call.
    pub fn take_serial(&mut self) -> Vec<u8> {
        self.lpuart.take_sent().into_iter().map(|sent| sent.byte).collect()
    }

    /// Broken rules and unknown registers.
    pub fn effects(&self) -> &Effects {
        &self.effects
    }

    /// Keeps a log of the emitter gates from now on.
    pub fn log_gates(&mut self) {
        self.gate_log = Some(Vec::new());
    }

    /// The log so far, which begins anew.
    pub fn take_gate_log(&mut self) -> Vec<GateEdge> {
        self.gate_log.as_mut().map(std::mem::take).unwrap_or_default()
    }

    /// Emitters lit now, bit k for emitter k.
    pub fn gates(&self) -> u8 {
        self.driven.0
    }

    /// The tick at which the device clock (TIM5) first started; `None` before.
    pub fn device_clock(&self) -> Option<Ticks> {
        self.device_clock
    }

    /// Sets the counter of the device clock, as if it had run for long.
    pub fn preset_device_clock(&mut self, count: u32) {
        self.timers[3].preset(count, &self.effects);
    }

    /// The flash memory's cells.
    pub fn flash(&self) -> &FlashArray {
        &self.flash.cells
    }

    /// Whether flash is being written.
    pub fn is_flash_busy(&self) -> bool {
        self.flash.next_event() != Ticks::MAX
    }

    /// Fault injection: the transfer of the next word of converter 1 or 2 does not happen.
    pub fn swallow_word(&mut self, converter: usize) {
        self.adc12.adc_mut(converter - 1).swallow_request();
    }

    /// Fault injection: the next transfer of a channel of DMA1 (from 1) meets a bus error.
    pub fn fail_transfer(&mut self, channel: usize) {
        self.dma.fail_next(channel - 1);
    }

    /// Triggers that came while a converter was still busy.
    pub fn missed_triggers(&self) -> u64 {
        (0..2).map(|index| self.adc12.adc(index).missed_triggers()).sum()
    }

    fn reset(&mut self, cause: ResetCause) {
        let effects = &mut self.effects;
        self.rcc.reset(cause);
        self.power.reset(effects);
        self.flash.reset(effects);
        self.ports.iter_mut().for_each(Port::reset);
        self.timers.iter_mut().for_each(|timer| timer.reset(effects));
        self.adc12.reset(effects);
        self.adc345.reset(effects);
        self.dacs.iter_mut().for_each(Dac::reset);
        self.dma.reset_controller(0, effects);
        self.dma.reset_controller(1, effects);
        self.dma.reset_multiplexer();
        self.watchdog = Watchdog::new();
        self.usb.reset(effects);
        self.lpuart.reset(effects);
        self.syscfg = Registers::new();
        self.crs = Registers::new();
        self.update_clocks();
        self.settle();
    }

    fn lose_power(&mut self) {
        self.reset(ResetCause::PowerOn);
        self.rcc = Rcc::new();
        self.backup = Registers::new();
        self.ram.fill(0xA5);
        self.settle();
    }

    fn run_events(&mut self) {
        let until = self.effects.now;
        loop {
            self.find_next();
            if self.next > until {
                break;
            }
            // What was changed from outside may be due since.
            let now = self.next.max(self.effects.now.min(self.next));
            self.effects.now = now;
            self.advance(now);
            self.route();
        }
        self.effects.now = until;
    }

    fn advance(&mut self, now: Ticks) {
        let effects = &mut self.effects;
        for timer in &mut self.timers {
            if timer.next_event() <= now {
                timer.advance(effects);
            }
        }
        if self.adc12.next_event() <= now {
            let world = &mut self.world;
            self.adc12.advance(effects, &mut |adc, channel| world.sample(now, adc, channel));
        }
        if self.adc345.next_event() <= now {
            let supply_v = self.power.supply_v();
            self.adc345.advance(effects, &mut |_, channel| internal_code(channel, supply_v));
        }
        if self.flash.next_event() <= now {
            self.flash.advance(effects);
        }
        if self.watchdog.next_event() <= now {
            self.watchdog.advance(effects);
        }
        if self.lpuart.next_event() <= now {
            self.lpuart.advance(effects);
        }
        if self.usb.next_event() <= now {
            self.usb.advance(effects);
        }
        if self.usb_host.next_event() <= now {
            self.usb_host.advance(now, &mut self.usb.port(effects));
        }
    }

    /// Passes on what has happened, until nothing more does.
    fn route(&mut self) {
        loop {
            let edges = self.effects.take_triggers();
            if edges != 0 {
                self.adc12.trigger(edges, &self.effects);
                self.adc345.trigger(edges, &self.effects);
            }
            let ready = self.effects.pending_requests() & self.dma.wanted();
            if ready == 0 {
                break;
            }
            self.serve(ready);
        }
        let driven = self.drive();
        if driven != self.driven {
            self.driven = driven;
            let (gates, levels) = driven;
            self.world.drive(self.effects.now, gates, levels);
            if let Some(log) = &mut self.gate_log {
                log.push(GateEdge { at: self.effects.now, gates, levels });
            }
        }
    }

    fn serve(&mut self, ready: u128) {
        let Some((channel, request)) = self.dma.select(ready) else {
            return;
        };
        // Before the access, which may well cause the next request.
        self.effects.withdraw(request);
        let moved = self.dma.transfer(channel).is_some_and(|transfer| {
            let value = self.access(transfer.source, transfer.source_width, None);
            let destination = transfer.destination;
            value.is_some_and(|value| self.access(destination, transfer.destination_width, Some(value)).is_some())
        });
        self.dma.finish(channel, moved, &mut self.effects);
    }

    fn drive(&self) -> (u8, [u16; 2]) {
        let gates = (self.ports[2].driven_high() >> FIRST_GATE & GATES) as u8;
        (gates, [self.dacs[0].output(), self.dacs[1].output()])
    }

    /// What must hold after anything may have changed.
    fn settle(&mut self) {
        self.route();
        self.find_next();
    }

    fn find_next(&mut self) {
        let timers = self.timers.iter().map(Timer::next_event).min().unwrap_or(Ticks::MAX);
        self.next = timers
            .min(self.adc12.next_event())
            .min(self.adc345.next_event())
            .min(self.flash.next_event())
            .min(self.watchdog.next_event())
            .min(self.lpuart.next_event())
            .min(self.usb.next_event())
            .min(self.usb_host.next_event());
    }

    fn update_clocks(&mut self) {
        let [adc12, adc345] = self.rcc.adc_half_ticks();
        self.adc12.set_kernel_clock(adc12);
        self.adc345.set_kernel_clock(adc345);
        self.usb.set_clock(self.rcc.has_hsi48(), &mut self.effects);
    }

    /// A read (`write` is `None`) or a write, of 1, 2 or 4 bytes; `None`: the address does not answer.
    #[inline]
    fn access(&mut self, address: u32, width: u32, write: Option<u32>) -> Option<u32> {
        let in_ram = address.wrapping_sub(RAM_BASE) as usize;
        if in_ram < RAM_BYTES {
            return match write {
                None => load(&self.ram, in_ram, width),
                Some(value) => store(&mut self.ram, in_ram, width, value).map(|()| 0),
            };
        }
        if let Some(offset) = offset_of(address) {
            self.effects.address = address;
            return match write {
                None => {
                    self.flash.note_read(offset, &mut self.effects);
                    load(self.flash.cells.bytes(), offset, width)
                }
                Some(value) => {
                    self.flash.program(offset, width, value, &mut self.effects);
                    Some(0)
                }
            };
        }
        self.access_elsewhere(address, width, write)
    }

    fn access_elsewhere(&mut self, address: u32, width: u32, write: Option<u32>) -> Option<u32> {
        let in_ccm = address.wrapping_sub(CCM_BASE) as usize;
        if in_ccm < CCM_BYTES {
            return self.access(RAM_BASE + (RAM_BYTES - CCM_BYTES + in_ccm) as u32, width, write);
        }
        if (0x1FFF_0000..0x1FFF_8000).contains(&address) {
            let word = system_word(address) >> (8 * (address & 3));
            return if write.is_none() { Some(narrow(word, width)) } else { None };
        }
        self.effects.address = address;
        if !is_peripheral(address) {
            return None;
        }
        if address & !0x3FF == 0x4000_6000 {
            return self.access_usb_memory(address & 0x3FF, width, write);
        }
        let value = match write {
            None => {
                let word = self.read_register(address & !3);
                narrow(word >> (8 * (address & 3)), width)
            }
            Some(value) => {
                self.write_register(address & !3, widen(value, width));
                0
            }
        };
        self.find_next();
        Some(value)
    }

    fn access_usb_memory(&mut self, offset: u32, width: u32, write: Option<u32>) -> Option<u32> {
        let effects = &mut self.effects;
        match write {
            None => Some(self.usb.read_memory(offset, width as usize, effects)),
            Some(value) => {
                self.usb.write_memory(offset, width as usize, value, effects);
                Some(0)
            }
        }
    }

    /// Notes an access to a peripheral without a clock, which reads zero and takes nothing.
    fn is_clocked(&mut self, address: u32, value: u32) -> bool {
        let is_clocked = gate_of(address).is_none_or(|gate| self.rcc.is_enabled(gate));
        if !is_clocked {
            self.effects.violation(value, "a peripheral is accessed only while its clock is enabled in RCC");
        }
        is_clocked
    }

    fn read_register(&mut self, address: u32) -> u32 {
        if !self.is_clocked(address, 0) {
            return 0;
        }
        let effects = &mut self.effects;
        let offset = address & 0x3FF;
        match address & !0x3FF {
            0x4000_0000..=0x4000_0C00 => self.timers[(address >> 10 & 3) as usize].read(offset, effects),
            0x4000_2000 => self.crs.read(offset),
            0x4000_2400 | 0x4000_2800 => self.backup.read(address & 0xFFF),
            0x4000_3000 => self.watchdog.read(offset, effects),
            0x4000_5C00 => self.usb.read(offset, effects),
            0x4000_7000 => self.power.read(offset, effects),
            0x4000_8000 => self.lpuart.read(offset, effects),
            0x4001_0000 => self.syscfg.read(offset),
            0x4001_0400 => self.power.read_lines(offset, effects),
            0x4002_0000 | 0x4002_0400 => self.dma.read((address >> 10 & 1) as usize, offset, effects),
            0x4002_0800 => self.dma.read_multiplexer(offset, effects),
            0x4002_1000 => self.rcc.read(offset, effects),
            0x4002_2000 => self.flash.read(offset, effects),
            0x4800_0000..=0x4800_1800 => self.ports[(address >> 10 & 7) as usize].read(offset, effects),
            0x5000_0000 => {
                let value = self.adc12.read(offset, effects);
                self.route();
                value
            }
            0x5000_0400 => self.adc345.read(offset, effects),
            0x5000_0800 | 0x5000_0C00 => self.dacs[(address >> 10 & 1) as usize].read(offset, effects),
            _ => {
                effects.unmodelled();
                0
            }
        }
    }

    fn write_register(&mut self, address: u32, value: u32) {
        if !self.is_clocked(address, value) {
            return;
        }
        let effects = &mut self.effects;
        let offset = address & 0x3FF;
        match address & !0x3FF {
            0x4000_0000..=0x4000_0C00 => {
                let timer = &mut self.timers[(address >> 10 & 3) as usize];
                timer.write(offset, value, effects);
                if address & !0x3FF == 0x4000_0C00 && self.device_clock.is_none() {
                    self.device_clock = timer.origin();
                }
            }
            0x4000_2000 => self.crs.write(offset, value),
            0x4000_2400 | 0x4000_2800 => {
                if self.power.may_write_backup() {
                    self.backup.write(address & 0xFFF, value);
                } else {
                    effects.violation(value, "the backup domain is written only while PWR_CR1.DBP = 1");
                }
            }
            0x4000_3000 => self.watchdog.write(offset, value, effects),
            0x4000_5C00 => self.usb.write(offset, value, effects),
            0x4000_7000 => self.power.write(offset, value, effects),
            0x4000_8000 => self.lpuart.write(offset, value, effects),
            0x4001_0000 => self.syscfg.write(offset, value),
            0x4001_0400 => self.power.write_lines(offset, value, effects),
            0x4002_0000 | 0x4002_0400 => self.dma.write((address >> 10 & 1) as usize, offset, value, effects),
            0x4002_0800 => self.dma.write_multiplexer(offset, value, effects),
            0x4002_1000 => self.write_rcc(offset, value),
            0x4002_2000 => self.flash.write(offset, value, effects),
            0x4800_0000..=0x4800_1800 => self.ports[(address >> 10 & 7) as usize].write(offset, value, effects),
            0x5000_0000 => self.adc12.write(offset, value, effects),
            0x5000_0400 => self.adc345.write(offset, value, effects),
            0x5000_0800 | 0x5000_0C00 => self.dacs[(address >> 10 & 1) as usize].write(offset, value, effects),
            _ => effects.unmodelled(),
        }
        self.effects.address = address;
    }

    fn write_rcc(&mut self, offset: u32, value: u32) {
        let order = self.rcc.write(offset, value, self.power.may_write_backup(), &mut self.effects);
        match order {
            Order::None => {}
            Order::Clocks => self.update_clocks(),
            Order::BackupReset => self.backup = Registers::new(),
            Order::Reset(..) => self.reset_peripherals(order),
        }
    }

    fn reset_peripherals(&mut self, order: Order) {
        let effects = &mut self.effects;
        for (index, timer) in (0..).zip(&mut self.timers) {
            if order.resets(Gate::apb1(index)) {
                timer.reset(effects);
            }
        }
        for (index, port) in (0..).zip(&mut self.ports) {
            if order.resets(Gate::ahb2(index)) {
                port.reset();
            }
        }
        for (index, dac) in (16..).zip(&mut self.dacs) {
            if order.resets(Gate::ahb2(index)) {
                dac.reset();
            }
        }
        for controller in 0..2 {
            if order.resets(Gate::ahb1(controller as u32)) {
                self.dma.reset_controller(controller, effects);
            }
        }
        if order.resets(DMAMUX) {
            self.dma.reset_multiplexer();
        }
        if order.resets(ADC12) {
            self.adc12.reset(effects);
        }
        if order.resets(ADC345) {
            self.adc345.reset(effects);
        }
        if order.resets(USB) {
            self.usb.reset(effects);
        }
        if order.resets(LPUART1) {
            self.lpuart.reset(effects);
        }
        if order.resets(CRS) {
            self.crs = Registers::new();
        }
        if order.resets(SYSCFG) {
            self.syscfg = Registers::new();
        }
        if order.resets(PWR) {
            self.power.reset_control();
        }
        self.update_clocks();
    }
}

const DMAMUX: Gate = Gate::ahb1(2);
const ADC12: Gate = Gate::ahb2(13);
const ADC345: Gate = Gate::ahb2(14);
const CRS: Gate = Gate::apb1(8);
const BACKUP: Gate = Gate::apb1(10);
const USB: Gate = Gate::apb1(23);
const PWR: Gate = Gate::apb1(28);
const LPUART1: Gate = Gate::apb1_2(0);
const SYSCFG: Gate = Gate::apb2(0);

/// The clock enable of the peripheral at `address`; `None` if it is always clocked or unknown.
fn gate_of(address: u32) -> Option<Gate> {
    match address & !0x3FF {
        0x4000_0000..=0x4000_0C00 => Some(Gate::apb1(address >> 10 & 3)),
        0x4000_2000 => Some(CRS),
        0x4000_2400 | 0x4000_2800 => Some(BACKUP),
        0x4000_5C00 | 0x4000_6000 => Some(USB),
        0x4000_7000 => Some(PWR),
        0x4000_8000 => Some(LPUART1),
        0x4001_0000 => Some(SYSCFG),
        0x4002_0000 | 0x4002_0400 => Some(Gate::ahb1(address >> 10 & 1)),
        0x4002_0800 => Some(DMAMUX),
        0x4800_0000..=0x4800_1800 => Some(Gate::ahb2(address >> 10 & 7)),
        0x5000_0000 => Some(ADC12),
        0x5000_0400 => Some(ADC345),
        0x5000_0800 | 0x5000_0C00 => Some(Gate::ahb2(16 + (address >> 10 & 1))),
        _ => None,
    }
}

fn is_peripheral(address: u32) -> bool {
    matches!(address, 0x4000_0000..=0x4002_43FF | 0x4800_0000..=0x4800_1FFF | 0x5000_0000..=0x5006_0BFF)
}

/// The low bytes of `word`.
fn narrow(word: u32, width: u32) -> u32 {
    match width {
        4 => word,
        2 => word & 0xFFFF,
        _ => word & 0xFF,
    }
}

/// A narrow write as the bridge hands it on: repeated over the word.
fn widen(value: u32, width: u32) -> u32 {
    match width {
        4 => value,
        2 => (value & 0xFFFF) * 0x0001_0001,
        _ => (value & 0xFF) * 0x0101_0101,
    }
}

/// Code of an internal channel of ADC5 at `supply_v`: temperature sensor at 30 °C, and reference.
fn internal_code(channel: u8, supply_v: f64) -> u16 {
    const SENSOR: u8 = 4;
    const REFERENCE: u8 = 18;
    let at_factory_supply = match channel {
        SENSOR => TS_CAL1,
        REFERENCE => VREFINT_CAL,
        _ => 0,
    };
    (f64::from(at_factory_supply) * FACTORY_V / supply_v).round().min(4095.0) as u16
}

impl<W: World> Bus for Board<W> {
    #[inline]
    fn fetch(&mut self, address: u32) -> Result<u16, BusFault> {
        if (BOOT_LOADER_BASE..BOOT_LOADER_END).contains(&address) {
            self.boot_loader = true;
            return Err(BusFault);
        }
        self.access(address, 2, None).map(|half| half as u16).ok_or(BusFault)
    }

    #[inline]
    fn read(&mut self, address: u32, size: Size) -> Result<u32, BusFault> {
        self.access(address, size.bytes(), None).ok_or(BusFault)
    }

    #[inline]
    fn write(&mut self, address: u32, size: Size, value: u32) -> Result<(), BusFault> {
        self.access(address, size.bytes(), Some(value)).ok_or(BusFault)?;
        if address >= 0x4000_0000 {
            self.settle();
        }
        Ok(())
    }

    #[inline]
    fn wait_states(&self, address: u32) -> u32 {
        if offset_of(address).is_some() {
            self.flash.latency()
        } else if (0x4000_0000..0x4002_0000).contains(&address) {
            BRIDGE_CYCLES
        } else {
            0
        }
    }
}
