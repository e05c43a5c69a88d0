//! Moving tools: what it costs to ignore that cells are exposed one after another.

mod flight;

use std::hint::black_box;

use glam::dvec2;
use slitpose_head::threads::on_all_cores;
use slitpose_model::{Outcome, Solver, Tracked, Tracker};

use crate::report::accuracy::{Errors, rms_of_covariances};
use crate::report::head::{Frame, Head, STREAM};
use crate::report::method::Solved;
use crate::report::noise::NoiseSource;
use crate::report::section::{Picture, Section, Table, Value, column};
use crate::report::sheet::{Sheet, curve};
use crate::report::stopwatch::{Candidate, RunTime, race};
use crate::report::{ReportError, Settings};
use flight::{Flight, SMOOTH_M_PER_S, smooth, straight};

use crate::plot::{Anchor, Axis, Chart, CurveStyle, Note, SOFT_INK};

pub(in crate::report) const TITLE: &str = "Moving tools: the order of exposure";

/// Greatest speeds, m/s; the tool turns at ten times as many rad/s.
const SPEEDS_M_PER_S: [f64; 7] = [0.0, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0];
/// Frames at the start of a flight that do not count: the tracker learns how the tool moves.
const LEARNING_FRAMES: usize = 6;

/// Memories of the filter, seconds.
const MEMORIES_S: [f64; 2] = [2e-3, 10e-3];

/// Memories after which the filter's start no longer shows.
const SETTLED: f64 = 5.0;

/// How a tracker makes its poses.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Following {
    /// Each frame for itself, every exposure carried to the reference instant.
    Honoured,
    /// Each frame for itself, as if all cells were exposed at once.
    Ignored,
    /// From many frames: the filter's memory, seconds. Exposures as in `Honoured`.
    Filtered(f64),
}

impl Following {
    fn all() -> impl Iterator<Item = Self> {
        [Self::Honoured, Self::Ignored].into_iter().chain(MEMORIES_S.map(Self::Filtered))
    }

    fn name(self) -> String {
        match self {
            Self::Honoured => "honoured".to_owned(),
            Self::Ignored => "ignored".to_owned(),
            Self::Filtered(memory_s) => format!("honoured, filter {} ms", memory_s * 1e3),
        }
    }

    fn tracker(self, resting: &Solver<f64>, frame: &Frame) -> Tracker<f64> {
        let solver = resting.clone();
        match self {
            Self::Honoured => Tracker::new(solver.with_exposures(&frame.exposures_s), frame.period_s),
            Self::Ignored => Tracker::new(solver, frame.period_s),
            Self::Filtered(memory_s) => Self::Honoured.tracker(resting, frame).with_filter(memory_s),
        }
    }

    /// The studied pose of a tracker's result.
    fn pose(self, tracked: Tracked) -> Solved {
        let raw = Solved::from(tracked.solution);
        match self {
            Self::Honoured | Self::Ignored => raw,
            Self::Filtered(_) => Solved { pose: tracked.filtered.map(|filtered| filtered.estimate.pose), ..raw },
        }
    }

    /// Frames at the start that do not count: the tracker learns how the tool moves, the filter fills.
    fn learning_frames(self, period_s: f64) -> usize {
        match self {
            Self::Honoured | Self::Ignored => LEARNING_FRAMES,
            Self::Filtered(memory_s) => LEARNING_FRAMES.max((SETTLED * memory_s / period_s) as usize),
        }
    }
}

/// How the tool moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Motion {
    /// Sinusoids in all coordinates: bends, the more the faster.
    Smooth,
    /// At a constant twist through home.
    Straight,
}

impl Motion {
    fn name(self) -> &'static str {
        match self {
            Self::Smooth => "smooth",
            Self::Straight => "straight",
        }
    }
}

/// Errors of one tracker at one speed.
struct Entry {
    motion: Motion,
    speed_m_per_s: f64,
    following: Following,
    errors: Errors,
    /// Root mean squares the bound of a tool at rest allows at the same poses, metres and radians.
    bound: (f64, f64),
    /// Share of the frames that a pose fits.
    fitting: f64,
}

pub(in crate::report) fn section(head: &Head<'_>, settings: &Settings) -> Result<Section, ReportError> {
    let mut section = Section {
        name: "motion",
        title: TITLE,
        summary: Vec::new(),
        paragraphs: Vec::new(),
        pictures: Vec::new(),
        tables: Vec::new(),
    };
    let Some(frame) = &head.frame else {
        section.paragraphs.push(
            "The scene has no [front_end], so nothing is known of the order in which its cells are exposed; give it \
             one, or study the shipped scene `wide`."
                .to_owned(),
        );
        return Ok(section);
    };
    let entries = measure(head, frame, settings)?;
    let spread = |fold: fn(f64, f64) -> f64| frame.exposures_s.iter().copied().reduce(fold).unwrap_or(0.0);
    section.paragraphs = vec![
        format!(
            "The tool moves while the cells are exposed one after another, {} µs between the first and the last. The \
             tracker carries each exposure to the reference instant with the twist it has seen in the frames before; \
             \"ignored\" is the same tracker told that all cells are exposed at once. Errors are divided by the least \
             that the noise of one frame allows a tool at rest (the Cramér–Rao bound): 1 is as good as can be. Without filter each pose rests on its own frame; a filter makes it \
             from many, and stays behind where the motion bends faster than its memory.",
            Value::from((spread(f64::max) - spread(f64::min)) * 1e6).shown()
        ),
        "Straight flights pass home at a constant twist: what is left there is the noise of the twist; they are too \
         short for longer memories. A smooth motion swings ±2.5 mm in all six coordinates, at 2 m/s with up to 1600 m/s²: it bends within the frames that the \
         twist is taken from. Speeds are the greatest of the motion; the tool turns at 10 rad/s for each m/s."
            .to_owned(),
    ];
    section.paragraphs.push(
        "A filter gives a pose once it has seen enough frames that fit, so that frames with a pose can be fewer than \
         frames that fit."
            .to_owned(),
    );
    let followed = |speed: f64| {
        let of = |entry: &&Entry| entry.motion == Motion::Smooth && entry.following == Following::Honoured;
        entries.iter().filter(of).find(|entry| entry.speed_m_per_s == speed)
    };
    if let (Some(slow), Some(fast)) = (followed(0.5), followed(2.0)) {
        let ratio = |entry: &Entry| Value::from(entry.errors.rms_m() / entry.bound.0).shown();
        section.summary.push(format!(
            "A tool that moves at up to 0.5 m/s is located with {} times the error that one at rest allows, at up to \
             2 m/s with {} times.",
            ratio(slow),
            ratio(fast)
        ));
    }
    section.pictures.push(picture(&entries, head));
    section.tables.push(table(&entries));
    section.tables.push(cost(head, frame, settings)?);
    Ok(section)
}

fn measure(head: &Head<'_>, frame: &Frame, settings: &Settings) -> Result<Vec<Entry>, ReportError> {
    let resting = Solver::<f64>::new(&head.scene, STREAM)?;
    let motions = [Motion::Smooth, Motion::Straight];
    let moves: Vec<_> = motions.into_iter().flat_map(|motion| SPEEDS_M_PER_S.map(|speed| (motion, speed))).collect();
    Ok(on_all_cores(&moves, |&moved| fly(head, frame, settings, &resting, moved)).into_iter().flatten().collect())
}

/// The errors of all trackers on one motion.
fn fly(
    head: &Head<'_>,
    frame: &Frame,
    settings: &Settings,
    resting: &Solver<f64>,
    (motion, speed_m_per_s): (Motion, f64),
) -> Vec<Entry> {
    let mut noise = NoiseSource::seeded(settings.seed);
    let flights = match motion {
        Motion::Smooth => vec![smooth(head, frame, settings, speed_m_per_s, &mut noise)],
        Motion::Straight => straight(head, frame, settings, speed_m_per_s, &mut noise),
    };
    let entry = |following: Following| {
        let learning = following.learning_frames(frame.period_s);
        // A flight that is over before the filter has filled says nothing of it.
        if flights.iter().any(|flight| flight.poses.len() <= learning) {
            return None;
        }
        let counted = flights.iter().flat_map(|flight| &flight.poses[learning..]);
        let bound = rms_of_covariances(counted.filter_map(|pose| resting.bound(pose)));
        let (errors, fitting) = follow(following, resting, frame, &flights);
        Some(Entry { motion, speed_m_per_s, following, errors, bound, fitting })
    };
    Following::all().filter_map(entry).collect()
}

/// Errors of a tracker's poses, and the share of frames that fit.
fn follow(following: Following, resting: &Solver<f64>, frame: &Frame, flights: &[Flight]) -> (Errors, f64) {
    let learning = following.learning_frames(frame.period_s);
    let (mut errors, mut fitting, mut counted) = (Errors::default(), 0.0, 0.0);
    for flight in flights {
        let mut tracker = following.tracker(resting, frame);
        for (index, (readings, pose)) in flight.readings.iter().zip(&flight.poses).enumerate() {
            let solved = following.pose(tracker.track(index as u64, readings));
            if index >= learning {
                errors.add(&solved, pose);
                fitting += f64::from(u8::from(solved.outcome == Outcome::Converged));
                counted += 1.0;
            }
        }
    }
    (errors, fitting / counted)
}

/// Cost of a frame by the way it is followed, at the simulator's own speed.
fn cost(head: &Head<'_>, frame: &Frame, settings: &Settings) -> Result<Table, ReportError> {
    let resting = Solver::<f64>::new(&head.scene, STREAM)?;
    let mut noise = NoiseSource::seeded(settings.seed);
    let flight = smooth(head, frame, settings, SMOOTH_M_PER_S, &mut noise);
    let flight = &flight;
    let mut trackers: Vec<_> = Following::all().map(|following| following.tracker(&resting, frame)).collect();
    let mut candidates: Vec<Candidate<'_>> = trackers
        .iter_mut()
        .map(|tracker| {
            Candidate::new(move || {
                for (index, readings) in flight.readings.iter().enumerate() {
                    black_box(tracker.track(index as u64, black_box(readings)));
                }
            })
        })
        .collect();
    let run_times = race(&mut candidates, settings.rounds(), flight.readings.len());
    let base_s = run_times[0].least_s;
    let row = |(following, run_time): (Following, RunTime)| {
        vec![
            following.name().into(),
            Value::from(run_time.least_s * 1e6),
            Value::from(run_time.median_s * 1e6),
            Value::from(run_time.least_s / base_s),
        ]
    };
    Ok(Table {
        name: "motion_cost",
        caption: format!("Time per frame of a smooth motion up to {SMOOTH_M_PER_S} m/s, exact tier at 1e-6, f64"),
        columns: vec![
            column("order", "order of exposure"),
            column("least_us", "least / µs"),
            column("median_us", "median / µs"),
            column("ratio", "ratio"),
        ],
        rows: Following::all().zip(run_times).map(row).collect(),
    })
}

fn table(entries: &[Entry]) -> Table {
    let row = |entry: &Entry| {
        let (rms_m, rms_rad) = (entry.errors.rms_m(), entry.errors.rms_rad());
        vec![
            entry.motion.name().into(),
            Value::from(entry.speed_m_per_s),
            entry.following.name().into(),
            Value::from(rms_m / entry.bound.0),
            Value::from(rms_rad / entry.bound.1),
            Value::from(rms_m * 1e6),
            Value::from(rms_rad * 1e6),
            Value::from(100.0 * entry.errors.solved()),
            Value::from(100.0 * entry.fitting),
        ]
    };
    Table {
        name: "motion",
        caption: "Error of the pose of each frame against the tool's speed".to_owned(),
        columns: vec![
            column("motion", "motion"),
            column("speed_m_per_s", "speed / (m/s)"),
            column("order", "order of exposure"),
            column("translation_sigmas", "translation / bound"),
            column("rotation_sigmas", "rotation / bound"),
            column("rms_um", "rms / µm"),
            column("rms_urad", "rms / µrad"),
            column("solved_percent", "frames with a pose / %"),
            column("converged_percent", "frames that fit their own currents / %"),
        ],
        rows: entries.iter().map(row).collect(),
    }
}

fn picture(entries: &[Entry], head: &Head<'_>) -> Picture {
    let panel = |motion: Motion| {
        let points = |following: Following, sigmas: fn(&Entry) -> f64| -> Vec<[f64; 2]> {
            let chosen = entries.iter().filter(|entry| entry.motion == motion && entry.following == following);
            chosen.map(|entry| [entry.speed_m_per_s, sigmas(entry)]).collect()
        };
        let translation: fn(&Entry) -> f64 = |entry| entry.errors.rms_m() / entry.bound.0;
        let rotation: fn(&Entry) -> f64 = |entry| entry.errors.rms_rad() / entry.bound.1;
        let mut curves = Vec::new();
        for (colour, following) in Following::all().enumerate() {
            let label = format!("order of exposure {}", following.name());
            curves.push(curve(&label, colour, CurveStyle::Joined, points(following, translation)));
            curves.push(curve("", colour, CurveStyle::DashedRings, points(following, rotation)));
        }
        curves.push(curve("", 6, CurveStyle::Dashed, vec![[0.0, 1.0], [2.0, 1.0]]));
        let all = || entries.iter().flat_map(|entry| [translation(entry), rotation(entry)]);
        let note = Note {
            at: [2.0, 1.0],
            offset: dvec2(-4.0, 15.0),
            anchor: Anchor::End,
            text: "bound of one frame, tool at rest".to_owned(),
            colour: SOFT_INK,
        };
        // Where no filter's curve crosses it.
        let notes = (motion == Motion::Straight).then_some(note).into_iter().collect();
        let x = Axis::around("greatest speed / (m/s)", SPEEDS_M_PER_S);
        let mut y = Axis::logarithmic("rms error / bound at rest", all().chain([1.0]));
        y.range[0] *= 0.8;
        (motion.name().to_owned() + " motion", Chart { x, y, curves, notes })
    };
    Sheet {
        title: "Error against the tool's speed".to_owned(),
        note: format!("{}; exact tier at 1e-6, f64. Discs translation, rings rotation.", head.file.name),
        panels: vec![panel(Motion::Smooth), panel(Motion::Straight)],
    }
    .draw(
        "motion",
        "Error in units of the bound against the tool's speed, with the order of exposure honoured and ignored.",
    )
}
