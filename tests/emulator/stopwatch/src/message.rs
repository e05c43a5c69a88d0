//! What is said, and how it becomes numbers and is taken from them.
//!
//! Each kind writes and reads its own numbers in the same order; the first number of a message
//! tells its kind.

use glam::{DQuat, DVec2};
use slitpose_model::{
    Cell, Detector, Emitter, MAX_CELLS, MAX_PROFILE_KNOTS, Noise, Pair, Photocurrents, Pose, Profile, Reading, Scene,
    Slit, Tier, Uncertainty,
};

use crate::numbers::{Numbers, Reader};

/// What the host asks for.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "no heap on the board, and one at a time")]
pub enum Request {
    /// A new scene with the noise and the uncertainty of this one, without its cells.
    Scene(Option<Noise>, Uncertainty),
    /// One more cell.
    Cell(Cell),
    /// A solver for the scene.
    Compile(Tier),
    /// The pose that these currents tell: near the prior if there is one, else from nothing.
    Solve(Photocurrents, Option<Pose>),
}

/// What the image answers.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "no heap on the board, and one at a time")]
pub enum Answer {
    /// It is done.
    Done,
    /// It cannot be done: a scene with a fault or too many cells, a solve without a solver.
    Refused,
    /// A solve.
    Solved(Solved),
}

/// The outcome of one solve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solved {
    /// Core cycles from currents to pose and covariance, by the core's own counter.
    pub cycles: u32,
    /// Steps of refinement.
    pub iterations: u32,
    /// Whether the solver has converged, with all cells.
    pub converged: bool,
    /// `base_from_tool` and the covariance, if there is a pose.
    pub estimate: Option<(Pose, [[f64; 6]; 6])>,
}

const SCENE: f64 = 1.0;
const CELL: f64 = 2.0;
const COMPILE: f64 = 3.0;
const SOLVE: f64 = 4.0;
const DONE: f64 = 5.0;
const REFUSED: f64 = 6.0;
const SOLVED: f64 = 7.0;

/// Which of `kinds` the next number is.
fn kind(from: &mut Reader<'_>, kinds: &[f64]) -> Option<usize> {
    let number = from.number()?;
    kinds.iter().position(|kind| kind.to_bits() == number.to_bits())
}

impl Request {
    /// The numbers that say it.
    pub fn write(&self) -> Numbers {
        let mut to = Numbers::default();
        match self {
            Self::Scene(noise, uncertainty) => {
                to.put(&[SCENE]);
                let Uncertainty { emitter_gain_relative, electrode_gain_relative, position_m } = *uncertainty;
                to.put(&[emitter_gain_relative, electrode_gain_relative, position_m]);
                if let Some(Noise { shot_bandwidth_hz, johnson_bandwidth_hz, temperature_k, adc_a }) = *noise {
                    to.put(&[shot_bandwidth_hz, johnson_bandwidth_hz, temperature_k, adc_a]);
                }
            }
            Self::Cell(cell) => {
                to.put(&[CELL]);
                write_detector(&cell.detector, &mut to);
                write_slit(&cell.slit, &mut to);
                write_emitter(&cell.emitter, &mut to);
            }
            Self::Compile(tier) => {
                to.put(&[COMPILE]);
                to.put_option(match tier {
                    Tier::Paper => None,
                    Tier::Exact { tolerance } => Some(*tolerance),
                });
            }
            Self::Solve(readings, prior) => {
                to.put(&[SOLVE]);
                write_pose(prior.as_ref(), &mut to);
                for reading in &readings.cells {
                    write_reading(reading, &mut to);
                }
            }
        }
        to
    }

    /// What `numbers` say; `None` if that is no request.
    pub fn read(numbers: &Numbers) -> Option<Self> {
        let mut from = numbers.reader();
        Some(match kind(&mut from, &[SCENE, CELL, COMPILE, SOLVE])? {
            0 => {
                let [emitter_gain_relative, electrode_gain_relative, position_m] = from.array()?;
                let noise = from.array().map(|[shot_bandwidth_hz, johnson_bandwidth_hz, temperature_k, adc_a]| Noise {
                    shot_bandwidth_hz,
                    johnson_bandwidth_hz,
                    temperature_k,
                    adc_a,
                });
                Self::Scene(noise, Uncertainty { emitter_gain_relative, electrode_gain_relative, position_m })
            }
            1 => {
                let (detector, slit) = (read_detector(&mut from)?, read_slit(&mut from)?);
                Self::Cell(Cell::ideal(detector, slit, read_emitter(&mut from)?))
            }
            2 => Self::Compile(from.option()?.map_or(Tier::Paper, |tolerance| Tier::Exact { tolerance })),
            _ => {
                let prior = read_pose(&mut from)?;
                let cells = (0..MAX_CELLS).map_while(|_| read_reading(&mut from)).collect();
                Self::Solve(Photocurrents { cells }, prior)
            }
        })
    }

    /// The requests that tell all of `scene`, in order.
    pub fn of_scene(scene: &Scene) -> impl Iterator<Item = Self> + '_ {
        let cells = scene.cells.iter().cloned().map(Self::Cell);
        core::iter::once(Self::Scene(scene.noise, scene.uncertainty)).chain(cells)
    }
}

impl Answer {
    /// The numbers that say it.
    pub fn write(&self) -> Numbers {
        let mut to = Numbers::default();
        match self {
            Self::Done => to.put(&[DONE]),
            Self::Refused => to.put(&[REFUSED]),
            Self::Solved(Solved { cycles, iterations, converged, estimate }) => {
                to.put(&[SOLVED, f64::from(*cycles), f64::from(*iterations), f64::from(u8::from(*converged))]);
                write_pose(estimate.as_ref().map(|(pose, _)| pose), &mut to);
                for row in estimate.iter().flat_map(|(_, covariance)| covariance) {
                    to.put(row);
                }
            }
        }
        to
    }

    /// What `numbers` say; `None` if that is no answer.
    pub fn read(numbers: &Numbers) -> Option<Self> {
        let mut from = numbers.reader();
        Some(match kind(&mut from, &[DONE, REFUSED, SOLVED])? {
            0 => Self::Done,
            1 => Self::Refused,
            _ => {
                let [cycles, iterations, converged] = from.array()?;
                let estimate = match read_pose(&mut from)? {
                    Some(pose) => {
                        let mut covariance = [[0.0; 6]; 6];
                        for row in &mut covariance {
                            *row = from.array()?;
                        }
                        Some((pose, covariance))
                    }
                    None => None,
                };
                let converged = converged > 0.0;
                Self::Solved(Solved { cycles: cycles as u32, iterations: iterations as u32, converged, estimate })
            }
        })
    }
}

fn write_detector(detector: &Detector, to: &mut Numbers) {
    to.put(&detector.centre_base_m.to_array());
    to.put(&detector.x_axis_base.to_array());
    to.put(&detector.normal_base.to_array());
    to.put(&[detector.length_m, detector.width_m, detector.responsivity_a_per_w]);
    to.put(&[detector.dark_current_a, detector.faint_a]);
    to.put_option(detector.interelectrode_ohm);
    to.put_option(detector.saturation_a);
}

fn read_detector(from: &mut Reader<'_>) -> Option<Detector> {
    let (centre_base_m, x_axis_base, normal_base) = (from.vector()?, from.vector()?, from.vector()?);
    let [length_m, width_m, responsivity_a_per_w, dark_current_a, faint_a] = from.array()?;
    Some(Detector {
        centre_base_m,
        x_axis_base,
        normal_base,
        length_m,
        width_m,
        responsivity_a_per_w,
        dark_current_a,
        faint_a,
        interelectrode_ohm: from.option()?,
        saturation_a: from.option()?,
    })
}

fn write_slit(slit: &Slit, to: &mut Numbers) {
    to.put(&[slit.distance_m, slit.width_m, slit.length_m, slit.thickness_m, slit.offset_m.x, slit.offset_m.y]);
    to.put(&slit.tilt_rad.to_array());
}

fn read_slit(from: &mut Reader<'_>) -> Option<Slit> {
    let [distance_m, width_m, length_m, thickness_m, x, y] = from.array()?;
    let (offset_m, tilt_rad) = (DVec2::new(x, y), from.vector()?);
    Some(Slit { distance_m, width_m, length_m, offset_m, tilt_rad, thickness_m })
}

/// The knots of a profile's table go last; a power of the cosine has its exponent and none.
fn write_emitter(emitter: &Emitter, to: &mut Numbers) {
    to.put(&emitter.position_tool_m.to_array());
    to.put(&emitter.axis_tool.to_array());
    to.put(&[emitter.radiant_intensity_w_per_sr]);
    match &emitter.profile {
        Profile::Cosine { exponent } => to.put(&[*exponent]),
        Profile::Table(knots) => {
            to.put_option(None);
            for &(angle, value) in knots {
                to.put(&[angle, value]);
            }
        }
    }
}

fn read_emitter(from: &mut Reader<'_>) -> Option<Emitter> {
    let (position_tool_m, axis_tool) = (from.vector()?, from.vector()?);
    let radiant_intensity_w_per_sr = from.number()?;
    let profile = match from.option()? {
        Some(exponent) => Profile::Cosine { exponent },
        None => Profile::Table(
            (0..MAX_PROFILE_KNOTS).map_while(|_| from.array().map(|[angle, value]| (angle, value))).collect(),
        ),
    };
    Some(Emitter { position_tool_m, axis_tool, radiant_intensity_w_per_sr, profile })
}

/// Seven numbers; for no pose, one.
fn write_pose(pose: Option<&Pose>, to: &mut Numbers) {
    match pose {
        Some(pose) => {
            to.put(&pose.translation_m.to_array());
            to.put(&pose.rotation.to_array());
        }
        None => to.put_option(None),
    }
}

/// The outer `Option`: whether there were numbers.
fn read_pose(from: &mut Reader<'_>) -> Option<Option<Pose>> {
    let Some(x) = from.option()? else {
        return Some(None);
    };
    let [y, z] = from.array()?;
    Some(Some(Pose { translation_m: glam::DVec3::new(x, y, z), rotation: DQuat::from_array(from.array()?) }))
}

/// Two currents; for none, NaN and what stands in their way.
fn write_reading(reading: &Reading, to: &mut Numbers) {
    match reading {
        Reading::Light(pair) => to.put(&[pair.i_x1_a, pair.i_x2_a]),
        Reading::Saturated => to.put(&[f64::NAN, 1.0]),
        Reading::Missing => to.put(&[f64::NAN, 0.0]),
    }
}

fn read_reading(from: &mut Reader<'_>) -> Option<Reading> {
    let [first, second] = from.array()?;
    Some(match first.is_nan() {
        false => Reading::Light(Pair { i_x1_a: first, i_x2_a: second }),
        true if second > 0.0 => Reading::Saturated,
        true => Reading::Missing,
    })
}
