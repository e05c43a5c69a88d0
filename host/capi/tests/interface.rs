//! Callers of the library: their poses are those of the other programs, bit for bit, and what they do wrong has a name.

use std::f64::consts::TAU;
use std::ffi::{CStr, CString, c_char};
use std::io::Write;
use std::mem::MaybeUninit;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::ptr::null;

use slitpose_calibration::{Head, Request, calibrate};
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_model::{CompiledScene, Pair, Pose, Solution, Tier};
use slitpose_solver::*;
use slitpose_tracking::measurements::Measurements;
use slitpose_tracking::pipeline::PipelineOptions;
use slitpose_tracking::solving::{self, RowSolver};
use tempfile::TempDir;

const TIER: Tier = Tier::Exact { tolerance: 1e-6 };
const RATE_HZ: f64 = 1000.0;
const PERIOD_NS: u64 = 1_000_000;

const SCENE: &str = "nominal.toml";
const CALIBRATION: &str = "calibration.toml";

/// Currents of `frames` frames of a tool that moves, with deviations as large as noise.
fn rows(file: &SceneFile, frames: usize) -> Vec<Vec<f64>> {
    let plan = CompiledScene::<f64>::compile(&file.scene, TIER).unwrap();
    let row = |frame: usize| {
        let phase = TAU * frame as f64 / 250.0;
        let t = 1e-3 * glam::DVec3::new(phase.sin(), (0.7 * phase).cos(), 0.5 * (1.3 * phase).sin());
        let pose = Pose::from_vectors(t, 0.1 * glam::DVec3::new(phase.cos(), 0.0, phase.sin()));
        let currents = (0..plan.cell_count()).flat_map(|cell| {
            let Pair { i_x1_a, i_x2_a } = plan.respond(cell, &pose).currents;
            [i_x1_a, i_x2_a]
        });
        currents.enumerate().map(|(k, a)| a * (1.0 + 2e-5 * ((frame * 12 + k) as f64).sin())).collect()
    };
    (0..frames).map(row).collect()
}

fn pairs(row: &[f64]) -> impl Iterator<Item = Option<Pair<f64>>> {
    row.as_chunks::<2>().0.iter().map(|&[i_x1_a, i_x2_a]| Some(Pair { i_x1_a, i_x2_a }))
}

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/heads").join(name)
}

/// A head with the calibration that measurements of `tests/data/heads` give, and its file.
fn calibrated(folder: &TempDir) -> (Head, PathBuf) {
    let file = SceneFile::open(data(SCENE).to_str().unwrap()).unwrap();
    // Some of the rows: all take half a minute.
    let text = std::fs::read_to_string(data("head_1_known.csv")).unwrap();
    let some = folder.path().join("known.csv");
    std::fs::write(&some, text.lines().take(31).collect::<Vec<_>>().join("\n")).unwrap();
    let known = vec![some.to_str().unwrap().to_owned()];
    let measurements = Measurements { known, known_sigmas: Some([2e-6, 20e-6]), ..Measurements::default() };
    let data = measurements.read(&file, &mut |_| ()).unwrap();
    let request = Request { file: &file, data: &data, start: None, date: None };
    let found = calibrate(&request, &mut |_| ControlFlow::Continue(())).unwrap().calibration;
    let path = folder.path().join(CALIBRATION);
    std::fs::write(&path, found.source()).unwrap();
    (Head::open_calibrated(file, &path).unwrap(), path)
}

fn c_text(path: &Path) -> CString {
    CString::new(path.to_str().unwrap()).unwrap()
}

/// The solver of a scene and a calibration, or why there is none.
fn open(scene: Option<&CStr>, calibration: Option<&CStr>) -> Result<*mut Solver, String> {
    let mut error = [0; 300];
    let pointer = |text: Option<&CStr>| text.map_or(null(), CStr::as_ptr);
    let solver = unsafe { slitpose_solver_open(pointer(scene), pointer(calibration), error.as_mut_ptr(), error.len()) };
    if solver.is_null() { Err(said(&error)) } else { Ok(solver) }
}

fn said(buffer: &[c_char]) -> String {
    unsafe { CStr::from_ptr(buffer.as_ptr()) }.to_str().unwrap().to_owned()
}

fn error_of(solver: *const Solver) -> String {
    let mut error = [0; 300];
    unsafe { slitpose_solver_error(solver, error.as_mut_ptr(), error.len()) };
    said(&error)
}

fn solve(solver: *mut Solver, row: &[f64]) -> Result<PoseSolution, ErrorCode> {
    let mut found = MaybeUninit::uninit();
    match unsafe { slitpose_solver_solve(solver, row.as_ptr(), row.len(), found.as_mut_ptr()) } {
        ErrorCode::Ok => Ok(unsafe { found.assume_init() }),
        code => Err(code),
    }
}

fn track(solver: *mut Solver, time_ns: u64, row: &[f64]) -> Result<PoseSolution, ErrorCode> {
    let mut found = MaybeUninit::uninit();
    match unsafe { slitpose_solver_track(solver, time_ns, row.as_ptr(), row.len(), found.as_mut_ptr()) } {
        ErrorCode::Ok => Ok(unsafe { found.assume_init() }),
        code => Err(code),
    }
}

fn assert_same(found: &PoseSolution, expected: &Solution) {
    let estimate = expected.estimate.expect("a pose");
    assert_eq!(found.translation_m, estimate.pose.translation_m.to_array());
    assert_eq!(found.rotation_xyzw, estimate.pose.rotation.to_array());
    assert_eq!(found.covariance, estimate.covariance.as_flattened());
    assert_eq!((found.chi2, usize::from(found.redundancy)), (expected.chi2, expected.redundancy));
    assert_eq!(usize::from(found.cells_used), expected.cells_used.count());
    assert_eq!((found.has_pose, found.status), (1, 0), "{:?}", expected.outcome);
}

#[test]
fn rows_and_frames_of_a_calibrated_head_are_those_of_the_other_programs_and_allocate_nothing() {
    let folder = TempDir::new().unwrap();
    let (head, calibration) = calibrated(&folder);
    let rows = rows(&head.file, 200);
    let solver = open(Some(&c_text(&data(SCENE))), Some(&c_text(&calibration))).unwrap();
    let by_row = RowSolver::new(head.clone(), TIER, false).unwrap();
    let ready = by_row.with_frames(1.0).unwrap();
    // One cell after another, around the instant of the frame.
    let exposures_s: Vec<f64> = (0..6).map(|cell| 1e-4 * (f64::from(cell) - 2.5)).collect();
    let options = PipelineOptions::default();
    let mut tracker = solving::tracker(&head, &head.file.scene, TIER, options, &exposures_s, RATE_HZ.recip()).unwrap();
    assert_eq!(unsafe { slitpose_solver_start(solver, RATE_HZ, exposures_s.as_ptr(), 6) }, ErrorCode::Ok);
    let mut found = Vec::with_capacity(2 * rows.len());
    let info = allocation_counter::measure(|| {
        for (frame, row) in (0..).zip(&rows) {
            found.push(solve(solver, row).unwrap());
            // By a clock that jitters, and goes a little fast.
            let time_ns = 7_000_000 + frame * (PERIOD_NS + 500) + frame % 3 * PERIOD_NS / 8;
            found.push(track(solver, time_ns, row).unwrap());
        }
    });
    assert_eq!(info.count_total, 0);
    for (frame, row) in (0..).zip(&rows) {
        assert_same(&found[2 * frame], &ready.solve(&ready.readings(pairs(row))));
        let mut tracked = tracker.track(frame as u64, &solving::readings(&head, pairs(row)));
        head.complete_tracked(&mut tracked);
        let found = &found[2 * frame + 1];
        assert_same(found, &tracked.solution);
        assert_eq!(found.has_twist != 0, tracked.twist.is_ok());
        if let Ok(moving) = &tracked.twist {
            assert_eq!(found.linear_m_per_s, moving.twist.linear_m_per_s.to_array());
            assert_eq!(found.angular_rad_per_s, moving.twist.angular_rad_per_s.to_array());
            assert_eq!(found.twist_sigma, std::array::from_fn(|i| moving.covariance[i][i].sqrt()));
        }
    }
    let (first, last) = (found[1], found[399]);
    assert_eq!((first.has_twist, first.no_twist, last.has_twist, last.no_twist), (0, 1, 1, 0));
    // As at the beginning.
    let mut again = None;
    let info = allocation_counter::measure(|| {
        assert_eq!(unsafe { slitpose_solver_reset(solver) }, ErrorCode::Ok);
        again = track(solver, 0, &rows[0]).ok();
    });
    let again = again.unwrap();
    assert_eq!((info.count_total, again.translation_m, again.covariance), (0, first.translation_m, first.covariance));
    unsafe { slitpose_solver_close(solver) };
}

#[test]
fn what_is_wrong_is_named_and_allocates_nothing() {
    let refused = |scene, calibration| open(scene, calibration).unwrap_err();
    assert_eq!(refused(None, None), "the scene is NULL; give its path");
    assert_eq!(refused(Some(c"\xff"), None), "the path of the scene is not UTF-8; give it as UTF-8");
    let missing = refused(Some(c"missing.toml"), None);
    assert!(missing.contains("missing.toml"), "{missing}");
    let no_calibration = refused(Some(c"wide"), Some(&c_text(&data(SCENE))));
    assert!(no_calibration.contains(SCENE) && no_calibration.contains("slitpose calibrate"), "{no_calibration}");
    unsafe {
        // Nowhere to say it.
        assert!(slitpose_solver_open(null(), null(), std::ptr::null_mut(), 0).is_null());
        assert!(slitpose_solver_open(c"missing.toml".as_ptr(), null(), std::ptr::null_mut(), 9).is_null());
        slitpose_solver_close(std::ptr::null_mut());
        assert_eq!(slitpose_solver_cells(null()), 0);
        assert_eq!(slitpose_solver_reset(std::ptr::null_mut()), ErrorCode::Null);
        assert_eq!(slitpose_solution_predict(std::ptr::null_mut(), 1, 0.0, 0.0), ErrorCode::Null);
    }
    assert_eq!(error_of(null()), "the solver is NULL; open one");

    let file = WIDE.read().unwrap();
    let row = &rows(&file, 1)[0];
    let solver = open(Some(c"wide"), None).unwrap();
    let mut name = [0; 3];
    // Cut off where the buffer ends.
    assert_eq!(unsafe { slitpose_solver_name(solver, name.as_mut_ptr(), 3) }, file.name.len());
    assert_eq!((said(&name), unsafe { slitpose_solver_cells(solver) }), (file.name[..2].to_owned(), 6));
    let assert_refused = |code, result: Result<PoseSolution, ErrorCode>, text: &str| {
        assert_eq!((result.map(|_| ()), error_of(solver).as_str()), (Err(code), text));
    };
    let time = "the frame at 1000000 ns is less than half a period after the one at 1000000 ns; give later instants, or \
                call slitpose_solver_reset() first";
    let started = "no frame rate is known; call slitpose_solver_start() first";
    assert_refused(ErrorCode::NotStarted, track(solver, 0, row), started);
    assert_refused(ErrorCode::Count, solve(solver, &row[1..]), "11 currents_a for 6 cells; give 12");
    let mut dark = row.clone();
    dark[3] = f64::NAN;
    let nan = "current I_X2 of cell 1 is NaN; give amperes, 0 for a cell that was not measured";
    assert_refused(ErrorCode::NotFinite, solve(solver, &dark), nan);
    let start = |rate_hz, exposures_s: &[f64]| unsafe {
        slitpose_solver_start(solver, rate_hz, exposures_s.as_ptr(), exposures_s.len())
    };
    assert_eq!((start(0.0, &[0.0; 6]), start(f64::NAN, &[0.0; 6])), (ErrorCode::Range, ErrorCode::NotFinite));
    assert_eq!(error_of(solver), "rate_hz = NaN; give 1 to 1000000 Hz");
    assert_eq!((start(RATE_HZ, &[0.0; 5]), start(RATE_HZ, &[1.0; 6])), (ErrorCode::Count, ErrorCode::Range));
    assert_eq!(unsafe { slitpose_solver_start(solver, RATE_HZ, null(), 0) }, ErrorCode::Ok);
    assert!(track(solver, 1_000_000, row).is_ok());
    let info = allocation_counter::measure(|| {
        assert_eq!(track(solver, 1_000_000, row).unwrap_err(), ErrorCode::Time);
        let nowhere = std::ptr::null_mut();
        assert_eq!(unsafe { slitpose_solver_solve(solver, row.as_ptr(), 12, nowhere) }, ErrorCode::Null);
        assert_eq!(unsafe { slitpose_solver_solve(solver, null(), 12, nowhere) }, ErrorCode::Null);
    });
    assert_eq!(info.count_total, 0);
    assert_refused(ErrorCode::Time, track(solver, 1_000_000, row), time);

    // A cell without light is left out; three without any leave too few.
    dark[2..4].fill(0.0);
    let mut found = solve(solver, &dark).unwrap();
    assert_eq!((found.status, found.reason, found.cells_used), (1, 1, 5));
    let predict = |found: &mut _, rms| unsafe { slitpose_solution_predict(found, 1, rms, 0.0) };
    assert_eq!(predict(&mut found, 0.0), ErrorCode::NoTwist);
    assert_eq!(
        (predict(&mut found, f64::INFINITY), predict(&mut found, -1.0)),
        (ErrorCode::NotFinite, ErrorCode::Range)
    );
    dark[4..].fill(0.0);
    let found = solve(solver, &dark).unwrap();
    assert_eq!((found.status, found.has_pose), (4, 0));
    assert!(found.translation_m.iter().chain(&found.covariance).all(|number| number.is_nan()));
    unsafe { slitpose_solver_close(solver) };
}

/// The folder where cargo has put the library: that of this program.
fn built() -> PathBuf {
    std::env::current_exe().unwrap().parent().unwrap().to_owned()
}

/// A program in C, with the library as users find it once it is installed: the shared or the static one.
fn compile(source: &str, folder: &TempDir, is_shared: bool) -> PathBuf {
    let host = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let (prefix, program) = (folder.path().join("local"), folder.path().join(format!("program_{is_shared}")));
    let lib = prefix.join("lib");
    done(Command::new(host.join("capi/install")).arg(built()).env("PREFIX", &prefix));
    let mut asked = Command::new("pkg-config");
    asked.args(["--cflags", "--libs", "slitpose-solver"]).env("PKG_CONFIG_PATH", lib.join("pkgconfig"));
    let flags = done(&mut asked);
    let mut command = Command::new("cc");
    command.args(["-O2", "-Wall", "-Wextra", "-Werror", "-pedantic", "-std=c11", "-I"]).arg(host.join("include"));
    command.arg("-o").arg(&program).arg(host.join(source));
    if is_shared {
        command.args(flags.split_whitespace()).arg(format!("-Wl,-rpath,{}", lib.display()));
    } else {
        command.arg("-I").arg(prefix.join("include")).arg(lib.join("libslitpose_solver.a"));
    }
    done(command.args(["-lm", "-lpthread", "-ldl"]));
    program
}

fn done(command: &mut Command) -> String {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn a_program_in_c_finds_the_same_poses() {
    let folder = TempDir::new().unwrap();
    let rows = rows(&WIDE.read().unwrap(), 50);
    let line = |row: &Vec<f64>| row.iter().map(|a| format!("{a:e} ")).collect::<String>() + "\n";
    let input: String = rows.iter().map(line).collect();
    let solver = open(Some(c"wide"), None).unwrap();
    assert_eq!(unsafe { slitpose_solver_start(solver, RATE_HZ, null(), 0) }, ErrorCode::Ok);
    for (is_shared, rate) in [(true, None), (true, Some("1000")), (false, Some("1000"))] {
        let program = compile("examples/c/solve_currents.c", &folder, is_shared);
        let mut command = Command::new(program);
        command.args(["wide", "-"]).args(rate).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        child.stdin.take().unwrap().write_all(input.as_bytes()).unwrap();
        let output = child.wait_with_output().unwrap();
        assert!(output.status.success());
        let text = String::from_utf8(output.stdout).unwrap();
        assert_eq!(text.lines().count(), rows.len());
        assert_eq!(unsafe { slitpose_solver_reset(solver) }, ErrorCode::Ok);
        for (frame, (line, row)) in (0..).zip(text.lines().zip(&rows)) {
            let numbers: Vec<f64> = line.split(' ').filter_map(|word| word.parse().ok()).collect();
            let found =
                if rate.is_some() { track(solver, frame * PERIOD_NS, row) } else { solve(solver, row) }.unwrap();
            let mut expected = vec![f64::from(found.cells_used)];
            expected.extend(found.translation_m.iter().chain(&found.rotation_xyzw).chain([&found.chi2]));
            expected.extend(found.linear_m_per_s.iter().filter(|v| v.is_finite()));
            assert_eq!(numbers, expected, "{line}");
        }
    }
    unsafe { slitpose_solver_close(solver) };
    let output = Command::new(folder.path().join("program_true")).args(["none.toml", "-"]).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("none.toml"), "{output:?}");
}

#[test]
fn predictions_are_those_of_the_header_for_the_daemons_poses() {
    let folder = TempDir::new().unwrap();
    let program = compile("capi/tests/predict.c", &folder, true);
    assert!(Command::new(program).status().unwrap().success());
}
