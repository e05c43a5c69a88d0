use glam::DQuat;
use slitpose_model::{Cells, NoTwist, Outcome, Solution};

use super::*;
use crate::link::DeviceId;

fn view() -> View {
    View {
        name: "jig".to_owned(),
        user_from_base: Pose::from_vectors(DVec3::new(0.12, -0.03, 0.4), DVec3::new(0.7, -1.9, 0.4)),
        tip_m: DVec3::new(4e-3, -2e-3, -80e-3),
        tip_covariance: DMat3::ZERO,
    }
}

fn pose() -> Pose {
    Pose::from_vectors(DVec3::new(1e-3, -2e-3, 3e-3), DVec3::new(0.2, -0.1, 0.3))
}

/// With every correlation: micrometres and tens of microradians.
fn covariance() -> Matrix6 {
    let root = |i: usize, j: usize| {
        let scale = if i < 3 { 2e-6 } else { 30e-6 };
        if j <= i { scale * (1.0 + (3 * i + 5 * j) as f64 % 7.0) / (1.0 + j as f64) } else { 0.0 }
    };
    matrix(|i, j| (0..6).map(|k| root(i, k) * root(j, k)).sum())
}

/// How the pose in the frame of the user changes with that in the base, and with the tip: central differences.
fn differences() -> [[f64; 9]; 6] {
    const STEP: f64 = 1e-6;
    let at = |axis: usize, step: f64| {
        let mut by = [DVec3::ZERO; 3];
        by[axis / 3][axis % 3] = step;
        View { tip_m: view().tip_m + by[2], ..view() }.pose(&pose().perturbed(by[0], by[1]))
    };
    let mut jacobian = [[0.0; 9]; 6];
    for axis in 0..9 {
        let (t, r) = at(axis, STEP).displacement_from(&at(axis, -STEP));
        for (row, change) in t.to_array().into_iter().chain(r.to_array()).enumerate() {
            jacobian[row][axis] = change / (2.0 * STEP);
        }
    }
    jacobian
}

#[test]
fn a_covariance_changes_as_differences_say() {
    let (jacobian, given) = (differences(), covariance());
    let root = DMat3::from_cols_array(&[3e-6, 1e-6, 2e-6, 0.0, 4e-6, -2e-6, 0.0, 0.0, 20e-6]);
    for tip_covariance in [DMat3::ZERO, root * root.transpose()] {
        let input = |i: usize, j: usize| match (i < 6, j < 6) {
            (true, true) => given[i][j],
            (false, false) => tip_covariance.col(j - 6)[i - 6],
            _ => 0.0,
        };
        let through = |i: usize, l: usize| (0..9).map(|k| jacobian[i][k] * input(k, l)).sum::<f64>();
        let expected = matrix(|i, j| (0..9).map(|l| through(i, l) * jacobian[j][l]).sum());
        let found = View { tip_covariance, ..view() }.estimate(&Estimate { pose: pose(), covariance: given });
        assert_eq!(found.pose, view().pose(&pose()));
        let found = found.covariance;
        for (i, j) in (0..36).map(|at| (at / 6, at % 6)) {
            let scale = (expected[i][i] * expected[j][j]).sqrt();
            assert!((found[i][j] - expected[i][j]).abs() < 1e-8 * scale, "{i} {j}: {found:?}, not {expected:?}");
            assert_eq!(found[i][j], found[j][i], "symmetric to the last bit");
        }
    }
}

#[test]
fn a_pose_comes_back() {
    let (t, r) = view().base_from_tool(&view().pose(&pose())).displacement_from(&pose());
    assert!(t.length() < 1e-15 && r.length() < 1e-15, "{t} {r}");
    // The tip is where the tool has it, seen from the user.
    let expected = view().user_from_base.rotation * (pose().rotation * view().tip_m + pose().translation_m)
        + view().user_from_base.translation_m;
    assert!(view().pose(&pose()).translation_m.distance(expected) < 1e-15);
}

fn record() -> Record {
    let cells = Cells::default();
    let mut solution = Solution::reported(Outcome::Diverged, None, f64::NAN, cells, cells);
    solution.estimate = Some(Estimate { pose: pose(), covariance: covariance() });
    let twist = Twist { linear_m_per_s: DVec3::new(0.1, -0.2, 0.3), angular_rad_per_s: DVec3::new(-1.0, 2.0, 0.5) };
    Record {
        device: DeviceId::default(),
        sequence: 0,
        device_time_s: 0.0,
        host_time: None,
        arrival: None,
        solution,
        twist: Ok(TwistEstimate { twist, covariance: covariance() }),
        filtered: None,
        light_level: None,
        simulated: true,
        truth: Some(pose()),
        view: None,
    }
}

#[test]
fn velocities_are_those_of_the_tip() {
    const STEP_S: f64 = 1e-5;
    let mut seen = record();
    let view = view().kept();
    view.see(&mut seen);
    let found = seen.twist.unwrap();
    let twist = record().twist.unwrap().twist;
    let at = |time_s: f64| view.pose(&twist.advance(&pose(), time_s));
    let (t, r) = at(STEP_S).displacement_from(&at(-STEP_S));
    assert!((t / (2.0 * STEP_S)).distance(found.twist.linear_m_per_s) < 1e-8);
    assert!((r / (2.0 * STEP_S)).distance(found.twist.angular_rad_per_s) < 1e-8);
    // Velocities change as displacements do.
    let expected = view.estimate(&Estimate { pose: pose(), covariance: covariance() }).covariance;
    assert_eq!(found.covariance, expected);
    assert_eq!((seen.truth, seen.view.map(View::name)), (Some(view.pose(&pose())), Some("jig")));
    let mut nothing = Record { twist: Err(NoTwist::NoPose), truth: None, ..record() };
    nothing.solution.estimate = None;
    view.see(&mut nothing);
    assert!(nothing.solution.estimate.is_none() && nothing.truth.is_none());
}

#[test]
fn files_come_back_as_they_were_and_faults_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("jig.toml");
    let name = path.to_str().unwrap();
    let tip_covariance = DMat3::from_cols_array(&[9e-12, 1e-12, 0.0, 1e-12, 4e-12, 0.0, 0.0, 0.0, 1e-10]);
    let written = View { tip_covariance, ..view() };
    std::fs::write(&path, written.to_text("a frame")).unwrap();
    let read = View::open(Some(name), Some(name)).unwrap().unwrap();
    assert_eq!((read.name(), read.tip_m.distance(written.tip_m) < 1e-15), ("jig", true));
    let (t, r) = read.user_from_base.displacement_from(&written.user_from_base);
    assert!(t.length() < 1e-15 && r.length() < 1e-15);
    assert!((0..3).all(|k| read.tip_covariance.col(k).distance(tip_covariance.col(k)) < 1e-25));
    assert_eq!(View::open(Some(name), None).unwrap(), Some(read), "the tip of the same file");
    let other = View::open(Some(name), Some("0,0,0")).unwrap().unwrap();
    assert_eq!((other.name(), other.tip_m), ("jig", DVec3::ZERO));
    let given = View::open(None, Some("1, 2,-3")).unwrap().unwrap();
    assert_eq!((given.name(), given.tip_m), (BASE, DVec3::new(1e-3, 2e-3, -3e-3)));
    assert_eq!(View::open(Some(BASE), Some("0,0,0")).unwrap(), None);
    for (text, parts) in [
        ("", &["user_from_base"][..]),
        ("name = 'a,b'\nuser_from_base.translation_mm = [0, 0, 0]", &["`a,b`", "letters"]),
        ("user_from_base.translation_mm = [0, 1e5, 0]", &["user_from_base.translation_mm = 100000", "millimetres"]),
        ("user_from_base.translation_mm = [nan, 0, 0]", &["NaN", "millimetres"]),
        ("[user_from_base]\ntranslation_mm = [0, 0, 0]\nrotation_rad = [90, 0, 0]", &["rotation_rad = 90", "radians"]),
        ("user_from_base = { translation_mm = [0, 0] }", &["is no frame"]),
        ("user_from_bass = 1", &["is no frame", "user_from_bass"]),
    ] {
        std::fs::write(&path, text).unwrap();
        let error = View::open(Some(name), None).unwrap_err().to_string();
        assert!(parts.iter().all(|part| error.contains(part)) && error.contains("jig.toml"), "{text}: {error}");
    }
    for tip in ["1,2", "1,2,x", "0,0,1e9", "no_such_tip"] {
        let error = View::open(None, Some(tip)).unwrap_err().to_string();
        assert!(error.contains(tip), "{error}");
    }
    std::fs::write(&path, "tip = { position_mm = [0, 0, 1], covariance_mm2 = [[1, 0, 0], [0, -1, 0], [0, 0, 1]] }")
        .unwrap();
    let error = View::open(None, Some(name)).unwrap_err().to_string();
    assert!(error.contains("diagonal not below 0"), "{error}");
}

#[test]
fn the_mean_of_some_time_is_the_zero_until_it_is_taken_back() {
    let mut viewer = Viewer::of(Some(View { user_from_base: Pose::HOME, ..view() }.kept()));
    let at = |scan: u32, off_m: f64| {
        let mut record = record();
        record.device_time_s = 1.0 + f64::from(scan) * 1e-3;
        let moved = pose().perturbed(DVec3::new(off_m, 0.0, 0.0), DVec3::ZERO);
        record.solution.estimate = Some(Estimate { pose: moved, covariance: covariance() });
        record
    };
    viewer.zero(Some(0.1));
    // Two micrometres to either side.
    for scan in 0..=100 {
        viewer.see(&mut at(scan, if scan % 2 == 0 { 2e-6 } else { -2e-6 }));
    }
    let report = viewer.report();
    assert_eq!((report.name.as_str(), report.zeros), ("zero", 1));
    let words = report.zero.unwrap();
    assert!(words.contains("101 poses within 0.1 s; sigma 0.200 0.000"), "{words}");
    assert!(report.text.contains(&words) && report.text.contains("[tip]"), "{}", report.text);
    let mut seen = at(101, 2e-6 / 101.0);
    viewer.see(&mut seen);
    let zero = seen.solution.estimate.unwrap().pose;
    assert!(zero.translation_m.length() < 1e-15 && zero.rotation.dot(DQuat::IDENTITY).abs() > 1.0 - 1e-15, "{zero:?}");
    // Its file makes the same frame.
    let path = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(&path, report.text).unwrap();
    let name = path.path().to_str().unwrap();
    let again = View::open(Some(name), Some(name)).unwrap().unwrap();
    assert!(again.pose(&at(0, 2e-6 / 101.0).solution.estimate.unwrap().pose).translation_m.length() < 1e-12);
    // Without a pose there is no zero, and the frame stays.
    viewer.zero(Some(1e-3));
    for scan in [200, 201] {
        let mut dark = at(scan, 0.0);
        dark.solution.estimate = None;
        viewer.see(&mut dark);
    }
    let report = viewer.report();
    assert!(report.name == "zero" && report.zeros == 2 && report.zero.unwrap().contains("no scan of that time"));
    viewer.zero(None);
    assert_eq!((viewer.report().name.as_str(), viewer.report().zeros), ("jig", 3));
}
