//! Poses in shared memory: whole for every reader, whatever becomes of other readers, and of the daemon.

use std::fs;
use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use glam::{DQuat, DVec3};
use tempfile::TempDir;

use super::c::compile_own;
use super::{DEVICE, record};
use crate::datagram::{Address, DatagramServer, Publisher};
use slitpose_tracking::clock::{HostInstant, HostTime};
use slitpose_tracking::pipeline::Record;
use slitpose_tracking::telemetry::DatagramCounts;

fn server(path: &Path) -> DatagramServer {
    DatagramServer::bind(&[Address::Memory(path.to_owned())]).unwrap()
}

/// Publishes a pose of which every number is that of its datagram, `number`.
fn publish(publisher: &mut Publisher, template: &Record, number: u64) {
    let (real, now) = (number as f64, HostInstant { monotonic_ns: number, utc_ns: number });
    let host_time = HostTime { monotonic_ns: number, utc_ns: number, uncertainty_ns: number };
    let mut record = Record { sequence: number, device_time_s: real * 1e-9, ..*template };
    (record.host_time, record.arrival, record.light_level) = (Some(host_time), Some(now), Some(real));
    let (estimate, twist) = (record.solution.estimate.as_mut().unwrap(), record.twist.as_mut().unwrap());
    estimate.pose.translation_m = DVec3::splat(real);
    estimate.pose.rotation = DQuat::from_array([real; 4]);
    estimate.covariance = [[real; 6]; 6];
    (twist.twist.linear_m_per_s, twist.twist.angular_rad_per_s) = (DVec3::splat(real), DVec3::splat(real));
    twist.covariance = [[real * real; 6]; 6];
    publisher.publish(&record, now);
}

/// A reader with the lowest priority: many keep all processors busy, and the writer shall write.
fn read(program: &Path, path: &Path, reads: u64) -> Child {
    let mut command = Command::new("nice");
    command.args(["-n", "19"]).arg(program).arg(format!("shm:{}", path.display())).arg(reads.to_string());
    command.stdout(Stdio::piped()).spawn().unwrap()
}

fn said(reader: Child) -> String {
    let output = reader.wait_with_output().unwrap();
    assert!(output.status.success(), "{output:?}");
    String::from_utf8(output.stdout).unwrap()
}

/// The long run: `SLITPOSE_READS=200000000 cargo nextest run --release -p slitpose --no-capture no_reader_sees`.
#[test]
fn no_reader_sees_a_torn_pose_and_none_costs_the_writer_any() {
    const READERS: u64 = 16;
    const PERIOD: Duration = Duration::from_micros(125);
    let reads: u64 = std::env::var("SLITPOSE_READS").map_or(1_000_000, |text| text.parse().unwrap());
    let folder = TempDir::new().unwrap();
    let (path, program) = (folder.path().join("pose"), compile_own("memory.c", &folder));
    let server = server(&path);
    let (mut publisher, template) = (server.publisher(DEVICE), record());
    let mut readers: Vec<Child> = (0..READERS).map(|_| read(&program, &path, reads.div_ceil(READERS))).collect();
    let [mut killed, mut stopped] = [(); 2].map(|()| read(&program, &path, u64::MAX));
    let (since, mut number, mut paced, mut struck) = (Instant::now(), 0, 0, false);
    let mut due = since;
    while !struck || readers.iter_mut().any(|reader| reader.try_wait().unwrap().is_none()) {
        // A tenth of a second at 8 kHz and one at full speed by turns.
        let is_paced = since.elapsed().as_millis() / 100 % 2 == 0;
        let count = if is_paced { (due.elapsed().as_nanos() / PERIOD.as_nanos()) as u32 } else { 1000 };
        for _ in 0..count {
            number += 1;
            publish(&mut publisher, &template, number);
        }
        due = if is_paced { due + PERIOD * count } else { Instant::now() };
        paced += u64::from(if is_paced { count } else { 0 });
        std::thread::sleep(if is_paced { PERIOD } else { Duration::ZERO });
        if !struck && since.elapsed() > Duration::from_millis(150) {
            killed.kill().unwrap();
            assert!(Command::new("kill").args(["-STOP", &stopped.id().to_string()]).status().unwrap().success());
            struck = true;
        }
    }
    println!("{reads} reads by {READERS} readers; {number} poses, {paced} at 8 kHz; {:.1?}", since.elapsed());
    for reader in readers {
        let text = said(reader);
        assert!(text.starts_with("torn 0, out of order 0, different "), "{text}");
    }
    let (counts, unharmed) = (server.counts(), DatagramCounts { places: 16, ..DatagramCounts::default() });
    assert_eq!((publisher.missed, counts), (0, unharmed));
    assert_eq!(said(read(&program, &path, 0)), format!("generation 1, newest {number}"));
    stopped.kill().unwrap();
    [killed, stopped].iter_mut().for_each(|reader| assert!(!reader.wait().unwrap().success()));
}

#[test]
fn a_memory_is_taken_over_from_the_dead_and_from_nobody_else() {
    let folder = TempDir::new().unwrap();
    let (path, program) = (folder.path().join("pose"), compile_own("memory.c", &folder));
    let found = || said(read(&program, &path, 0));
    let inode = || fs::metadata(&path).unwrap().ino();
    let refusal = |path: PathBuf| DatagramServer::bind(&[Address::Memory(path)]).unwrap_err().to_string();

    let (first, before) = (server(&path), inode());
    assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o640);
    assert_eq!(found(), "generation 1, newest 0");
    let mut publisher = first.publisher(DEVICE);
    publish(&mut publisher, &record(), 1);
    assert_eq!(found(), "generation 1, newest 1");
    assert!(refusal(path.clone()).contains("another program serves shm:/"), "{}", refusal(path.clone()));
    // A board that has gone says nothing any more, and leaves its ring to others.
    drop(publisher);
    assert_eq!(found(), "generation 1, newest 0");
    let mut all: Vec<Publisher> = (0..crate::datagram::MAX_BOARDS).map(|_| first.publisher(DEVICE)).collect();
    publish(all.last_mut().unwrap(), &record(), 1);
    assert_eq!(found(), "generation 1, newest 1");
    drop((all, first));
    assert_eq!(read(&program, &path, 0).wait().unwrap().code(), Some(1), "no daemon");
    let second = server(&path);
    assert_eq!((found().as_str(), inode()), ("generation 2, newest 0", before));
    drop(second);

    fs::write(&path, b"SLPM\0\0\0\0 of another version").unwrap();
    let _third = server(&path);
    assert_eq!(found(), "generation 1, newest 0");
    let [text, link] = ["text", "link"].map(|name| folder.path().join(name));
    fs::write(&text, "of somebody else").unwrap();
    symlink(&path, &link).unwrap();
    assert!(refusal(text.clone()).contains("is left alone; give another name"));
    assert_eq!(fs::read_to_string(&text).unwrap(), "of somebody else");
    assert!(refusal(link).contains("cannot listen"));
    assert!(refusal(folder.path().to_owned()).contains("cannot listen"));
}
