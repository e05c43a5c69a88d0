//! Time driven to extremes: front ends from far faster to far slower than a frame, and tools that
//! jump.

use glam::DVec3;
use slitpose_head::front_end::{Settling, configuration};
use slitpose_model::{Pose, Scalar, SceneError, Solver, Tracker};
use slitpose_protocol::Schedule;

use super::{Case, Expected, Reached};
use crate::report::Settings;
use crate::report::head::{Head, NoiseSource, STREAM, currents, rms_of_covariances};
use crate::report::method::Precision;

/// Frames before and after a jump.
const BEFORE: u64 = 20;
const AFTER: u64 = 20;

/// A frame has recovered when its pose is within this many σ.
const RECOVERED_SIGMAS: f64 = 5.0;

/// Lit minus dark of front ends with time constants from a nanosecond to a second.
pub(super) fn front_ends(head: &Head<'_>) -> Vec<Case> {
    let Ok(configuration) = configuration(head.file) else {
        return Vec::new();
    };
    let schedule = &configuration.schedule;
    let case = |exponent: i32| {
        let tau_s = 10f64.powi(exponent);
        let found = Settling::of_cell(schedule, 0, tau_s).map(|settling| settling.gain);
        let expected = lit_minus_dark(schedule, 0, tau_s);
        let error = found.zip(expected).map(|(found, expected)| ((found - expected) / expected).abs());
        // Of an exponential of x a rounding of x is x roundings; beyond some forty nothing is left.
        let reached = Reached::once("value", error, Some(Precision::Double.unit_roundoff()));
        Case {
            study: "front end",
            case: format!("τ = {tau_s:e} s, gain {:.3e}", expected.unwrap_or(f64::NAN)),
            condition: None,
            quantity: "gain / relative",
            expected: Expected::Value,
            reached: vec![reached],
        }
    };
    (-9..=0).map(case).collect()
}

/// What a periodic first-order front end gives, lit minus dark, without a difference of numbers
/// that are nearly one: with u = exp(−x/τ) for the time x since the light came on, likewise v since
/// it went off, a = exp(−T_on/τ), b = exp(−T_off/τ), the mean of
/// [(1 − a)·(1 − v) − (1 − b)·(u − a)]/(1 − ab) over pairs of samples.
fn lit_minus_dark(schedule: &Schedule, cell: usize, tau_s: f64) -> Option<f64> {
    let in_tau = |ticks: f64| ticks / f64::from(schedule.tick_hz) / tau_s;
    // 1 − exp(−x), exact for small x.
    let rise = |x: f64| -(-x).exp_m1();
    let (slot, dark) = (schedule.lit_slot(cell)?, schedule.dark_slot()?);
    let (slot_ticks, frame_ticks) = (f64::from(schedule.slot_ticks), f64::from(schedule.frame_ticks));
    let on_ticks = slot as f64 * slot_ticks;
    let first_lit = schedule.first_sample_ticks(slot, cell)? as f64 - on_ticks;
    let first_dark = (schedule.first_sample_ticks(dark, cell)? as f64 - on_ticks - slot_ticks).rem_euclid(frame_ticks);
    let (on, off, frame) = (in_tau(slot_ticks), in_tau(frame_ticks - slot_ticks), in_tau(frame_ticks));
    let sample = |conversion: u16| {
        let later = f64::from(conversion) * f64::from(schedule.conversion_ticks);
        let (lit, dark) = (in_tau(first_lit + later), in_tau(first_dark + later));
        let left = (-lit).exp() * rise(on - lit);
        (rise(on) * rise(dark) - rise(off) * left) / rise(frame)
    };
    Some((0..schedule.oversampling).map(sample).sum::<f64>() / f64::from(schedule.oversampling))
}

/// A tool at rest that is elsewhere from one frame to the next.
pub(super) fn jumps(head: &Head<'_>, settings: &Settings) -> Result<Vec<Case>, SceneError> {
    let jumps = [
        ("0.1 mm", DVec3::new(0.6, -0.64, 0.48) * 1e-4, DVec3::ZERO),
        ("1 mm", DVec3::new(0.6, -0.64, 0.48) * 1e-3, DVec3::ZERO),
        ("10°", DVec3::ZERO, DVec3::new(-0.48, 0.6, 0.64) * 10f64.to_radians()),
        ("1 mm and 10°", DVec3::new(0.6, -0.64, 0.48) * 1e-3, DVec3::new(-0.48, 0.6, 0.64) * 10f64.to_radians()),
        ("5 mm and 15°", DVec3::new(0.6, -0.64, 0.48) * 5e-3, DVec3::new(-0.48, 0.6, 0.64) * 15f64.to_radians()),
    ];
    let mut cases = Vec::new();
    for (name, shift_m, turn_rad) in jumps {
        let landed = Pose::HOME.perturbed(shift_m, turn_rad);
        let double = jump::<f64>(head, settings, &landed)?;
        let single = jump::<f32>(head, settings, &landed)?;
        cases.push(Case {
            study: "jump of the tool",
            case: name.to_owned(),
            condition: None,
            quantity: "pose at the emitters in the frame of the jump / µm",
            expected: Expected::Honest,
            reached: vec![double, single],
        });
    }
    Ok(cases)
}

/// What the tracker says in the frame of the jump, and how many frames pass until its poses are
/// right again.
fn jump<S: Scalar>(head: &Head<'_>, settings: &Settings, landed: &Pose) -> Result<Reached, SceneError> {
    let mut solver = Solver::<S>::new(&head.scene, STREAM)?;
    let period_s = head.frame.as_ref().map_or(1e-3, |frame| frame.period_s);
    if let Some(frame) = &head.frame {
        solver = solver.with_exposures(&frame.exposures_s);
    }
    let arm_m = head.scene.length_scale_m();
    let resting = Solver::<f64>::new(&head.scene, STREAM)?;
    let [bound_m, bound_rad] = rms_of_covariances(resting.bound(landed));
    let bound = bound_m.hypot(arm_m * bound_rad);
    let mut tracker = Tracker::new(solver, period_s);
    let mut noise = NoiseSource::seeded(settings.seed);
    let mut readings = |pose: &Pose| noise.disturb(&head.scene, &head.truth, pose, &currents(&head.truth, pose));
    for frame in 0..BEFORE {
        tracker.track(frame, &readings(&Pose::HOME).rounded());
    }
    let mut reached = Reached::default();
    let mut recovered = None;
    for frame in BEFORE..BEFORE + AFTER {
        let solution = tracker.track(frame, &readings(landed).rounded()).solution;
        let error = solution.estimate.map(|estimate| {
            let (dt, dr) = estimate.pose.displacement_from(landed);
            dt.length().hypot(arm_m * dr.length())
        });
        let after = frame - BEFORE;
        if after == 0 {
            let cells = if solution.estimate.is_some() { "" } else { ", no pose" };
            reached = Reached::once(
                &format!("{}{cells}", solution.outcome.as_str()),
                error.map(|error| error * 1e6),
                Some(bound * 1e6),
            );
        }
        match error {
            Some(error) if error <= RECOVERED_SIGMAS * bound => recovered = recovered.or(Some(after)),
            _ => recovered = None,
        }
    }
    let recovery = match recovered {
        Some(0) => "right at once".to_owned(),
        Some(frames) => format!("right after {frames} frames"),
        None => format!("still wrong after {AFTER} frames"),
    };
    reached.outcomes = reached.outcomes.into_keys().map(|word| (format!("{word}; {recovery}"), 1)).collect();
    Ok(reached)
}

#[cfg(test)]
mod tests {
    use super::*;
    use slitpose_head::scene_file::WIDE;

    #[test]
    fn lit_minus_dark_is_what_the_stage_takes_it_for() {
        let file = WIDE.read().unwrap();
        let schedule = configuration(&file).unwrap().schedule;
        for tau_s in [1e-7, 1.36e-6, 2e-5, 2e-4] {
            for cell in 0..6 {
                let gain = Settling::of_cell(&schedule, cell, tau_s).unwrap().gain;
                let found = lit_minus_dark(&schedule, cell, tau_s).unwrap();
                assert!((gain - found).abs() < 1e-13, "{tau_s} {cell}: {gain} {found}");
            }
        }
    }
}
