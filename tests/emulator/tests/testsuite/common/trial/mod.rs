//! A board on faulty silicon, from power-on to the end of its light: whether each word is the model's, and whether it
//! is dark in time and stays dark.

#![allow(dead_code, reason = "each program uses its part")]

pub mod endings;
pub mod words;

use super::chain::Chain;
use endings::{Ending, MS, last_light, until_lit_and_awake};
use slitpose_emulator::faults::{Fault, Faults};
use slitpose_emulator::image::Image;
use slitpose_emulator::peripherals::{TICKS_PER_SECOND, Ticks};
use slitpose_emulator::world::NoiseSource;
use slitpose_head::scene_file::WIDE;
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_protocol::Command;
use words::{FRAME_TICKS, Model, TOLERANCE_CODES, difference};

/// Dark between two starts, in seconds: shorter and longer than what makes a converter stale (1 ms), and longer than
/// a session that breaks.
const PAUSES_S: [f64; 3] = [0.5e-3, 5e-3, 50e-3];

/// How long it must stay dark, with its cause and without.
const DARK_TICKS: Ticks = 100 * MS;

#[derive(Clone, Copy, Debug)]
pub struct Plan {
    pub silicon: Faults,
    pub ending: Ending,
    /// Light before the end, in seconds, in four starts.
    pub seconds: f64,
    /// Seed of the tool's motion, and of when the light ends.
    pub seed: u64,
}

#[derive(Clone, Debug)]
pub struct Outcome {
    pub scans: usize,
    /// Those of which a word is not the model's.
    pub wrong: usize,
    /// Those whose tick is not that of their number.
    pub misplaced: usize,
    pub missing: u64,
    /// Furthest that a word's mean code is from the model's.
    pub worst_codes: f64,
    /// How long it was lit after its end.
    pub lit_ticks: Ticks,
    pub relit: bool,
    /// What the program did against the manuals before its end.
    pub faults: Vec<String>,
}

impl Plan {
    /// Lets a board with `image` live this life.
    ///
    /// # Errors
    /// Naming what is not as it must be.
    pub fn carry_out(&self, image: &Image) -> Result<Outcome, String> {
        let trajectory = || Trajectory::of_kind(TrajectoryKind::Smooth, self.seed, 20.0);
        let file = WIDE.read().expect("shipped");
        let mut chain = Chain::open_with(image, &file, trajectory(), NoiseSource::Off, self.silicon);
        for pause_s in PAUSES_S {
            command(&mut chain, &Command::Start)?;
            chain.run_for(self.seconds / 4.0);
            command(&mut chain, &Command::Stop)?;
            chain.run_for(pause_s);
        }
        command(&mut chain, &Command::Start)?;
        // Another phase of frames, polls and the bus for each seed.
        chain.run_for(self.seconds / 4.0 + (self.seed % 997) as f64 * 7.3e-6);
        // A host hears no answer from a core that stands still: what is against the manuals counts until here.
        let faults = chain.rig.faults();
        let (lit_ticks, relit) = self.end(&mut chain, image);

        let model = Model::new(&file, trajectory());
        let mut outcome = Outcome {
            scans: chain.scans.len(),
            wrong: 0,
            misplaced: 0,
            missing: 0,
            worst_codes: 0.0,
            lit_ticks,
            relit,
            faults,
        };
        for (_, scan) in &chain.scans {
            let off = difference(scan, &model.frame(scan.tick));
            outcome.wrong += usize::from(off > TOLERANCE_CODES);
            outcome.worst_codes = outcome.worst_codes.max(off);
        }
        for pair in chain.scans.windows(2) {
            let [(_, one), (_, next)] = pair else { unreachable!("two") };
            let numbers = next.sequence.wrapping_sub(one.sequence);
            outcome.missing += numbers.wrapping_sub(1);
            // Numbers go on over a pause, ticks do not.
            let goes_on = next.tick.wrapping_sub(one.tick) == numbers.wrapping_mul(FRAME_TICKS);
            outcome.misplaced += usize::from(!goes_on);
        }
        // The pauses.
        outcome.misplaced = outcome.misplaced.saturating_sub(PAUSES_S.len());
        outcome.judge(self)
    }

    /// Ends the light; gives for how long it went on, and whether there was light again.
    fn end(&self, chain: &mut Chain, image: &Image) -> (Ticks, bool) {
        const INSISTS_EVERY: Ticks = 20 * MS;
        chain.rig.machine().board.log_gates();
        until_lit_and_awake(&mut chain.rig);
        chain.rig.machine().board.take_gate_log();
        let event = chain.rig.now();
        let end = event + self.ending.most_ticks(self.silicon) + DARK_TICKS;
        self.ending.happen(&mut chain.rig, image);
        while chain.rig.now() < end {
            let next = (chain.rig.now() + INSISTS_EVERY).min(end);
            chain.rig.run_until(next);
            if chain.rig.machine().board.gates() != 0 {
                self.ending.insist(&mut chain.rig);
            }
        }
        let dark = match last_light(&mut chain.rig) {
            (Some(dark), false) => dark,
            _ => end,
        };
        let lit_ticks = dark - event;
        self.ending.pass(&mut chain.rig);
        // With its last words.
        chain.run_for(DARK_TICKS as f64 / TICKS_PER_SECOND as f64);
        let relit = chain.rig.machine().board.take_gate_log().iter().any(|edge| edge.gates != 0);
        (lit_ticks, relit)
    }
}

impl Outcome {
    fn judge(self, plan: &Plan) -> Result<Self, String> {
        let most_ticks = plan.ending.most_ticks(plan.silicon);
        // A USB host that breaks sessions costs scans; nothing else may.
        let may_miss = plan.silicon.has(Fault::UsbHost);
        match &self {
            _ if self.scans == 0 => Err("no scan".to_owned()),
            Self { wrong, .. } if *wrong > 0 => Err(format!("{wrong} scans are {} codes off", self.worst_codes)),
            Self { misplaced, .. } if *misplaced > 0 => Err(format!("{misplaced} scans are not where they belong")),
            Self { missing, .. } if *missing > 0 && !may_miss => Err(format!("{missing} scans are missing")),
            Self { lit_ticks, .. } if *lit_ticks > most_ticks => {
                Err(format!("lit for {lit_ticks} of {most_ticks} ticks"))
            }
            Self { relit: true, .. } => Err("lit again".to_owned()),
            Self { faults, .. } if !faults.is_empty() => Err(faults.join("; ")),
            _ => Ok(self),
        }
    }
}

/// Says a command until it is accepted, however often a session breaks meanwhile.
fn command(chain: &mut Chain, command: &Command) -> Result<(), String> {
    for attempt in 0..2_000 {
        if attempt % 40 == 0 {
            chain.rig.send(command.clone());
        }
        chain.run_for(0.5e-3);
        if std::mem::take(&mut chain.replies).contains(&true) {
            return Ok(());
        }
    }
    Err(format!("{command:?} was never accepted"))
}
