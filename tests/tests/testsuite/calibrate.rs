//! Calibration of simulated heads whose physics is richer than the model.

use std::path::Path;

use glam::DVec3;
use slitpose_calibration::align;
use slitpose_model::{Pose, rotation_exp};
use slitpose_tests::process::{name_in, text};
use slitpose_tests::slitpose;
use slitpose_tests::table::{POSE, Row, SIGMA, Table};
use tempfile::TempDir;

/// The path of a file of the heads.
pub(super) fn data(name: &str) -> String {
    text(&slitpose_tests::reference::data("heads").join(name)).to_owned()
}

/// The first `rows` rows of a file of the heads, those before `skip` left out.
fn part(folder: &TempDir, name: &str, skip: usize, rows: usize) -> String {
    let text = std::fs::read_to_string(data(name)).expect("a table");
    let mut lines = text.lines();
    let header = lines.next().expect("a header");
    let kept: Vec<&str> = std::iter::once(header).chain(lines.skip(skip).take(rows)).collect();
    let path = folder.path().join(format!("{skip}-{rows}-{name}"));
    std::fs::write(&path, kept.join("\n") + "\n").expect("written");
    path.to_str().expect("UTF-8").to_owned()
}

/// Calibrates; what it says on standard error.
fn calibrate(arguments: &[&str], output: &Path) -> String {
    let scene = data("nominal.toml");
    let fixed = ["calibrate", &scene, "--output", output.to_str().expect("UTF-8")];
    let finished = slitpose!().run(fixed.iter().chain(arguments));
    assert_eq!(finished.code, 0, "{}", finished.stderr);
    finished.stderr
}

fn pose(row: Row<'_>) -> Pose {
    let [tx, ty, tz, rx, ry, rz] = row.numbers(POSE);
    Pose { translation_m: DVec3::new(tx, ty, tz) * 1e-3, rotation: rotation_exp(DVec3::new(rx, ry, rz)) }
}

/// Poses solved with a calibration, and true ones.
struct Solved {
    pairs: Vec<(Pose, Pose)>,
    sigmas: Vec<[f64; 6]>,
}

impl Solved {
    fn by(calibration: &Path, test: &str) -> Self {
        let (scene, currents) = (data("nominal.toml"), data(test));
        let path = calibration.to_str().expect("UTF-8");
        let table = slitpose!().run(["solve", &scene, "--currents", &currents, "--calibration", path]).done();
        let table = Table::parse(&table);
        let truths = Table::parse(&std::fs::read_to_string(&currents).expect("a table"));
        let mut solved = Self { pairs: Vec::new(), sigmas: Vec::new() };
        for (row, truth) in table.rows().zip(truths.rows()) {
            solved.pairs.push((pose(row), pose(truth)));
            let sigma = row.numbers(SIGMA);
            solved.sigmas.push(std::array::from_fn(|k| if k < 3 { sigma[k] * 1e-3 } else { sigma[k] }));
        }
        assert_eq!(solved.pairs.len(), 100);
        solved
    }

    fn errors(&self) -> impl Iterator<Item = (DVec3, DVec3)> + '_ {
        self.pairs.iter().map(|(found, truth)| found.displacement_from(truth))
    }

    /// Mean and largest distance, micrometres; mean angle, degrees.
    fn distances(&self) -> [f64; 3] {
        let count = self.pairs.len() as f64;
        let largest = self.errors().map(|(t, _)| t.length()).fold(0.0, f64::max);
        let mean: f64 = self.errors().map(|(t, _)| t.length()).sum();
        let angle: f64 = self.errors().map(|(_, r)| r.length().to_degrees()).sum();
        [mean / count * 1e6, largest * 1e6, angle / count]
    }

    /// Root-mean-square error over σ of each axis.
    fn normalised(&self) -> [f64; 6] {
        let mut sums = [0.0; 6];
        for ((t, r), sigma) in self.errors().zip(&self.sigmas) {
            let error = [t.x, t.y, t.z, r.x, r.y, r.z];
            for k in 0..6 {
                sums[k] += (error[k] / sigma[k]).powi(2);
            }
        }
        sums.map(|sum| (sum / self.pairs.len() as f64).sqrt())
    }

    /// The same poses after the rigid transforms of base and tool that bring them nearest to the truth.
    fn aligned(&self) -> Self {
        let [x, y] = align(&self.pairs).expect("a tool that turns");
        let of = |truth: &Pose| {
            let rotation = x.rotation * truth.rotation * y.rotation.conjugate();
            let translation_m = x.translation_m + x.rotation * truth.translation_m - rotation * y.translation_m;
            Pose { rotation, translation_m }
        };
        let pairs = self.pairs.iter().map(|(found, truth)| (*found, of(truth))).collect();
        Self { pairs, sigmas: self.sigmas.clone() }
    }
}

#[test]
fn known_poses_calibrate_a_head_to_micrometres_with_honest_uncertainties() {
    let folder = TempDir::new().expect("a folder");
    for head in [1, 4] {
        let output = folder.path().join("head.toml");
        let said = calibrate(&["--known", &data(&format!("head_{head}_known.csv"))], &output);
        assert!(said.contains("poses left out in turn miss the instrument's by"), "{said}");
        let quiet = Solved::by(&output, &format!("head_{head}_quiet.csv"));
        let [mean, largest, angle] = quiet.distances();
        println!("head {head}: {mean:.2} µm, {largest:.1} µm, {angle:.4}°, {:.2?}", quiet.normalised());
        // What a laboratory was promised: all of four hundred poses; here are a hundred of them.
        assert!(mean <= 3.0 && largest <= 20.0 && angle <= 0.015, "head {head}: {mean} µm, {largest} µm, {angle}°");
        // The σ of a head's own constant errors is one draw for all poses: 0.8 to 1.25 asked of single frames is
        // asked of them then; of means of a hundred frames, which hardly have noise, half and one and a half.
        assert!(quiet.normalised().iter().all(|ratio| (0.5..1.5).contains(ratio)), "{:?}", quiet.normalised());
        if head == 1 {
            let frames = Solved::by(&output, "head_1_test.csv");
            // A hundred rows: the root mean square of a normal variable scatters by 7 %, beside the 0.8 to 1.25 of the model.
            let ratios = frames.normalised();
            assert!(ratios.iter().all(|ratio| (0.75..1.3).contains(ratio)), "{ratios:?}");
            let [mean, ..] = frames.distances();
            assert!((2.5..5.5).contains(&mean), "{mean} µm");
        }
    }
}

#[test]
fn fewer_poses_calibrate_less_well_and_a_later_file_goes_on_from_them() {
    let folder = TempDir::new().expect("a folder");
    let [few, all] = ["few.toml", "all.toml"].map(|name| folder.path().join(name));
    calibrate(&["--known", &part(&folder, "head_1_known.csv", 0, 50)], &few);
    let [fewer, ..] = Solved::by(&few, "head_1_quiet.csv").distances();
    assert!((1.5..=5.0).contains(&fewer), "{fewer} µm");
    let start = few.to_str().expect("UTF-8");
    calibrate(&["--known", &part(&folder, "head_1_known.csv", 50, 150), "--start", start], &all);
    let [mean, ..] = Solved::by(&all, "head_1_quiet.csv").distances();
    assert!(mean < 0.8 * fewer && mean <= 3.0, "{mean} µm after {fewer} µm");
}

#[test]
fn an_instrument_with_frames_of_its_own_calibrates_as_well_and_its_frames_are_found() {
    // Of the program that simulated the head: millimetres and radians.
    const INSTRUMENT_FROM_BASE: [f64; 6] = [
        6.526447243463368,
        -1.12873972288355,
        40.68502934019902,
        -0.08875909522921967,
        -0.27910495150140147,
        -0.14392921924830393,
    ];
    const TOOL_FROM_MARKER: [f64; 6] = [
        12.776243876165335,
        -18.523991864176605,
        -24.444079043301624,
        0.17581768923005855,
        -0.03476369337551624,
        0.12755202486490047,
    ];
    let folder = TempDir::new().expect("a folder");
    let output = folder.path().join("head.toml");
    let said = calibrate(&["--known", &data("head_1_own.csv"), "--frames", "own"], &output);
    assert!(said.contains("open: where the base and the tool frame lie"), "{said}");
    let [mean, largest, angle] = Solved::by(&output, "head_1_quiet.csv").aligned().distances();
    assert!(mean <= 3.0 && largest <= 20.0 && angle <= 0.015, "{mean} µm, {largest} µm, {angle}°");

    let calibration = slitpose_calibration::Calibration::open(&output).expect("a calibration");
    let [frames] = calibration.frames() else { panic!("{:?}", calibration.frames()) };
    let pose = |v: [f64; 6]| Pose {
        translation_m: DVec3::new(v[0], v[1], v[2]),
        rotation: rotation_exp(DVec3::new(v[3], v[4], v[5])),
    };
    let metres = |v: [f64; 6]| pose(std::array::from_fn(|k| if k < 3 { v[k] * 1e-3 } else { v[k] }));
    let instrument = metres(INSTRUMENT_FROM_BASE);
    let rotation = instrument.rotation.conjugate();
    let base = Pose { rotation, translation_m: -(rotation * instrument.translation_m) };
    for (found, sigma, truth) in [
        (frames.base_from_reference, frames.base_from_reference_sigma, base),
        (frames.tool_from_marker, frames.tool_from_marker_sigma, metres(TOOL_FROM_MARKER)),
    ] {
        let (t, r) = pose(found).displacement_from(&truth);
        for (error, sigma) in [t.x, t.y, t.z, r.x, r.y, r.z].into_iter().zip(sigma) {
            assert!(error.abs() <= 3.0 * sigma, "{found:?}: {error} of {sigma}");
        }
    }
}

#[test]
fn free_motion_alone_leaves_the_frames_and_the_scale_open_and_little_else() {
    let folder = TempDir::new().expect("a folder");
    let output = folder.path().join("head.toml");
    let said = calibrate(&["--free", &data("head_1_free.csv")], &output);
    for part in ["where the base and the tool frame lie", "the scale of translations", "--stage", "--known"] {
        assert!(said.contains(part), "`{part}` is not in: {said}");
    }
    let [mean, _, angle] = Solved::by(&output, "head_1_quiet.csv").aligned().distances();
    assert!(mean <= 20.0 && angle <= 0.1, "{mean} µm, {angle}°");
}

#[test]
fn an_instrument_that_follows_a_motion_by_its_own_clock_calibrates_a_head() {
    let folder = TempDir::new().expect("a folder");
    let at = |name: &str| name_in(folder.path(), name);
    let bench = ["bench", "wide", "--duration", "6s", "--poses", "1", "--seed", "3", "--output", &at("bench")];
    assert_eq!(slitpose!().run(bench).code, 0);
    let [scene, tracked, capture] = ["scene.toml", "tracked.csv", "free.mcap"].map(|name| at(&format!("bench/{name}")));
    let output = at("head.toml");
    let inputs = ["calibrate", &scene, "--known", &tracked, "--known-capture", &capture, "--frames", "own"];
    let finished = slitpose!().run(inputs.into_iter().chain(["--output", &output]));
    assert_eq!(finished.code, 0, "{}", finished.stderr);
    println!("{}", finished.stderr);
    let read =
        |name: &str| -> toml::Table { std::fs::read_to_string(at(name)).expect("a file").parse().expect("TOML") };
    let (found, truth) = (read("head.toml"), read("bench/truth/truth.toml"));
    let clock = found["clock"][0].as_table().expect("a clock");
    for (key, true_key) in [("ahead", "clock_ahead_s"), ("faster", "clock_faster")] {
        let number = |key: &str| clock[key].as_float().expect("a number");
        let key = if key == "ahead" { ["ahead_s", "ahead_sigma_s"] } else { ["faster", "faster_sigma"] };
        let [value, sigma] = key.map(number);
        let expected = truth["instrument"][true_key].as_float().expect("a number");
        // Four σ, and no more than microseconds: the motion is 20 mm/s fast, and measured to 2 µm 400 times.
        assert!((value - expected).abs() < 4.0 * sigma && sigma < 2e-5, "{value} ± {sigma}, truth {expected}");
    }
    let held_out_um = found["statistics"]["held_out_m"].as_float().expect("a number") * 1e6;
    assert!((1.0..8.0).contains(&held_out_um), "{held_out_um} µm");
    let more = slitpose!().run(inputs.into_iter().chain(["--known-capture", &capture, "--output", &at("none.toml")]));
    assert!(more.code == 1 && more.stderr.contains("one more than the tables of --known"), "{}", more.stderr);
    // The record of another motion is not taken.
    let other = ["bench", "wide", "--duration", "4s", "--poses", "1", "--seed", "4", "--output", &at("other")];
    assert_eq!(slitpose!().run(other).code, 0);
    let inputs = ["calibrate", &scene, "--known", &at("other/tracked.csv"), "--known-capture", &capture];
    let finished = slitpose!().run(inputs.into_iter().chain(["--frames", "own", "--output", &at("none.toml")]));
    assert!(finished.code == 1 && finished.stderr.contains("its motion is not that of"), "{}", finished.stderr);
}
