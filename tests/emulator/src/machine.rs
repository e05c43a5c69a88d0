//! The machine: a core on a board, with power, resets and time.
//!
//! Time is a count of core clocks, [`Ticks`]. The core executes an instruction at once at its
//! start; then time moves by its duration, and what the board does meanwhile happens at its
//! exact ticks. A core that sleeps lets time jump from event to event.

use crate::board::Board;
use crate::cpu::{Cpu, FaultReport, Step};
use crate::faults::{Fault, Faults};
use crate::memory::FlashArray;
use crate::peripherals::{ResetCause, Ticks};
use crate::world::World;

/// Timer index of the free-running device clock, TIM5.
const DEVICE_CLOCK: usize = 3;

/// Why [`Machine::run_until`] has returned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// The time has come.
    Reached,
    /// The supply is off or too low; the time has come all the same.
    PoweredOff,
    /// The core has jumped into the factory's boot loader, which is not executed.
    BootLoader,
    /// A fault that no handler could take, and no watchdog runs. Only a reset helps.
    Lockup(FaultReport),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reset {
    pub at: Ticks,
    pub cause: ResetCause,
}

#[derive(Debug)]
pub struct Machine {
    pub cpu: Cpu,
    pub board: Board,
    resets: Vec<Reset>,
    /// Ticks in which the core did not sleep.
    awake: Ticks,
    powered: bool,
    /// The brown-out reset holds the device.
    browned_out: bool,
}

impl Machine {
    /// A machine whose flash holds `array`, powered on at tick 0.
    pub fn new(array: FlashArray, world: Option<World>) -> Self {
        let mut machine = Self {
            cpu: Cpu::default(),
            board: Board::new(array, world),
            resets: Vec::new(),
            awake: 0,
            powered: true,
            browned_out: false,
        };
        machine.reset(ResetCause::PowerOn);
        machine
    }

    /// The same with faults of the silicon, which come by chance from `seed`; before it runs.
    #[must_use]
    pub fn with_faults(mut self, faults: Faults, seed: u64) -> Self {
        self.board.set_faults(faults, seed);
        self.cpu.fetch_wrong_behind_sleep(faults.has(Fault::SleepFetch));
        self
    }

    /// The present, in ticks since the machine was made.
    pub fn now(&self) -> Ticks {
        self.board.now()
    }

    /// Runs until tick `end`, or until something stops the core for good. An instruction that
    /// has begun is finished, so time may be a few ticks beyond `end`.
    pub fn run_until(&mut self, end: Ticks) -> Stop {
        // Between runs the caller may have moved what is outside.
        self.board.outside_changed();
        while self.now() < end {
            if !self.powered || self.browned_out {
                // The computer at the USB cable lives on.
                self.board.advance_to(end);
                return Stop::PoweredOff;
            }
            if self.board.next_event() <= self.now() {
                self.board.advance_to(self.now());
            }
            if self.board.effects.attention
                && let Some(stop) = self.attend()
            {
                return stop;
            }
            self.board.effects.pc = self.cpu.pc();
            match self.cpu.step(&mut self.board) {
                Step::Ran { cycles } => {
                    self.board.effects.now += Ticks::from(cycles);
                    self.awake += Ticks::from(cycles);
                }
                Step::Asleep => self.sleep(end),
                Step::ResetRequested => self.reset(ResetCause::Software),
                // Only a reset helps now, and the watchdog may bring one.
                Step::Lockup(_) if self.board.watchdog_runs() => {
                    let before = self.now();
                    self.sleep(end);
                    self.awake += self.now() - before;
                }
                Step::Lockup(report) => return Stop::Lockup(report),
            }
        }
        Stop::Reached
    }

    /// Lets time pass until tick `end` while a debugger halts the core, or until a reset.
    pub fn halt_until(&mut self, end: Ticks) {
        self.board.halt_timers(self.cpu.frozen_in_halt());
        self.board.advance_to(end);
        self.board.halt_timers(0);
    }

    pub fn pull_reset_pin(&mut self) {
        if self.powered && !self.browned_out {
            self.reset(ResetCause::Pin);
        }
    }

    /// Cuts the supply. A flash operation under way leaves torn cells; RAM and backup registers
    /// are lost.
    pub fn cut_power(&mut self) {
        self.powered = false;
        self.board.lose_power();
    }

    /// Switches the supply on again; it comes back as high as it was set.
    pub fn power_on(&mut self) {
        if !self.powered {
            self.powered = true;
            if !self.browned_out {
                self.reset(ResetCause::PowerOn);
            }
        }
    }

    /// Sets the supply, in volts. Below 1.64 V the brown-out reset stops the device; it starts
    /// again when the supply is back.
    pub fn set_supply_v(&mut self, volts: f64) {
        let low = !self.board.set_supply_v(volts);
        let was_low = std::mem::replace(&mut self.browned_out, low);
        match (was_low, low) {
            (false, true) if self.powered => self.board.reset(ResetCause::BrownOut),
            (true, false) if self.powered => self.reset(ResetCause::BrownOut),
            _ => {}
        }
    }

    /// All resets since the machine was made, the first power-on included.
    pub fn resets(&self) -> &[Reset] {
        &self.resets
    }

    /// Ticks in which the core was awake. Its load over a stretch of time is the increase of
    /// this divided by the length of the stretch.
    pub fn awake_ticks(&self) -> Ticks {
        self.awake
    }

    /// Tick at which the device clock (TIM5) was zero, counted back from where it was started
    /// or preset (modulo 2⁶⁴); `None` before the firmware starts it.
    pub fn device_clock_origin(&self) -> Option<Ticks> {
        self.board.timers[DEVICE_CLOCK].origin()
    }

    /// Sets the device clock, as a write to its counter does: to bring it close to its wrap.
    pub fn preset_device_clock(&mut self, count: u32) {
        self.board.preset_timer(DEVICE_CLOCK, count);
    }

    fn reset(&mut self, cause: ResetCause) {
        self.resets.push(Reset { at: self.now(), cause });
        self.board.reset(cause);
        self.cpu.set_lines(&self.board.effects.lines);
        self.cpu.reset(&mut self.board);
    }

    /// Does what the board has asked of core and machine.
    #[cold]
    fn attend(&mut self) -> Option<Stop> {
        self.board.effects.attention = false;
        if let Some(cause) = self.board.effects.reset {
            self.reset(cause);
            return None;
        }
        if std::mem::take(&mut self.board.effects.boot_loader_entered) {
            return Some(Stop::BootLoader);
        }
        if std::mem::take(&mut self.board.effects.nmi) {
            self.cpu.raise_nmi();
        }
        self.cpu.set_lines(&self.board.effects.lines);
        None
    }

    /// Lets time pass until something happens that may wake the core, or reset it.
    fn sleep(&mut self, end: Ticks) {
        self.board.advance_to(self.board.next_event().min(end).max(self.now()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::board::Board;
    use crate::cpu::Size;
    use crate::peripherals::TICKS_PER_SECOND;

    const SPIN: &[u16] = &[0xE7FE];
    /// A machine with a vector table and `code` behind it.
    fn machine(code: &[u16]) -> Machine {
        let mut flash = FlashArray::erased();
        flash.load(0, &0x2000_1000_u32.to_le_bytes());
        flash.load(4, &0x0800_0009_u32.to_le_bytes());
        let bytes: Vec<u8> = code.iter().flat_map(|half| half.to_le_bytes()).collect();
        flash.load(8, &bytes);
        Machine::new(flash, None)
    }

    fn put(board: &mut Board, address: u32, value: u32) {
        board.write(address, Size::Word, value).unwrap();
    }

    fn causes(machine: &Machine) -> Vec<ResetCause> {
        machine.resets().iter().map(|reset| reset.cause).collect()
    }

    fn start_watchdog(machine: &mut Machine) {
        for (offset, value) in [(0, 0x5555), (4, 1), (8, 399), (0, 0xCCCC)] {
            put(&mut machine.board, 0x4000_3000 + offset, value);
        }
    }

    #[test]
    fn a_locked_up_core_waits_for_the_watchdog() {
        let undefined = &[0xDE00];
        let mut alone = machine(undefined);
        assert!(matches!(alone.run_until(1_000), Stop::Lockup(_)));
        let mut guarded = machine(undefined);
        start_watchdog(&mut guarded);
        guarded.run_until(TICKS_PER_SECOND / 10 - 1);
        assert_eq!(causes(&guarded), [ResetCause::PowerOn]);
        guarded.run_until(TICKS_PER_SECOND / 10 + 1);
        assert_eq!(causes(&guarded), [ResetCause::PowerOn, ResetCause::Watchdog]);
    }

    #[test]
    fn a_supply_restored_while_off_starts_once_at_power_on() {
        let mut machine = machine(SPIN);
        machine.set_supply_v(1.0);
        machine.cut_power();
        machine.set_supply_v(3.3);
        // The computer at the USB cable keeps looking every millisecond; time never goes back.
        assert_eq!(machine.run_until(TICKS_PER_SECOND), Stop::PoweredOff);
        machine.power_on();
        assert_eq!(machine.run_until(TICKS_PER_SECOND + 10), Stop::Reached);
        assert!(machine.now() >= TICKS_PER_SECOND + 10);
        assert_eq!(machine.resets()[1..], [Reset { at: TICKS_PER_SECOND, cause: ResetCause::PowerOn }]);
    }
}
