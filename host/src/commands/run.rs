//! `slitpose run`: poses of boards, live.

use std::io::{self, IsTerminal};
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, OnceLock};
use std::time::{Duration, Instant};

use clap::ValueEnum;
use slitpose_calibration::{Basis, Head};
use slitpose_protocol::{Pulse, Stream};

use super::calibrate::from_recordings;
use super::live::{LiveOptions, changes};
use super::options::{PoseOptions, open_scene, parse_duration};
use super::record::RecordOptions;
use super::simulate::ToolOptions;
use super::{CommandError, Outcome, interrupt, options, talk, usage};
use crate::address::Address;
use crate::daemon::{Admit, BoardPlan, Daemon, Ended, Opener, Plan};
use crate::datagram::{self, DatagramServer, MAX_BOARDS};
use crate::device::{Contact, Search, Selector, SimulatedPort};
use crate::live::{LiveBoard, LivePlan};
use crate::platform;
use crate::sink;
use crate::telemetry::{serve_status, status_address};
use crate::terminal;
use slitpose_head::front_end;
use slitpose_head::pace::Speed;
use slitpose_head::scene_file::SceneFile;
use slitpose_head::table::OutputError;
use slitpose_head::threads::lock;
use slitpose_tracking::clock::{HostInstant, UtcWatch};
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::pipeline::{self, PipelineOptions, PoseSource, SceneMatch};
use slitpose_tracking::solving::head_by;
use slitpose_tracking::telemetry::{DaemonReport, RecorderReport, RecorderState};

/// Period of checks for ended boards, and of housekeeping.
const MOMENT: Duration = Duration::from_millis(20);

/// Period of the daemon's report in the capture.
const ACCOUNT_EVERY: Duration = Duration::from_secs(1);

/// Follows the tool in front of a board, or of several.
///
/// Finds the board, starts it with the schedule of the scene and prints a pose for each scan: a
/// summary on a terminal, one JSON object a line otherwise. A board that is unplugged is looked for until
/// it is back. Simulated poses are marked and come with the true ones.
///
/// Ends with exit code 3 if data were damaged or lost on the way, or scans were not solved because the solver was behind
/// (neither those that waited at an interrupt nor a packet that was under way count).
///
/// Each option may also stand in the environment (SLITPOSE_DEVICE, SLITPOSE_SCENE, …) or in a
/// configuration file (device = "auto"). Flags override environment variables, which override the file.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose run --scene head.toml\n  \
                  slitpose run --device sim --live --open\n  \
                  slitpose run --device sim --trajectory contact --record contact.mcap > poses.ndjson\n  \
                  slitpose run --device sim --duration 3s --fault occlude:cell=2,from=1s,for=500ms\n  \
                  slitpose run --device /dev/ttyACM0 --publish unix:/run/slitpose/pose --status 127.0.0.1:7450 --format none")]
pub(super) struct Args {
    /// Which board: `auto`, a serial number, the path of a port, or `sim`, a simulated one; once for each
    /// board
    #[arg(long, value_name = "DEVICE", value_delimiter = ',', default_value = "auto", value_parser = options::devices(), hide_possible_values = true)]
    device: Vec<String>,
    /// Scene file, or the name of a shipped scene; one for all boards, or one for each
    #[arg(long, value_name = "SCENE", value_delimiter = ',', default_value = "wide", value_parser = options::scenes(), hide_possible_values = true)]
    scene: Vec<String>,
    /// Calibration of the head, as `slitpose calibrate` wrote it, one for each board; or none: the head is as
    /// its scene says
    #[arg(long, value_name = "FILE", value_delimiter = ',')]
    calibration: Vec<PathBuf>,
    /// What the board sends: its scans, which are solved here; poses that it finds itself, and a sample of its scans to
    /// check them by; or both, solved here and compared. A board that shall solve poses is sent its head first
    #[arg(long, value_enum, value_name = "WHAT", default_value_t = StreamName::Raw)]
    stream: StreamName,
    /// Frame rate instead of the scene's, such as 8kHz; conversions are halved until they fit in a frame
    #[arg(long, value_name = "RATE", value_parser = parse_rate)]
    rate: Option<f64>,
    /// Fewer scans in a packet, for a lower latency: one up to 6 kHz, more above, as USB requires
    #[arg(long)]
    latency: bool,
    /// Pulses at the board's frame output: one every so many frames, from the first sample of a slot on; such as 4, or
    /// 4:2 for slot 2
    #[arg(long, value_name = "FRAMES[:SLOT]", value_parser = parse_pulse)]
    pulse: Option<Pulse>,
    #[command(flatten)]
    poses: PoseOptions,
    #[command(flatten)]
    record: RecordOptions,
    /// Send poses as datagrams: unix:PATH, or udp:127.0.0.1:PORT; or write them to shared memory: shm:NAME
    #[arg(long, value_name = "ADDRESS", value_delimiter = ',', value_parser = datagram::address)]
    publish: Vec<Address>,
    /// Serve the state as text, as JSON and for Prometheus at 127.0.0.1:PORT, or unix:PATH
    #[arg(long, value_name = "ADDRESS", value_parser = status_address)]
    status: Option<Address>,
    #[command(flatten)]
    live: LiveOptions,
    /// How long to look for a board that is not there: a time, or `forever`
    #[arg(long, value_name = "TIME", value_parser = parse_patience)]
    patience: Option<Patience>,
    /// Ports to look at for boards, besides those on USB, such as '/dev/ttyS*'
    #[arg(long, value_name = "PATTERN", value_delimiter = ',')]
    search: Vec<String>,
    /// Read and solve with real-time priority (SCHED_FIFO), 1 to 99
    #[arg(long, value_name = "PRIORITY", value_parser = clap::value_parser!(u8).range(1..=99))]
    real_time: Option<u8>,
    /// Seconds of a simulated board's clock per second, or max
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    speed: Option<Speed>,
    #[command(flatten)]
    tool: ToolOptions,
    /// Configuration file, or none
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Print the options in force as a configuration file, and end
    #[arg(long)]
    pub(super) print_config: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum StreamName {
    Raw,
    Pose,
    Both,
}

impl StreamName {
    fn stream(self) -> Stream {
        match self {
            Self::Raw => Stream::SCANS,
            Self::Pose => Stream::POSES,
            Self::Both => Stream::BOTH,
        }
    }

    fn source(self) -> PoseSource {
        if self == Self::Pose { PoseSource::Board } else { PoseSource::Host }
    }
}

/// How long to look for a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Patience(Option<Duration>);

fn parse_patience(text: &str) -> Result<Patience, String> {
    match text {
        "forever" => Ok(Patience(None)),
        "0" | "0s" => Ok(Patience(Some(Duration::ZERO))),
        _ => Ok(Patience(Some(Duration::try_from_secs_f64(parse_duration(text)?).unwrap_or(Duration::MAX)))),
    }
}

/// Frames a second of boards: a link carries no more, and motion is not followed with fewer.
const RATES_HZ: [f64; 2] = [10.0, 10e3];

fn parse_rate(text: &str) -> Result<f64, String> {
    let rate_hz = options::parse_frequency(text);
    let [least, most] = RATES_HZ;
    rate_hz.filter(|rate_hz| (least..=most).contains(rate_hz)).ok_or_else(|| {
        format!("give a frame rate from {least}Hz to {}kHz, such as 8kHz; USB carries no more", most * 1e-3)
    })
}

fn parse_pulse(text: &str) -> Result<Pulse, String> {
    let (every, slot) = text.split_once(':').unwrap_or((text, "0"));
    match (every.parse(), slot.parse()) {
        (Ok(every @ 1..), Ok(slot)) => Ok(Pulse { every, slot }),
        _ => Err(format!("give a number of frames from 1 to {}, and perhaps a slot, counted from 0: 4:2", u16::MAX)),
    }
}

pub(super) fn run(args: &mut Args) -> Result<Outcome, CommandError> {
    if args.live.is_wanted() {
        args.tool.default_motion = "hand";
    }
    if let (StreamName::Pose, Some(option)) = (args.stream, args.poses.for_this_program()) {
        return Err(usage!(
            "{option} says how this program solves poses, and with --stream pose the board does; leave one of both out"
        )
        .into());
    }
    if args.latency && args.stream != StreamName::Raw {
        return Err(
            usage!("--latency is for scans, and USB does not carry poses beside them so; leave out --stream").into()
        );
    }
    let boards = args.boards()?;
    if let Some(memory) = args.publish.iter().find(|address| matches!(address, Address::Memory(_)))
        && boards.len() > MAX_BOARDS
    {
        let next_step = "give unix:PATH, or run two programs";
        return Err(usage!("{memory} takes the poses of {MAX_BOARDS} boards, not {}; {next_step}", boards.len()).into());
    }
    args.tool.faults.tell();
    let stop = interrupt()?;
    let datagrams = if args.publish.is_empty() { None } else { Some(DatagramServer::bind(&args.publish)?) };
    for address in datagrams.iter().flat_map(DatagramServer::addresses) {
        talk(format_args!("poses at {address}"));
    }
    let output = io::BufWriter::with_capacity(1 << 16, io::stdout());
    let is_terminal = io::stdout().is_terminal();
    let sink = sink::open(args.poses.format(is_terminal), output, is_terminal && terminal::is_live());
    // All that can fail comes before the first thread: a board that is lit is stopped by its own.
    let (began, followed) = (HostInstant::now(), Arc::new(OnceLock::<Arc<Daemon>>::new()));
    let reports = || {
        let followed = Arc::clone(&followed);
        move || match followed.get() {
            Some(daemon) => daemon.report(),
            None => DaemonReport::of(began, HostInstant::now(), Vec::new(), RecorderReport::default()),
        }
    };
    let access = args.live.access()?;
    let is_recorded_later = access.as_ref().is_some_and(|access| access.may_write);
    let shown = || {
        let shown = |board: &BoardPlan| LiveBoard { name: board.opener.name(), head: board.head.clone() };
        boards.iter().map(shown).collect()
    };
    let control = || changes(Arc::clone(&followed), args.record.clone());
    let live = match access {
        Some(access) => Some(args.live.access.start(LivePlan {
            access,
            source: "run",
            boards: shown(),
            scene: None,
            control: control(),
            report: Some(Box::new(reports())),
            recordings:
                boards.first().map(|board| args.record.recordings(from_recordings(Arc::clone(&board.head.file)))),
        })?),
        None => None,
    };
    let status = args.status.as_ref().map(|address| serve_status(address, reports(), control())).transpose()?;
    status.iter().for_each(|server| talk(format_args!("status at {}", server.address)));
    let capture = args.record.open(is_recorded_later)?;
    let shown = live.as_ref().map(|live| live.input.clone());
    let plan = Plan { boards, sink, capture, datagrams, live: shown, real_time: args.real_time };
    let daemon = Arc::new(Daemon::start(plan, Arc::clone(&stop))?);
    let daemon = followed.get_or_init(|| daemon);
    // systemd's protocol; without a service manager nothing is sent.
    if let Err(error) = platform::notify("READY=1") {
        talk(format_args!(
            "the service manager that NOTIFY_SOCKET names cannot be reached ({error}); start the program without it"
        ));
    }
    // A manager that does not listen at this moment will at the next.
    let alive_every = platform::watchdog().map(|limit| limit / 2);
    let (mut accounted, mut alive, mut utc) = (Instant::now(), Instant::now(), UtcWatch::default());
    while !daemon.is_over() {
        std::thread::sleep(MOMENT);
        if let Some(step_s) = utc.step_s(HostInstant::now()) {
            tell_step(step_s);
        }
        if alive_every.is_some_and(|every| alive.elapsed() >= every) && daemon.is_alive() {
            alive = Instant::now();
            let _ = platform::notify("WATCHDOG=1");
        }
        if accounted.elapsed() >= ACCOUNT_EVERY {
            accounted = Instant::now();
            daemon.record_report();
        }
    }
    let _ = platform::notify("STOPPING=1");
    let ended = daemon.end();
    drop((status, live));
    let reconnects = daemon.report().boards.iter().map(|board| board.link.reconnects).collect::<Vec<_>>();
    outcome_of(ended, &reconnects, stop.load(Ordering::Relaxed), args.poses.duration.is_some())
}

/// Says that UTC has made a step, and what follows from it.
fn tell_step(step_s: f64) {
    if step_s > 0.0 {
        talk(format_args!(
            "this computer's clock was set ahead by {step_s:.1} s, or it was suspended: `host_utc_ns` jumps, \
             `host_monotonic_ns` does not"
        ));
    } else {
        let (back_s, lasts_s) = (-step_s, -2.0 * step_s);
        talk(format_args!(
            "this computer's clock was set back by {back_s:.1} s: `host_utc_ns` runs at half speed for {lasts_s:.1} s, \
             `host_monotonic_ns` is not affected"
        ));
    }
}

/// Reports losses; the first error counts.
fn outcome_of(ended: Ended, reconnects: &[u64], interrupted: bool, bounded: bool) -> Result<Outcome, CommandError> {
    let Ended { boards, printed, capture } = ended;
    let mut outcome = Outcome::Done;
    let mut failed = Ok(());
    for ((name, counts, followed), &reconnects) in boards.into_iter().zip(reconnects) {
        if reconnects > 0 {
            talk(format_args!("{name}: the board was missed {reconnects} times; what it took meanwhile is lost"));
            outcome = Outcome::DataLost;
        }
        let wanted = interrupted || (bounded && followed.is_ok());
        outcome = outcome.max(options::tell(&name, &counts, wanted));
        let behind = counts.scans_skipped - counts.scans_given_up;
        for (count, reason) in
            [(behind, "the solver was behind"), (counts.scans_given_up, "they waited at the interrupt")]
        {
            if count > 0 && printed.is_ok() {
                talk(format_args!("{name}: {count} of {} scans were not solved: {reason}", counts.scans));
            }
        }
        if behind > 0 {
            outcome = Outcome::DataLost;
        }
        failed = failed.and(followed);
    }
    if capture.state == RecorderState::Failed || capture.bytes_dropped > 0 {
        talk(format_args!(
            "the capture is not whole: {} bytes were not recorded; replay tells what is there",
            capture.bytes_dropped
        ));
        outcome = Outcome::DataLost;
    }
    // Somebody looks; programs read it from /status and the capture.
    if let (true, Some(file)) = (io::stderr().is_terminal() && capture.state != RecorderState::Failed, &capture.file) {
        let files = if capture.files > 1 { format!(", the last of {} files", capture.files) } else { String::new() };
        talk(format_args!("recorded {:.1} MB in {file}{files}", capture.bytes as f64 * 1e-6));
    }
    failed?;
    match printed {
        // The reader of the poses has gone; what was lost besides still counts.
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe && outcome == Outcome::DataLost => Ok(outcome),
        printed => {
            let target = "standard output".to_owned();
            Ok(printed.map(|()| outcome).map_err(|source| OutputError::Write { target, source })?)
        }
    }
}

impl Args {
    fn boards(&self) -> Result<Vec<BoardPlan>, CommandError> {
        let open = |scene: &String| match self.rate {
            Some(rate_hz) => front_end::at_rate(&open_scene(scene)?, rate_hz)
                .map_err(|error| usage!("--rate {rate_hz}Hz does not suit {scene}: {error}").into()),
            None => open_scene(scene),
        };
        let scenes = self.scene.iter().map(open).collect::<Result<Vec<_>, CommandError>>()?;
        let (scenes_given, calibrations, devices) = (scenes.len(), self.calibration.len(), self.device.len());
        if scenes_given != 1 && scenes_given != devices {
            let next_step = "give one for all, or one for each, in the same order";
            return Err(usage!("{scenes_given} scenes for {devices} boards; {next_step}").into());
        }
        if ![0, devices].contains(&calibrations) {
            let next_step = "give one for each, in the same order, or `none` for one";
            return Err(usage!("{calibrations} calibrations for {devices} boards; {next_step}").into());
        }
        let search = self.search.iter().map(|pattern| pattern.parse()).collect::<Result<Vec<Search>, _>>()?;
        let boards = self.device.iter().zip(scenes.iter().cycle()).enumerate();
        boards.map(|(number, (device, scene))| self.board(number, device, scene, &search)).collect()
    }

    fn board(
        &self,
        number: usize,
        device: &str,
        file: &SceneFile,
        search: &[Search],
    ) -> Result<BoardPlan, CommandError> {
        let tier = self.poses.tier();
        let configuration = front_end::configuration(file)?;
        // A simulated board needs none.
        let contact = match device.parse()? {
            Selector::Sim => None,
            selector => Some(Contact::new(selector, search.to_vec())),
        };
        // A head is within its tolerances, given or usual.
        let head = head_by(self.calibration.get(number).map(PathBuf::as_path), file.clone(), |file| {
            let head = if contact.is_none() { Head::as_scene_says(file) } else { Head::uncalibrated(file) };
            Ok::<_, CommandError>(head?)
        })?;
        let (opener, keeps_time): (Box<dyn Opener>, _) = match contact {
            None => {
                let duration_s = self.poses.duration.unwrap_or(f64::INFINITY);
                let speed = self.speed.unwrap_or(Speed::Times(1.0));
                // More boards than numbers share the last one.
                let number_of_board = u8::try_from(number).unwrap_or(u8::MAX);
                let simulated = self.tool.device(number_of_board, &head.simulated, tier, duration_s, speed)?;
                let is_simulated = |device: &&String| *device == "sim";
                let name = match self.device.iter().filter(is_simulated).count() {
                    0 | 1 => device.to_owned(),
                    _ => format!("sim {}", self.device[..=number].iter().filter(is_simulated).count()),
                };
                (Box::new(SimulatedPort::new(simulated, name)), speed == Speed::Times(1.0))
            }
            Some(contact) => {
                if let Some(option) = self.tool.given().or(self.speed.map(|_| "--speed")) {
                    return Err(usage!(
                        "{option} is for simulated boards and means nothing to {device}; leave it out, or give --device sim"
                    )
                    .into());
                }
                (Box::new(contact), true)
            }
        };
        let patience = match (self.patience, self.poses.duration) {
            (Some(Patience(patience)), _) => patience,
            (None, Some(_)) => Some(Duration::ZERO),
            (None, None) => None,
        };
        Ok(BoardPlan {
            opener,
            admit: admission(head.clone(), device.to_owned()),
            head,
            configuration,
            tier,
            following: PipelineOptions { source: self.stream.source(), ..self.poses.following() },
            view: self.poses.frame.view()?,
            stream: self.stream.stream(),
            sends_soon: self.latency,
            pulse: self.pulse,
            until_s: self.poses.duration,
            patience,
            keeps_time,
        })
    }
}

/// Whether a board may be followed at `name`, and what its user should know, which is said once of each board.
fn admission(head: Head, name: String) -> Admit {
    let last = Mutex::new(None);
    Box::new(move |hello| {
        let file = &head.file;
        pipeline::check(file, SceneMatch::Required, hello)?;
        pipeline::check_calibration(&head, SceneMatch::Required, hello)?;
        let device = DeviceId(hello.device_id);
        if lock(&last).replace(device) == Some(device) {
            return Ok(());
        }
        let scene = &file.name;
        let board_a = hello.scaling.full_scale_a();
        if let Some(front_end) = &file.front_end
            && !front_end::is_full_scale_of(board_a, front_end.full_scale_a)
        {
            talk(format_args!(
                "the board on {name} measures up to {:.3} uA, the front end of `{scene}` up to {:.3} uA: the \
                 board's is taken; correct front_end.full_scale_a, or tell the board what its feedback resistors make: \
                 slitpose device set --scene FILE --full-scale UA",
                board_a * 1e6,
                front_end.full_scale_a * 1e6
            ));
        }
        if hello.hashes.scene.is_none() {
            talk(format_args!(
                "the board on {name} has no scene stored; taking `{scene}` for the scene of its head: give another \
                 with --scene, or store this one with `slitpose device set --scene {}`",
                file.origin
            ));
        }
        let is_uncalibrated = matches!(pipeline::head_of(&head, hello).basis, Basis::Tolerances);
        if let (true, Some(hash)) = (is_uncalibrated, hello.hashes.calibration) {
            talk(format_args!(
                "the board on {name} belongs to the calibration with hash {hash:016x}, and none is given: poses are those \
                 of parts within their tolerances; give its file with --calibration"
            ));
        } else if is_uncalibrated {
            talk(format_args!(
                "the head on {name} has no calibration: its poses are those of parts within their tolerances, with the \
                 errors that these allow; next, `slitpose calibrate {} --known poses.csv --output calibration.toml`, and \
                 give that with --calibration",
                file.origin
            ));
        }
        Ok(())
    })
}
