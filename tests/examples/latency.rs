//! How long a pose takes from a board's bytes to a control loop in C, in a table on stdout; exit code
//! 1 if it takes longer than it may.
//!
//! `cargo run --release -p slitpose-tests --example latency -- [--seconds 30] [--unrecorded] [--pages 20] [-- OPTIONS OF run]`
//!
//! The board is virtual and runs in this process, on a pseudo-terminal. The daemon is this program
//! once more: cargo builds no other for an example, and `slitpose` is what its arguments make of it. With
//! `--against PROGRAM`, another build of `slitpose`, both are measured by turns, and compared.

use std::ffi::OsStr;
use std::path::PathBuf;
use std::process::ExitCode;
use std::thread::available_parallelism;

use clap::Parser;
use slitpose_tests::acceptance::live_pages::{Page, look};
use slitpose_tests::latency::{Distribution, Measurement, Plan, measure};
use slitpose_tests::process::Slitpose;
use slitpose_tests::terminal::FRAME_RATE_HZ;

/// Bytes in to pose out, half of all poses, µs.
const MOST_MEDIAN_US: f64 = 150.0;

/// As many, 99 % of all poses, µs.
const MOST_P99_US: f64 = 1000.0;

/// Scans in one write of a board that writes each millisecond.
const PLACES: usize = 4;

#[derive(Parser)]
#[command(about = "Time from a board's bytes to a control loop")]
struct Options {
    /// Seconds that are measured, after one that is not
    #[arg(long, default_value_t = 30.0)]
    seconds: f64,
    /// Without a recorder
    #[arg(long)]
    unrecorded: bool,
    /// So many live pages look at the board meanwhile, of which one stalls
    #[arg(long, default_value_t = 0)]
    pages: usize,
    /// Another `slitpose`, to compare with
    #[arg(long, value_name = "PROGRAM")]
    against: Option<PathBuf>,
    /// More options of `slitpose run`
    #[arg(last = true)]
    options: Vec<String>,
}

fn main() -> ExitCode {
    if std::env::args_os().nth(1).as_deref() == Some(OsStr::new("run")) {
        return slitpose::commands::main(std::env::args_os());
    }
    let options = Options::parse();
    let own = std::env::current_exe().expect("this program").to_str().expect("UTF-8").to_owned();
    let mut run = options.options;
    if options.pages > 0 {
        let pages = [Page::Sleeps].into_iter().chain(std::iter::repeat_n(Page::Takes, options.pages - 1));
        run.extend(["--live".to_owned(), look(pages).to_string()]);
    }
    let plan = Plan {
        warm_up: FRAME_RATE_HZ as usize,
        poses: (options.seconds * FRAME_RATE_HZ) as usize,
        recorded: !options.unrecorded,
        options: run,
    };
    print_conditions(&plan);
    let slitpose = Slitpose::at(own.leak());
    if let Some(other) = options.against {
        compare(slitpose, Slitpose::given_or_beside(Some(other)), &plan);
        return ExitCode::SUCCESS;
    }
    let measurement = measure(slitpose, &plan);
    let total = print(&measurement);
    let (median_us, p99_us) = (total.quantile_us(0.5), total.quantile_us(0.99));
    let is_met = median_us <= MOST_MEDIAN_US && p99_us <= MOST_P99_US;
    let verdict = if is_met { "met" } else { "NOT MET" };
    println!("bounds of written to received: median {MOST_MEDIAN_US} us, 99 % {MOST_P99_US} us: {verdict}");
    ExitCode::from(u8::from(!is_met))
}

/// Poses that each of two programs is given at a turn.
const TURN: usize = 24_000;

/// Prints how both do.
fn compare(slitpose: Slitpose, other: Slitpose, plan: &Plan) {
    let turns = plan.poses.div_ceil(TURN);
    let plan = Plan { poses: TURN, ..plan.clone() };
    let (mut times_ns, mut shares) = ([Vec::new(), Vec::new()], [0.0; 2]);
    for _ in 0..turns {
        for (which, program) in [slitpose, other].into_iter().enumerate() {
            let Measurement { ways, processor_share, .. } = measure(program, &plan);
            times_ns[which].extend(ways.iter().map(|way| way.received.received_ns - way.written_ns));
            shares[which] += processor_share / turns as f64;
        }
    }
    println!("{turns} turns of {TURN} poses each\n\n{:<34}{}  us of a processor a scan", "us", Distribution::HEADING);
    let scan_us = shares.map(|share| share / FRAME_RATE_HZ * 1e6);
    for (which, name) in ["this", "the other"].into_iter().enumerate() {
        let times = Distribution::of(times_ns[which].iter().copied());
        println!("{name:<34}{times}{:>12.2}", scan_us[which]);
    }
    println!("\nthis takes {:.2} of the other's processor time", scan_us[0] / scan_us[1]);
}

fn print_conditions(plan: &Plan) {
    let read = |path: &str| std::fs::read_to_string(path).ok().map(|text| text.trim().to_owned());
    let cores = available_parallelism().map_or(0, usize::from);
    let system = nix::sys::utsname::uname().expect("a system");
    let processors = read("/proc/cpuinfo").unwrap_or_default();
    let model = processors.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": "));
    let governor = read("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor");
    println!(
        "{cores} processors ({}), {} {}, governor {}, load {}",
        model.map_or("unknown", |(_, model)| model),
        system.sysname().to_string_lossy(),
        system.release().to_string_lossy(),
        governor.as_deref().unwrap_or("unknown"),
        read("/proc/loadavg").as_deref().and_then(|text| text.split(' ').next()).unwrap_or("unknown"),
    );
    let recorder = if plan.recorded { "on" } else { "off" };
    println!("{} poses at {FRAME_RATE_HZ} Hz, recorder {recorder}, options {:?}", plan.poses, plan.options);
}

/// Prints all tables and gives the one that counts.
fn print(measurement: &Measurement) -> Distribution {
    let Measurement { ways, writes_ns, .. } = measurement;
    let total = Distribution::of(ways.iter().map(|way| way.received.received_ns - way.written_ns));
    println!("\n{:<34}{}", "us", Distribution::HEADING);
    let row = |name: &str, distribution: &Distribution| println!("{name:<34}{distribution}");
    row("written to received", &total);
    let daemon = ways.iter().map(|way| way.received.received_ns - way.received.arrival_ns);
    row("read by the daemon to received", &Distribution::of(daemon));
    let terminal = ways.iter().map(|way| way.received.arrival_ns - way.written_ns);
    row("  written to read", &Distribution::of(terminal));
    let solving = ways.iter().map(|way| way.received.published_ns - way.received.arrival_ns);
    row("  read to published", &Distribution::of(solving));
    let sending = ways.iter().map(|way| way.received.received_ns - way.received.published_ns);
    row("  published to received", &Distribution::of(sending));
    for place in 0..PLACES {
        let placed = ways.iter().filter(|way| way.place == place);
        let total: Vec<u64> = placed.map(|way| way.received.received_ns - way.written_ns).collect();
        if !total.is_empty() {
            row(&format!("written to received, scan {} of a write", place + 1), &Distribution::of(total));
        }
    }
    row("between two writes of the board", &Distribution::of(writes_ns.windows(2).map(|pair| pair[1] - pair[0])));
    println!(
        "\n{:.1} scans in a write; {:.1} % of a processor for the daemon; {:.1} MB recorded; said: {:?}",
        (ways.len() as f64) / (measurement_writes(measurement) as f64),
        measurement.processor_share * 100.0,
        measurement.capture_bytes as f64 * 1e-6,
        measurement.daemon.stderr,
    );
    total
}

/// How many writes brought the poses that were measured.
fn measurement_writes(measurement: &Measurement) -> usize {
    let mut writes: Vec<u64> = measurement.ways.iter().map(|way| way.written_ns).collect();
    writes.dedup();
    writes.len()
}
