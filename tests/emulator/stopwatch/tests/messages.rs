//! What one side says is what the other hears.

use glam::{DQuat, DVec2, DVec3};
use slitpose_model::{
    Cell, Detector, Emitter, MAX_CELLS, MAX_PROFILE_KNOTS, Noise, Pair, Photocurrents, Pose, Profile, Reading, Slit,
    Tier, Uncertainty,
};
use slitpose_stopwatch::{Answer, Mailbox, Numbers, Request, Solved};

/// A cell no two of whose numbers are equal.
fn cell(profile: Profile, known: bool) -> Cell {
    Cell {
        detector: Detector {
            centre_base_m: DVec3::new(1.0, 2.0, 3.0),
            x_axis_base: DVec3::new(4.0, 5.0, 6.0),
            normal_base: DVec3::new(7.0, 8.0, 9.0),
            length_m: 10.0,
            width_m: 11.0,
            responsivity_a_per_w: 12.0,
            dark_current_a: 13.0,
            interelectrode_ohm: known.then_some(14.0),
            saturation_a: known.then_some(15.0),
            faint_a: 16.0,
        },
        slit: Slit {
            distance_m: 17.0,
            width_m: 18.0,
            length_m: 19.0,
            offset_m: DVec2::new(20.0, 21.0),
            tilt_rad: DVec3::new(22.0, 23.0, 24.0),
            thickness_m: 25.0,
        },
        emitter: Emitter {
            position_tool_m: DVec3::new(26.0, 27.0, 28.0),
            axis_tool: DVec3::new(29.0, 30.0, 31.0),
            radiant_intensity_w_per_sr: 32.0,
            profile,
        },
        effects: slitpose_model::Effects::default(),
    }
}

fn pose() -> Pose {
    Pose { rotation: DQuat::from_xyzw(1.0, 2.0, 3.0, 4.0), translation_m: DVec3::new(5.0, 6.0, 7.0) }
}

/// By way of a mailbox.
fn posted(numbers: &Numbers) -> Numbers {
    let mailbox = Mailbox::new();
    mailbox.write(numbers);
    mailbox.read()
}

#[test]
fn requests_arrive_as_they_were_made() {
    let knots = (0..MAX_PROFILE_KNOTS).map(|i| (i as f64, -(i as f64))).collect();
    let noise = Noise { shot_bandwidth_hz: 1.0, johnson_bandwidth_hz: 2.0, temperature_k: 3.0, adc_a: 4.0 };
    let uncertainty = Uncertainty { emitter_gain_relative: 5.0, electrode_gain_relative: 6.0, position_m: 7.0 };
    let light = Reading::Light(Pair { i_x1_a: 1e-6, i_x2_a: -2e-9 });
    let readings = Photocurrents { cells: [light, Reading::Missing, Reading::Saturated].into_iter().collect() };
    let many = Photocurrents { cells: [light; MAX_CELLS].into_iter().collect() };
    for request in [
        Request::Scene(Some(noise), uncertainty),
        Request::Scene(None, uncertainty),
        Request::Cell(cell(Profile::Cosine { exponent: 33.0 }, true)),
        Request::Cell(cell(Profile::Table(knots), false)),
        Request::Compile(Tier::Paper),
        Request::Compile(Tier::Exact { tolerance: 1e-4 }),
        Request::Solve(readings, None),
        Request::Solve(many, Some(pose())),
    ] {
        assert_eq!(Request::read(&posted(&request.write())), Some(request));
    }
}

#[test]
fn answers_arrive_as_they_were_made() {
    let covariance = std::array::from_fn(|i| std::array::from_fn(|j| (10 * i + j) as f64));
    let solved = Solved { cycles: u32::MAX, iterations: 3, converged: true, estimate: Some((pose(), covariance)) };
    for answer in [
        Answer::Done,
        Answer::Refused,
        Answer::Solved(solved),
        Answer::Solved(Solved { converged: false, estimate: None, ..solved }),
    ] {
        assert_eq!(Answer::read(&posted(&answer.write())), Some(answer));
    }
}

#[test]
fn what_is_cut_short_or_of_no_kind_is_nothing() {
    let request = Request::Cell(cell(Profile::Cosine { exponent: 1.0 }, true)).write();
    for count in 0..request.len() {
        let cut = request.iter().copied().take(count).collect();
        assert_eq!(Request::read(&cut), None, "{count}");
    }
    let unknown: Numbers = [f64::NAN, 1.0].into_iter().collect();
    assert_eq!((Request::read(&unknown), Answer::read(&unknown)), (None, None));
}
