//! `slitpose device update`: new firmware, over the board's own USB cable.

use std::io::Read;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, bail};
use slitpose_head::scene_file::WIDE;
use slitpose_head::text_file;
use slitpose_protocol::{BootTarget, Command};

use super::{BoardOptions, await_back};
use crate::commands::{CommandError, Outcome, talk, usage};
use crate::device::update::{self, Firmware, Known};
use crate::device::{BootLoader, BootLoaders, DeviceError, Selector};
use crate::terminal::{Amount, Progress};

// `SLITPOSE_FIRMWARE`, when this program is built: the folder of a release's .dfu files.
include!(concat!(env!("OUT_DIR"), "/firmware.rs"));

/// More than any firmware has.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// A boot loader needs a second until the computer has found it.
const BOOT_LOADER_WITHIN: Duration = Duration::from_secs(10);

/// Gives a board new firmware, over the cable of its own USB port.
///
/// The board's settings and head stay. If cable or supply fail on the way, plug the board in and update again: a board
/// without whole firmware waits in its boot loader. A release has its firmware inside the program: `board`, and `pose`, which
/// solves poses.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose device update\n  \
                  slitpose device update --device 0036002900544850025a0320 pose\n  \
                  slitpose device update slitpose-board-0.1.0.dfu")]
pub(super) struct UpdateArgs {
    #[command(flatten)]
    board: BoardOptions,
    /// The firmware: a .dfu or .bin file, or of this program's release: board or pose [default: the one that the board has,
    /// of this release]
    #[arg(value_name = "FIRMWARE")]
    firmware: Option<String>,
}

pub(super) fn update(args: &UpdateArgs) -> Result<Outcome, CommandError> {
    let selector = &args.board.device;
    if *selector == Selector::Sim {
        bail!(usage!("a simulated board has no firmware of its own; leave --device sim out"));
    }
    let given = args.firmware.as_deref().map(read).transpose()?;
    let mut connection = match args.board.connect(&WIDE.read()?) {
        Ok(connection) => connection,
        // A board that waits in its boot loader has no serial port.
        Err(error) => {
            let named = if let Selector::Serial(device) = selector { Some(*device) } else { None };
            let is_missing =
                matches!(error.downcast_ref(), Some(DeviceError::NoBoard { .. } | DeviceError::NoSuchBoard { .. }));
            // Where there is no USB, no boot loader is either.
            let waiting = BootLoaders::now().ok().filter(|_| is_missing);
            return match waiting.map(|waiting| waiting.open(named).context(NOT_OPENED)).transpose()?.flatten() {
                Some(boot_loader) => complete(boot_loader, given),
                None => Err(error),
            };
        }
    };
    let firmware = match given {
        Some(firmware) => firmware,
        None => {
            // A board that solves no poses has no head to forget; the others have theirs again when they start.
            let (board, pose) = (released(RELEASED)?, released(RELEASED_WITH_POSES)?);
            if connection.board.forget_head()? { pose } else { board }
        }
    };
    firmware.check_board(&connection.info.board)?;
    let name = connection.name();
    talk(format_args!("{name} has firmware {}; it gets {}", connection.info.firmware, version(&firmware)));
    let before = BootLoaders::now().context("cannot list what is on USB; the board's own USB port is needed")?;
    connection.board.order(Command::Reboot(BootTarget::BootLoader))?;
    let super::Connection { board, contact, info } = connection;
    let boot_loader = before.await_new(info.device, BOOT_LOADER_WITHIN).with_context(|| {
        format!(
            "the boot loader of {name} cannot be used; its cable must be at the board's own USB port (PA11, PA12), not at \
             its debugger. {NOT_OPENED}. A reset starts the old firmware again"
        )
    })?;
    write(boot_loader, &firmware, Known::Board)?;
    let (port, info) = await_back(board, &contact, info.device)?;
    talk(format_args!("{} is back on {port}, firmware {}", info.device, info.firmware));
    Ok(Outcome::Done)
}

const NOT_OPENED: &str = "The user needs the right to open the boot loader: install the udev rule, on Windows the driver WinUSB \
                          (INSTALL.md), and update again";

/// Completes an update that was cut short.
fn complete(boot_loader: BootLoader, given: Option<Firmware>) -> Result<Outcome, CommandError> {
    let firmware = given.ok_or_else(|| {
        usage!(
            "a board waits in its boot loader, and says not which firmware it had; give a file, or `board`, or `pose` for \
             one that solves poses"
        )
    })?;
    talk(format_args!("a board waits in its boot loader; it gets firmware {}", version(&firmware)));
    write(boot_loader, &firmware, Known::Waiting)?;
    talk(format_args!("firmware {} is written and read back; the board starts", version(&firmware)));
    Ok(Outcome::Done)
}

fn read(name: &str) -> Result<Firmware, CommandError> {
    match name {
        "board" => return released(RELEASED),
        "pose" => return released(RELEASED_WITH_POSES),
        _ => {}
    }
    let path = Path::new(name);
    let mut file = Vec::new();
    let opened = text_file::open(path).with_context(|| format!("cannot read {name}"))?;
    opened.take(MAX_FILE_BYTES).read_to_end(&mut file).with_context(|| format!("cannot read {name}"))?;
    Firmware::read(&file).with_context(|| format!("cannot use {name}"))
}

fn write(mut boot_loader: BootLoader, firmware: &Firmware, known: Known) -> Result<(), CommandError> {
    let mut progress = Progress::new("update", 3 * firmware.bytes() as u64, Amount::Bytes);
    Ok(update::update(&mut boot_loader, firmware, known, |bytes| progress.at(bytes as u64))?)
}

fn released(file: Option<&[u8]>) -> Result<Firmware, CommandError> {
    let file = file.ok_or_else(|| {
        usage!(
            "this program was built without firmware; give the .dfu file of a release, or one of host/packaging/build"
        )
    })?;
    Ok(Firmware::read(file)?)
}

fn version(firmware: &Firmware) -> String {
    firmware.header.firmware.map(|number| number.to_string()).join(".")
}
