//! `slitpose device update`: new firmware, over the board's own USB cable.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, anyhow, bail};
use slitpose_head::scene_file::WIDE;
use slitpose_protocol::{BootTarget, Command};

use super::{BoardOptions, await_back};
use crate::commands::{CommandError, Outcome, talk, usage};
use crate::device::update::{self, Firmware};
use crate::device::{BootLoader, DeviceError, Selector, find};
use crate::terminal::{Amount, Progress};

// `SLITPOSE_FIRMWARE`, when this program is built: the folder of a release's .dfu files.
include!(concat!(env!("OUT_DIR"), "/firmware.rs"));

/// A boot loader needs a second until the computer has found it.
const BOOT_LOADER_WITHIN: Duration = Duration::from_secs(10);

/// Gives a board new firmware, over the cable of its own USB port.
///
/// The board's settings and head stay. If cable or supply fail on the way, plug the board in and update again: a board
/// without whole firmware waits in its boot loader. A release has its firmware inside the program; one that solves poses
/// goes to a board that solves poses.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose device update\n  \
                  slitpose device update --device 0036002900544850025a0320 slitpose-board-pose-0.1.0.dfu")]
pub(super) struct UpdateArgs {
    #[command(flatten)]
    board: BoardOptions,
    /// The firmware: a .dfu or .bin file [default: that of this program's release]
    file: Option<PathBuf>,
}

pub(super) fn update(args: &UpdateArgs) -> Result<Outcome, CommandError> {
    if args.board.device == Selector::Sim {
        bail!(usage!("a simulated board has no firmware of its own; leave --device sim out"));
    }
    let given = args.file.as_ref().map(|path| {
        let file = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        Firmware::read(&file).with_context(|| format!("cannot use {}", path.display()))
    });
    let given = given.transpose()?;
    // A board that waits in its boot loader has no serial port.
    if let Err(DeviceError::NoBoard { .. } | DeviceError::NoSuchBoard { .. }) =
        find(&args.board.device, &args.board.search)
        && let Some(mut boot_loader) = BootLoader::await_one(None, Duration::ZERO)?
    {
        let firmware = given.map_or_else(|| released(false), Ok)?;
        talk(format_args!("a board waits in its boot loader; it takes the firmware that was begun, or another"));
        write(&mut boot_loader, &firmware)?;
        talk(format_args!("firmware {} is written and read back; the board starts", version(&firmware)));
        return Ok(Outcome::Done);
    }
    let mut connection = args.board.connect(&WIDE.read()?)?.understood()?;
    let firmware = match given {
        Some(firmware) => firmware,
        // A board that solves no poses has no head to forget.
        None => released(connection.board.forget_head()?)?,
    };
    firmware.check_board(&connection.info.board)?;
    let name = connection.name();
    talk(format_args!("{name} has firmware {}; it gets {}", connection.info.firmware, version(&firmware)));
    connection.board.order(Command::Reboot(BootTarget::BootLoader))?;
    let super::Connection { board, contact, info } = connection;
    let mut boot_loader = BootLoader::await_one(Some(info.device), BOOT_LOADER_WITHIN)?.ok_or_else(|| {
        anyhow!(
            "the boot loader of {name} has not come up on USB within {} s; the cable must be at the board's own USB port \
             (PA11, PA12), not at its debugger; then update again, or reset the board to go on with its old firmware",
            BOOT_LOADER_WITHIN.as_secs()
        )
    })?;
    write(&mut boot_loader, &firmware)?;
    let (port, info) = await_back(board, &contact, info.device)?;
    talk(format_args!("{} is back on {port}, firmware {}", info.device, info.firmware));
    Ok(Outcome::Done)
}

fn write(boot_loader: &mut BootLoader, firmware: &Firmware) -> Result<(), CommandError> {
    let mut progress = Progress::new("update", 3 * firmware.bytes() as u64, Amount::Bytes);
    Ok(update::update(boot_loader, firmware, |bytes| progress.at(bytes as u64))?)
}

/// The firmware of this program's release.
fn released(solves_poses: bool) -> Result<Firmware, CommandError> {
    let file = if solves_poses { RELEASED_WITH_POSES } else { RELEASED };
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
