//! `slitpose device info`: hello and status of a board.

use clap::ValueEnum;
use serde::Serialize;
use slitpose_protocol::{PROTOCOL, Schedule, Status};

use super::{BoardOptions, Connection};
use crate::commands::{CommandError, Outcome};
use crate::device::{BoardInfo, UsbId};
use crate::link::Versions;
use slitpose_head::foreign::printable;
use slitpose_head::scene_file::{Shipped, WIDE};
use slitpose_head::table::Output;

/// Shows all that a board reports: versions, schedule, scaling, what it stores, its counters.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose device info\n  slitpose device info --device /dev/ttyACM0 --format json")]
pub(super) struct Args {
    #[command(flatten)]
    board: BoardOptions,
    /// For people, or for programs (SI units)
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    Text,
    Json,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let mut connection = args.board.connect(&WIDE.read()?)?;
    // What a board of another build counts cannot be trusted.
    let status = match connection.info.mismatch {
        None => Some(connection.board.status()?),
        Some(_) => None,
    };
    let output = Output::open(None)?;
    let text = match args.format {
        Format::Text => text(&connection, status.as_ref()),
        Format::Json => {
            let Connection { info, found, .. } = &connection;
            let info = Info { port: &found.port, usb: found.usb.as_ref(), hello: info, status: status.as_ref() };
            serde_json::to_string_pretty(&info).map_err(|error| output.error(error.into()))? + "\n"
        }
    };
    output.write_text(&text)?;
    Ok(Outcome::Done)
}

fn text(connection: &Connection, status: Option<&Status>) -> String {
    let Connection { info, found, .. } = connection;
    let mut lines = vec![("serial", info.device.to_string()), ("port", found.port.clone())];
    if let Some(usb) = &found.usb {
        let product = usb.product.as_deref().unwrap_or("");
        lines.push(("usb", format!("{:04x}:{:04x} {product}", usb.vid, usb.pid)));
    }
    lines.push(("board", format!("{} ({}), firmware {}", info.board, info.kind_name(), info.firmware)));
    lines.push(match &info.mismatch {
        None => ("protocol", format!("{}; this program speaks {PROTOCOL}", info.protocol)),
        Some(mismatch) => ("protocol", format!("{}; {mismatch}", Versions { board: info.protocol })),
    });
    lines.push(("last start", info.reset_cause_name().replace('_', " ")));
    lines.push(("scene", stored(info.hashes.scene)));
    lines.push(("calibration", stored(info.hashes.calibration)));
    let scaling = &info.scaling;
    lines.push((
        "scaling",
        format!(
            "up to {:.3} uA in {} bits, zero at code {:.1}, {:.4} nA a code, full scale at code {}",
            scaling.full_scale_a() * 1e6,
            scaling.bits,
            scaling.zero_code,
            scaling.amperes_per_code * 1e9,
            scaling.saturation_code
        ),
    ));
    lines.push(("schedule", schedule(&info.schedule)));
    if let Some(status) = status {
        lines.extend(counters(info, status));
    }
    let shown = |value| printable(value).at_most(LONGEST_VALUE);
    lines.iter().map(|(name, value)| format!("{name:<12} {}\n", shown(value))).collect()
}

/// A text of the board that is longer is cut.
const LONGEST_VALUE: usize = 800;

/// A stored hash, with the shipped scene it belongs to.
fn stored(hash: Option<u64>) -> String {
    match hash {
        None => "none stored".to_owned(),
        Some(hash) => match Shipped::with_hash(hash) {
            Some(file) => format!("{hash:016x} (`{}`)", file.origin),
            None => format!("{hash:016x}"),
        },
    }
}

fn schedule(schedule: &Schedule) -> String {
    let us = |ticks: u32| f64::from(ticks) / f64::from(schedule.tick_hz) * 1e6;
    let slots: Vec<String> = schedule
        .slots
        .iter()
        .map(|set| {
            let emitters: Vec<_> = set.emitters().map(|emitter| emitter.to_string()).collect();
            if emitters.is_empty() { "dark".to_owned() } else { emitters.join("+") }
        })
        .collect();
    format!(
        "{:.3} frames/s of {} cells; slots {} of {:.2} us: {:.2} us settling, {} conversions of {:.3} us a word",
        schedule.frame_rate_hz(),
        schedule.cells,
        slots.join(", "),
        us(schedule.slot_ticks),
        us(schedule.settling_ticks),
        schedule.oversampling,
        us(schedule.conversion_ticks)
    )
}

fn counters(info: &BoardInfo, status: &Status) -> Vec<(&'static str, String)> {
    let up_s = status.tick as f64 / f64::from(info.schedule.tick_hz);
    vec![
        ("clock", status.clock.to_string()),
        ("settings", status.settings.to_string()),
        ("up since", format!("{up_s:.3} s, {}", if status.acquiring { "measuring" } else { "idle" })),
        (
            "scans",
            format!(
                "{} taken, {} dropped in {} batches, {} lost, {} overruns",
                status.scans_taken,
                status.scans_dropped,
                status.batches_dropped,
                status.scans_lost,
                status.adc_overruns
            ),
        ),
        (
            "commands",
            format!(
                "{} damaged, {} rejected, {} replies dropped",
                status.commands_damaged, status.commands_rejected, status.replies_dropped
            ),
        ),
        ("supply", format!("{:.3} V", status.supply_v)),
        ("temperature", format!("{:.1} C", status.temperature_k - 273.15)),
        ("load", format!("{:.1} %", f64::from(status.cpu_load_permille) / 10.0)),
    ]
}

#[derive(Serialize)]
struct Info<'a> {
    port: &'a str,
    usb: Option<&'a UsbId>,
    hello: &'a BoardInfo,
    status: Option<&'a Status>,
}
