//! Several boards for a long time, everything switched on: nothing is lost anywhere, and nothing grows.

use std::process::Stdio;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use clap::Args;
use nix::sys::signal::Signal;
use serde_json::Value;
use slitpose_head::scene_file::WIDE;
use slitpose_model::Tier;
use slitpose_protocol::{Decoder, MAX_MESSAGE_BYTES, Message, Schedule};

use super::scan_table::{self, Scans};
use super::{Table, Verdicts, check_growth, mib};
use crate::daemon::{Daemon, Ended, Subscriber, Usage, boards, scans};
use crate::process::{Slitpose, name_in};
use crate::terminal::{BACKLOG_BYTES, Board, Device, Terminal, packet};

/// An account is renewed each 200 ms, also when nothing comes; boards that are silent for longer than 450 ms
/// are missed.
const BREATH_HELD: Duration = Duration::from_millis(400);

/// How often the boards hold their breath until the account is found to be complete.
const BREATHS: usize = 5;

#[derive(Debug, Args)]
pub struct Conditions {
    /// Boards, each at 4 kHz on a pseudo-terminal
    #[arg(long, default_value_t = 4)]
    boards: u8,
    /// For how long, such as 10m
    #[arg(long, default_value = "10m", value_parser = humantime::parse_duration)]
    duration: Duration,
    /// Looks at the process this far apart
    #[arg(long, default_value = "1s", value_parser = humantime::parse_duration)]
    every: Duration,
    /// Memory may grow by so many KiB from the second quarter to the last
    #[arg(long, default_value_t = 2048.0)]
    most_growth_kib: f64,
}

/// What the study and a board tell each other.
#[derive(Debug, Default)]
struct Meter {
    scans: AtomicU64,
    /// Whether it is to take no scans at the moment.
    holds_breath: AtomicBool,
    is_unplugged: AtomicBool,
}

/// A board that counts its scans and sends no truths: no real one does.
struct Metered {
    board: Board,
    meter: Arc<Meter>,
    decoder: Decoder<MAX_MESSAGE_BYTES>,
    schedule: Option<Schedule>,
    sampled_s: f64,
}

impl Device for Metered {
    fn act(&mut self, received: &[u8], now_s: f64, sent: &mut Vec<u8>) -> bool {
        // Without time passing a board answers and takes no scans.
        if sent.len() <= BACKLOG_BYTES && !self.meter.holds_breath.load(Ordering::Relaxed) {
            self.sampled_s = now_s;
        }
        let mut own = Vec::new();
        let plugged = self.board.act(received, self.sampled_s, &mut own);
        let mut bytes = &own[..];
        while let Some(message) = self.decoder.next::<Message<'_>>(&mut bytes) {
            let message = message.expect("undamaged");
            match &message {
                Message::Truth(_) => continue,
                Message::Hello(hello) => self.schedule = Some(hello.schedule.clone()),
                Message::Batch(batch) => {
                    let scans = batch.scans(self.schedule.as_ref().expect("hello first")).expect("readable").len();
                    self.meter.scans.fetch_add(scans as u64, Ordering::Relaxed);
                }
                _ => {}
            }
            sent.extend(packet(&message));
        }
        plugged && !self.meter.is_unplugged.load(Ordering::Relaxed)
    }
}

pub fn study(slitpose: Slitpose, conditions: &Conditions) -> Verdicts {
    let file = WIDE.read().expect("shipped");
    let meters: Vec<Arc<Meter>> = (0..conditions.boards).map(|_| Arc::default()).collect();
    let terminals: Vec<Terminal> = (0..conditions.boards)
        .zip(&meters)
        .map(|(number, meter)| {
            let board = Board::numbered(number, &file, Tier::Paper, 100 + u64::from(number));
            let (meter, decoder) = (Arc::clone(meter), Decoder::new());
            Terminal::serve_until_pulled(Metered { board, meter, decoder, schedule: None, sampled_s: 0.0 })
        })
        .collect();
    let folder = tempfile::tempdir().expect("temporary folder");
    let [capture, publish] = ["soak.mcap", "publish"].map(|name| name_in(folder.path(), name));
    let mut arguments = vec!["--format".to_owned(), "none".to_owned(), "--record".to_owned(), capture.clone()];
    arguments.extend(["--publish".to_owned(), format!("unix:{publish}")]);
    arguments.extend(terminals.iter().flat_map(|terminal| ["--device".to_owned(), terminal.path.clone()]));
    let daemon = Daemon::start(None, slitpose, folder, &arguments, Stdio::null());
    let subscriber = Subscriber::start(publish.into());
    daemon.await_scans(meters.len());

    let begun = Instant::now();
    let (mut usages, mut looks, mut status) = (Vec::new(), Vec::new(), Value::Null);
    while begun.elapsed() < conditions.duration {
        // Read before the status is requested: that connection would count as a descriptor.
        usages.push(daemon.usage().expect("the daemon runs"));
        status = daemon.status().expect("the daemon tells how it goes");
        looks.push((begun.elapsed().as_secs_f64(), scans(&status).iter().sum::<u64>()));
        std::thread::sleep((conditions.every * looks.len() as u32).saturating_sub(begun.elapsed()));
    }
    let reported = hold_breath(&daemon, &meters);
    let Ended { status: exit, stderr, folder: _folder } = daemon.end_by(Signal::SIGINT);
    meters.iter().for_each(|meter| meter.is_unplugged.store(true, Ordering::Relaxed));
    terminals.into_iter().for_each(|terminal| drop(terminal.closed()));
    let datagrams = subscriber.end();
    let capture_bytes = std::fs::metadata(&capture).map_or(0, |metadata| metadata.len());
    let (captured, replayed) = scan_table::count(slitpose, &capture, &["--tier", "paper"]);
    let captured: Vec<Scans> = captured.into_values().collect();
    let all = |count: fn(&Scans) -> u64| captured.iter().map(count).collect::<Vec<_>>();
    let sent: Vec<u64> = meters.iter().map(|meter| meter.scans.load(Ordering::Relaxed)).collect();
    let count: u64 = all(|scans| scans.count).iter().sum();

    let Conditions { boards: number, duration, .. } = conditions;
    println!("{number} boards at 4 kHz, exact 1e-6, recorded and published, for {duration:?}");
    let ([first, .., last], [(from_s, before), .., (to_s, after)]) = (&usages[..], &looks[..]) else {
        panic!("too short for two looks")
    };
    let (cpu_s, scans) = (last.cpu_s - first.cpu_s, after - before);
    let percent = 100.0 * cpu_s / (to_s - from_s);
    println!(
        "  processor: {percent:.1} % of one core, {:.1} % a board, {:.1} us a scan ({scans} scans)",
        percent / f64::from(*number),
        1e6 * cpu_s / scans as f64
    );
    println!(
        "  {:.2} MiB at most; {} threads, {} descriptors; capture: {capture_bytes} bytes, {:.1} a scan; {datagrams} datagrams",
        mib(last.peak_bytes),
        last.threads,
        last.descriptors,
        capture_bytes as f64 / count as f64
    );
    let mut table = Table::new(&[
        "board",
        "sent",
        "captured",
        "degraded",
        "light to pose, ms: 50/99/99.9 %, most",
        "read to pose, us: 50/99/99.9 %, most",
    ]);
    for (number, board) in boards(&status).enumerate() {
        let at = |of: &str, unit: f64| {
            let part = |quantile: &str| board["latencies"][of]["total"][quantile].as_f64().unwrap_or(f64::NAN) * unit;
            let [p50, p99, p999, max] = ["p50_s", "p99_s", "p999_s", "max_s"].map(part);
            format!("{p50:.2}/{p99:.2}/{p999:.2}, {max:.1}")
        };
        let captured = captured.get(number).map_or(0, |scans| scans.count);
        let numbers = [number as u64, sent[number], captured].map(|number| number.to_string());
        let rest = [board["outcomes"]["degraded"].to_string(), at("total", 1e3), at("host", 1e6)];
        table.row(numbers.into_iter().chain(rest));
    }
    print!("{table}");

    let mut verdicts = Verdicts::default();
    // A machine that is busy with other things leaves scans unsolved, which is no loss of data: they are in the capture.
    let is_behind = stderr.contains("scans were not solved: the solver was behind");
    let code = if is_behind { 3 } else { 0 };
    verdicts.check(exit.code() == Some(code), format!("the daemon ends with {code}: {exit}: {stderr}"));
    let is_reported = reported.iter().all(|(reported, sent)| reported == sent);
    verdicts.check(is_reported, format!("the daemon reports what was sent: {reported:?}"));
    let counts = all(|scans| scans.count);
    verdicts.check(counts == sent, format!("captured {counts:?} of {sent:?} scans"));
    verdicts.check(all(|scans| scans.jumps).iter().all(|jumps| *jumps == 0), "scans follow each other");
    verdicts.check(all(|scans| scans.poses) == counts, "each scan has a pose");
    verdicts.check(replayed.code == 0, format!("the capture is whole: {} {}", replayed.code, replayed.stderr));
    verdicts.check(datagrams > 0, "the client was sent poses");
    for board in boards(&status) {
        let mut losses = board["losses"].clone();
        // It is not the daemon's fault when the machine has no time for the subscriber.
        losses["host"]["poses_unsent"] = 0.into();
        let (is_whole, reconnects) = (is_zero(&losses), &board["link"]["reconnects"]);
        verdicts.check(*reconnects == 0 && is_whole, format!("nothing lost, never reconnected: {losses} {reconnects}"));
    }
    check_growth(
        &mut verdicts,
        &usages.iter().map(|usage| usage.resident_bytes).collect::<Vec<_>>(),
        conditions.most_growth_kib,
    );
    // Within the first quarter all has begun, and a client been admitted.
    let settled = &usages[usages.len() / 4..];
    let is_constant = |of: fn(&Usage) -> u64| settled.iter().all(|usage| of(usage) == of(&settled[0]));
    verdicts.check(is_constant(|usage| usage.threads), "the number of threads is constant");
    verdicts.check(is_constant(|usage| usage.descriptors), "the number of descriptors is constant");
    verdicts
}

/// Lets no board take scans until the daemon has accounted for all it was sent: what it reports, and what was sent.
fn hold_breath(daemon: &Daemon, meters: &[Arc<Meter>]) -> Vec<(u64, u64)> {
    let mut both = Vec::new();
    for _ in 0..BREATHS {
        meters.iter().for_each(|meter| meter.holds_breath.store(true, Ordering::Relaxed));
        let since = Instant::now();
        while since.elapsed() < BREATH_HELD {
            let reported = daemon.status().map(|status| scans(&status)).unwrap_or_default();
            let sent = meters.iter().map(|meter| meter.scans.load(Ordering::Relaxed));
            both = reported.into_iter().zip(sent).collect();
            if !both.is_empty() && both.iter().all(|(reported, sent)| reported == sent) {
                break;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        meters.iter().for_each(|meter| meter.holds_breath.store(false, Ordering::Relaxed));
        if both.iter().all(|(reported, sent)| reported == sent) {
            break;
        }
        std::thread::sleep(Duration::from_secs(1));
    }
    both
}

fn is_zero(value: &Value) -> bool {
    match value {
        Value::Object(object) => object.values().all(is_zero),
        value => value == 0,
    }
}
