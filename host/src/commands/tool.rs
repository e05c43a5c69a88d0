//! The tool in front of a simulated board.

use slitpose_model::Tier;

use super::faults::FaultOptions;
use super::{CommandError, names, talk};
use crate::comparison::NothingMatches;
use crate::device::SimulatedDevice;
use slitpose_head::faults::{Faults, Injector};
use slitpose_head::front_end;
use slitpose_head::pace::Speed;
use slitpose_head::scene_file::{SceneFile, nearest};
use slitpose_head::simulator::{PathError, SimulatedBoard, Trajectory, TrajectoryKind};
use slitpose_head::table::TableError;

/// How many times as far out as the workspace a path may lead without a word.
const FAR: f64 = 2.0;

/// A path begins within a day, if the simulation has no end, seconds.
const MAX_START_S: f64 = 86_400.0;

/// A path that is so many times as long as its simulation, which meets fewer rows of it than these, is hardly one in seconds.
const MAX_LENGTHS: f64 = 100.0;
const MIN_ROWS: usize = 3;

/// The tool in front of a simulated board.
#[derive(clap::Args, Debug)]
pub(super) struct ToolOptions {
    /// still, smooth, fast, contact, or a CSV table with time_s and the columns of a pose
    #[arg(long, value_name = "MOTION", value_parser = names::motions(), hide_possible_values = true)]
    trajectory: Option<String>,
    /// Seed of motion and noise
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    #[command(flatten)]
    pub(super) faults: FaultOptions,
}

impl ToolOptions {
    /// The first option that was given, if any.
    pub(super) fn given(&self) -> Option<&'static str> {
        self.trajectory.as_ref().map(|_| "--trajectory").or(self.seed.map(|_| "--seed")).or(self.faults.given())
    }

    /// The table of a motion, if it is one.
    pub(super) fn table(&self) -> Option<&str> {
        use clap::ValueEnum;
        self.trajectory.as_deref().filter(|name| TrajectoryKind::from_str(name, false).is_err())
    }

    /// The simulated board with this number and the head of `file`, for `duration_s`, which may be
    /// infinite. Each number has a seed of its own.
    pub(super) fn device(
        &self,
        number: u8,
        file: &SceneFile,
        tier: Tier,
        duration_s: f64,
        speed: Speed,
    ) -> Result<SimulatedDevice, CommandError> {
        let frame_s = front_end::configuration(file)?.schedule.frame_rate_hz().recip();
        let seed = self.seed(number);
        let trajectory = self.trajectory(file, number, duration_s)?;
        if let (0, Some(table), Some((knots, sizes)), Some([first_s, last_s])) =
            (number, self.table(), trajectory.path(), trajectory.span_s())
        {
            let end_s = duration_s.min(MAX_START_S);
            if first_s > end_s || last_s < 0.0 {
                let (theirs, ours) = ([first_s, last_s], [0.0, end_s]);
                let file = table.to_owned();
                return Err(NothingMatches { file, theirs, column: "time_s", of: "the simulation", ours }.into());
            }
            let used = knots.iter().filter(|(time_s, _)| (0.0..=end_s).contains(time_s)).count();
            if used < MIN_ROWS && last_s - first_s > MAX_LENGTHS * duration_s {
                talk(format_args!(
                    "{table}: its time_s takes {} s, and the simulation {duration_s} s; are these milliseconds, or \
                     numbers of rows? time_s is seconds",
                    last_s - first_s
                ));
            }
            sizes.finding(table, &file.workspace, FAR).iter().for_each(|finding| talk(format_args!("{finding}")));
        }
        let board = SimulatedBoard::numbered(number, file, trajectory, tier, seed)?;
        let faults = Faults::new(self.faults.fault.clone(), file.scene.cells.len())?;
        let board = board.with_faults(&faults, file, tier)?;
        let device = SimulatedDevice::new(board, frame_s, duration_s, speed);
        Ok(device.with_faults(Injector::of_link(&faults)))
    }

    fn seed(&self, number: u8) -> u64 {
        self.seed.unwrap_or(1).wrapping_add(number.into())
    }

    /// The motion of the tool of that board, of the head of `file`, over `duration_s`, which may be infinite.
    pub(super) fn trajectory(&self, file: &SceneFile, number: u8, duration_s: f64) -> Result<Trajectory, CommandError> {
        use clap::ValueEnum;
        let name = self.trajectory.as_deref().unwrap_or("smooth");
        match TrajectoryKind::from_str(name, false) {
            Ok(kind) => Ok(Trajectory::of_kind(kind, self.seed(number), duration_s).within(&file.workspace)),
            Err(_) => Trajectory::from_table(name).map_err(|error| match error {
                PathError::Table(source @ TableError::Open { .. }) => {
                    let motions = names::motions();
                    let known: Vec<&str> = motions.list().iter().map(String::as_str).collect();
                    let nearest = nearest(name, &known).map(str::to_owned);
                    CommandError::NoMotion {
                        name: name.to_owned(),
                        nearest,
                        known: known.join(", "),
                        source: Box::new(source),
                    }
                }
                error => error.into(),
            }),
        }
    }
}
