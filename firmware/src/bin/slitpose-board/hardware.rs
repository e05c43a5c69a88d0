//! The hardware edge of the core, over the parts of this board.

use cortex_m::peripheral::{DCB, DWT, Peripherals as Core};
use embassy_stm32::gpio::Output;
use slitpose_firmware::pcb::frame_plan::FramePlan;
use slitpose_firmware::pcb::wiring;
use slitpose_firmware::settings::Settings;
use slitpose_firmware::{Acquisition, Health, Indicator, ScanError, Storage, StorageError, System};
use slitpose_protocol::{BootTarget, Configuration, Edge, HardwareFault, Level, Pulse, RawScan, Schedule};

use crate::acquisition::Sampler;
use crate::clock::Clock;
use crate::emitters::Emitters;
use crate::faults;
#[cfg(feature = "pose")]
use crate::pose_port::PosePort;
#[cfg(feature = "sensors")]
use crate::sensors::Sensors;
#[cfg(feature = "storage")]
use crate::storage;
use crate::trigger::Trigger;

pub struct BoardHardware {
    emitters: Emitters,
    sampler: Sampler,
    clock: Clock,
    trigger: Trigger,
    light: Output<'static>,
    load: Load,
    #[cfg(feature = "sensors")]
    sensors: Sensors,
    #[cfg(feature = "pose")]
    poses: PosePort,
}

impl BoardHardware {
    /// The parts, idle and with emitters off.
    pub fn new(
        emitters: Emitters,
        sampler: Sampler,
        clock: Clock,
        trigger: Trigger,
        light: Output<'static>,
        #[cfg(feature = "sensors")] sensors: Sensors,
        #[cfg(feature = "pose")] poses: PosePort,
    ) -> Self {
        Self {
            emitters,
            sampler,
            clock,
            trigger,
            light,
            load: Load::new(),
            #[cfg(feature = "sensors")]
            sensors,
            #[cfg(feature = "pose")]
            poses,
        }
    }

    /// Ticks until `scans` more scans are finished; `None` while the board does not sample.
    pub fn ticks_to(&mut self, scans: usize) -> Option<u64> {
        self.sampler.ticks_to(scans, &mut self.clock)
    }
}

impl Acquisition for BoardHardware {
    fn check(&self, configuration: &Configuration) -> Result<(), HardwareFault> {
        FramePlan::new(configuration).map(|_| ())
    }

    fn limit_levels(&self, schedule: &Schedule, levels: &mut [Level]) {
        wiring::limit_levels(schedule, levels);
    }

    fn acquire(&mut self, configuration: Option<&Configuration>) -> Result<(), HardwareFault> {
        match configuration {
            Some(configuration) => self.sampler.start(configuration, &mut self.emitters, &mut self.clock),
            None => self.sampler.stop(&mut self.emitters),
        }
    }

    fn next_scan(&mut self, scan: &mut RawScan) -> Result<bool, ScanError> {
        self.sampler.next_scan(scan, &mut self.emitters, &mut self.clock)
    }

    fn set_pulse(&mut self, pulse: Pulse, schedule: &Schedule) -> Result<(), HardwareFault> {
        self.sampler.output.set(pulse, schedule)
    }
}

impl Storage for BoardHardware {
    #[cfg(feature = "storage")]
    fn store(&mut self, settings: Option<&Settings>, head: &[u8]) {
        storage::begin(settings.cloned(), head);
    }

    #[cfg(feature = "storage")]
    fn stored(&mut self) -> Option<Result<(), StorageError>> {
        storage::poll()
    }

    #[cfg(not(feature = "storage"))]
    fn store(&mut self, _: Option<&Settings>, _: &[u8]) {}

    #[cfg(not(feature = "storage"))]
    fn stored(&mut self) -> Option<Result<(), StorageError>> {
        Some(Err(StorageError))
    }
}

impl System for BoardHardware {
    fn now_ticks(&mut self) -> u64 {
        self.clock.now()
    }

    fn next_edge(&mut self) -> Option<Edge> {
        self.trigger.next_edge(&mut self.clock)
    }

    fn missed_edges(&self) -> u32 {
        self.trigger.missed
    }

    fn housekeeping(&mut self, indicator: Indicator) -> Health {
        // One light: on while acquiring; for attention it toggles at every call.
        match indicator {
            Indicator::Idle => self.light.set_low(),
            Indicator::Acquiring => self.light.set_high(),
            Indicator::Identify | Indicator::Fault => self.light.toggle(),
        }
        let cpu_load_permille = self.load.permille(self.clock.now());
        #[cfg(feature = "sensors")]
        {
            let Self { sensors, sampler, clock, .. } = self;
            let readings = sensors.read(|| sampler.pause_ticks(clock));
            Health { supply_v: readings.supply_v, temperature_k: readings.temperature_k, cpu_load_permille }
        }
        #[cfg(not(feature = "sensors"))]
        Health { supply_v: f32::NAN, temperature_k: f32::NAN, cpu_load_permille }
    }

    #[cfg(feature = "pose")]
    fn pose_solved(&mut self, pose: &slitpose_firmware::SolvedPose) {
        self.poses.tell(pose);
    }

    fn reboot(&mut self, target: BootTarget) {
        faults::restart(target)
    }
}

/// Share of time the processor is awake: its cycle counter stands still while it sleeps.
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

    /// The share since the last call, in thousandths.
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
