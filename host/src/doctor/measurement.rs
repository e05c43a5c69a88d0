//! A trial measurement: rates, losses, poses, and the state of the board.

use std::time::{Duration, Instant};

use slitpose_calibration::Head;
use slitpose_model::Tier;
use slitpose_protocol::{Configuration, Severity, Status};

use super::judged;
use crate::device::Conversation;
use slitpose_head::finding::Finding;
use slitpose_head::finding::Grade::{Failed, Warning};
use slitpose_head::scene_file::SceneFile;
use slitpose_tracking::link::{Segment, contradicted_crystal, start_findings};
use slitpose_tracking::pipeline::{Counts, Item, Pipeline, PipelineError, SceneMatch};

const TIER: Tier = Tier::Exact { tolerance: 1e-6 };

/// Duration limit relative to real time, for slow emulators; and the time to begin.
const SLOWEST: f64 = 10.0;
const BEGIN: Duration = Duration::from_secs(5);

/// How long to wait for a measurement that takes `duration_s` of a board's time.
pub(super) fn patience(duration_s: f64) -> Duration {
    BEGIN + Duration::try_from_secs_f64(SLOWEST * duration_s).unwrap_or(Duration::MAX)
}

/// Largest relative difference of rates explained by crystals, and by packets cut at both ends of a second.
const RATE_SLACK: f64 = 0.05;

/// Least share of scans with a pose for a tool in its workspace.
const POSES: f64 = 0.99;

/// Supply of the MCU: 3.3 V ± 5 %, as the regulator of its board gives it.
pub(super) const SUPPLY_V: std::ops::RangeInclusive<f32> = 3.135..=3.465;

/// Ambient limits of the MCU (STM32G474xE data sheet, suffix 6), which its own heat may reach.
pub(super) const TEMPERATURE_K: std::ops::RangeInclusive<f32> = 273.15 - 40.0..=273.15 + 85.0;

/// Greatest CPU load of the MCU that leaves a reserve.
const BUSIEST_PERMILLE: u16 = 900;

/// Most warnings and errors of the board that are kept.
const EVENTS: usize = 5;

#[derive(Clone, Debug)]
pub(super) struct Measurement {
    counts: Counts,
    before: Status,
    after: Status,
    frame_rate_hz: f64,
    /// Number of scans received, and the duration by the host's clock, seconds.
    received: (u64, f64),
    bytes: usize,
    /// Rate error of the board's clock, ppm, and uncertainty of its times at the end, ns.
    clock: Option<(f64, u64)>,
    contradicts_crystal: bool,
    events: Vec<String>,
}

/// Lets `board` measure by `configuration` for `duration_s` of its time; its bytes are appended to `bytes`.
pub(super) fn measure(
    board: &mut Conversation,
    scene: &SceneFile,
    configuration: Configuration,
    duration_s: f64,
    bytes: &mut Vec<u8>,
) -> anyhow::Result<Measurement> {
    let frame_rate_hz = configuration.schedule.frame_rate_hz();
    let mut pipeline =
        Pipeline::new(Head::uncalibrated(scene.clone())?, TIER, SceneMatch::Waived).until(Some(duration_s));
    let mut events = Vec::new();
    let mut segment = Segment::default();
    let mut uncertainty_ns = None;
    let mut take = |pipeline: &mut Pipeline, board: &mut Conversation| {
        segment.clear();
        board.fill(&mut segment);
        let taken = pipeline.feed(&segment, |item| {
            match item {
                Item::Pose(record) => uncertainty_ns = record.host_time.map(|time| time.uncertainty_ns),
                Item::Event { severity, text, .. } if severity != Severity::Info && events.len() < EVENTS => {
                    events.push(text.to_owned());
                }
                _ => {}
            }
            Ok::<_, PipelineError>(())
        })?;
        bytes.extend_from_slice(&segment.bytes[..taken]);
        Ok::<_, PipelineError>(())
    };

    let before = board.status()?;
    board.configure(configuration)?;
    board.start()?;
    let started = Instant::now();
    let patience = patience(duration_s);
    take(&mut pipeline, board)?;
    let mut first: Option<(u64, Instant)> = None;
    let mut received = (0, 0.0);
    while !pipeline.is_complete() && started.elapsed() < patience && board.listen()? {
        take(&mut pipeline, board)?;
        let scans = pipeline.counts().scans;
        if scans > 0 {
            let (scans_first, at) = *first.get_or_insert_with(|| (scans, Instant::now()));
            received = (scans - scans_first, at.elapsed().as_secs_f64());
        }
    }
    board.stop()?;
    take(&mut pipeline, board)?;
    let after = board.status()?;
    let counts = pipeline.counts();
    let clock = pipeline.drift_ppm().zip(uncertainty_ns);
    let contradicts_crystal = pipeline.contradicts_crystal();
    Ok(Measurement {
        counts,
        clock,
        contradicts_crystal,
        before,
        after,
        frame_rate_hz,
        received,
        bytes: bytes.len(),
        events,
    })
}

impl Measurement {
    /// Bytes that the board sends per second of its time; `None` if it has sent no scan.
    pub(super) fn bytes_per_s(&self) -> Option<f64> {
        let seconds = self.counts.scans as f64 / self.frame_rate_hz;
        (seconds > 0.0).then(|| self.bytes as f64 / seconds)
    }

    pub(super) fn checks(&self) -> Vec<Finding> {
        let mut checks = vec![
            self.rate(),
            self.clock(),
            self.losses_on_board(),
            self.losses_on_the_way(),
            self.poses(),
            self.health(),
        ];
        checks.extend(self.start());
        if !self.events.is_empty() {
            checks.push(Finding::warning("events", self.events.join("; "), "do what the warnings of the board say"));
        }
        checks
    }

    /// The findings that need no light.
    pub(super) fn dark_checks(&self) -> Vec<Finding> {
        [self.rate(), self.losses_on_board(), self.losses_on_the_way()].into_iter().chain(self.start()).collect()
    }

    fn start(&self) -> impl Iterator<Item = Finding> + use<> {
        start_findings(self.after.clock, self.after.settings).into_iter()
    }

    fn rate(&self) -> Finding {
        let (scans, seconds) = self.received;
        if self.counts.scans == 0 {
            return Finding::failed(
                "rate",
                "the board is measuring, but no scan arrived",
                "reset the board and try again",
            );
        }
        let rate_hz = scans as f64 / seconds;
        let finding = format!("{rate_hz:.0} scans/s by the host's clock, {:.0} by the schedule", self.frame_rate_hz);
        let is_off = (rate_hz / self.frame_rate_hz - 1.0).abs() > RATE_SLACK;
        let next_step = "lower the load of this host, then measure again with a longer --duration";
        judged("rate", finding, [(is_off, Warning, next_step)])
    }

    fn clock(&self) -> Finding {
        match self.clock {
            _ if self.contradicts_crystal => contradicted_crystal(),
            Some((drift_ppm, uncertainty_ns)) => Finding::ok(
                "board clock",
                format!("fast by {drift_ppm:.0} ppm; times are known within {:.0} us", uncertainty_ns as f64 * 1e-3),
            ),
            None => Finding::warning(
                "board clock",
                "not yet compared with the clock of this host".to_owned(),
                "measure again with a longer --duration: the comparison takes two pings, and an emulated board may be slow",
            ),
        }
    }

    /// Scans that the board took and did not send.
    fn lost_on_board(&self) -> (u64, u64) {
        let (before, after) = (&self.before, &self.after);
        let dropped = after.scans_dropped.saturating_sub(before.scans_dropped);
        (dropped, after.scans_lost.saturating_sub(before.scans_lost))
    }

    fn losses_on_board(&self) -> Finding {
        let (dropped, lost) = self.lost_on_board();
        let overruns = self.after.adc_overruns.saturating_sub(self.before.adc_overruns);
        let finding =
            format!("{dropped} scans dropped by the queue, {lost} lost at the converters, {overruns} overruns");
        let overloaded = "the MCU is overloaded: lower front_end.frame_rate_hz, and report it";
        let unread = "the host did not read in time: check its load, hubs and cable";
        let is_overloaded = lost + u64::from(overruns) > 0;
        judged("board", finding, [(is_overloaded, Failed, overloaded), (dropped > 0, Failed, unread)])
    }

    fn losses_on_the_way(&self) -> Finding {
        let counts = &self.counts;
        let (dropped, lost) = self.lost_on_board();
        let missing = counts.scans_lost.saturating_sub(dropped + lost);
        let unreadable = counts.decoder.unknown + counts.decoder.malformed + counts.batches_unreadable;
        let (scans, damaged) = (counts.scans, counts.decoder.damaged());
        let finding = format!(
            "{scans} scans received, {missing} lost on the way; {damaged} packets damaged, {unreadable} unreadable"
        );
        let is_lossy = missing + damaged + unreadable > 0;
        judged("link", finding, [(is_lossy, Failed, "change cable or hub; a UART needs a short one")])
    }

    fn poses(&self) -> Finding {
        let counts = &self.counts;
        let finding = counts.outcomes.words();
        let is_good = counts.scans > 0 && counts.poses() as f64 >= POSES * counts.scans as f64;
        let next_step = "is the tool in its workspace, and the scene that of this head? see `slitpose scene check`";
        judged("poses", if finding.is_empty() { "none".to_owned() } else { finding }, [(!is_good, Warning, next_step)])
    }

    fn health(&self) -> Finding {
        // The load is measured during acquisition: at rest it is meaningless.
        let status = self.counts.board_status.as_ref().unwrap_or(&self.after);
        let Status { supply_v, temperature_k, cpu_load_permille, .. } = *status;
        let finding = format!(
            "supply {supply_v:.3} V, {:.1} C, load {:.1} %",
            temperature_k - 273.15,
            f64::from(cpu_load_permille) / 10.0
        );
        // NaN is in no range.
        let faults = [
            (!SUPPLY_V.contains(&supply_v), Warning, "check cable and supply: 3.3 V within 5 % is required"),
            (!TEMPERATURE_K.contains(&temperature_k), Warning, "keep the board between -40 and 85 C"),
            (cpu_load_permille > BUSIEST_PERMILLE, Warning, "lower front_end.frame_rate_hz: the MCU has no reserve"),
        ];
        judged("health", finding, faults)
    }
}

#[cfg(test)]
mod tests {
    use std::borrow::Cow;

    use slitpose_protocol::{ClockSource, SettingsSource};

    use super::*;
    use crate::device::SimulatedDevice;
    use slitpose_head::finding::Grade::{self, Ok};
    use slitpose_head::front_end;
    use slitpose_head::scene_file::WIDE;
    use slitpose_head::simulator::TrajectoryKind;
    use slitpose_tracking::pipeline::Outcomes;

    fn measured() -> (Measurement, Vec<u8>) {
        let scene = WIDE.read().unwrap();
        let device = SimulatedDevice::for_trials(&scene, TrajectoryKind::Smooth).unwrap();
        let mut board = Conversation::open(Box::new(device)).unwrap();
        board.introduce(Duration::from_secs(1)).unwrap();
        let mut bytes = Vec::new();
        let configuration = front_end::configuration(&scene).unwrap();
        (measure(&mut board, &scene, configuration, 0.1, &mut bytes).unwrap(), bytes)
    }

    fn grades(measurement: &Measurement) -> Vec<(Cow<'static, str>, Grade)> {
        // The rate depends on what else this machine does, and so does the clock.
        measurement.checks().into_iter().skip(2).map(|check| (check.place, check.grade)).collect()
    }

    #[test]
    fn a_good_board_is_found_good_and_each_fault_in_its_place() {
        let (good, bytes) = measured();
        assert_eq!(
            grades(&good),
            ["board", "link", "poses", "health", "oscillator", "settings"].map(|place| (place.into(), Ok))
        );
        assert_eq!((good.counts.scans, bytes.len()), (400, good.bytes));
        // 60 bytes per scan, and as many for the true pose of a simulated one.
        assert!((200e3..800e3).contains(&good.bytes_per_s().unwrap()), "{:?}", good.bytes_per_s());

        let with = |change: fn(&mut Measurement)| {
            let mut measurement = good.clone();
            change(&mut measurement);
            let found = grades(&measurement);
            found.into_iter().filter(|(_, grade)| *grade != Ok).collect::<Vec<_>>()
        };
        assert_eq!(with(|it| it.counts.scans_lost += 3), [("link".into(), Failed)]);
        assert_eq!(with(|it| it.counts.decoder.misframed += 1), [("link".into(), Failed)]);
        assert_eq!(with(|it| it.counts.batches_unreadable += 1), [("link".into(), Failed)]);
        // Dropped on the board and so missing in the numbering: not the link's fault.
        let dropped = with(|it| {
            it.after.scans_dropped += 3;
            it.counts.scans_lost += 3;
        });
        assert_eq!(dropped, [("board".into(), Failed)]);
        assert_eq!(with(|it| it.after.adc_overruns += 1), [("board".into(), Failed)]);
        assert_eq!(with(|it| it.after.clock = ClockSource::CrystalFailed), [("oscillator".into(), Warning)]);
        assert_eq!(with(|it| it.after.settings = SettingsSource::PassedOver), [("settings".into(), Warning)]);
        assert_eq!(
            with(|it| it.counts.outcomes = Outcomes { too_dark: 400, ..Outcomes::default() }),
            [("poses".into(), Warning)]
        );
        let health = |change: fn(&mut Status)| {
            let mut sick = good.clone();
            change(sick.counts.board_status.insert(good.after));
            sick.health().grade
        };
        assert_eq!(health(|_| ()), Ok);
        assert_eq!(health(|status| status.supply_v = 3.1), Warning);
        assert_eq!(health(|status| status.supply_v = f32::NAN), Warning);
        assert_eq!(health(|status| status.temperature_k = 360.0), Warning);
        assert_eq!(health(|status| status.temperature_k = f32::NAN), Warning);
        assert_eq!(health(|status| status.cpu_load_permille = 901), Warning);
        // It takes two pings, half a second apart.
        assert_eq!(good.clock().grade, Warning);
        let known = Measurement { clock: Some((-12.4, 250_000)), ..good.clone() }.clock();
        assert!(known.grade == Ok && known.text.contains("-12 ppm") && known.text.contains("250 us"), "{known:?}");
        let contradicted =
            Measurement { clock: Some((9_800.0, 250_000)), contradicts_crystal: true, ..good.clone() }.clock();
        assert!(contradicted.grade == Warning && contradicted.text.contains("crystal"), "{contradicted:?}");
        let with_rate = |scans| Measurement { received: (scans, 0.1), ..good.clone() }.rate().grade;
        assert_eq!([400, 390, 350].map(with_rate), [Ok, Ok, Warning]);
    }
}
