//! The loop of the virtual wall in `examples/c`, as it runs beside a publisher.

use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use slitpose_model::{DegradedReason, Outcome};

use super::c::compile;
use super::wall::{POSITION_M, example, force_n, pose};
use super::{Bench, DEVICE, PATIENCE};
use crate::clock::HostInstant;
use crate::pipeline::Record;

/// As the constants of the other tests.
const OPTIONS: [&str; 10] = ["--wall", "1", "--stiffness", "2000", "--damping", "2", "--limit", "10", "--release", "4"];

/// The example as it runs, and the table it leaves.
struct Running {
    child: Child,
    csv: PathBuf,
}

struct Row {
    input: String,
    datagram: u64,
    age_s: f64,
    x_m: f64,
    force_n: f64,
}

impl Running {
    fn start(bench: &Bench, options: &[&str]) -> Self {
        let program = compile(&example("virtual_wall.c"), &bench.folder);
        let csv = bench.folder.path().join("wall.csv");
        let mut command = Command::new(program);
        command.arg(bench.server.addresses()[0].to_string()).args(OPTIONS).args(options).arg("--csv").arg(&csv);
        let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        Self { child, csv }
    }

    fn has_ended(&mut self) -> bool {
        self.child.try_wait().unwrap().is_some()
    }

    fn interrupt(&self) {
        let pid = self.child.id().to_string();
        assert!(Command::new("sh").args(["-c", "kill -INT $0", &pid]).status().unwrap().success());
    }

    fn end(mut self) -> (Option<i32>, String, Vec<Row>) {
        let since = Instant::now();
        while !self.has_ended() {
            if since.elapsed() > PATIENCE {
                self.child.kill().unwrap();
                panic!("the wall hangs: {:?}", self.child.wait_with_output());
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        let output = self.child.wait_with_output().unwrap();
        let said = String::from_utf8([output.stdout, output.stderr].concat()).unwrap();
        let text = std::fs::read_to_string(self.csv).unwrap();
        let rows = text.lines().skip(1).map(|line| {
            let words: Vec<&str> = line.split(',').collect();
            let number = |at: usize| words[at].parse::<f64>().unwrap();
            let datagram = words[2].parse().unwrap();
            Row { input: words[1].to_owned(), datagram, age_s: number(3), x_m: number(4), force_n: number(6) }
        });
        (output.status.code(), said, rows.collect())
    }
}

/// Publishes until the client has been sent `count`, or has ended.
fn publish(bench: &Bench, running: &mut Running, count: u64, record: impl Fn(u64, u64) -> Record) {
    let mut publisher = bench.server.publisher(DEVICE);
    let (since, until) = (Instant::now(), bench.server.counts().sent + count);
    for number in 1.. {
        let now = HostInstant::now();
        publisher.publish(&record(number, now.monotonic_ns), now);
        if bench.server.counts().sent >= until || running.has_ended() {
            return;
        }
        assert!(since.elapsed() < PATIENCE, "the client takes no poses");
        std::thread::sleep(Duration::from_micros(500));
    }
}

#[test]
fn the_running_wall_sets_the_force_of_each_pose_and_lets_go_at_an_interrupt() {
    let x_m = |datagram: u64| [0.4e-3, 1.6e-3, 3.1e-3, 2.2e-3, 9e-3][datagram as usize % 5];
    let v_m_per_s = |datagram: u64| datagram as f64 * 1e-4;
    let bench = Bench::new();
    // Poses of any age are used, so that nothing depends on how busy the machine is.
    let mut running = Running::start(&bench, &["--oldest", "1e6", "--duration", "1e6"]);
    publish(&bench, &mut running, 400, |number, now_ns| pose(x_m(number), v_m_per_s(number), now_ns));
    running.interrupt();
    let (code, said, rows) = running.end();
    assert_eq!(code, Some(0), "{said}");
    let (mut is_engaged, mut pushes, mut releasing) = (false, 0, f64::INFINITY);
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
            pushes += u32::from(expected > 0.0);
        }
    }
    assert!(pushes > 0 && rows.last().unwrap().force_n == 0.0, "{said}");
    assert!(said.contains("passive if the mechanism's own damping exceeds"), "{said}");
}

#[test]
fn a_stalled_publisher_leaves_no_force_and_does_not_hang_the_wall() {
    let bench = Bench::new();
    let mut running = Running::start(&bench, &["--oldest", "5", "--duration", "2"]);
    publish(&bench, &mut running, 100, |number, now_ns| pose([0.5e-3, 3e-3][number as usize % 2], 0.0, now_ns));
    let (code, said, rows) = running.end();
    assert_eq!(code, Some(0), "{said}");
    for pair in rows.windows(2).filter(|pair| pair[1].input != "used" && pair[1].age_s > 5e-3) {
        let (before, after) = (pair[0].force_n, pair[1].force_n);
        assert!(after < before || after == 0.0, "{before} N, then {after} N");
    }
    assert_eq!(rows.last().unwrap().force_n, 0.0);
}

#[test]
fn useless_poses_give_no_force_and_a_daemon_that_ends_is_reported() {
    let bench = Bench::new();
    let mut running = Running::start(&bench, &["--oldest", "1e3", "--duration", "1e6"]);
    publish(&bench, &mut running, 100, |number, now_ns| {
        let x_m = [0.5e-3, 3e-3][number as usize / 5 % 2];
        let mut record = pose(x_m, 0.2, now_ns);
        match number % 5 {
            0 => record.solution.outcome = Outcome::Degraded(DegradedReason::Misfit),
            1 => record.solution.estimate = None,
            2 => record.twist = None,
            3 => record.host_time = None,
            _ => record.host_time = pose(x_m, 0.2, now_ns - 30_000_000_000).host_time,
        }
        record
    });
    let address = bench.server.addresses()[0].to_string();
    let Bench { folder, server, .. } = bench;
    drop(server);
    let (code, said, rows) = running.end();
    drop(folder);
    assert!(code == Some(1) && said.contains(&address) && said.contains("refused"), "{code:?}: {said}");
    assert!(rows.iter().any(|row| row.datagram > 0), "{said}");
    assert!(rows.iter().all(|row| row.force_n == 0.0 && row.input != "used"), "{said}");
}
