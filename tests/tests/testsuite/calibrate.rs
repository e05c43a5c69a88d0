//! Calibration of simulated heads whose physics is richer than the model, and with data that are not what they are said to
//! be.

use std::f64::consts::TAU;
use std::fmt::Write;
use std::path::Path;

use glam::DVec3;
use slitpose_calibration::{Knowledge, align};
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_model::{CompiledScene, Pose, Tier};
use slitpose_tests::poses::pose;
use slitpose_tests::process::{name_in, text, written};
use slitpose_tests::slitpose;
use slitpose_tests::table::{POSE, SIGMA, Table, with_changed};
use slitpose_tracking::capture::{CaptureReader, CaptureSeries, Entry, Existing, Limits};
use slitpose_tracking::link::Segment;
use slitpose_tracking::measurements::Measurements;
use tempfile::TempDir;

/// The path of a file of the heads.
pub(super) fn data(name: &str) -> String {
    text(&slitpose_tests::table::data("heads").join(name)).to_owned()
}

/// The first `rows` rows of a file of the heads, those before `skip` left out.
fn part(folder: &TempDir, name: &str, skip: usize, rows: usize) -> String {
    let text = std::fs::read_to_string(data(name)).expect("a table");
    let mut lines = text.lines();
    let header = lines.next().expect("a header");
    let kept: Vec<&str> = std::iter::once(header).chain(lines.skip(skip).take(rows)).collect();
    written(folder.path(), &format!("{skip}-{rows}-{name}"), kept.join("\n") + "\n")
}

/// Calibrates; what it says on standard error.
fn calibrate(arguments: &[&str], output: &Path) -> String {
    let scene = data("nominal.toml");
    let fixed = ["calibrate", &scene, "--output", output.to_str().expect("UTF-8")];
    let finished = slitpose!().run(fixed.iter().chain(arguments));
    assert_eq!(finished.code, 0, "{}", finished.stderr);
    finished.stderr
}

/// Poses solved with a calibration, and true ones.
struct Solved {
    pairs: Vec<(Pose, Pose)>,
    sigmas: Vec<[f64; 6]>,
    statuses: Vec<String>,
}

/// The table `test` with all currents multiplied by `level`, in `folder`.
fn dimmed(folder: &TempDir, test: &str, level: f64) -> String {
    let text = std::fs::read_to_string(data(test)).expect("a table");
    let dimmed = with_changed(&text, |name| name.starts_with("i_x"), |current| level * current);
    written(folder.path(), &format!("{level}.csv"), dimmed)
}

impl Solved {
    fn by(calibration: &Path, currents: &str) -> Self {
        let (scene, currents) = (data("nominal.toml"), currents.to_owned());
        let path = calibration.to_str().expect("UTF-8");
        let table = slitpose!().run(["solve", &scene, "--currents", &currents, "--calibration", path]).done();
        let table = Table::parse(&table);
        let truths = Table::parse(&std::fs::read_to_string(&currents).expect("a table"));
        let mut solved = Self { pairs: Vec::new(), sigmas: Vec::new(), statuses: Vec::new() };
        for (row, truth) in table.rows().zip(truths.rows()) {
            solved.pairs.push((pose(row.numbers(POSE)), pose(truth.numbers(POSE))));
            solved.statuses.push(row.text("status").to_owned());
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
        Self { pairs, sigmas: self.sigmas.clone(), statuses: self.statuses.clone() }
    }
}

#[test]
fn known_poses_calibrate_a_head_to_micrometres_with_honest_uncertainties() {
    let folder = TempDir::new().expect("a folder");
    for head in [1, 4] {
        let output = folder.path().join("head.toml");
        let said = calibrate(&["--known", &data(&format!("head_{head}_known.csv"))], &output);
        assert!(said.contains("poses left out in turn miss the instrument's by"), "{said}");
        let quiet = Solved::by(&output, &data(&format!("head_{head}_quiet.csv")));
        let [mean, largest, angle] = quiet.distances();
        println!("head {head}: {mean:.2} µm, {largest:.1} µm, {angle:.4}°, {:.2?}", quiet.normalised());
        // What a laboratory was promised: all of four hundred poses; here are a hundred of them.
        assert!(mean <= 3.0 && largest <= 20.0 && angle <= 0.015, "head {head}: {mean} µm, {largest} µm, {angle}°");
        // The σ of a head's own constant errors is one draw for all poses: 0.8 to 1.25 asked of single frames is
        // asked of them then; of means of a hundred frames, which hardly have noise, half and one and a half.
        assert!(quiet.normalised().iter().all(|ratio| (0.5..1.5).contains(ratio)), "{:?}", quiet.normalised());
        // Sound cells are hardly ever left out of a mean, wherever light lies on their detectors: of 3 in 2000 of five heads.
        let doubtful = quiet.statuses.iter().filter(|status| *status != "converged").count();
        assert!(doubtful <= 1, "head {head}: {doubtful}");
        if head == 1 {
            let frames = Solved::by(&output, &data("head_1_test.csv"));
            // A hundred rows: the root mean square of a normal variable scatters by 7 %, beside the 0.8 to 1.25 of the model.
            let ratios = frames.normalised();
            assert!(ratios.iter().all(|ratio| (0.75..1.3).contains(ratio)), "{ratios:?}");
            let [mean, ..] = frames.distances();
            // 4.3 µm is the bound of a known light level, 4.9 that of an unknown one.
            assert!((2.5..6.0).contains(&mean), "{mean} µm");
            for level in [0.998, 0.995, 0.92, 1.02] {
                // The head as it is after its lamps have warmed or cooled: as good, but for less light in the same noise.
                let dimmed = Solved::by(&output, &dimmed(&folder, "head_1_test.csv", level));
                let [mean_then, ..] = dimmed.distances();
                println!("level {level}: {mean_then:.2} µm of {mean:.2}, {:.2?}", dimmed.normalised());
                assert!(mean_then < 1.05 / level.min(1.0) * mean, "{level}: {mean_then} µm, not {mean}");
                assert!(dimmed.normalised().iter().all(|ratio| (0.75..1.3).contains(ratio)), "{level}");
            }
        }
    }
}

#[test]
fn fewer_poses_calibrate_less_well_and_a_later_file_goes_on_from_them() {
    let folder = TempDir::new().expect("a folder");
    let [few, all] = ["few.toml", "all.toml"].map(|name| folder.path().join(name));
    calibrate(&["--known", &part(&folder, "head_1_known.csv", 0, 50)], &few);
    let [fewer, ..] = Solved::by(&few, &data("head_1_quiet.csv")).distances();
    assert!((1.5..=5.0).contains(&fewer), "{fewer} µm");
    let start = few.to_str().expect("UTF-8");
    calibrate(&["--known", &part(&folder, "head_1_known.csv", 50, 150), "--start", start], &all);
    let [mean, ..] = Solved::by(&all, &data("head_1_quiet.csv")).distances();
    assert!(mean < 0.8 * fewer && mean <= 3.0, "{mean} µm after {fewer} µm");
}

#[test]
fn an_instrument_with_frames_of_its_own_calibrates_as_well_and_its_frames_are_found() {
    // Of the program that simulated the head: millimetres and radians, to a thousandth of what is known of them.
    const INSTRUMENT_FROM_BASE: [f64; 6] = [6.526447, -1.128740, 40.685029, -0.08875910, -0.27910495, -0.14392922];
    const TOOL_FROM_MARKER: [f64; 6] = [12.776244, -18.523992, -24.444079, 0.17581769, -0.03476369, 0.12755202];
    let folder = TempDir::new().expect("a folder");
    let output = folder.path().join("head.toml");
    let said = calibrate(&["--known", &data("head_1_own.csv"), "--frames", "own"], &output);
    assert!(said.contains("open: where the base and the tool frame lie"), "{said}");
    let [mean, largest, angle] = Solved::by(&output, &data("head_1_quiet.csv")).aligned().distances();
    assert!(mean <= 3.0 && largest <= 20.0 && angle <= 0.015, "{mean} µm, {largest} µm, {angle}°");

    let calibration = slitpose_calibration::Calibration::open(&output).expect("a calibration");
    let [frames] = &calibration.frames[..] else { panic!("{:?}", calibration.frames) };
    let instrument = pose(INSTRUMENT_FROM_BASE);
    let rotation = instrument.rotation.conjugate();
    let base = Pose { rotation, translation_m: -(rotation * instrument.translation_m) };
    for (found, sigma, truth) in [
        (frames.base_from_reference, frames.base_from_reference_sigma, base),
        (frames.tool_from_marker, frames.tool_from_marker_sigma, pose(TOOL_FROM_MARKER)),
    ] {
        let in_millimetres = std::array::from_fn(|k| if k < 3 { found[k] * 1e3 } else { found[k] });
        let (t, r) = pose(in_millimetres).displacement_from(&truth);
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
    let [mean, _, angle] = Solved::by(&output, &data("head_1_quiet.csv")).aligned().distances();
    assert!(mean <= 20.0 && angle <= 0.1, "{mean} µm, {angle}°");
}

/// A table of known poses that can be spoilt: pose, and both currents of each cell.
#[derive(Clone)]
struct Known {
    header: String,
    rows: Vec<([f64; 6], [[f64; 2]; 6])>,
}

impl Known {
    fn read() -> Self {
        // Half of them is enough, and half as slow.
        Self::read_every(2)
    }

    fn read_every(step: usize) -> Self {
        let text = std::fs::read_to_string(data("head_1_known.csv")).expect("a table");
        let row = |line: &str| {
            let numbers: Vec<f64> = line.split(',').map(|field| field.parse().expect("a number")).collect();
            let pose = std::array::from_fn(|k| numbers[1 + k]);
            (pose, std::array::from_fn(|cell| [numbers[7 + 2 * cell], numbers[8 + 2 * cell]]))
        };
        let (header, rows) = text.split_once('\n').expect("rows");
        Self { header: header.to_owned(), rows: rows.lines().step_by(step).map(row).collect() }
    }

    fn spoilt(mut self, spoil: impl FnMut(&mut ([f64; 6], [[f64; 2]; 6]))) -> Self {
        self.rows.iter_mut().for_each(spoil);
        self
    }

    fn write(&self, folder: &TempDir) -> String {
        let mut text = format!("{}\n", self.header);
        for (id, (pose, cells)) in self.rows.iter().enumerate() {
            let _ = write!(text, "{id}");
            pose.iter().chain(cells.as_flattened()).for_each(|value| {
                let _ = write!(text, ",{value:e}");
            });
            text += ",16\n";
        }
        written(folder.path(), "wrong.csv", text)
    }

    /// Exit code and standard error.
    fn calibrate(&self, scene: &str, arguments: &[&str]) -> (i32, String) {
        let folder = TempDir::new().expect("a folder");
        let (table, output) = (self.write(&folder), name_in(folder.path(), "head.toml"));
        let fixed = ["calibrate", scene, "--known", &table, "--output", &output];
        let finished = slitpose!().run(fixed.iter().chain(arguments));
        assert_eq!(finished.code == 0, Path::new(&output).exists(), "a file exactly if something was learnt");
        (finished.code, finished.stderr)
    }
}

#[test]
fn wrong_data_are_recognised_and_named() {
    let known = Known::read();
    let few_millimetres = |row: &mut ([f64; 6], _)| row.0 = row.0.map(|value| 0.01 * value);
    // Angles of degrees that could be radians.
    let mut little = Known::read_every(1);
    let is_little = |pose: &[f64; 6]| pose[3..].iter().all(|angle| angle.to_degrees().abs() < TAU);
    little.rows.retain(|(pose, _)| is_little(pose));
    let in_degrees = |row: &mut ([f64; 6], _)| row.0[3..].iter_mut().for_each(|angle| *angle = angle.to_degrees());
    // Other lengths, inverted poses and shifted rows are cases of the crate of calibrations; one of them comes this way, too.
    let metres = |row: &mut ([f64; 6], _)| row.0[..3].iter_mut().for_each(|value| *value *= 1e-3);
    let dead = |row: &mut (_, [[f64; 2]; 6])| row.1[3] = [1e-9; 2];
    let cases: [(&str, Known, &[&str]); 7] = [
        ("little motion", known.clone().spoilt(few_millimetres), &["too little to tell parts apart"]),
        ("a dead cell", known.clone().spoilt(dead), &["cell 3 sees no light", "in 100 of 100 rows"]),
        ("electrodes", known.clone().spoilt(|row| row.1[2].swap(0, 1)), &["electrodes of cell 2", "i_x1_2_a"]),
        ("cells", known.clone().spoilt(|row| row.1.swap(1, 2)), &["cell 1 look like those of cell 2"]),
        ("metres", known.clone().spoilt(metres), &["tx_mm, ty_mm and tz_mm are millimetres", "are these metres?"]),
        ("degrees", known.clone().spoilt(in_degrees), &["row 1", "column `rx_rad`", "are these degrees?"]),
        ("degrees within a turn", little.spoilt(in_degrees), &["radians, but are these degrees?"]),
    ];
    for (case, table, parts) in cases {
        let (code, said) = table.calibrate(&data("nominal.toml"), &[]);
        assert_eq!(code, 1, "{case}: {said}");
        for part in parts {
            assert!(said.contains(part), "{case}: `{part}` is not in: {said}");
        }
    }
}

/// A stage that does not turn tells something, and the calibration says what it leaves open.
#[test]
fn translations_alone_calibrate_what_they_tell_and_a_row_counts_once() {
    let file = SceneFile::open(&data("nominal.toml")).expect("a scene");
    let plan = CompiledScene::<f64>::compile(&file.scene, Tier::Paper).expect("a head");
    let mut known = Known::read().spoilt(|row| {
        row.0[3..].fill(0.0);
        for (cell, pair) in row.1.iter_mut().enumerate() {
            let currents = plan.photocurrents(cell, &pose(row.0));
            *pair = [currents.i_x1_a, currents.i_x2_a];
        }
    });
    let (code, said) = known.calibrate(&data("nominal.toml"), &[]);
    assert!(code == 0 && said.contains("open: "), "{said}");

    let first = known.rows[0];
    known.rows.push(first);
    let (code, said) = known.calibrate(&data("nominal.toml"), &[]);
    let row = format!("row {} repeats an earlier one", known.rows.len());
    assert!(code == 1 && said.contains(&row), "{said}");
}

/// Without an instrument nothing tells which cell is wrong, and the errors that are left could pass for those of the model.
#[test]
fn free_motion_with_readings_that_are_not_the_cells_own_is_refused() {
    let text = std::fs::read_to_string(data("head_1_free.csv")).expect("a table");
    let (header, rows) = text.split_once('\n').expect("rows");
    let rows: Vec<Vec<&str>> = rows.lines().map(|row| row.split(',').collect()).collect();
    let column = |cell: usize, electrode: usize| 2 + 2 * cell + electrode;
    let mut exchanged_electrodes = rows.clone();
    let mut late_cell = rows.clone();
    for (row, fields) in rows.iter().enumerate() {
        for electrode in 0..2 {
            late_cell[row][column(4, electrode)] = rows[(row + 50) % rows.len()][column(4, electrode)];
        }
        exchanged_electrodes[row].swap(column(3, 0), column(3, 1));
        assert_eq!(fields.len(), column(6, 0));
    }
    let folder = TempDir::new().expect("a folder");
    let output = name_in(folder.path(), "head.toml");
    for (rows, cell) in [(exchanged_electrodes, " of cell 3"), (late_cell, " of cell 4")] {
        let rows: Vec<String> = rows.iter().map(|row| row.join(",")).collect();
        let table = written(folder.path(), "free.csv", format!("{header}\n{}\n", rows.join("\n")));
        let finished = slitpose!().run(["calibrate", &data("nominal.toml"), "--free", &table, "--output", &output]);
        let said = finished.stderr;
        assert!(finished.code == 1 && said.contains("no head within the tolerances") && said.contains(cell), "{said}");
        assert!(!Path::new(&output).exists());
    }
}

#[test]
fn a_head_that_never_tells_a_pose_is_sent_to_known_poses_alone() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let rows: String = (0..50).map(|row| format!("{row},{}e-6,2e-6\n", 1.0 + 0.02 * f64::from(row))).collect();
    let free = written(folder.path(), "free.csv", "id,i_x1_0_a,i_x2_0_a\n".to_owned() + &rows);
    let output = name_in(folder.path(), "head.toml");
    let calibrated = slitpose!().run(["calibrate", "bench", "--free", &free, "--output", &output]);
    calibrated.assert_refused(1, &["fewer than three cells", "can only be calibrated by poses", "(--known)"]);
}

#[test]
fn another_scene_is_recognised() {
    let (code, said) = Known::read().calibrate("base", &[]);
    assert!(code == 1 && said.contains("do not belong to this scene") && said.contains("tolerances explain"), "{said}");
    let (code, said) = Known::read().calibrate("bench", &[]);
    assert!(code == 1 && said.contains("currents of a cell 1, the scene has the cells 0 to 0"), "{said}");
}

/// A stage stands at 0, 1 and 2 mm for a second each, and takes 0.2 s from one to the next.
#[test]
fn steps_and_stops_of_a_capture_are_read_at_its_notes() {
    let folder = TempDir::new().expect("a folder");
    let motion = "time_s,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad\n0,0,0,0,0,0,0\n1,0,0,0,0,0,0\n1.2,1,0,0,0,0,0\n\
                  2.2,1,0,0,0,0,0\n2.4,2,0,0,0,0,0\n3.4,2,0,0,0,0,0\n";
    let [bare, noted] = ["bare.mcap", "noted.mcap"].map(|name| name_in(folder.path(), name));
    let motion = written(folder.path(), "motion.csv", motion);
    slitpose!().run(["simulate", "--trajectory", &motion, "--duration", "3.4s", "--output", &bare]).done();
    let mut reader = CaptureReader::open(Path::new(&bare)).expect("a capture");
    let (limits, mut segment) = (Limits::default(), Segment::default());
    let mut series = CaptureSeries::create(Path::new(&noted), limits, Existing::Kept).expect("a capture");
    while let Some(entry) = reader.next(&mut segment).expect("an entry") {
        match entry {
            Entry::Setup(setup) => series.add_device(*setup, None, 0).expect("a board"),
            Entry::Link { device: Some(device), log_ns } => series.segment(device, &segment, log_ns).expect("room"),
            _ => {}
        }
    }
    let notes = [
        (900, "step 0 mm"),
        (1100, "step 0.5 mm"),
        (2100, "step 1 mm"),
        (3300, "step 2e0 mm "),
        (3300, "a fly"),
        (9000, "step 3 mm"),
        (1900, "stop"),
    ];
    for (at_ms, text) in notes {
        series.note(at_ms * 1_000_000, text, 3_400_000_000).expect("room");
    }
    series.finish().expect("an end");
    let file = WIDE.read().expect("a scene");
    let read = |measurements: Measurements| {
        let mut said = Vec::new();
        let data = measurements.read(&file, &mut |remark| said.push(remark.to_owned()));
        (data.map(|data| data.rows), said.join("\n"))
    };
    let (rows, said) = read(Measurements { stage: vec![noted.clone()], ..Measurements::default() });
    let rows = rows.expect("steps");
    let steps: Vec<Knowledge> = rows.iter().map(|row| row.knowledge).collect();
    assert_eq!(steps, [0.0, 1e-3, 2e-3].map(Knowledge::Step));
    // A quarter of a second at 4 kHz, in packets of some scans.
    assert!(rows.iter().all(|row| (900.0..=1001.0).contains(&row.frames)), "{rows:?}");
    assert!(said.contains("the tool moved at the note `step 0.5 mm`; left out"), "{said}");
    assert!(said.contains("no frames at the note `step 3 mm`; left out"), "{said}");
    let (rows, _) = read(Measurements { rest: vec![noted], ..Measurements::default() });
    assert_eq!(rows.expect("a stop").len(), 1);
    let (rows, _) = read(Measurements { stage: vec![bare], ..Measurements::default() });
    let error = rows.expect_err("nothing says where it stood").to_string();
    assert!(error.contains("bare.mcap has no note such as `step 1.25 mm`"), "{error}");
}
