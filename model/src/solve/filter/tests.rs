use super::*;
use crate::pose::Pose;
use glam::DVec3;

const PERIOD: f64 = 250e-6;

/// A covariance.
const UNIT: Matrix6<f64> = {
    let mut unit = [[0.0; 6]; 6];
    let mut i = 0;
    while i < 6 {
        unit[i][i] = 1.0;
        i += 1;
    }
    unit
};

/// Frames of a polynomial motion, through a filter.
/// None of them is off by more than noise explains.
fn run(memory_s: f64, frames: u32, pose: impl Fn(f64) -> Pose) -> FadingFilter<f64> {
    let mut filter = FadingFilter::new(PERIOD, memory_s);
    for frame in 0..frames {
        filter.update(&Rigid::of(&pose(f64::from(frame) * PERIOD)), &UNIT, |_| 6.0);
    }
    filter
}

#[test]
fn steady_acceleration_comes_through_without_delay() {
    let (velocity, acceleration) = (DVec3::new(0.3, -0.2, 0.1), DVec3::new(20.0, 0.0, -40.0));
    let at = |t: f64| Pose::from_vectors(velocity * t + acceleration * (0.5 * t * t), DVec3::ZERO);
    let state = run(2e-3, 400, at).state(&[[0.0; 6]; 6]).expect("many frames");
    let end = 399.0 * PERIOD;
    assert!((state.estimate.pose.translation_m - at(end).translation_m).length() < 1e-12);
    let expected = velocity + acceleration * end;
    assert!((state.twist.twist.linear_m_per_s - expected).length() < 1e-9);
}

#[test]
fn a_steady_jerk_leads_pose_and_step_astray_as_told() {
    for memory_s in [0.75e-3, 5e-3] {
        // The filter forgets its start; t³/6 in units of frames stays small enough for its digits.
        let at = |frame: f64| Pose::from_vectors(DVec3::X * (frame * frame * frame / 6.0), DVec3::ZERO);
        let filter = run(memory_s, 600, |t| at(t / PERIOD - 400.0));
        let predicted = filter.predict().expect("started");
        let pose = at(200.0).translation_m.x - predicted.pose.to_pose().translation_m.x;
        let step = 0.5 * 200.0 * 200.0 - predicted.twist[0].x * PERIOD;
        let theta = filter.state.expect("started").theta();
        assert!((pose * (1.0 - theta).powi(3) - 1.0).abs() < 1e-6, "{pose}");
        assert!((step / pose - astray(theta)).abs() < 1e-6, "{step} {pose}");
    }
}

#[test]
fn gains_start_as_least_squares_and_end_fading() {
    // A parabola through five points of which the last is one off: the textbook's weights.
    let mut filter = FadingFilter::<f64>::new(PERIOD, 1.0);
    for frame in 0..=PARABOLA_FROM {
        let x = if frame == PARABOLA_FROM { 35.0 } else { 0.0 };
        filter.update(&Rigid::of(&Pose::from_vectors(DVec3::new(x, 0.0, 0.0), DVec3::ZERO)), &UNIT, |_| 6.0);
    }
    let x = filter.state.expect("started").pose.to_pose().translation_m.x;
    assert!((x - 31.0).abs() < 1e-12, "{x}");
    let predicted = run(2e-3, 3000, |_| Pose::HOME).state.expect("started").advanced();
    let theta = predicted.theta();
    // Morrison 1969, table of the fading-memory parabola: variance of the position one frame ahead.
    let expected = (1.0 - theta) * (19.0 + 24.0 * theta + 16.0 * theta.powi(2) + 6.0 * theta.powi(3) + theta.powi(4))
        / (1.0 + theta).powi(5);
    assert!((predicted.spread[0][0] / expected - 1.0).abs() < 1e-9, "{} {expected}", predicted.spread[0][0]);
}

#[test]
fn a_sudden_bend_shortens_the_memory_within_a_few_frames_and_the_lag_told_with_it() {
    let mut filter = run(0.1, 5_000, |_| Pose::HOME);
    let lag_s = |filter: &FadingFilter<f64>| filter.state(&UNIT).expect("many frames").lag_s;
    assert!((lag_s(&filter) / (0.2 * 0.1) - 1.0).abs() < 1e-9);
    // Predictions err by twice what noise explains. The mean over 50 frames would need 12 to notice.
    (0..12).for_each(|_| filter.update(&Rigid::of(&Pose::HOME), &UNIT, |_| 4.0 * 12.0));
    let memory = filter.state.expect("started").memory * PERIOD;
    assert!(memory < 0.1 * 0.05, "{memory}");
    // The step of which half has come through, as long as the memory is what it is now.
    let (told, there) = (lag_s(&filter), Pose::from_vectors(DVec3::X * 1e-6, DVec3::ZERO));
    let mut frames = 0.0;
    while filter.state.expect("started").pose.to_pose().translation_m.x < 0.5e-6 {
        filter.update(&Rigid::of(&there), &UNIT, |_| 6.0);
        frames += 1.0;
    }
    assert!((frames * PERIOD - told).abs() < 1.5 * PERIOD + 0.2 * told, "{frames} frames, {told}");
}

#[test]
fn lag_is_what_a_small_step_shows() {
    for memory_s in [5e-3, 50e-3, 500e-3] {
        let mut filter = run(memory_s, 30_000, |_| Pose::HOME);
        let mut frames = 0.0;
        let there = Pose::from_vectors(DVec3::X * 1e-6, DVec3::ZERO);
        while filter.state.expect("started").pose.to_pose().translation_m.x < 0.5e-6 {
            filter.update(&Rigid::of(&there), &UNIT, |_| 6.0);
            frames += 1.0;
        }
        let told = filter.state(&[[0.0; 6]; 6]).expect("many frames").lag_s;
        // Counted in whole frames, from the step's first one on.
        assert!((frames * PERIOD - told).abs() < 1.5 * PERIOD + 0.1 * told, "{memory_s}: {frames} frames, {told}");
    }
}
