//! One board under one configuration: from a scan to a solution.

use slitpose_calibration::{Basis, Head};
use slitpose_model::{NoTwist, Photocurrents, PoseTracker, Tier, Tracked, Tracker};
use slitpose_protocol::poses::{Poses, TRIANGLE};
use slitpose_protocol::{AdcScaling, BoardKind, Hello, PoseStatus, RawScan, Schedule};

use super::board_poses::{BoardPose, Comparison, PoseFault};
use super::doubt::Doubt;
use super::waiting::{Content, Scan};
use super::{PipelineError, PipelineOptions, SceneMatch};
use crate::health::{HeadHealth, Health};
use crate::link::{DeviceId, Versions};
use crate::solving;
use slitpose_head::front_end::Stage;
use slitpose_head::scene_file::SceneFile;

/// A board under one configuration, opened by its hello.
#[derive(Debug)]
pub(super) struct Session {
    /// Number of the session in the pipeline.
    pub(super) number: u64,
    pub(super) device: DeviceId,
    pub(super) kind: BoardKind,
    pub(super) configuration: u16,
    pub(super) schedule: Schedule,
    scaling: AdcScaling,
    /// Ticks from the start of a scan's frame to the instant of its pose.
    pub(super) reference_ticks: f64,
    last_sample_ticks: u64,
    pub(super) stage: Stage,
    /// Those of the scan that was solved last.
    pub(super) photocurrents: Photocurrents,
    head: Head,
    tracker: Tracker<f64>,
    /// Tracks the newest scans while older ones wait.
    ahead: Option<Tracker<f64>>,
    pub(super) health: Option<Health>,
    doubt: Doubt,
    /// Number of the head that the board's poses must be of.
    head_number: u32,
    /// Poses of the board and of this program, once the board has sent any.
    pub(super) comparison: Option<Box<Comparison>>,
    /// Finds what the board's poses are compared with: of a known light level, as the board's.
    as_board: Option<Box<PoseTracker<f64>>>,
    /// The latest that the board has told.
    covariance: Option<[f32; TRIANGLE]>,
    /// Scans that the board has not solved, and those among them whose place is known.
    missed: u64,
    placed: u64,
}

/// Checks the parts of `hello` that do not depend on the schedule: protocol, scaling and scene.
///
/// # Errors
/// If the board has another protocol, cannot measure, or belongs to another scene.
pub fn check(file: &SceneFile, scene_match: SceneMatch, hello: &Hello<'_>) -> Result<(), PipelineError> {
    let board = || hello.board.to_owned();
    let versions = Versions { board: hello.protocol };
    hello.check_schemas().map_err(|source| PipelineError::Schema { board: board(), versions, source })?;
    hello.scaling.validate(1).map_err(|source| PipelineError::Scaling { board: board(), source })?;
    if let Some(board_hash) = hello.hashes.scene
        && board_hash != file.hash
        && scene_match == SceneMatch::Required
    {
        let (scene, scene_hash) = (file.name.clone(), file.hash);
        return Err(PipelineError::SceneHash { board: board(), board_hash, scene, scene_hash });
    }
    Ok(())
}

/// Checks that the board of `hello` belongs to the calibration of `head`, if both have one.
///
/// # Errors
/// If it belongs to another.
pub fn check_calibration(head: &Head, scene_match: SceneMatch, hello: &Hello<'_>) -> Result<(), PipelineError> {
    match (head.calibration(), hello.hashes.calibration) {
        (Some(calibration), Some(board_hash))
            if scene_match == SceneMatch::Required && calibration.hash() != board_hash =>
        {
            Err(PipelineError::CalibrationHash {
                board: hello.board.to_owned(),
                board_hash,
                calibration: calibration.origin().to_owned(),
                calibration_hash: calibration.hash(),
            })
        }
        _ => Ok(()),
    }
}

/// `head` in front of the board of `hello`.
pub fn head_of(head: &Head, hello: &Hello<'_>) -> Head {
    if hello.kind == BoardKind::Simulated { head.in_simulation() } else { head.clone() }
}

impl Session {
    /// Checks `hello` against the scene and computes everything that is constant over the session.
    pub(super) fn open(
        head: &Head,
        tier: Tier,
        scene_match: SceneMatch,
        following: PipelineOptions,
        watched: bool,
        hello: &Hello<'_>,
        number: u64,
    ) -> Result<Self, PipelineError> {
        let head = head_of(head, hello);
        let file = &head.file;
        check(file, scene_match, hello)?;
        check_calibration(&head, scene_match, hello)?;
        let board = || hello.board.to_owned();
        let Schedule { oversampling, .. } = hello.schedule;
        hello.schedule.validate().map_err(|source| PipelineError::Schedule { board: board(), source })?;
        hello.scaling.validate(oversampling).map_err(|source| PipelineError::Scaling { board: board(), source })?;
        let board_cells = usize::from(hello.schedule.cells);
        let scene_cells = file.scene.cells.len();
        if board_cells != scene_cells {
            return Err(PipelineError::Cells { board: board(), board_cells, scene: file.name.clone(), scene_cells });
        }
        let is_calibrated = matches!(head.basis, Basis::Calibration(_));
        let health = || Health::new(file, tier, &hello.schedule, &hello.scaling, is_calibrated);
        let health = watched.then(health).transpose()?;
        let head_number = solving::hashes(&head).number();
        let stage = Stage::new(file, &hello.schedule, &hello.scaling);
        let scene = Stage::weighted_scene(file, &hello.schedule, &hello.scaling);
        let period_s = hello.schedule.frame_rate_hz().recip();
        let tracker = solving::tracker(&head, &scene, tier, following, &stage.exposures_s(), period_s)?;
        Ok(Self {
            number,
            device: DeviceId(hello.device_id),
            kind: hello.kind,
            configuration: hello.configuration,
            reference_ticks: hello.schedule.reference_ticks(),
            last_sample_ticks: hello.schedule.last_sample_ticks(),
            head,
            tracker,
            ahead: None,
            health,
            doubt: Doubt::new(period_s),
            head_number,
            comparison: None,
            as_board: None,
            covariance: None,
            missed: 0,
            placed: 0,
            stage,
            photocurrents: Photocurrents::default(),
            schedule: hello.schedule.clone(),
            scaling: hello.scaling,
        })
    }

    /// Whether `hello` equals the one that opened this session, which then continues.
    pub(super) fn is_of(&self, hello: &Hello<'_>) -> bool {
        self.device == DeviceId(hello.device_id)
            && self.configuration == hello.configuration
            && self.schedule == hello.schedule
            && self.scaling == hello.scaling
    }

    pub(super) fn tick_hz(&self) -> f64 {
        f64::from(self.schedule.tick_hz)
    }

    pub(super) fn frame_s(&self) -> f64 {
        self.schedule.frame_rate_hz().recip()
    }

    /// The instant of the pose of a scan whose frame began at `tick`, device seconds.
    pub(super) fn time_s(&self, tick: u64) -> f64 {
        (tick as f64 + self.reference_ticks) / self.tick_hz()
    }

    /// Tick of the last sample in a batch of `scans` scans that begins at `tick`.
    pub(super) fn last_tick(&self, tick: u64, scans: usize) -> u64 {
        let frames = scans.saturating_sub(1) as u64;
        tick.wrapping_add(frames.wrapping_mul(u64::from(self.schedule.frame_ticks)))
            .wrapping_add(self.last_sample_ticks)
    }

    /// Solves the next scan in turn; `watched`: it counts for the health of the head.
    pub(super) fn solve(&mut self, scan: &Scan, watched: bool) -> Tracked {
        let mut tracked = match &scan.content {
            Content::Words(words) => self.solve_words(words, watched),
            Content::Pose(pose) => self.completed(pose),
        };
        self.doubt.count(scan.sequence, &tracked.solution);
        self.doubt.apply(scan.sequence, &mut tracked);
        tracked
    }

    /// A pose that the board has found.
    fn completed(&self, pose: &BoardPose) -> Tracked {
        let mut tracked =
            Tracked { solution: pose.solution(), twist: Err(NoTwist::NoPose), filtered: None, light_level: None };
        self.head.complete_tracked(&mut tracked);
        tracked
    }

    /// Takes the board's poses, each with the latest covariance. `None` if they are of another head.
    pub(super) fn take_poses<'p>(
        &mut self,
        poses: &Poses<'p>,
    ) -> Option<impl Iterator<Item = (u64, u64, BoardPose)> + use<'p>> {
        if poses.head != self.head_number {
            return None;
        }
        self.covariance = poses.covariance.or(self.covariance);
        let comparison = self.comparison.get_or_insert_default();
        self.as_board.get_or_insert_with(|| Box::new(self.tracker.poses_as_on_board()));
        self.missed = self.missed.max(poses.missed.into());
        comparison.agreement.missed = self.missed;
        let all = poses.iter(self.schedule.frame_ticks);
        all.clone().for_each(|(sequence, _, record)| comparison.take_board(sequence, &record));
        let covariance = self.covariance.unwrap_or([0.0; TRIANGLE]);
        Some(all.map(move |(sequence, tick, record)| (sequence, tick, BoardPose { record, covariance })))
    }

    /// Takes away a pose that cannot be right, and says why.
    pub(super) fn refuse(&mut self, pose: &mut BoardPose) -> Option<PoseFault> {
        let fault = pose.fault(self.tracker.poses().solver().plan())?;
        pose.record.status = PoseStatus::Diverged;
        Some(fault)
    }

    /// How many of `missing` scans in a row the board says not to have solved.
    pub(super) fn place_unsolved(&mut self, missing: u64) -> u64 {
        let unsolved = missing.min(self.missed - self.placed);
        self.placed += unsolved;
        unsolved
    }

    pub(super) fn solve_words(&mut self, scan: &RawScan, watched: bool) -> Tracked {
        self.photocurrents = self.stage.photocurrents(scan);
        let mut tracked = self.tracker.track(scan.sequence, &self.photocurrents);
        if let (Some(comparison), Some(as_board)) = (&mut self.comparison, &mut self.as_board) {
            let found = as_board.track(scan.sequence, &self.photocurrents);
            comparison.take_host(scan.sequence, found.estimate.as_ref());
        }
        self.head.complete_tracked(&mut tracked);
        if let Some(health) = self.health.as_mut().filter(|_| watched) {
            health.update(scan, &self.photocurrents, &tracked.solution);
        }
        tracked
    }

    /// The health of the head, if it is monitored.
    pub(super) fn health(&self) -> Option<HeadHealth> {
        let mut health = self.health.as_ref()?.report();
        for (cell, [drift, sigma]) in health.cells.iter_mut().zip(self.tracker.emitter_drifts().into_iter().flatten()) {
            (cell.emitter_drift, cell.emitter_drift_sigma) = (Some(drift), Some(sigma));
        }
        Some(health)
    }

    /// All that the next pose depends on, besides its scan.
    pub(super) fn state(&self) -> (&Tracker<f64>, &Doubt) {
        (&self.tracker, &self.doubt)
    }

    /// Solves a scan ahead of the waiting ones; `first`: none of these has been solved ahead.
    pub(super) fn solve_ahead(&mut self, scan: &Scan, first: bool) -> Tracked {
        let mut tracked = match &scan.content {
            Content::Words(words) => self.solve_words_ahead(words, first),
            Content::Pose(pose) => self.completed(pose),
        };
        self.doubt.apply(scan.sequence, &mut tracked);
        tracked
    }

    fn solve_words_ahead(&mut self, scan: &RawScan, first: bool) -> Tracked {
        self.photocurrents = self.stage.photocurrents(scan);
        let ahead = match &mut self.ahead {
            // Starts from the latest pose.
            Some(ahead) if first => {
                ahead.clone_from(&self.tracker);
                ahead
            }
            ahead => ahead.get_or_insert_with(|| self.tracker.clone()),
        };
        let mut tracked = ahead.track(scan.sequence, &self.photocurrents);
        self.head.complete_tracked(&mut tracked);
        if let Some(health) = &mut self.health {
            health.update(scan, &self.photocurrents, &tracked.solution);
        }
        tracked
    }
}
