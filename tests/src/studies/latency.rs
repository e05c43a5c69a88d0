//! From a board's bytes to a control loop in C: how long a pose takes.
//!
//! ```text
//! virtual board ──terminal──▶ slitpose run ──datagram──▶ client in C
//!      written                 read, published              received
//! ```
//!
//! Each of the three is a process, or as good as one, and notes when it had each scan, by
//! CLOCK_MONOTONIC. The board writes what it has once a millisecond, as one on USB does: four scans
//! at 4 kHz. What it costs to simulate it is taken from the same processors.

use std::path::Path;
use std::process::Command;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use clap::Args;
use nix::time::{ClockId, clock_gettime};
use slitpose_protocol::{Decoder, MAX_MESSAGE_BYTES, Message, Schedule};

use super::{Table, Verdicts};
use crate::consistency::Sorted;
use crate::daemon::{Usage, live_pages};
use crate::process::{Finished, Slitpose, compile, name_in};
use crate::terminal::{Board, Device, FRAME_RATE_HZ, Terminal};

/// Bytes in to pose out, of half and of 99 % of all poses, µs.
const MAX_US: [(f64, f64); 2] = [(0.5, 150.0), (0.99, 1000.0)];

const READY_WITHIN: Duration = Duration::from_secs(20);

#[derive(Clone, Debug, Args)]
pub struct Conditions {
    /// Seconds that are measured
    #[arg(long, default_value_t = 30.0)]
    seconds: f64,
    /// Seconds before that: the link's and the caches'
    #[arg(long, default_value_t = 1.0)]
    warm_up: f64,
    /// Without a recorder
    #[arg(long)]
    unrecorded: bool,
    /// Without a verdict on times: the machine may be as busy as it likes
    #[arg(long)]
    untimed: bool,
    /// Through shared memory instead of a Unix socket
    #[arg(long)]
    memory: bool,
    /// So many live pages look at the board meanwhile, of which one stalls
    #[arg(long, default_value_t = 0)]
    pages: usize,
    /// More options of `slitpose run`
    #[arg(last = true)]
    options: Vec<String>,
}

/// The way of one pose. All times are CLOCK_MONOTONIC, ns.
#[derive(Clone, Copy, Debug)]
struct Way {
    /// Its scan was on its way to the terminal.
    written_ns: u64,
    /// How many scans were ahead of it in the same write.
    place: usize,
    sequence: u64,
    /// Number of the datagram: a gap is what the client missed.
    datagram: u64,
    /// Whether scans before it were passed over.
    is_behind: bool,
    /// When the scan was taken, as far as the daemon knew.
    taken_ns: Option<u64>,
    /// The daemon had read its bytes.
    arrival_ns: u64,
    /// The daemon had solved it.
    published_ns: u64,
    /// The client had it.
    received_ns: u64,
}

struct Measurement {
    /// Poses in the order in which the client got them.
    ways: Vec<Way>,
    /// When the board wrote.
    writes_ns: Vec<u64>,
    /// Share of a processor that the daemon takes from when it is up.
    processor_share: f64,
    daemon: Finished,
    capture_bytes: u64,
}

pub fn study(slitpose: Slitpose, conditions: &Conditions) -> Verdicts {
    let mut conditions = conditions.clone();
    if conditions.pages > 0 {
        let live =
            ["--trajectory", "smooth", "--live", &live_pages(conditions.pages, 1).to_string()].map(str::to_owned);
        conditions.options.extend(live);
    }
    print_conditions(&conditions);
    let poses = (conditions.seconds * FRAME_RATE_HZ) as usize;
    let measurement = measure(slitpose, &conditions, poses);
    let total = print(&measurement);
    let mut verdicts = Verdicts::default();
    let Measurement { ways, daemon, capture_bytes, .. } = &measurement;
    // 3 if it did not run for a while and left scans out.
    let code = if daemon.stderr.contains("were not solved") { 3 } else { 0 };
    verdicts.check(daemon.code == code, format!("the daemon ends with {code}: {}", daemon.code));
    verdicts.check(daemon.stderr.starts_with("slitpose: poses at "), "it says where poses are");
    verdicts.check(ways.len() == poses, "all poses came");
    let least = if conditions.unrecorded { 0 } else { poses as u64 * 30 };
    verdicts.check(*capture_bytes >= least, format!("{capture_bytes} bytes recorded"));
    let pairs = || ways.windows(2).map(|pair| (pair[0], pair[1]));
    verdicts.check(pairs().all(|(before, after)| before.sequence < after.sequence), "scans are in order");
    // What a client misses that does not run for a while is in the datagrams that it did not take. A daemon that does not
    // run for a while passes scans over, and says so.
    let is_whole = |(before, after): (Way, Way)| {
        after.is_behind || after.sequence - before.sequence == after.datagram - before.datagram
    };
    verdicts.check(pairs().all(is_whole), "each scan has a datagram, or is said to be passed over");
    // A machine so busy that the board cannot keep its pace makes a clock of it that is none; but the first
    // ping is answered in any case.
    let timed = ways.iter().filter(|way| way.taken_ns.is_some()).count();
    verdicts.check(timed > 0, format!("{timed} of {poses} poses have the host's time"));
    let is_forward = |way: &Way| {
        way.taken_ns.is_none_or(|taken_ns| taken_ns < way.arrival_ns)
            && [way.written_ns, way.arrival_ns, way.published_ns, way.received_ns].is_sorted()
    };
    let backwards: Vec<&Way> = ways.iter().filter(|way| !is_forward(way)).take(5).collect();
    verdicts.check(backwards.is_empty(), format!("no pose goes back in time: {backwards:?}"));
    for (share, most_us) in MAX_US.into_iter().filter(|_| !conditions.untimed) {
        verdicts.check(total.at(share) <= most_us, format!("{:.0} % within {most_us} us", 100.0 * share));
    }
    verdicts
}

fn print_conditions(conditions: &Conditions) {
    let read = |path: &str| std::fs::read_to_string(path).ok().map(|text| text.trim().to_owned());
    let processors = read("/proc/cpuinfo").unwrap_or_default();
    let model = processors.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": "));
    let kernel = read("/proc/sys/kernel/osrelease");
    let governor = read("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor");
    println!(
        "{} processors ({}), Linux {}, governor {}, load {}",
        std::thread::available_parallelism().map_or(0, usize::from),
        model.map_or("unknown", |(_, model)| model),
        kernel.as_deref().unwrap_or("unknown"),
        governor.as_deref().unwrap_or("unknown"),
        read("/proc/loadavg").as_deref().and_then(|text| text.split(' ').next()).unwrap_or("unknown"),
    );
    println!("at {FRAME_RATE_HZ} Hz, {conditions:?}");
}

fn us(ns: u64) -> f64 {
    ns as f64 * 1e-3
}

fn row(table: &mut Table, name: &str, times_us: impl IntoIterator<Item = f64>) -> Sorted {
    let times = Sorted::of(times_us);
    let quantiles = [0.5, 0.9, 0.99, 0.999, 1.0].map(|share| format!("{:.1}", times.at(share)));
    table.row([name.to_owned()].into_iter().chain(quantiles));
    times
}

/// Prints all times and gives those that count.
fn print(measurement: &Measurement) -> Sorted {
    let Measurement { ways, writes_ns, processor_share, daemon, capture_bytes } = measurement;
    let mut table = Table::new(&["us", "median", "90 %", "99 %", "99.9 %", "longest"]);
    let total = |way: &Way| us(way.received_ns - way.written_ns);
    let all = row(&mut table, "written to received", ways.iter().map(total));
    type Part = (&'static str, fn(&Way) -> [u64; 2]);
    let parts: [Part; 4] = [
        ("read by the daemon to received", |way| [way.arrival_ns, way.received_ns]),
        ("  written to read", |way| [way.written_ns, way.arrival_ns]),
        ("  read to published", |way| [way.arrival_ns, way.published_ns]),
        ("  published to received", |way| [way.published_ns, way.received_ns]),
    ];
    for (name, of) in parts {
        row(&mut table, name, ways.iter().map(|way| us(of(way)[1].saturating_sub(of(way)[0]))));
    }
    for place in 0..=ways.iter().map(|way| way.place).max().unwrap_or(0) {
        let name = format!("written to received, scan {} of a write", place + 1);
        row(&mut table, &name, ways.iter().filter(|way| way.place == place).map(total));
    }
    let between = writes_ns.windows(2).map(|pair| us(pair[1] - pair[0]));
    row(&mut table, "between two writes of the board", between);
    print!("{table}");
    let mut writes: Vec<u64> = ways.iter().map(|way| way.written_ns).collect();
    writes.dedup();
    println!(
        "  {:.1} scans in a write; {:.1} % of a processor for the daemon; {:.1} MB recorded; said: {:?}",
        ways.len() as f64 / writes.len() as f64,
        processor_share * 100.0,
        *capture_bytes as f64 * 1e-6,
        daemon.stderr,
    );
    all
}

fn measure(slitpose: Slitpose, conditions: &Conditions, poses: usize) -> Measurement {
    let folder = tempfile::tempdir().expect("temporary folder");
    let [socket, capture] = ["pose", "latency.mcap"].map(|name| name_in(folder.path(), name));
    let written = Arc::<Mutex<Written>>::default();
    let board =
        Timed { board: Board::wide(70), decoder: Decoder::new(), schedule: None, written: Arc::clone(&written) };
    // The control loop, compiled as a user would.
    let client = compile("tests/latency/latency.c", folder.path());
    let terminal = Terminal::serve(board);

    let publish = format!("{}:{socket}", if conditions.memory { "shm" } else { "unix" });
    let mut arguments = vec!["run", "--config", "none", "--device", &terminal.path, "--format", "none"];
    arguments.extend(["--publish", &publish]);
    if !conditions.unrecorded {
        arguments.extend(["--record", &capture]);
    }
    arguments.extend(conditions.options.iter().map(String::as_str));
    let mut daemon = slitpose.spawn(arguments);
    let started = Instant::now();
    while !Path::new(&socket).exists()
        && started.elapsed() < READY_WITHIN
        && daemon.try_wait().expect("status").is_none()
    {
        std::thread::sleep(Duration::from_millis(5));
    }
    // 0 of one that has ended.
    let processor_s = || Usage::of(daemon.id()).map_or(0.0, |usage| usage.cpu_s);
    let (since, begun_s) = (Instant::now(), processor_s());
    let table = folder.path().join("received");
    let warm_up = (conditions.warm_up * FRAME_RATE_HZ) as usize;
    let mut follow = Command::new(client);
    follow.arg(&publish).args([poses.to_string(), warm_up.to_string()]).arg(&table);
    let client = follow.output().expect("the client starts");
    let processor_share = (processor_s() - begun_s) / since.elapsed().as_secs_f64();
    let daemon = Finished::interrupted(daemon);
    assert!(client.status.success(), "{}; slitpose: {}", String::from_utf8_lossy(&client.stderr), daemon.stderr);
    let summary = String::from_utf8(client.stdout).expect("UTF-8");
    let is_whole = summary.starts_with(&format!("datagrams {}, ", poses + warm_up));
    assert!(is_whole && summary.contains("\nbytes-in to pose-out: median "), "{summary}");
    terminal.closed();

    let written = std::mem::take(&mut *written.lock().unwrap_or_else(PoisonError::into_inner));
    let table = std::fs::read_to_string(&table).expect("a table");
    Measurement {
        ways: table.lines().map(|line| written.way(line)).collect(),
        writes_ns: written.writes_ns,
        processor_share,
        daemon,
        capture_bytes: std::fs::metadata(&capture).map_or(0, |metadata| metadata.len()),
    }
}

/// A board that notes when it wrote each scan.
struct Timed {
    board: Board,
    decoder: Decoder<MAX_MESSAGE_BYTES>,
    schedule: Option<Schedule>,
    written: Arc<Mutex<Written>>,
}

#[derive(Default)]
struct Written {
    writes_ns: Vec<u64>,
    /// For each scan in order: its number, which write it was in, and how many were ahead of it there.
    scans: Vec<(u64, usize, usize)>,
}

impl Device for Timed {
    fn act(&mut self, received: &[u8], now_s: f64, sent: &mut Vec<u8>) -> bool {
        let start = sent.len();
        let plugged = self.board.act(received, now_s, sent);
        let mut written = self.written.lock().unwrap_or_else(PoisonError::into_inner);
        let (mut bytes, write, mut place) = (&sent[start..], written.writes_ns.len(), 0);
        while let Some(message) = self.decoder.next::<Message<'_>>(&mut bytes) {
            match (message.expect("undamaged"), &self.schedule) {
                (Message::Hello(hello), _) => self.schedule = Some(hello.schedule),
                (Message::Batch(batch), Some(schedule)) => {
                    for scan in batch.scans(schedule).expect("readable") {
                        written.scans.push((scan.sequence, write, place));
                        place += 1;
                    }
                }
                _ => {}
            }
        }
        if place > 0 {
            // The write is what its caller does next.
            let now = clock_gettime(ClockId::CLOCK_MONOTONIC).expect("a clock");
            written.writes_ns.push(now.tv_sec() as u64 * 1_000_000_000 + now.tv_nsec() as u64);
        }
        plugged
    }
}

impl Written {
    /// The whole way of a pose, of which the client has noted this.
    fn way(&self, line: &str) -> Way {
        // Bits of a datagram's flags: the host's time of the scan is known, and scans before it were passed over.
        const HAS_HOST_TIME: u64 = 4;
        const BEHIND: u64 = 32;
        let numbers: Vec<u64> = line.split(' ').map(|number| number.parse().expect("a number")).collect();
        let [sequence, datagram, flags, taken_ns, arrival_ns, published_ns, received_ns] = numbers[..] else {
            panic!("`{line}` is no line of seven numbers");
        };
        let at =
            self.scans.binary_search_by_key(&sequence, |(sequence, ..)| *sequence).expect("a scan that was written");
        let (_, write, place) = self.scans[at];
        let taken_ns = (flags & HAS_HOST_TIME != 0).then_some(taken_ns);
        let (written_ns, is_behind) = (self.writes_ns[write], flags & BEHIND != 0);
        Way { written_ns, place, sequence, datagram, is_behind, taken_ns, arrival_ns, published_ns, received_ns }
    }
}
