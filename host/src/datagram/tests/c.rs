//! Clients in C, compiled as users would, and the header as programs find it once it is installed.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use tempfile::TempDir;

use super::{Bench, DEVICE, OTHER, PATIENCE, record};
use crate::datagram::{PoseDatagram, Publisher};
use slitpose_model::NoTwist;
use slitpose_tracking::clock::{HostInstant, HostTime};
use slitpose_tracking::pipeline::Record;

pub(super) fn compile(source: &Path, folder: &TempDir) -> PathBuf {
    let program = folder.path().join(source.file_stem().unwrap());
    let output = Command::new("cc")
        .args(["-O2", "-Wall", "-Wextra", "-Werror", "-pedantic", "-std=c11", "-pthread", "-I"])
        .arg(host("include"))
        .arg("-o")
        .args([&program, source])
        .arg("-lm")
        .output()
        .expect("a C compiler, as `cc`");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    program
}

/// A program of this folder.
pub(super) fn compile_own(name: &str, folder: &TempDir) -> PathBuf {
    compile(&host("src/datagram/tests").join(name), folder)
}

fn numbers(line: &str) -> Vec<f64> {
    line.split(' ').skip(1).map(|number| number.parse().unwrap()).collect()
}

/// What the C program prints of a datagram.
fn read(program: &Path, datagram: &PoseDatagram) -> String {
    let mut child = Command::new(program).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    child.stdin.take().unwrap().write_all(datagram.as_bytes()).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success());
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn c_reads_what_is_written() {
    let folder = TempDir::new().unwrap();
    let program = compile_own("fields.c", &folder);
    let read = |datagram: &PoseDatagram| read(&program, datagram);
    let record = record();
    let now = HostInstant { monotonic_ns: 123_457_000_001, utc_ns: 0 };
    let mut datagram = PoseDatagram::new(&record, 77, now);
    datagram.set_missed(5);
    let text = read(&datagram);
    let lines: Vec<&str> = text.lines().collect();
    let solution = &record.solution;
    let (used, redundancy) = (solution.cells_used.count(), solution.redundancy);
    assert_eq!(lines[0], format!("560 31 0 {used} simulated 0 {redundancy}"));
    let mut behind = datagram.clone();
    behind.mark_behind();
    assert!(read(&behind).starts_with("560 63 0 "), "the sixth bit, and no other");
    let device_time_ns = (record.device_time_s * 1e9).round();
    assert_eq!(
        lines[1],
        format!(
            "77 5 {} {device_time_ns} 123456789000 1700000000987654321 345 123456999000 123457000001 ",
            record.sequence
        )
    );
    let (estimate, twist) = (solution.estimate.unwrap(), record.twist.unwrap());
    assert_eq!(numbers(lines[2]), estimate.pose.translation_m.to_array());
    assert_eq!(numbers(lines[3]), estimate.pose.rotation.to_array());
    assert_eq!(numbers(lines[4]), estimate.covariance.concat());
    assert_eq!(numbers(lines[5]), twist.twist.linear_m_per_s.to_array());
    assert_eq!(numbers(lines[6]), twist.twist.angular_rad_per_s.to_array());
    let sigma: Vec<f64> = (0..6).map(|i| twist.covariance[i][i].sqrt()).collect();
    assert_eq!(numbers(lines[7]), sigma);
    assert_eq!((numbers(lines[8]), lines[9]), (vec![record.light_level.unwrap()], "0"));
    let jumped = Record { twist: Err(NoTwist::Jump), light_level: None, ..record };
    let text = read(&PoseDatagram::new(&jumped, 1, now));
    let lines: Vec<&str> = text.lines().collect();
    assert!(numbers(lines[8])[0].is_nan() && lines[9] == "2", "{text}");

    let mut nothing =
        Record { twist: Err(NoTwist::NoPose), host_time: None, arrival: None, simulated: false, ..record };
    nothing.solution.estimate = None;
    nothing.solution.outcome = slitpose_model::Outcome::TooDark;
    let text = read(&PoseDatagram::new(&nothing, 1, now));
    let lines: Vec<&str> = text.lines().collect();
    assert!(lines[0].starts_with("560 0 4 "), "{}", lines[0]);
    assert!(lines[1].ends_with(" 0 0 0 0 123457000001 "), "{}", lines[1]);
    assert!(lines[2..8].iter().flat_map(|line| numbers(line)).all(f64::is_nan), "{text}");
}

#[test]
fn the_age_in_c_counts_from_the_earliest_instant_that_is_known() {
    const SECOND_NS: u64 = 1_000_000_000;
    let folder = TempDir::new().unwrap();
    let program = compile_own("fields.c", &folder);
    let record = record();
    // The pose's instant 30 s ago, its arrival 20 s ago, sent 10 s ago: as far apart as no busy machine is.
    let now = HostInstant::now();
    let before = |seconds| HostInstant { monotonic_ns: now.monotonic_ns - seconds * SECOND_NS, utc_ns: 0 };
    let host_time = record.host_time.map(|time| HostTime { monotonic_ns: before(30).monotonic_ns, ..time });
    let all = Record { host_time, arrival: Some(before(20)), ..record };
    let arrival = Record { host_time: None, ..all };
    let neither = Record { host_time: None, arrival: None, ..all };
    // By a clock that is ahead, it is not younger than now.
    let ahead = Record { arrival: Some(HostInstant { monotonic_ns: u64::MAX / 2, utc_ns: 0 }), ..arrival };
    let ages_ns = [all, arrival, neither, ahead].map(|record| {
        let text = read(&program, &PoseDatagram::new(&record, 1, before(10)));
        text.lines().last().unwrap().parse::<u64>().unwrap()
    });
    let passed_ns = HostInstant::now().monotonic_ns - now.monotonic_ns;
    for (age_ns, seconds) in ages_ns.iter().zip([30, 20, 10]) {
        let least_ns = seconds * SECOND_NS;
        assert!((least_ns..=least_ns + passed_ns).contains(age_ns), "{age_ns} ns for {seconds} s");
    }
    assert_eq!(ages_ns[3], 0);
}

fn publish_for(mut program: Child, publisher: &mut Publisher, record: &Record) -> Output {
    let since = Instant::now();
    while program.try_wait().unwrap().is_none() {
        if since.elapsed() > PATIENCE {
            program.kill().unwrap();
            panic!("the client does not end: {:?}", program.wait_with_output());
        }
        let now = HostInstant::now();
        publisher.publish(&Record { arrival: Some(now), ..*record }, now);
        std::thread::sleep(Duration::from_micros(500));
    }
    program.wait_with_output().unwrap()
}

#[test]
fn the_example_client_follows_on_both_kinds_of_socket() {
    let bench = Bench::new();
    let example = host("examples/c/follow_pose.c");
    let program = compile(&example, &bench.folder);
    let mut publisher = bench.server.publisher(DEVICE);
    let record = record();
    let t = record.solution.estimate.unwrap().pose.translation_m;
    let expected = format!("scan {} converged  t {:+.6} {:+.6} {:+.6} m", record.sequence, t.x, t.y, t.z);
    for address in bench.server.addresses() {
        let client = Command::new(&program).args([&address.to_string(), "20"]).stdout(Stdio::piped()).spawn().unwrap();
        let output = publish_for(client, &mut publisher, &record);
        let text = String::from_utf8(output.stdout).unwrap();
        assert!(output.status.success() && text.lines().count() == 20, "{address}: {text}");
        assert!(text.lines().all(|line| line.starts_with(&expected) && line.ends_with("us  simulated")), "{text}");
    }
    let output = Command::new(&program).arg("udp:nowhere").output().unwrap();
    assert_eq!(output.status.code(), Some(1));
}

#[test]
fn c_asks_for_the_newest_of_a_board() {
    let bench = Bench::new();
    let program = compile_own("newest.c", &bench.folder);
    let (mut first, mut second) = (bench.server.publisher(DEVICE), bench.server.publisher(OTHER));
    let record = record();
    for _ in 0..4 {
        first.publish(&record, HostInstant::now());
        second.publish(&Record { device: OTHER, ..record }, HostInstant::now());
    }
    second.publish(&Record { device: OTHER, ..record }, HostInstant::now());
    for address in bench.server.addresses() {
        let output = Command::new(&program).args([&address.to_string(), "another one"]).output().unwrap();
        assert!(output.status.success());
        assert_eq!(String::from_utf8(output.stdout).unwrap(), "another one 5");
    }
}

pub(super) fn host(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

fn install(prefix: &str, destination: &str) -> Output {
    let mut command = Command::new(host("include/install"));
    command.env("PREFIX", prefix).env("DESTDIR", destination).output().unwrap()
}

#[test]
fn a_package_is_staged_elsewhere_and_a_relative_prefix_is_refused() {
    let folder = TempDir::new().unwrap();
    let stage = folder.path().to_str().unwrap();
    assert!(install("/opt/slitpose", stage).status.success());
    let package = std::fs::read_to_string(format!("{stage}/opt/slitpose/share/pkgconfig/slitpose-pose.pc")).unwrap();
    assert!(package.starts_with("prefix=/opt/slitpose\n") && !package.contains(stage), "{package}");
    assert!(package.contains(concat!("Version: ", env!("CARGO_PKG_VERSION"), "\n")), "{package}");
    let refused = install("local", stage);
    assert_eq!(refused.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("PREFIX=local"), "{refused:?}");
    assert!(!Path::new(&format!("{stage}local")).exists());
}

#[test]
fn header_and_examples_compile_without_warnings_in_every_standard() {
    const WARNINGS: [&str; 7] = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Wundef", "-Werror"];
    let folder = TempDir::new().unwrap();
    let alone = folder.path().join("alone.c");
    std::fs::write(&alone, "#define _POSIX_C_SOURCE 200809L\n#include \"slitpose_pose.h\"\n").unwrap();
    let examples = ["follow_pose", "virtual_wall", "solve_currents"].map(|name| host(&format!("examples/c/{name}.c")));
    for (language, standard) in [("c", "c99"), ("c", "c11"), ("c++", "c++11"), ("c++", "c++17")] {
        for source in examples.iter().chain([&alone]) {
            let mut command = Command::new(if language == "c" { "cc" } else { "c++" });
            command.args(["-x", language]).arg(format!("-std={standard}")).args(WARNINGS);
            command.args(["-O2", "-I"]).arg(host("include")).arg("-I").arg(host("capi/include"));
            command.args(["-c", "-o"]).arg(folder.path().join("object")).arg(source);
            let output = command.output().expect("cc and c++; on Debian: apt-get install g++");
            assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
        }
    }
}
