//! `slitpose device reboot`: a board starts anew, or its boot loader does.

use std::thread::sleep;
use std::time::{Duration, Instant};

use slitpose_protocol::{BootTarget, ResetCause};

use super::{BoardOptions, Connection};
use crate::commands::talk;
use crate::commands::{CommandError, Outcome};
use crate::device::{BoardInfo, Conversation, DeviceError, SerialDevice, locate};
use slitpose_head::scene_file::WIDE;

/// A board restarts 0.2 s after its reply at the latest; until then the old one might answer.
const GONE_WITHIN: Duration = Duration::from_millis(300);

/// A board is up in milliseconds; on USB the host needs a second or two to see it.
const BACK_WITHIN: Duration = Duration::from_secs(10);

const ANSWER_WITHIN: Duration = Duration::from_secs(1);

const LOOK_EVERY: Duration = Duration::from_millis(100);

/// Restarts a board, and waits until it is back.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  slitpose device reboot --device /dev/ttyACM0")]
pub(super) struct Args {
    #[command(flatten)]
    board: BoardOptions,
    /// Start the boot loader in the controller instead, to be given new firmware
    #[arg(long)]
    boot_loader: bool,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let mut connection = args.board.connect(&WIDE.read()?)?.understood()?;
    if args.boot_loader {
        connection.board.reboot(BootTarget::BootLoader)?;
        talk(format_args!(
            "{} is in its boot loader, on its own USB port. Next, with the image as a binary file:\n  \
             dfu-util -a 0 -s 0x08000000:leave -D slitpose-board.bin\nthen reset the board",
            connection.name()
        ));
        return Ok(Outcome::Done);
    }
    connection.board.reboot(BootTarget::Firmware)?;
    let device = connection.info.device;
    let (port, info) = wait(connection, args)?;
    if info.device != device {
        talk(format_args!("another board is on {port} now: {}", info.device));
        return Err(DeviceError::NotBack { name: port, seconds: BACK_WITHIN.as_secs_f64() }.into());
    }
    talk(format_args!("{device} is back on {port}, firmware {}", info.firmware));
    if info.reset_cause != ResetCause::Software {
        talk(format_args!("it says that it last started by `{}`, not by command", info.reset_cause_name()));
    }
    Ok(Outcome::Done)
}

/// Where the board answers again, and what it says.
fn wait(connection: Connection, args: &Args) -> Result<(String, BoardInfo), DeviceError> {
    let Connection { board, mut found, info } = connection;
    let name = found.port.clone();
    found.device = Some(info.device);
    let until = Instant::now() + BACK_WITHIN;
    // The port of a debugger outlives the board behind it, and stays open.
    let mut open = Some(board);
    sleep(GONE_WITHIN);
    while Instant::now() < until {
        let Some(board) = &mut open else {
            let there = locate(&args.board.device, Some(&found));
            // It may be there and not yet be allowed to this user, or not yet be ready.
            open = there.and_then(|there| Conversation::open(Box::new(SerialDevice::open(&there.port).ok()?)).ok());
            if open.is_none() {
                sleep(LOOK_EVERY);
            }
            continue;
        };
        match board.introduce(ANSWER_WITHIN) {
            Ok(info) => return Ok((board.name(), info)),
            Err(DeviceError::Gone { .. }) => open = None,
            Err(DeviceError::Silent { .. } | DeviceError::NoHello { .. }) => {}
            Err(error) => return Err(error),
        }
    }
    Err(DeviceError::NotBack { name, seconds: BACK_WITHIN.as_secs_f64() })
}
