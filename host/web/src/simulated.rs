//! A simulated head in front of a simulated board, in real time.

use slitpose_head::faults::{Fault, Faults, Injector, Link};
use slitpose_head::scene_file::SceneFile;
use slitpose_head::simulator::{SimulatedBoard, Trajectory, TrajectoryKind};
use slitpose_model::Tier;
use slitpose_protocol::Configuration;
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::solving::STREAM_TOLERANCE;

/// Most device time caught up at once, seconds. A browser may stop a page for longer: then the link counts as broken, for the
/// board's clock stood still.
const CATCH_UP_S: f64 = 2.0;

/// The board at the other end of a link.
pub(crate) struct SimulatedHead {
    board: SimulatedBoard,
    frame_s: f64,
    injector: Option<Injector>,
    /// When its time began, and the frames since.
    began_ns: u64,
    frames: u64,
    sent: Vec<u8>,
    /// The link is broken until then.
    is_back_ns: Option<u64>,
}

impl SimulatedHead {
    /// In front of the head of `file`, whose tool moves as `motion`; motion and noise are drawn from `seed`.
    pub(crate) fn new(
        file: &SceneFile,
        configuration: &Configuration,
        (motion, seed): (TrajectoryKind, u64),
        faults: Vec<Fault>,
        now: HostInstant,
    ) -> anyhow::Result<Self> {
        let tier = Tier::Exact { tolerance: STREAM_TOLERANCE };
        let faults = Faults::new(faults, file.scene.cells.len())?;
        let motion = Trajectory::of_kind(motion, seed, f64::INFINITY).within(&file.workspace);
        let board = SimulatedBoard::new(file, motion, tier, seed)?;
        let board = board.with_faults(&faults, file, tier)?;
        Ok(Self {
            board,
            frame_s: configuration.schedule.frame_rate_hz().recip(),
            injector: Injector::of_link(&faults),
            began_ns: now.monotonic_ns,
            frames: 0,
            sent: Vec::new(),
            is_back_ns: None,
        })
    }

    /// Sends bytes of the host to the board.
    pub(crate) fn write(&mut self, bytes: &[u8]) {
        self.board.write(bytes);
    }

    /// Whether the link can be opened `now`.
    pub(crate) fn is_there(&mut self, now: HostInstant) -> bool {
        if self.is_back_ns.is_some_and(|is_back_ns| now.monotonic_ns >= is_back_ns) {
            self.is_back_ns = None;
            // A port that is closed for a moment only is still seen to be closed.
            self.board.step_closed();
        }
        self.is_back_ns.is_none()
    }

    /// Lets time pass until `now`, and appends what comes over the link to `bytes`; `false`: the link is broken.
    pub(crate) fn advance(&mut self, now: HostInstant, bytes: &mut Vec<u8>) -> bool {
        let due_s = now.monotonic_ns.saturating_sub(self.began_ns) as f64 * 1e-9;
        let late_s = due_s - self.frames as f64 * self.frame_s;
        if late_s > CATCH_UP_S {
            self.began_ns += (late_s * 1e9) as u64;
            self.is_back_ns.get_or_insert(now.monotonic_ns);
            return false;
        }
        while (self.frames + 1) as f64 * self.frame_s <= due_s {
            self.frames += 1;
            if self.is_back_ns.is_some() {
                self.board.step_closed();
                continue;
            }
            self.sent.clear();
            self.board.step(&mut self.sent);
            let away_s = self.inject(bytes).or_else(|| self.board.take_off_s());
            if let Some(away_s) = away_s {
                self.is_back_ns = Some(now.monotonic_ns + (away_s * 1e9) as u64);
                return false;
            }
        }
        true
    }

    /// Passes on what the board sent as a faulty link does; returns for how long the link is broken, if it is, seconds.
    fn inject(&mut self, bytes: &mut Vec<u8>) -> Option<f64> {
        let Some(injector) = &mut self.injector else {
            bytes.extend_from_slice(&self.sent);
            return None;
        };
        if !self.board.is_acquiring() {
            injector.idle(self.frame_s);
        }
        match injector.push(&self.sent, bytes) {
            Link::Open => None,
            Link::HungUp { for_s } => Some(for_s),
        }
    }
}
