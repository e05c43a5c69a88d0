//! `slitpose device`: which boards there are, and what one is told beside measuring.

mod list;
mod update;

use std::num::NonZeroU32;
use std::path::PathBuf;
use std::thread::sleep;
use std::time::Duration;

use clap::Subcommand;
use clap::builder::TypedValueParser;
use slitpose_calibration::{Calibration, Head};
use slitpose_head::front_end;
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_head::simulator::TrajectoryKind;
use slitpose_protocol::{BootTarget, Command, Hashes, ResetCause, Schedule};

use super::{CommandError, Outcome, options, talk};
use crate::device::{
    ANSWER_WITHIN, BoardInfo, Contact, Conversation, Device, DeviceError, Search, Selector, SerialDevice,
    SimulatedDevice, UsbId, find,
};
use crate::platform::holders;
use slitpose_tracking::link::{DeviceId, Versions};
use slitpose_tracking::pipeline::PipelineError;
use slitpose_tracking::solving;

/// Lists boards; tells one what head it has, to show itself, or to start anew; gives it new firmware.
///
/// A board that another program follows is left alone.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    List(list::ListArgs),
    Info(list::InfoArgs),
    Set(SetArgs),
    Identify(IdentifyArgs),
    Reboot(RebootArgs),
    Update(update::UpdateArgs),
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    match &args.verb {
        Verb::List(args) => list::list(args),
        Verb::Info(args) => list::info(args),
        Verb::Set(args) => set(args),
        Verb::Identify(args) => identify(args),
        Verb::Reboot(args) => reboot(args),
        Verb::Update(args) => update::update(args),
    }
}

/// Which board.
#[derive(Debug, clap::Args)]
pub(super) struct BoardOptions {
    /// The board: its serial number, the path of its port, auto: the one there is, or sim: a simulated one
    #[arg(
        long, value_name = "DEVICE", default_value = "auto", hide_possible_values = true,
        value_parser = options::devices().try_map(|text| text.parse::<Selector>())
    )]
    pub(super) device: Selector,
    /// Look for boards here, too: a path with * and ?, such as '/dev/ttyUSB*'; may be repeated
    #[arg(long, value_name = "GLOB")]
    pub(super) search: Vec<Search>,
}

pub(super) struct Connection {
    pub(super) board: Conversation,
    pub(super) info: BoardInfo,
    pub(super) contact: Contact,
}

impl BoardOptions {
    pub(super) fn contact(&self) -> Contact {
        Contact::new(self.device.clone(), self.search.clone())
    }

    /// Finds the board, opens its port and asks who it is; a simulated one has the head of `file`.
    pub(super) fn connect(&self, file: &SceneFile) -> Result<Connection, CommandError> {
        let mut contact = self.contact();
        let device: Box<dyn Device> = match &self.device {
            Selector::Sim => Box::new(SimulatedDevice::for_trials(file, TrajectoryKind::Smooth)?),
            selector => {
                let port = contact.port.insert(find(selector, &self.search)?);
                Box::new(SerialDevice::open(&port.name).inspect_err(name_holders)?)
            }
        };
        let (board, info) = Conversation::introduced(device)?;
        contact.greeted(info.device);
        Ok(Connection { board, info, contact })
    }
}

impl Connection {
    /// The same, if board and program understand each other.
    pub(super) fn understood(self) -> Result<Self, CommandError> {
        match self.info.mismatch {
            None => Ok(self),
            Some(source) => {
                let versions = Versions { board: self.info.protocol };
                Err(PipelineError::Schema { board: self.info.board, versions, source }.into())
            }
        }
    }

    pub(super) fn usb(&self) -> Option<&UsbId> {
        self.contact.port.as_ref()?.usb.as_ref()
    }

    pub(super) fn name(&self) -> String {
        format!("{} on {}", self.info.device, self.board.name())
    }
}

fn name_holders(error: &DeviceError) {
    if let DeviceError::Busy { name } = error {
        for holder in holders(name) {
            talk(format_args!("{holder} has {name} open"));
        }
    }
}

/// Has a board keep the schedule and the hashes of its head's scene and calibration, also without supply.
///
/// From then on it starts with that schedule, and `run` refuses to read it by the scene or the calibration of another
/// head. What is stored is read back. Unless one is given, a calibration stays stored only if the scene stays the same,
/// and the full scale stays as it is.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose device set --scene head.toml\n  \
                  slitpose device set --scene head.toml --calibration calibration.toml\n  \
                  slitpose device set --scene head.toml --full-scale 6.6\n  \
                  slitpose device set --device 0036002900544850025a0320 --clear")]
struct SetArgs {
    #[command(flatten)]
    board: BoardOptions,
    /// The scene of its head: a file, or the name of a shipped scene
    #[arg(long, value_name = "SCENE", value_parser = options::scenes(), hide_possible_values = true, required_unless_present = "clear", conflicts_with = "clear")]
    scene: Option<String>,
    /// The calibration of its head, which `slitpose calibrate` wrote
    #[arg(long, value_name = "FILE", requires = "scene")]
    calibration: Option<PathBuf>,
    /// Photocurrent of an electrode at the end of its converter's range, in microamperes: the reference voltage over the
    /// feedback resistor
    #[arg(long, value_name = "UA", requires = "scene", value_parser = parse_full_scale)]
    full_scale: Option<NonZeroU32>,
    /// Forget what is stored; the board starts with its defaults from then on
    #[arg(long)]
    clear: bool,
}

fn set(args: &SetArgs) -> Result<Outcome, CommandError> {
    let said = match &args.scene {
        None => clear(args.board.connect(&WIDE.read()?)?.understood()?)?,
        Some(scene) => {
            let file = SceneFile::open(scene)?;
            let configuration = front_end::configuration(&file)?;
            let given =
                args.calibration.as_deref().map(|path| Head::open_calibrated(file.clone(), path)).transpose()?;
            let calibrated = given;
            let given = calibrated.as_ref().and_then(Head::calibration).map(Calibration::hash);
            let mut connection = args.board.connect(&file)?.understood()?;
            let before = connection.info.hashes;
            let same = before.scene == Some(file.hash);
            let hashes = Hashes { scene: Some(file.hash), calibration: given.or(before.calibration.filter(|_| same)) };
            let schedule = configuration.schedule.clone();
            connection.board.configure(configuration)?;
            if let Some(full_scale_pa) = args.full_scale {
                connection.board.order(Command::FullScale { full_scale_pa })?;
                connection.info = connection.board.introduce(ANSWER_WITHIN)?;
            }
            let solving = if given == hashes.calibration {
                let head = calibrated.unwrap_or_else(|| file.clone().into());
                send_head(&mut connection, &head, &schedule)?
            } else {
                connection.board.forget_head()?;
                "; it solves no poses itself: give the calibration, too".to_owned()
            };
            connection.board.order(Command::Store(hashes))?;
            let after = connection.board.introduce(ANSWER_WITHIN)?;
            if after.hashes != hashes || after.schedule != schedule || after.scaling != connection.info.scaling {
                return Err(DeviceError::NotStored { name: connection.board.name() }.into());
            }
            let calibration = match hashes.calibration {
                Some(hash) => format!(", and the calibration with hash {hash:016x}"),
                None if before.calibration.is_some() => "; the calibration is forgotten".to_owned(),
                None => String::new(),
            };
            format!(
                "{} keeps scene `{}` with hash {:016x}, {:.3} frames/s, up to {:.3} uA{calibration}{solving}\n",
                connection.name(),
                file.name,
                file.hash,
                schedule.frame_rate_hz(),
                after.scaling.full_scale_a() * 1e6
            )
        }
    };
    options::print(&said)
}

fn parse_full_scale(text: &str) -> Result<NonZeroU32, String> {
    let pa = text.parse().map_or(f64::NAN, |ua: f64| (ua * 1e6).round());
    // What is no number, or below zero, becomes zero.
    let full_scale = NonZeroU32::new(pa as u32).filter(|_| pa <= f64::from(u32::MAX));
    full_scale.ok_or_else(|| "give microamperes, more than 0 and up to 4294".to_owned())
}

/// Gives a board that solves poses its head, and says how that went.
fn send_head(connection: &mut Connection, head: &Head, schedule: &Schedule) -> Result<String, CommandError> {
    let Connection { board, info, .. } = connection;
    // Of a board without the command, or of one that solves no poses, nothing is said: it has poses as ever, by `run`.
    if !board.forget_head()? {
        return Ok(String::new());
    }
    match solving::compile(head, schedule, &info.scaling) {
        Ok(bytes) => {
            board.send_head(&bytes)?;
            Ok("; with them it solves poses itself".to_owned())
        }
        Err(error) => Ok(format!("; it solves no poses itself: {error}")),
    }
}

fn clear(mut connection: Connection) -> Result<String, CommandError> {
    connection.board.order(Command::Forget)?;
    if connection.board.introduce(ANSWER_WITHIN)?.hashes != Hashes::default() {
        return Err(DeviceError::NotStored { name: connection.board.name() }.into());
    }
    Ok(format!("{} keeps no scene and no calibration; it starts with its defaults\n", connection.name()))
}

/// Blinks a board's indicator light, to find it among several.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  slitpose device identify --device 0036002900544850025a0320 --seconds 30")]
struct IdentifyArgs {
    #[command(flatten)]
    board: BoardOptions,
    /// For how long; 0 ends it
    #[arg(long, value_name = "N", default_value_t = 10)]
    seconds: u8,
}

fn identify(args: &IdentifyArgs) -> Result<Outcome, CommandError> {
    let mut connection = args.board.connect(&WIDE.read()?)?.understood()?;
    connection.board.order(Command::Identify { seconds: args.seconds })?;
    match args.seconds {
        0 => talk(format_args!("{} shows itself no more", connection.name())),
        seconds => talk(format_args!("{} shows itself by its indicator light for {seconds} s", connection.name())),
    }
    Ok(Outcome::Done)
}

/// A board restarts 0.2 s after its reply at the latest; until then the old one might answer.
const GONE_WITHIN: Duration = Duration::from_millis(300);

/// A board is up in milliseconds; on USB the host needs a second or two to see it.
const BACK_WITHIN: Duration = Duration::from_secs(10);

/// Restarts a board, and waits until it is back.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  slitpose device reboot --device /dev/ttyACM0")]
struct RebootArgs {
    #[command(flatten)]
    board: BoardOptions,
    /// Start the boot loader in the controller instead, to be given new firmware
    #[arg(long)]
    boot_loader: bool,
}

fn reboot(args: &RebootArgs) -> Result<Outcome, CommandError> {
    let mut connection = args.board.connect(&WIDE.read()?)?.understood()?;
    if args.boot_loader {
        connection.board.order(Command::Reboot(BootTarget::BootLoader))?;
        talk(format_args!(
            "{} is in its boot loader, on its own USB port; give it firmware with `slitpose device update`, or reset it",
            connection.name()
        ));
        return Ok(Outcome::Done);
    }
    connection.board.order(Command::Reboot(BootTarget::Firmware))?;
    let Connection { board, contact, info: BoardInfo { device, .. } } = connection;
    let (port, info) = await_back(board, &contact, device)?;
    talk(format_args!("{device} is back on {port}, firmware {}", info.firmware));
    if info.reset_cause != ResetCause::Software {
        talk(format_args!("it says that it last started by `{}`, not by command", info.reset_cause_name()));
    }
    Ok(Outcome::Done)
}

/// Waits until the board `device` is back, which has just been told to start anew; gives its port and what it says.
fn await_back(board: Conversation, contact: &Contact, device: DeviceId) -> Result<(String, BoardInfo), CommandError> {
    sleep(GONE_WITHIN);
    let (board, info) = contact.await_return(Some(board), BACK_WITHIN)?;
    let port = board.name();
    if info.device != device {
        talk(format_args!("another board is on {port} now: {}", info.device));
        return Err(DeviceError::NotBack { name: port, seconds: BACK_WITHIN.as_secs_f64() }.into());
    }
    Ok((port, info))
}
