//! `slitpose-emulator`: a board without a board, behind a pseudo-terminal.

use std::fmt;
use std::io::{self, Read, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use clap::Parser;
use slitpose_emulator::faults::{Fault, Faults, Kind};
use slitpose_emulator::machine::Stop;
use slitpose_emulator::peripherals::{TICKS_PER_SECOND, Ticks};
use slitpose_emulator::rig::{Link, Rig, open_image};
use slitpose_emulator::terminal::Terminal;
use slitpose_emulator::world::NoiseSource;
use slitpose_head::causes::with_causes;
use slitpose_head::pace::{Pace, Speed};
use slitpose_head::scene_file::SceneFile;
use slitpose_head::simulator::{Trajectory, TrajectoryKind};

/// Device time between two looks at the terminal: half a USB frame.
const SLICE_TICKS: Ticks = TICKS_PER_SECOND / 2_000;

/// While a reader is this slow to take what has come, the board's time stands still; then it
/// goes on, and the board sees a host that does not read.
const PATIENCE: Duration = Duration::from_secs(10);

/// Motions are planned for this long, in seconds.
const HORIZON_S: f64 = 3600.0;

/// An STM32G474 in software that runs the board's image in front of the head of a scene.
///
/// Prints the path of a pseudo-terminal that stands for the board's serial port, and runs until
/// standard input is closed. Give the path to `slitpose run --device`.
#[derive(Debug, Parser)]
#[command(name = "slitpose-emulator", version, after_help = "Example:\n  slitpose-emulator wide < /dev/tty")]
struct Args {
    /// Scene file, or the name of a shipped scene
    scene: String,
    /// The image [default: what firmware/build made last]
    #[arg(long, value_name = "FILE")]
    elf: Option<PathBuf>,
    /// still, hand, smooth, fast, contact, or a CSV table with time_s and the columns of a pose
    #[arg(long, value_name = "MOTION", default_value = "smooth")]
    trajectory: String,
    /// Seed of motion and noise
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// No noise at all
    #[arg(long)]
    quiet: bool,
    /// Device seconds a second, or max
    #[arg(long, value_name = "N", default_value_t = Speed::Times(1.0), allow_negative_numbers = true)]
    speed: Speed,
    /// What the silicon does against its manual: names separated by commas, or all [default: nothing]
    #[arg(long, value_name = "FAULTS", env = "SLITPOSE_SILICON", value_parser = Faults::of_silicon, long_help = format!("What the silicon does against its manual: names separated by commas, or all [default: nothing]\n{}", Fault::list(Kind::Silicon)))]
    silicon: Option<Faults>,
    /// What is wrong with board and head: names separated by commas [default: nothing]
    #[arg(long, value_name = "FLAWS", value_parser = Faults::of_board, long_help = format!("What is wrong with board and head: names separated by commas [default: nothing]\n{}", Fault::list(Kind::Board)))]
    flaw: Option<Faults>,
    /// The board's link that the terminal stands for
    #[arg(long, value_enum, default_value_t = Link::Usb)]
    link: Link,
}

fn main() -> ExitCode {
    let Err(failure) = run(&Args::parse()) else { return ExitCode::SUCCESS };
    talk(format_args!("{}", with_causes(failure.as_ref())));
    ExitCode::FAILURE
}

/// Says something on standard error, if that is open.
fn talk(text: fmt::Arguments<'_>) {
    let _ = writeln!(io::stderr(), "slitpose-emulator: {text}");
}

fn run(args: &Args) -> Result<()> {
    let scene = SceneFile::open(&args.scene)?;
    let image = open_image(args.elf.as_deref())?;
    let trajectory = match TrajectoryKind::named(&args.trajectory) {
        Some(kind) => Trajectory::of_kind(kind, args.seed, HORIZON_S).within(&scene.workspace),
        None => Trajectory::from_table(&args.trajectory)?,
    };
    let noise = if args.quiet { NoiseSource::Off } else { NoiseSource::Seeded(args.seed) };
    let faults = args.silicon.unwrap_or_default().and(args.flaw.unwrap_or_default());
    let rig = Rig::boot(&image, &scene, trajectory, noise, faults)?.with_link(args.link);
    let terminal = Terminal::open()?;
    let mut out = io::stdout();
    let written = writeln!(out, "{}", terminal.path().display()).and_then(|()| out.flush());
    written.context("cannot write to standard output")?;
    let (pace, started) = (Pace::new(args.speed), Instant::now());
    let mut session = Session { rig, terminal, pace, started, pending: Vec::new(), stuck: None };
    let outcome = session.follow(&stdin_closed());
    session.report();
    outcome
}

/// Becomes true when standard input ends.
fn stdin_closed() -> Arc<AtomicBool> {
    let closed = Arc::new(AtomicBool::new(false));
    let told = Arc::clone(&closed);
    thread::spawn(move || {
        let mut sink = [0; 256];
        while matches!(io::stdin().read(&mut sink), Ok(bytes) if bytes > 0) {}
        told.store(true, Ordering::Relaxed);
    });
    closed
}

struct Session {
    rig: Rig,
    terminal: Terminal,
    pace: Pace,
    started: Instant,
    /// What the terminal has not taken yet, and since when.
    pending: Vec<u8>,
    stuck: Option<Instant>,
}

impl Session {
    fn follow(&mut self, closed: &AtomicBool) -> Result<()> {
        let mut from_terminal = [0; 4096];
        while !closed.load(Ordering::Relaxed) {
            // What was written before the port was closed still goes to the board.
            let open = self.terminal.is_open()?;
            let bytes = self.terminal.read(&mut from_terminal)?;
            self.rig.send_bytes(bytes);
            if open || bytes.is_empty() {
                self.rig.set_open(open);
            }
            if !open {
                self.pending.clear();
            }
            let end = self.rig.now() + SLICE_TICKS;
            match self.rig.run_until(end) {
                // Nothing here takes its supply away.
                Stop::Reached | Stop::PoweredOff => {}
                Stop::BootLoader => bail!("the board has started its boot loader, which is not emulated"),
                Stop::Lockup(report) => bail!("the board is dead: {report}"),
            }
            let bytes = self.rig.take_bytes();
            if open {
                self.pending.extend(bytes);
                self.hand_over(closed)?;
            }
            self.pace.wait(self.device_s());
        }
        Ok(())
    }

    /// Gives the terminal what has come, and waits a while for a slow reader.
    fn hand_over(&mut self, closed: &AtomicBool) -> Result<()> {
        let begun = Instant::now();
        loop {
            let taken = self.terminal.write(&self.pending)?;
            self.pending.drain(..taken);
            if taken > 0 || self.pending.is_empty() {
                self.stuck = None;
            }
            if self.pending.is_empty() {
                self.rig.stop_reading(false);
                break;
            }
            if self.stuck.get_or_insert_with(Instant::now).elapsed() > PATIENCE {
                self.rig.stop_reading(true);
                break;
            }
            if closed.load(Ordering::Relaxed) || !self.terminal.is_open()? {
                break;
            }
            thread::sleep(Duration::from_micros(100));
        }
        self.pace.excuse(begun.elapsed());
        Ok(())
    }

    fn device_s(&self) -> f64 {
        self.rig.now() as f64 / TICKS_PER_SECOND as f64
    }

    fn report(&mut self) {
        let device_s = self.device_s();
        let wall_s = self.started.elapsed().as_secs_f64();
        talk(format_args!(
            "{device_s:.3} s of device time in {wall_s:.3} s, ratio {:.2}; \
             {:.1} million instructions a second; stack {} bytes at most",
            device_s / wall_s,
            self.rig.machine.cpu.instructions() as f64 / wall_s / 1e6,
            self.rig.stack_bytes(),
        ));
        for fault in self.rig.faults() {
            talk(format_args!("{fault}"));
        }
    }
}
