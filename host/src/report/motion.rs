//! Moving tools: what it costs to ignore that cells are exposed one after another.

use glam::dvec2;
use slitpose_model::{Outcome, Photocurrents, Pose, Solver, Tracked, Tracker, Twist};

use super::accuracy::{Errors, rms_of_covariances};
use super::head::{Frame, Head, STREAM};
use super::noise::NoiseSource;
use super::section::{Picture, Section, Table, Value, column};
use super::sheet::{Sheet, curve};
use super::{ReportError, Settings};
use crate::plot::{Anchor, Axis, Chart, CurveStyle, Note, SOFT_INK};
use crate::simulator::{Trajectory, TrajectoryKind};

pub(super) const TITLE: &str = "Moving tools: the order of exposure";

/// Greatest speeds, m/s; the tool turns at ten times as many rad/s.
const SPEEDS_M_PER_S: [f64; 7] = [0.0, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0];
const TURN_PER_SPEED_RAD_PER_M: f64 = 10.0;

/// Greatest speed of the smooth motion as the simulator has it; others are the same motion at
/// another pace.
const SMOOTH_M_PER_S: f64 = 0.5;

/// How far a straight flight goes to either side of home.
const HALF_FLIGHT_M: f64 = 3.5e-3;

/// Most frames of a flight.
const FLIGHT_FRAMES: usize = 40;

/// Frames at the start of a flight that do not count: the tracker learns how the tool moves.
const LEARNING_FRAMES: usize = 6;

/// Memory of the filter.
const MEMORY_S: f64 = 3e-3;

/// What a tracker is told of the order of exposure, and which of its poses counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Order {
    Honoured,
    Ignored,
    /// Honoured, and a parabola through [`MEMORY_S`] of frames.
    Filtered,
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

/// Frames in a row, with the pose at each reference instant and what was measured.
struct Flight {
    poses: Vec<Pose>,
    readings: Vec<Photocurrents>,
    /// The first frame that counts.
    counts_from: usize,
}

/// Errors of one tracker at one speed.
struct Entry {
    motion: Motion,
    speed_m_per_s: f64,
    order: Order,
    errors: Errors,
    /// Root mean squares the bound of a tool at rest allows at the same poses, metres and radians.
    bound: (f64, f64),
    /// Share of the frames that a pose fits.
    fitting: f64,
}

pub(super) fn section(head: &Head<'_>, settings: &Settings) -> Result<Section, ReportError> {
    let mut section =
        Section { name: "motion", title: TITLE, paragraphs: Vec::new(), pictures: Vec::new(), tables: Vec::new() };
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
             \"ignored\" is the same tracker told that all cells are exposed at once, \"filtered\" a parabola through the \
             poses of 3 ms (run --filter 3ms); all else is the pose of each frame by itself. Errors in units of the Cramér–Rao bound of a tool at rest.",
            Value::from((spread(f64::max) - spread(f64::min)) * 1e6).shown()
        ),
        "Straight flights pass home at a constant twist: what is left there is the noise of the twist. A smooth motion \
         swings ±2.5 mm in all six coordinates, at 2 m/s with up to 1600 m/s²: it bends within the frames that the \
         twist is taken from. Speeds are the greatest of the motion; the tool turns at 10 rad/s for each m/s."
            .to_owned(),
    ];
    section.pictures.push(picture(&entries, head));
    section.tables.push(table(&entries));
    Ok(section)
}

fn measure(head: &Head<'_>, frame: &Frame, settings: &Settings) -> Result<Vec<Entry>, ReportError> {
    let resting = Solver::<f64>::new(&head.scene, STREAM)?;
    let mut entries = Vec::new();
    for motion in [Motion::Smooth, Motion::Straight] {
        for speed_m_per_s in SPEEDS_M_PER_S {
            let mut noise = NoiseSource::seeded(settings.seed);
            let flights = match motion {
                Motion::Smooth => vec![smooth(head, frame, settings, speed_m_per_s, &mut noise)],
                Motion::Straight => straight(head, frame, settings, speed_m_per_s, &mut noise),
            };
            let counted = flights.iter().flat_map(|flight| &flight.poses[flight.counts_from..]);
            let bound = rms_of_covariances(counted.filter_map(|pose| resting.bound(pose)));
            for order in [Order::Honoured, Order::Ignored, Order::Filtered] {
                let solver = match order {
                    Order::Honoured | Order::Filtered => resting.clone().with_exposures(&frame.exposures_s),
                    Order::Ignored => resting.clone(),
                };
                let (errors, fitting) = track(&solver, frame.period_s, order, &flights);
                entries.push(Entry { motion, speed_m_per_s, order, errors, bound, fitting });
            }
        }
    }
    Ok(entries)
}

/// Errors of the poses as the tracker gives them, and the share of frames that fit.
fn track(solver: &Solver<f64>, period_s: f64, order: Order, flights: &[Flight]) -> (Errors, f64) {
    let (mut errors, mut fitting, mut counted) = (Errors::default(), 0.0, 0.0);
    for flight in flights {
        let mut tracker = Tracker::new(solver.clone(), period_s);
        if order == Order::Filtered {
            tracker = tracker.with_filter(MEMORY_S);
        }
        for (index, (readings, pose)) in flight.readings.iter().zip(&flight.poses).enumerate() {
            let Tracked { solution, smoothed, .. } = tracker.track(index as u64, readings);
            if index >= flight.counts_from {
                match order {
                    Order::Filtered => errors.add_estimate(smoothed.map(|smoothed| smoothed.estimate).as_ref(), pose),
                    Order::Honoured | Order::Ignored => errors.add(&solution, pose),
                }
                fitting += f64::from(u8::from(solution.outcome == Outcome::Converged));
                counted += 1.0;
            }
        }
    }
    (errors, fitting / counted)
}

/// The simulator's smooth motion, its time stretched to the speed asked for.
fn smooth(head: &Head<'_>, frame: &Frame, settings: &Settings, speed_m_per_s: f64, noise: &mut NoiseSource) -> Flight {
    let frames = if settings.quick { 600 } else { 4000 };
    let trajectory = Trajectory::of_kind(TrajectoryKind::Smooth, settings.seed, 1.0);
    let pace = speed_m_per_s / SMOOTH_M_PER_S;
    flight(head, frame, frames, noise, |time_s| trajectory.pose(pace * time_s))
}

/// Flights through home in all directions.
fn straight(
    head: &Head<'_>,
    frame: &Frame,
    settings: &Settings,
    speed_m_per_s: f64,
    noise: &mut NoiseSource,
) -> Vec<Flight> {
    let flights = if settings.quick { 15 } else { 100 };
    let crossing = 2.0 * HALF_FLIGHT_M / (speed_m_per_s * frame.period_s);
    let frames = (crossing as usize).clamp(LEARNING_FRAMES + 1, FLIGHT_FRAMES);
    let middle_s = 0.5 * frames as f64 * frame.period_s;
    (0..flights)
        .map(|_| {
            let twist = Twist {
                linear_m_per_s: noise.direction() * speed_m_per_s,
                angular_rad_per_s: noise.direction() * speed_m_per_s * TURN_PER_SPEED_RAD_PER_M,
            };
            flight(head, frame, frames, noise, |time_s| twist.advance(&Pose::HOME, time_s - middle_s))
        })
        .collect()
}

fn flight(
    head: &Head<'_>,
    frame: &Frame,
    frames: usize,
    noise: &mut NoiseSource,
    pose_at: impl Fn(f64) -> Pose,
) -> Flight {
    let instants: Vec<f64> = (0..frames).map(|index| index as f64 * frame.period_s).collect();
    let clean = |time_s: f64| {
        let cells = frame.exposures_s.iter().enumerate();
        Photocurrents::of_pairs(
            cells.map(|(cell, offset_s)| head.truth.photocurrents(cell, &pose_at(time_s + offset_s))),
        )
    };
    Flight {
        readings: instants.iter().map(|&time_s| noise.disturb(&head.scene, &clean(time_s))).collect(),
        poses: instants.iter().map(|&time_s| pose_at(time_s)).collect(),
        counts_from: LEARNING_FRAMES,
    }
}

fn table(entries: &[Entry]) -> Table {
    let row = |entry: &Entry| {
        let (rms_m, rms_rad) = (entry.errors.rms_m(), entry.errors.rms_rad());
        vec![
            entry.motion.name().into(),
            Value::from(entry.speed_m_per_s),
            match entry.order {
                Order::Honoured => "honoured",
                Order::Ignored => "ignored",
                Order::Filtered => "honoured, filtered over 3 ms",
            }
            .into(),
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
        caption: "Error against the tool's speed".to_owned(),
        columns: vec![
            column("motion", "motion"),
            column("speed_m_per_s", "speed / (m/s)"),
            column("order", "order of exposure"),
            column("translation_sigmas", "translation / σ"),
            column("rotation_sigmas", "rotation / σ"),
            column("rms_um", "rms / µm"),
            column("rms_urad", "rms / µrad"),
            column("solved_percent", "solved / %"),
            column("converged_percent", "converged / %"),
        ],
        rows: entries.iter().map(row).collect(),
    }
}

fn picture(entries: &[Entry], head: &Head<'_>) -> Picture {
    let panel = |motion: Motion| {
        let points = |order: Order, sigmas: fn(&Entry) -> f64| -> Vec<[f64; 2]> {
            let chosen = entries.iter().filter(|entry| entry.motion == motion && entry.order == order);
            chosen.map(|entry| [entry.speed_m_per_s, sigmas(entry)]).collect()
        };
        let translation: fn(&Entry) -> f64 = |entry| entry.errors.rms_m() / entry.bound.0;
        let rotation: fn(&Entry) -> f64 = |entry| entry.errors.rms_rad() / entry.bound.1;
        let curves = vec![
            curve(
                "order of exposure honoured, translation",
                0,
                CurveStyle::Joined,
                points(Order::Honoured, translation),
            ),
            curve(
                "order of exposure honoured, rotation",
                0,
                CurveStyle::DashedRings,
                points(Order::Honoured, rotation),
            ),
            curve("order of exposure ignored, translation", 1, CurveStyle::Joined, points(Order::Ignored, translation)),
            curve("order of exposure ignored, rotation", 1, CurveStyle::DashedRings, points(Order::Ignored, rotation)),
            curve("filtered, translation", 2, CurveStyle::Joined, points(Order::Filtered, translation)),
            curve("filtered, rotation", 2, CurveStyle::DashedRings, points(Order::Filtered, rotation)),
            curve("", 6, CurveStyle::Dashed, vec![[0.0, 1.0], [2.0, 1.0]]),
        ];
        let all = || entries.iter().flat_map(|entry| [translation(entry), rotation(entry)]);
        let notes = vec![Note {
            at: [2.0, 1.0],
            offset: dvec2(-4.0, 15.0),
            anchor: Anchor::End,
            text: "bound of one frame, tool at rest".to_owned(),
            colour: SOFT_INK,
        }];
        let x = Axis::around("greatest speed / (m/s)", SPEEDS_M_PER_S);
        let mut y = Axis::logarithmic("rms error / σ", all().chain([1.0]));
        y.range[0] *= 0.8;
        (motion.name().to_owned() + " motion", Chart { x, y, curves, notes })
    };
    Sheet {
        title: "Error against the tool's speed".to_owned(),
        note: format!("{}; pose of each frame, and filtered over 3 ms; exact tier at 1e-6, f64", head.file.name),
        panels: vec![panel(Motion::Smooth), panel(Motion::Straight)],
    }
    .draw(
        "motion",
        "Error in units of the bound against the tool's speed, with the order of exposure honoured and ignored.",
    )
}
