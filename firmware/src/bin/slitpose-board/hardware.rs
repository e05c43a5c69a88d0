//! The parts of the board, as the core sees them.

use cortex_m::peripheral::{DCB, DWT, Peripherals as Core};
use embassy_stm32::gpio::Output;
use slitpose_firmware::settings::Settings;
use slitpose_firmware::timing::FramePlan;
use slitpose_firmware::{Hardware, Health, Indicator, ScanError, StorageError};
use slitpose_protocol::{BootTarget, Configuration, HardwareFault, RawScan};

use crate::acquisition::Acquisition;
use crate::clock::Clock;
use crate::emitters::Emitters;
use crate::faults;
#[cfg(feature = "sensors")]
use crate::sensors::Sensors;
#[cfg(feature = "storage")]
use crate::storage;

/// Everything the core commands.
pub struct BoardHardware {
    emitters: Emitters,
    acquisition: Acquisition,
    clock: Clock,
    light: Output<'static>,
    load: Load,
    #[cfg(feature = "sensors")]
    sensors: Sensors,
}

impl BoardHardware {
    /// Idle and dark.
    pub fn new(
        emitters: Emitters,
        acquisition: Acquisition,
        clock: Clock,
        light: Output<'static>,
        #[cfg(feature = "sensors")] sensors: Sensors,
    ) -> Self {
        Self {
            emitters,
            acquisition,
            clock,
            light,
            load: Load::new(),
            #[cfg(feature = "sensors")]
            sensors,
        }
    }

    /// Ticks until `scans` more scans are finished; `None` if none are under way.
    pub fn ticks_to(&mut self, scans: usize) -> Option<u64> {
        self.acquisition.ticks_to(scans, &mut self.clock)
    }
}

impl Hardware for BoardHardware {
    fn now_ticks(&mut self) -> u64 {
        self.clock.now()
    }

    fn check(&self, configuration: &Configuration) -> Result<(), HardwareFault> {
        FramePlan::new(configuration).map(|_| ())
    }

    fn acquire(&mut self, configuration: Option<&Configuration>) -> Result<(), HardwareFault> {
        match configuration {
            Some(configuration) => self.acquisition.start(configuration, &mut self.emitters, &mut self.clock),
            None => self.acquisition.stop(&mut self.emitters),
        }
    }

    fn next_scan(&mut self, scan: &mut RawScan) -> Result<bool, ScanError> {
        self.acquisition.next_scan(scan, &mut self.emitters, &mut self.clock)
    }

    fn housekeeping(&mut self, indicator: Indicator) -> Health {
        // One light: on while acquiring, and blinking, at the pace of the calls, for
        // attention.
        match indicator {
            Indicator::Idle => self.light.set_low(),
            Indicator::Acquiring => self.light.set_high(),
            Indicator::Identify | Indicator::Fault => self.light.toggle(),
        }
        let cpu_load_permille = self.load.permille(self.clock.now());
        #[cfg(feature = "sensors")]
        {
            let readings = self.sensors.read();
            Health { supply_v: readings.supply_v, temperature_k: readings.temperature_k, cpu_load_permille }
        }
        #[cfg(not(feature = "sensors"))]
        Health { supply_v: f32::NAN, temperature_k: f32::NAN, cpu_load_permille }
    }

    #[cfg(feature = "storage")]
    fn store(&mut self, settings: Option<&Settings>) {
        storage::begin(settings.cloned());
    }

    #[cfg(feature = "storage")]
    fn stored(&mut self) -> Option<Result<(), StorageError>> {
        storage::poll()
    }

    #[cfg(not(feature = "storage"))]
    fn store(&mut self, _: Option<&Settings>) {}

    #[cfg(not(feature = "storage"))]
    fn stored(&mut self) -> Option<Result<(), StorageError>> {
        Some(Err(StorageError))
    }

    fn reboot(&mut self, target: BootTarget) {
        faults::restart(target)
    }
}

/// Share of time the core is awake: its cycle counter stands still while it sleeps.
#[derive(Debug)]
struct Load {
    cycles: u32,
    ticks: u64,
}

impl Load {
    fn new() -> Self {
        if let Some(Core { mut DCB, mut DWT, .. }) = Core::take() {
            enable(&mut DCB, &mut DWT);
        }
        Self { cycles: DWT::cycle_count(), ticks: 0 }
    }

    /// Since the last call.
    fn permille(&mut self, now: u64) -> u16 {
        let cycles = DWT::cycle_count();
        let awake = u64::from(cycles.wrapping_sub(self.cycles));
        let passed = now.saturating_sub(self.ticks).max(1);
        (self.cycles, self.ticks) = (cycles, now);
        (awake * 1_000 / passed).min(1_000) as u16
    }
}

fn enable(control: &mut DCB, counter: &mut DWT) {
    control.enable_trace();
    counter.enable_cycle_counter();
}
