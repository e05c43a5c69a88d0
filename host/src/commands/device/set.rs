//! `slitpose device set`: which head and which front end a board has, kept on the board.

use std::num::NonZeroU32;
use std::path::PathBuf;
use std::time::Duration;

use slitpose_calibration::{Calibration, Head};
use slitpose_protocol::{Hashes, Schedule};

use super::{BoardOptions, Connection};
use crate::commands::{CommandError, Outcome, options};
use crate::device::DeviceError;
use crate::solving;
use slitpose_head::front_end;
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_head::table::Output;

/// A board that has just replied answers at once.
const HELLO_WITHIN: Duration = Duration::from_secs(1);

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
pub(super) struct Args {
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

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
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
                connection.board.set_full_scale(full_scale_pa)?;
                connection.info = connection.board.introduce(HELLO_WITHIN)?;
            }
            let solving = if given == hashes.calibration {
                let head = calibrated.unwrap_or_else(|| file.clone().into());
                send_head(&mut connection, &head, &schedule)?
            } else {
                connection.board.forget_head()?;
                "; it solves no poses itself: give the calibration, too".to_owned()
            };
            connection.board.store(hashes)?;
            let after = connection.board.introduce(HELLO_WITHIN)?;
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
    Output::open(None)?.write_text(&said)?;
    Ok(Outcome::Done)
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
    connection.board.forget_stored()?;
    if connection.board.introduce(HELLO_WITHIN)?.hashes != Hashes::default() {
        return Err(DeviceError::NotStored { name: connection.board.name() }.into());
    }
    Ok(format!("{} keeps no scene and no calibration; it starts with its defaults\n", connection.name()))
}
