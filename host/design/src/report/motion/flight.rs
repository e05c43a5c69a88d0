//! Motions of a tool, and their measurements.

use slitpose_model::{Photocurrents, Pose, Twist};

use super::LEARNING_FRAMES;
use crate::report::Settings;
use crate::report::head::{Frame, Head};
use crate::report::noise::NoiseSource;
use slitpose_head::simulator::{Trajectory, TrajectoryKind};

/// How fast the tool turns for each m/s, in rad/s.
const TURN_PER_SPEED_RAD_PER_M: f64 = 10.0;

/// Greatest speed of the smooth motion as the simulator has it; others are the same motion at
/// another pace.
pub(super) const SMOOTH_M_PER_S: f64 = 0.5;

/// How far a straight flight goes to either side of home.
const HALF_FLIGHT_M: f64 = 3.5e-3;

/// Most frames of a flight.
const FLIGHT_FRAMES: usize = 40;

/// Frames in a row, with the pose at each reference instant and what was measured.
pub(super) struct Flight {
    pub(super) poses: Vec<Pose>,
    pub(super) readings: Vec<Photocurrents>,
}

/// The simulator's smooth motion, its time stretched to the speed asked for.
pub(super) fn smooth(
    head: &Head<'_>,
    frame: &Frame,
    settings: &Settings,
    speed_m_per_s: f64,
    noise: &mut NoiseSource,
) -> Flight {
    let frames = if settings.quick { 600 } else { 4000 };
    let trajectory = Trajectory::of_kind(TrajectoryKind::Smooth, settings.seed, 1.0);
    let pace = speed_m_per_s / SMOOTH_M_PER_S;
    flight(head, frame, frames, noise, |time_s| trajectory.pose(pace * time_s))
}

/// Flights through home in all directions.
pub(super) fn straight(
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
    let poses: Vec<Pose> = instants.iter().map(|&time_s| pose_at(time_s)).collect();
    let disturbed = instants.iter().zip(&poses);
    let disturbed = disturbed.map(|(&time_s, pose)| noise.disturb(&head.scene, &head.truth, pose, &clean(time_s)));
    Flight { readings: disturbed.collect(), poses }
}
