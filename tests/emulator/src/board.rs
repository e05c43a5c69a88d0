//! Everything but the core: memories, peripherals, and the wires between them; the address map is
//! in `bus`, what faulty silicon does to the wires in `faults`.
//!
//! The board moves in time from event to event. All that happens in one tick is done in this
//! order: converters hold their samples; timers and the others have their events; trigger edges
//! reach the converters; DMA requests are served by priority.

use crate::faults::Fault;
use crate::memory::{Bits, FlashArray, RAM_BYTES, TS_CAL1, TS_CAL2, VREFINT_CAL};
use crate::peripherals::Bank;
use crate::peripherals::adc::AdcGroup;
use crate::peripherals::dac::Dac;
use crate::peripherals::dma::{CHANNELS as DMA_CHANNELS, Dma};
use crate::peripherals::exti::Exti;
use crate::peripherals::flash::Flash;
use crate::peripherals::gpio::{PORTS, Port};
use crate::peripherals::lab::{FrameTimer, TriggerLine};
use crate::peripherals::plain::{self, Crc};
use crate::peripherals::power::Power;
use crate::peripherals::rcc::Rcc;
use crate::peripherals::timer::Timer;
use crate::peripherals::uart::Uart;
use crate::peripherals::usb::Usb;
use crate::peripherals::watchdog::Watchdog;
use crate::peripherals::{Effects, ResetCause, Ticks};
use crate::st::{self, LL, TS, V};
use crate::usb_host::UsbHost;
use crate::world::{Drive, Hold, Record, World};

mod bus;
mod faults;

use bus::{UNITS, Unit};
use faults::UnderWay;

/// The port that switches the emitters, and the shift of its first gate (PC6).
const GATE_PORT: usize = 2;
const FIRST_GATE: u32 = 6;
/// PC6 to PC11.
const GATES: u16 = 0x3F;

/// Port and number of the trigger input, PC12, and of the frame output, PA10.
const TRIGGER: (usize, u32) = (2, 12);
const FRAME_OUTPUT: (usize, u32) = (0, 10);

/// Temperatures at which the factory calibrates the sensor, in degrees Celsius.
const CALIBRATION_C: [f64; 2] = [TS::CAL1_temperature as f64, TS::CAL2_temperature as f64];

#[derive(Debug)]
pub struct Board {
    /// Light and electronics around the board; none: converters at zero.
    pub world: Option<World>,
    /// What the board does to them, if somebody wants to know.
    pub record: Option<Record>,
    /// Signals between the peripherals, and the record of broken rules.
    pub effects: Effects,
    /// TIM2 to TIM5.
    pub timers: [Timer; 4],
    /// TIM1: the frame output.
    pub frame_timer: FrameTimer,
    /// The line at the trigger input: a wire from the frame output, and edges from outside.
    pub trigger_line: TriggerLine,
    /// Level of the frame output at its pin.
    is_output_high: bool,
    /// ADC1 and ADC2.
    pub adc12: AdcGroup<2>,
    /// ADC3 to ADC5.
    pub adc345: AdcGroup<3>,
    /// DMA1, DMA2 and DMAMUX.
    pub dma: Dma,
    /// USB device.
    pub usb: Usb,
    /// The host at the other end of the USB cable.
    pub usb_host: UsbHost,
    /// LPUART1: the serial port to the debugger.
    pub lpuart: Uart,
    /// USART1: the serial port to a motor controller.
    pub usart: Uart,
    ram: Box<[u8]>,
    pub flash: Flash,
    rcc: Rcc,
    power: Power,
    exti: Exti,
    syscfg: Bank,
    backup: Bank,
    /// GPIO ports A to G.
    pub ports: [Port; PORTS],
    dacs: [Dac; 2],
    watchdog: Watchdog,
    crs: Bank,
    crc: Crc,
    /// Temperature of the chip, in degrees Celsius.
    pub temperature_c: f64,
    /// Output of the voltage detector, as the interrupt controller last saw it.
    pvd: bool,
    gates: u8,
    levels: [u16; 2],
    under_way: UnderWay,
    /// Fault sram-first-write: some block of SRAM may lose a write, or has lost one that was not repeated.
    loses_writes: bool,
    next_event: Ticks,
}

impl Board {
    /// A board at 3.3 V and 30 °C whose flash holds `array`, after power-on at tick 0.
    pub fn new(array: FlashArray, world: Option<World>) -> Self {
        let mut board = Self {
            world,
            record: None,
            effects: Effects::default(),
            timers: std::array::from_fn(Timer::new),
            frame_timer: FrameTimer::default(),
            trigger_line: TriggerLine::default(),
            is_output_high: false,
            adc12: AdcGroup::adc12(),
            adc345: AdcGroup::adc345(),
            dma: Dma::new(),
            usb: Usb::new(),
            usb_host: UsbHost::new(),
            lpuart: Uart::lpuart1(),
            usart: Uart::usart1(),
            ram: vec![0; RAM_BYTES].into_boxed_slice(),
            flash: Flash::new(array),
            rcc: Rcc::new(),
            power: Power::new(3.3),
            exti: Exti::new(),
            syscfg: Bank::new(plain::SYSCFG_REGISTERS),
            backup: Bank::new(plain::BACKUP_REGISTERS),
            ports: std::array::from_fn(Port::new),
            dacs: [Dac::new(), Dac::new()],
            watchdog: Watchdog::new(),
            crs: Bank::new(plain::CRS_REGISTERS),
            crc: Crc::new(),
            temperature_c: CALIBRATION_C[0],
            pvd: false,
            gates: 0,
            levels: [0; 2],
            under_way: UnderWay::default(),
            loses_writes: false,
            next_event: Ticks::MAX,
        };
        board.scramble_ram();
        board.find_next_event();
        board
    }

    /// The present, in ticks since the machine was made.
    #[inline]
    pub fn now(&self) -> Ticks {
        self.effects.now
    }

    /// The next tick at which something happens without the core.
    #[inline]
    pub fn next_event(&self) -> Ticks {
        self.next_event
    }

    /// Lets time pass until `end`, or until an event asks for a reset.
    pub fn advance_to(&mut self, end: Ticks) {
        while self.next_event <= end {
            self.effects.now = self.next_event;
            self.handle_events();
            self.settle();
            if self.effects.reset.is_some() {
                return;
            }
        }
        self.effects.now = end;
    }

    /// Resets all that `cause` resets. RAM outlives all but a loss of power; backup registers
    /// outlive all but that of the backup supply; flash outlives everything, but an operation
    /// that was under way leaves torn cells.
    pub fn reset(&mut self, cause: ResetCause) {
        self.effects.clear_signals();
        self.under_way.reset();
        self.forget_accesses();
        self.flash.reset(&self.effects);
        self.rcc.reset(cause);
        self.pvd = false;
        for (unit, _) in UNITS {
            self.reset_unit(*unit);
        }
        if matches!(cause, ResetCause::PowerOn | ResetCause::BrownOut) {
            self.scramble_ram();
        }
        self.update_clocks();
        self.update_drive();
        self.settle();
    }

    /// The supply is gone, and with it the content of the backup registers.
    pub fn lose_power(&mut self) {
        self.reset(ResetCause::PowerOn);
        self.lose_backup();
    }

    /// Sets the supply, in volts. Returns whether it is high enough for the device to run.
    pub fn set_supply_v(&mut self, volts: f64) -> bool {
        self.power.supply_v = volts;
        if volts < V::BAT_least {
            self.lose_backup();
        }
        self.update_pvd();
        volts >= V::BOR0_falling
    }

    pub fn watchdog_runs(&self) -> bool {
        self.watchdog.next_event() != Ticks::MAX
    }

    /// The emitter gates: bit k for PC(6 + k).
    pub fn gates(&self) -> u8 {
        self.gates
    }

    /// Sets the counter of TIM2 to TIM5 (`index` 0 to 3), as a write to CNT does.
    pub fn preset_timer(&mut self, index: usize, count: u32) {
        self.timers[index].preset(count, &self.effects);
        self.find_next_event();
    }

    /// Halts those of TIM2 to TIM5 whose bits are set, from bit 0 on, and lets the others go on.
    pub fn halt_timers(&mut self, frozen: u32) {
        for (bit, timer) in self.timers.iter_mut().enumerate() {
            timer.halt(frozen >> bit & 1 != 0, &self.effects);
        }
        self.find_next_event();
    }

    /// Tells that something outside (a USB cable, a serial line) was moved past the bus. A run
    /// begins with it.
    pub fn outside_changed(&mut self) {
        self.find_next_event();
    }

    fn scramble_ram(&mut self) {
        let mut bits = Bits::seeded(self.effects.now);
        for chunk in self.ram.chunks_exact_mut(8) {
            chunk.copy_from_slice(&bits.next().to_le_bytes());
        }
    }

    fn lose_backup(&mut self) {
        self.backup.reset();
        self.rcc.reset_backup_domain();
    }

    fn handle_events(&mut self) {
        let now = self.effects.now;
        if self.adc12.next_event() == now {
            let Self { world, record, .. } = self;
            self.adc12.advance(&mut self.effects, &mut |adc, channel| {
                if let Some(holds) = record.as_mut().and_then(|record| record.holds.as_mut()) {
                    holds.push(Hold { at: now, adc, channel });
                }
                world.as_mut().map_or(0, |world| world.sample(now, adc, channel))
            });
            self.disturb_neighbours();
        }
        for timer in &mut self.timers {
            if timer.next_event() == now {
                timer.advance(&mut self.effects);
            }
        }
        if self.trigger_line.next_event() == now {
            self.follow_trigger_line();
        }
        if self.lpuart.next_event() == now {
            self.lpuart.advance(&mut self.effects);
        }
        if self.usart.next_event() == now {
            self.usart.advance(&mut self.effects);
        }
        if self.usb.next_event() == now {
            self.usb.advance(&mut self.effects);
        }
        if self.usb_host.next_event() == now {
            self.usb_host.advance(now, &mut self.usb.port(&mut self.effects));
        }
        if self.flash.next_event() == now {
            self.flash.advance(&mut self.effects);
        }
        if self.adc345.next_event() == now {
            let (supply_v, temperature_c) = (self.power.supply_v, self.temperature_c);
            self.adc345.advance(&mut self.effects, &mut |_, channel| internal_code(channel, supply_v, temperature_c));
            self.disturb_neighbours();
        }
        self.handle_faults(now);
        if self.watchdog.next_event() == now {
            self.watchdog.advance(&mut self.effects);
        }
    }

    /// Lets all consequences of an access or event run out, then looks for the next event.
    fn settle(&mut self) {
        loop {
            if std::mem::take(&mut self.effects.triggered) {
                self.adc12.trigger(&self.effects);
                self.adc345.trigger(&self.effects);
                for timer in &mut self.timers {
                    timer.trigger(&mut self.effects);
                }
                self.frame_timer.trigger(self.effects.now);
            }
            let ready = self.effects.requests & self.dma.wanted();
            if ready == 0 {
                break;
            }
            if self.effects.faults.has(Fault::DmaLatency) {
                if !self.begin_transfers(ready) {
                    break;
                }
            } else if let Some((channel, request)) = self.dma.select(ready, 0..DMA_CHANNELS) {
                self.carry_out(channel, request);
            }
        }
        self.follow_frame_output();
        self.find_next_event();
    }

    fn carry_out(&mut self, channel: usize, request: u32) {
        // Acknowledged first: the access itself may raise the next request.
        self.effects.withdraw(request);
        let moved = self.dma.transfer(channel).is_some_and(|transfer| {
            let value = self.access_read(transfer.source, transfer.source_width);
            value.is_ok_and(|value| {
                let mask = u32::MAX >> (32 - 8 * transfer.destination_width);
                self.access_write(transfer.destination, transfer.destination_width, value & mask).is_ok()
            })
        });
        self.dma.finish(channel, moved, &mut self.effects);
    }

    #[inline]
    fn find_next_event(&mut self) {
        let timers = self.timers.iter().map(Timer::next_event).fold(Ticks::MAX, Ticks::min);
        self.next_event = timers
            .min(self.trigger_line.next_event())
            .min(self.adc12.next_event())
            .min(self.lpuart.next_event())
            .min(self.usart.next_event())
            .min(self.usb.next_event())
            .min(self.usb_host.next_event())
            .min(self.flash.next_event())
            .min(self.adc345.next_event())
            .min(self.watchdog.next_event())
            .min(self.under_way.next_event());
    }

    /// Takes the frame output along its wire to the trigger input.
    fn follow_frame_output(&mut self) {
        let is_driven = self.ports[FRAME_OUTPUT.0].function(FRAME_OUTPUT.1) == Some(st::GPIO::AF6_TIM1);
        let is_high = is_driven && self.frame_timer.is_high;
        let has_changed = std::mem::replace(&mut self.is_output_high, is_high) != is_high;
        if has_changed && !self.effects.faults.has(Fault::MissingWire) {
            self.trigger_line.edges.push_front((self.effects.now, is_high));
            self.follow_trigger_line();
        }
    }

    /// Takes the line at PC12 to its pin, and its edges to channel 2 of TIM5.
    fn follow_trigger_line(&mut self) {
        let has_passed = self.trigger_line.advance(self.effects.now);
        let port = &mut self.ports[TRIGGER.0];
        port.held_high = u16::from(self.trigger_line.is_high) << TRIGGER.1;
        if has_passed && port.function(TRIGGER.1) == Some(st::GPIO::AF1_TIM5) {
            self.timers[3].capture(&mut self.effects);
        }
    }

    /// Tells the world, if gates or levels have changed.
    fn update_drive(&mut self) {
        let gates = (self.ports[GATE_PORT].driven_high() >> FIRST_GATE & GATES) as u8;
        let levels = [self.dacs[0].output(), self.dacs[1].output()];
        if (gates, levels) == (self.gates, self.levels) {
            return;
        }
        (self.gates, self.levels) = (gates, levels);
        let now = self.effects.now;
        if let Some(record) = &mut self.record {
            record.drives.push(Drive { at: now, gates, levels });
        }
        if let Some(world) = &mut self.world {
            world.drive(now, gates, levels);
        }
    }

    /// Carries the detector's output to its interrupt line.
    fn follow_pvd(&mut self) {
        self.power.compare();
        let low = self.power.is_low;
        if low != self.pvd {
            self.pvd = low;
            self.exti.supply_crosses(low, &mut self.effects);
        }
    }

    /// Tells the USB block, which has a clock of its own, what RCC selects.
    fn update_clocks(&mut self) {
        self.usb.set_clock(self.rcc.has_usb_clock(), &mut self.effects);
    }

    fn write_rcc(&mut self, offset: u32, value: u32) {
        let slow = !self.rcc.is_at_full_speed();
        let pulled = self.rcc.write(offset, value, &mut self.effects);
        if slow && self.rcc.is_at_full_speed() {
            if self.flash.latency() < st::wait::states_170_MHz {
                self.effects.violation(value, "170 MHz need four wait states of the flash");
            }
            if !self.power.is_boosted() {
                self.effects.violation(value, "170 MHz need range 1 boost mode");
            }
        }
        if self.rcc.holds_backup_domain() {
            self.backup.reset();
        }
        self.update_clocks();
        if let Some(pulled) = pulled {
            for (unit, gate) in UNITS {
                if gate.is_some_and(|gate| pulled.meets(gate)) {
                    self.reset_unit(*unit);
                }
            }
            self.update_drive();
        }
    }

    /// Brings a unit into its state after reset; flash, RCC and the backup registers have ways of their own.
    fn reset_unit(&mut self, unit: Unit) {
        let effects = &mut self.effects;
        match unit {
            Unit::Timer(index) => self.timers[index].reset(effects),
            Unit::FrameTimer => self.frame_timer.reset(),
            Unit::Adc12 => self.adc12.reset(effects),
            Unit::Adc345 => self.adc345.reset(effects),
            Unit::Dma(controller) => self.dma.reset_controller(controller, effects),
            Unit::Dmamux => self.dma.reset_multiplexer(),
            Unit::Gpio(index) => self.ports[index].reset(),
            Unit::Dac(index) => self.dacs[index].reset(),
            Unit::Usb => self.usb.reset(effects),
            Unit::Lpuart => self.lpuart.reset(effects),
            Unit::Usart => self.usart.reset(effects),
            Unit::Power => self.power.reset(),
            Unit::Exti => self.exti.reset(effects),
            Unit::Syscfg => self.syscfg.reset(),
            Unit::Watchdog => self.watchdog = Watchdog::new(),
            Unit::Crs => self.crs.reset(),
            Unit::Crc => self.crc = Crc::new(),
            Unit::Flash | Unit::Rcc | Unit::Backup => {}
        }
    }
}

/// Code of `channel` of ADC3 to ADC5 (data sheet, "Temperature sensor characteristics" and "Internal voltage reference"):
/// temperature on ADC5_IN4, reference on IN18; nothing else is connected.
fn internal_code(channel: u8, supply_v: f64, temperature_c: f64) -> u16 {
    let at_calibration_supply = match channel.into() {
        LL::ADC_CHANNEL_TEMPSENSOR_ADC5 => {
            let slope = f64::from(TS_CAL2 - TS_CAL1) / (CALIBRATION_C[1] - CALIBRATION_C[0]);
            f64::from(TS_CAL1) + slope * (temperature_c - CALIBRATION_C[0])
        }
        LL::ADC_CHANNEL_VREFINT => f64::from(VREFINT_CAL),
        _ => 0.0,
    };
    (at_calibration_supply * st::calibration::supply / supply_v).round().clamp(0.0, 4_095.0) as u16
}

#[cfg(test)]
mod tests;
