//! The virtual wall in `examples/c`: its force against the same equations in Rust, when it lets go, and its loop beside a
//! publisher.

use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use glam::DVec3;
use slitpose_model::{DegradedReason, NoTwist, Outcome};
use tempfile::TempDir;

use super::c::{compile, compile_own, host};
use super::{Bench, DEVICE, PATIENCE, record};
use crate::datagram::PoseDatagram;
use slitpose_tracking::clock::{HostInstant, HostTime};
use slitpose_tracking::pipeline::Record;

const POSITION_M: f64 = 1e-3;
const STIFFNESS: f64 = 2000.0;
const DAMPING: f64 = 2.0;
const LIMIT_N: f64 = 10.0;
const OLDEST_NS: u64 = 5_000_000;
const RELEASE_NS: u64 = 4_000_000;

/// A pose at `x_m` with the velocity `v_m_per_s` along x, of the instant `at_ns`.
fn pose(x_m: f64, v_m_per_s: f64, at_ns: u64) -> Record {
    let mut record = record();
    record.host_time = Some(HostTime { monotonic_ns: at_ns, utc_ns: 0, uncertainty_ns: 0 });
    record.solution.estimate.as_mut().unwrap().pose.translation_m = DVec3::new(x_m, 0.3e-3, -0.2e-3);
    record.twist.as_mut().unwrap().twist.linear_m_per_s = DVec3::new(v_m_per_s, 0.1, -0.1);
    record
}

/// Spring and damper, pushing only, and no more than the limit.
fn force_n(x_m: f64, v_m_per_s: f64) -> f64 {
    let depth_m = x_m - POSITION_M;
    if depth_m > 0.0 { (STIFFNESS * depth_m + DAMPING * v_m_per_s).clamp(0.0, LIMIT_N) } else { 0.0 }
}

type Step = (u64, Option<PoseDatagram>);

fn step(now_ns: u64, record: &Record) -> Step {
    (now_ns, Some(PoseDatagram::new(record, 1, HostInstant { monotonic_ns: now_ns, utc_ns: 0 })))
}

/// Forces, and what became of each pose.
fn run(program: &Path, steps: &[Step]) -> Vec<(f64, String)> {
    let mut bytes = Vec::new();
    for (now_ns, datagram) in steps {
        bytes.extend(now_ns.to_le_bytes());
        bytes.extend(u64::from(datagram.is_some()).to_le_bytes());
        bytes.extend(datagram.as_ref().map_or([0; PoseDatagram::BYTES], |datagram| *datagram.as_bytes()));
    }
    let mut child = Command::new(program).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let writer = std::thread::spawn(move || stdin.write_all(&bytes).unwrap());
    let text = String::from_utf8(child.wait_with_output().unwrap().stdout).unwrap();
    writer.join().unwrap();
    let row = |line: &str| line.split_once(' ').map(|(force, input)| (force.parse().unwrap(), input.to_owned()));
    let rows: Vec<_> = text.lines().map(|line| row(line).unwrap()).collect();
    assert_eq!(rows.len(), steps.len());
    rows
}

/// Every way for a pose to be of no use, as the example names it.
fn useless(now_ns: u64) -> Vec<(&'static str, Step)> {
    let good = pose(1.4e-3, 0.0, now_ns - 700_000);
    let with = |change: &dyn Fn(&mut Record)| {
        let mut record = good;
        change(&mut record);
        step(now_ns, &record)
    };
    let (_, mut behind) = step(now_ns, &good);
    behind.as_mut().unwrap().mark_behind();
    vec![
        ("nothing came", (now_ns, None)),
        ("no pose", with(&|record| record.solution.estimate = None)),
        ("degraded", with(&|record| record.solution.outcome = Outcome::Degraded(DegradedReason::FewerCells))),
        ("no twist", with(&|record| record.twist = Err(NoTwist::Jump))),
        ("behind", (now_ns, behind)),
        ("of unknown age", with(&|record| record.host_time = None)),
        ("too old", step(now_ns, &pose(1.4e-3, 0.0, now_ns - OLDEST_NS))),
    ]
}

#[test]
fn without_usable_poses_the_force_is_held_then_falls_to_zero_and_stays_there() {
    const PERIOD_NS: u64 = 250_000;
    let folder = TempDir::new().unwrap();
    let program = compile_own("steps.c", &folder);
    let start_ns = 1_000_000_000;
    for kind in 0..useless(start_ns).len() {
        let good = |number: u64, x_m| {
            let now_ns = start_ns + number * PERIOD_NS;
            step(now_ns, &pose(x_m, 0.0, now_ns - 700_000))
        };
        let held_n = force_n(3e-3, 0.0);
        let mut script = vec![good(0, 0.0), good(1, 3e-3)];
        script.extend((2..60).map(|number| useless(start_ns + number * PERIOD_NS).swap_remove(kind).1));
        script.extend([good(60, 3e-3), good(61, 0.5e-3), good(62, 3e-3)]);
        let rows = run(&program, &script);
        let name = useless(start_ns)[kind].0;
        assert_eq!(rows[1].0, held_n);
        for (number, (force, input)) in (2..60).zip(&rows[2..60]) {
            assert_eq!(input, name);
            // The pose is 0.7 ms old in step 1.
            let age_ns = 700_000 + (number - 1) * PERIOD_NS;
            let expected = if age_ns < OLDEST_NS {
                held_n
            } else {
                let first = (OLDEST_NS - 700_000).div_ceil(PERIOD_NS) + 1;
                let falling_ns = (number - first + 1) * PERIOD_NS;
                (held_n - LIMIT_N * falling_ns as f64 / RELEASE_NS as f64).max(0.0)
            };
            assert!((force - expected).abs() < 1e-9, "{name}, step {number}: {force} N, not {expected} N");
        }
        let last: Vec<f64> = rows[59..].iter().map(|row| row.0).collect();
        assert_eq!(last, [0.0, 0.0, 0.0, held_n], "{name}: it comes back from outside only");
    }
}

/// Least damping by the condition itself (Colgate and Schenkel 1997, equation 3), over frequencies up to Nyquist's, for
/// H(z) = (K + B (z - 1) / (T z)) / z^periods.
fn least_damping(stiffness: f64, damping: f64, period_s: f64, periods: i32) -> f64 {
    let at = |angle: f64| {
        // (1 - 1/z) H(z), each term a cosine.
        let cosine = |power: i32| (angle * f64::from(power)).cos();
        let spring = stiffness * (cosine(periods) - cosine(periods + 1));
        let damper = damping / period_s * (cosine(periods) - 2.0 * cosine(periods + 1) + cosine(periods + 2));
        period_s / 2.0 / (1.0 - angle.cos()) * (spring + damper)
    };
    (1..=20_000).map(|i| at(std::f64::consts::PI * f64::from(i) / 20_000.0)).fold(f64::MIN, f64::max)
}

#[test]
fn the_damping_for_passivity_satisfies_the_condition_and_is_not_needlessly_large() {
    let folder = TempDir::new().unwrap();
    let program = compile_own("steps.c", &folder);
    let (stiffness, period_s) = (1500.0, 250e-6);
    for (damping, periods) in [(0.0, 0), (0.0, 1), (0.0, 6), (3.0, 0), (3.0, 1), (3.0, 6)] {
        let delay_s = f64::from(periods) * period_s;
        let arguments = [stiffness, damping, period_s, delay_s].map(|number| number.to_string());
        let output = Command::new(&program).args(arguments).stdin(Stdio::null()).output().unwrap();
        let printed: f64 = String::from_utf8(output.stdout).unwrap().trim().parse().unwrap();
        let least = least_damping(stiffness, damping, period_s, periods);
        assert!(printed >= least * (1.0 - 1e-9), "{printed} is under {least}, B {damping}, {periods} periods");
        // Without delay, or without damper, it is the least.
        if damping == 0.0 || periods == 0 {
            assert!(printed < least * (1.0 + 1e-4), "{printed} is over {least}, B {damping}, {periods} periods");
        }
    }
}

/// As the constants of the other tests; poses of any age are used, so that nothing depends on how busy the machine is.
const OPTIONS: &str = "--wall 1 --stiffness 2000 --damping 2 --limit 10 --release 4 --oldest 1e6 --duration 1e6";

struct Row {
    input: String,
    datagram: u64,
    x_m: f64,
    force_n: f64,
}

/// Runs the example beside a publisher until it was sent `count` poses and an interrupt: what it says, and its table.
fn run_until_interrupted(count: u64, record: impl Fn(u64, u64) -> Record) -> (String, Vec<Row>) {
    let bench = Bench::new();
    let csv = bench.folder.path().join("wall.csv");
    let mut command = Command::new(compile(&host("examples/c/virtual_wall.c"), &bench.folder));
    command.arg(bench.server.addresses()[0].to_string()).args(OPTIONS.split(' ')).arg("--csv").arg(&csv);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut publisher = bench.server.publisher(DEVICE);
    let since = Instant::now();
    for number in 1.. {
        let now = HostInstant::now();
        publisher.publish(&record(number, now.monotonic_ns), now);
        if bench.server.counts().sent >= count {
            break;
        }
        let is_running = child.try_wait().unwrap().is_none();
        assert!(is_running && since.elapsed() < PATIENCE, "the client takes no poses");
        std::thread::sleep(Duration::from_micros(500));
    }
    let interrupt = ["-c", "kill -INT $0", &child.id().to_string()];
    assert!(Command::new("sh").args(interrupt).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8([output.stdout, output.stderr].concat()).unwrap();
    assert_eq!(output.status.code(), Some(0), "{said}");
    let text = std::fs::read_to_string(csv).unwrap();
    let rows = text.lines().skip(1).map(|line| {
        let words: Vec<&str> = line.split(',').collect();
        let number = |at: usize| words[at].parse::<f64>().unwrap();
        let datagram = words[2].parse().unwrap();
        Row { input: words[1].to_owned(), datagram, x_m: number(4), force_n: number(6) }
    });
    (said, rows.collect())
}

#[test]
fn the_running_wall_sets_the_force_of_each_pose_and_lets_go_at_an_interrupt() {
    let x_m = |datagram: u64| [0.4e-3, 1.6e-3, 3.1e-3, 2.2e-3, 9e-3][datagram as usize % 5];
    let v_m_per_s = |datagram: u64| (datagram % 7) as f64 * 0.3 - 0.9;
    let (said, rows) = run_until_interrupted(400, |number, now_ns| pose(x_m(number), v_m_per_s(number), now_ns));
    let (mut is_engaged, mut forces, mut releasing) = (false, Vec::new(), f64::INFINITY);
    for (index, row) in rows.iter().enumerate() {
        assert!(["used", "nothing came"].contains(&row.input.as_str()), "{}", row.input);
        if row.datagram > 0 {
            assert_eq!(row.x_m, x_m(row.datagram));
            is_engaged |= row.x_m <= POSITION_M;
        }
        let expected = if is_engaged { force_n(x_m(row.datagram), v_m_per_s(row.datagram)) } else { 0.0 };
        if releasing.is_finite() || (row.force_n - expected).abs() > 1e-12 {
            // After the interrupt the force only falls, and nothing more is read.
            assert!(
                row.input == "nothing came" && row.force_n < releasing.min(expected),
                "row {index}: {}",
                row.force_n
            );
            releasing = row.force_n;
        } else {
            forces.extend(is_engaged.then_some(expected));
        }
    }
    assert!(rows.last().unwrap().force_n == 0.0, "{said}");
    // None, all, and some of the force allowed.
    let is_seen = |is_it: fn(f64) -> bool| forces.iter().copied().any(is_it);
    assert!(is_seen(|f| f == 0.0) && is_seen(|f| f >= LIMIT_N) && is_seen(|f| f > 0.0 && f < LIMIT_N), "{said}");
    assert!(said.contains("passive if the mechanism's own damping exceeds"), "{said}");
}

#[test]
fn the_stiffest_wall_of_a_simulated_loop_is_a_little_above_the_passive_one() {
    let folder = TempDir::new().unwrap();
    let output = Command::new(compile(&host("examples/c/passive_wall.c"), &folder)).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    let rows: Vec<Vec<f64>> =
        text.lines().skip(2).map(|row| row.split_whitespace().map(|word| word.parse().unwrap()).collect()).collect();
    assert_eq!(rows.len(), 12, "{text}");
    for row in rows {
        let &[rate_hz, age_ms, passive, stable] = &row[..] else { panic!("{text}") };
        assert!((passive - 2.0 / (0.5 / rate_hz + age_ms * 1e-3)).abs() < 1.0, "{text}");
        // To first order of the delay they are the same.
        assert!((1.0..1.1).contains(&(stable / passive)), "{text}");
    }
}
