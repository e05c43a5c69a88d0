//! The header follows from the sources, and programs in C find the poses of the other programs, bit for bit.
#![allow(clippy::unwrap_used, reason = "tests, and what they call")]

use std::path::{Path, PathBuf};
use std::process::Command;

use slitpose_head::scene_file::WIDE;
use slitpose_model::{CompiledScene, Pair, Pose, Solution, Tier};
use slitpose_tracking::pipeline::PipelineOptions;
use slitpose_tracking::solving::{self, RowSolver};
use tempfile::TempDir;

const TIER: Tier = Tier::Exact { tolerance: 1e-6 };

fn host(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().join(path)
}

/// Currents of a tool that moves, frame after frame, with deviations as large as noise.
fn rows(plan: &CompiledScene<f64>) -> Vec<Vec<Option<Pair<f64>>>> {
    let pair = |frame: f64, cell: usize| {
        let vector = |size, phase: f64| size * glam::DVec3::new(phase.sin(), phase.cos(), (0.7 * phase).sin());
        let Pair { i_x1_a, i_x2_a } =
            plan.respond(cell, &Pose::from_vectors(vector(1e-3, frame / 40.0), vector(0.1, frame / 50.0))).currents;
        let noise = 2e-5 * (6.0 * frame + cell as f64).sin();
        Some(Pair { i_x1_a: i_x1_a * (1.0 + noise), i_x2_a: i_x2_a * (1.0 - noise) })
    };
    (0..50).map(|frame| (0..plan.cell_count()).map(|cell| pair(f64::from(frame), cell)).collect()).collect()
}

/// Compiles a program with the library as users find it once it is installed, and runs it in `folder`.
fn run(source: &str, arguments: &str, folder: &TempDir) -> String {
    let script = r#"export PREFIX="$PWD/local" PKG_CONFIG_PATH="$PWD/local/lib/pkgconfig" LD_LIBRARY_PATH="$PWD/local/lib"
        "$2/capi/install" "$1"
        cc -O2 -Wall -Wextra -Werror -std=c11 -I "$2/include" $(pkg-config --cflags slitpose-solver) -o program "$2/$3" \
            $(pkg-config --libs slitpose-solver) -lm
        eval "./program $4""#;
    let mut command = Command::new("bash");
    command.args(["-euc", script, "bash"]).arg(std::env::current_exe().unwrap().parent().unwrap());
    let output = command.arg(host("")).args([source, arguments]).current_dir(folder).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn header_follows_from_the_sources() {
    let builder =
        cbindgen::Builder::new().with_config(cbindgen::Config::from_file(host("capi/cbindgen.toml")).unwrap());
    let sources = ["lib", "solution", "solver"].map(|name| host(&format!("capi/src/{name}.rs")));
    let mut made = Vec::new();
    sources.iter().fold(builder, cbindgen::Builder::with_src).generate().unwrap().write(&mut made);
    let header = host("capi/include/slitpose_solver.h");
    if std::env::var_os("SLITPOSE_WRITE").is_some() {
        std::fs::write(&header, &made).unwrap();
    }
    let is_current = std::fs::read(&header).is_ok_and(|written| written == made);
    assert!(is_current, "{header:?}: run SLITPOSE_WRITE=1 cargo test -p slitpose-capi --test c");
}

#[test]
fn rows_and_frames_have_the_poses_of_the_other_programs() {
    let (folder, head) = (TempDir::new().unwrap(), slitpose_calibration::Head::from(WIDE.read().unwrap()));
    let scene = &head.file.scene;
    let rows = rows(&CompiledScene::compile(scene, TIER).unwrap());
    let line =
        |row: &Vec<Option<Pair<f64>>>| row.iter().flatten().map(|it| format!("{} {} ", it.i_x1_a, it.i_x2_a)).collect();
    std::fs::write(folder.path().join("currents"), rows.iter().map(line).collect::<Vec<String>>().join("\n")).unwrap();
    let assert_same = |line: &str, found: &Solution, velocity: Option<[f64; 3]>| {
        let estimate = found.estimate.unwrap();
        let mut expected = vec![found.cells_used.count() as f64];
        expected.extend(estimate.pose.translation_m.to_array().into_iter().chain(estimate.pose.rotation.to_array()));
        expected.extend((0..3).map(|axis| estimate.covariance[axis][axis]).chain([found.chi2]));
        expected.extend(velocity.iter().flatten());
        let numbers: Vec<f64> = line.split(' ').filter_map(|word| word.parse().ok()).collect();
        assert_eq!(numbers, expected, "{line}");
    };
    let solver = RowSolver::new(head.clone(), TIER, false).unwrap();
    let ready = solver.with_frames(1.0).unwrap();
    let found = run("examples/c/solve_currents.c", "wide - < currents", &folder);
    assert_eq!(found.lines().count(), rows.len());
    for (line, row) in found.lines().zip(&rows) {
        assert_same(line, &ready.solve(&ready.readings(row.iter().copied())), None);
    }
    let options = PipelineOptions::default();
    let mut tracker = solving::tracker(&head, scene, TIER, options, &[0.0; 6], 1e-3).unwrap();
    let found = run("examples/c/solve_currents.c", "wide - 1000 < currents", &folder);
    for ((frame, row), line) in (0..).zip(&rows).zip(found.lines()) {
        let tracked = tracker.track(frame, &solving::readings(&head, row.iter().copied()));
        assert_same(line, &tracked.solution, tracked.twist.ok().map(|it| it.twist.linear_m_per_s.to_array()));
    }
    let currents = std::fs::read_to_string(folder.path().join("currents")).unwrap();
    let first = currents.lines().next().unwrap();
    run("capi/tests/refusals.c", &format!("{} {first}", host("README.md").display()), &folder);
    run("capi/tests/predict.c", "", &folder);
}
