//! `slitpose device list` and `slitpose device info`: which boards there are, and all that one reports.

use clap::ValueEnum;
use serde::Serialize;
use serde_json::json;
use slitpose_head::foreign::printable;
use slitpose_head::scene_file::{Shipped, WIDE};
use slitpose_head::table::{Output, aligned};
use slitpose_protocol::{PROTOCOL, Schedule, Status};

use super::{BoardOptions, Connection};
use crate::commands::options::{TextOrJson, print};
use crate::commands::{CommandError, Outcome, talk};
use crate::device::{BoardInfo, Listed, PortState, Search, UsbId};
use slitpose_tracking::link::Versions;

/// Lists the boards there are, and the ports that might have one.
///
/// Boards with a USB port of their own are known without asking. Serial ports of ST-LINK debuggers, and those
/// found with --search, are asked: they are opened, if nobody else has them, and sent one Hello.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  slitpose device list\n  slitpose device list --search '/dev/ttyUSB*' --format ndjson"
)]
pub(super) struct ListArgs {
    /// Look here, too: a path with * and ?, such as '/dev/ttyUSB*'; may be repeated
    #[arg(long, value_name = "GLOB")]
    search: Vec<Search>,
    /// Open no port: list what USB tells
    #[arg(long)]
    no_probe: bool,
    /// For people, or for programs: one JSON object a port
    #[arg(long, value_enum, default_value_t = ListFormat::Table)]
    format: ListFormat,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ListFormat {
    Table,
    Ndjson,
}

pub(super) fn list(args: &ListArgs) -> Result<Outcome, CommandError> {
    let listed = crate::device::list(&args.search, !args.no_probe)?;
    let text = match args.format {
        ListFormat::Table => table(&listed),
        ListFormat::Ndjson => ndjson(&listed),
    };
    print(&text)?;
    for hint in hints(&listed) {
        talk(format_args!("{hint}"));
    }
    Ok(Outcome::Done)
}

/// The next step for ports that could not be asked.
fn hints(listed: &[Listed]) -> Vec<&'static str> {
    let any = |state: fn(PortState) -> bool| listed.iter().any(|it| state(it.state));
    let mut hints = Vec::new();
    if !listed.iter().any(|it| it.device().is_some()) {
        hints.push(
            "no board found. Check its power, and that the cable carries data: a board is the USB device 1209:0001, and \
             an ST-LINK 0483:374e. Look at other ports with --search '/dev/ttyUSB*', or use a simulated board: \
             --device sim",
        );
    }
    if any(|state| state == PortState::NoPermission) {
        hints.push(
            "a port may not be opened by this user; install the udev rule (host/INSTALL.md), or join the group dialout",
        );
    }
    if any(|state| matches!(state, PortState::OtherVersion(_))) {
        hints.push("a board speaks otherwise than this program; `slitpose device info` tells which of both is older");
    }
    hints
}

/// A board's name that is longer is cut: columns are as wide as the longest.
const MAX_NAME: usize = 40;

const HEADINGS: [&str; 7] = ["SERIAL", "USB", "PORT", "BOARD", "FIRMWARE", "KIND", "STATE"];

fn table(listed: &[Listed]) -> String {
    let headings = HEADINGS.map(str::to_owned).to_vec();
    let rows: Vec<Vec<String>> = std::iter::once(headings).chain(listed.iter().map(row)).collect();
    aligned(&rows, |_| false).map(|line| line + "\n").collect()
}

fn row(listed: &Listed) -> Vec<String> {
    let name = |text: &str| printable(text).at_most(MAX_NAME).to_string();
    let or_dash = |text: Option<String>| text.unwrap_or_else(|| "-".to_owned());
    let board = listed.board.as_ref();
    vec![
        or_dash(listed.device().map(|device| device.to_string())),
        or_dash(listed.port.usb.as_ref().map(|usb| format!("{:04x}:{:04x}", usb.vid, usb.pid))),
        printable(&listed.port.name).to_string(),
        or_dash(board.map(|board| name(&board.board))),
        or_dash(board.map(|board| name(&board.firmware))),
        or_dash(board.map(|board| board.kind_name().to_owned())),
        match listed.state {
            PortState::OtherVersion(version) => format!("other version ({version})"),
            state => state.as_str().to_owned(),
        },
    ]
}

fn ndjson(listed: &[Listed]) -> String {
    let mut text = String::new();
    for it in listed {
        let board = it.board.as_ref();
        let protocol = match it.state {
            PortState::OtherVersion(version) => Some(version),
            _ => board.map(|board| board.protocol),
        };
        let line = json!({
            "serial": it.device(),
            "usb": it.port.usb,
            "port": it.port.name,
            "board": board.map(|board| &board.board),
            "firmware": board.map(|board| &board.firmware),
            "kind": board.map(|board| board.kind_name()),
            "protocol": protocol.map(|version| version.to_string()),
            "state": it.state.as_str().replace(' ', "_"),
        });
        text += &line.to_string();
        text.push('\n');
    }
    text
}

/// Shows all that a board reports: versions, schedule, scaling, what it stores, its counters.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose device info\n  slitpose device info --device /dev/ttyACM0 --format json")]
pub(super) struct InfoArgs {
    #[command(flatten)]
    board: BoardOptions,
    /// For people, or for programs (SI units)
    #[arg(long, value_enum, default_value_t = TextOrJson::Text)]
    format: TextOrJson,
}

pub(super) fn info(args: &InfoArgs) -> Result<Outcome, CommandError> {
    let mut connection = args.board.connect(&WIDE.read()?)?;
    // What a board of another build counts cannot be trusted.
    let status = match connection.info.mismatch {
        None => Some(connection.board.status()?),
        Some(_) => None,
    };
    let output = Output::open(None)?;
    let text = match args.format {
        TextOrJson::Text => info_text(&connection, status.as_ref()),
        TextOrJson::Json => {
            let Connection { info, board, .. } = &connection;
            let info = Info { port: &board.name(), usb: connection.usb(), hello: info, status: status.as_ref() };
            serde_json::to_string_pretty(&info).map_err(|error| output.error(error.into()))? + "\n"
        }
    };
    output.write_text(&text)?;
    Ok(Outcome::Done)
}

fn info_text(connection: &Connection, status: Option<&Status>) -> String {
    let Connection { info, board, .. } = connection;
    let mut lines = vec![("serial", info.device.to_string()), ("port", board.name())];
    if let Some(usb) = connection.usb() {
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
    let shown = |value| printable(value).at_most(MAX_VALUE);
    lines.iter().map(|(name, value)| format!("{name:<12} {}\n", shown(value))).collect()
}

/// A text of the board that is longer is cut.
const MAX_VALUE: usize = 800;

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::Port;

    #[test]
    fn ports_without_a_board_are_no_board() {
        let port = |state| {
            let port = Port { name: "/dev/ttyUSB0".to_owned(), usb: None };
            vec![Listed { state, ..Listed::new(port) }]
        };
        for listed in [Vec::new(), port(PortState::NoAnswer), port(PortState::InUse)] {
            let hints = hints(&listed);
            assert!(hints.len() == 1 && hints[0].starts_with("no board found. Check"), "{hints:?}");
        }
        assert_eq!(hints(&port(PortState::NoPermission)).len(), 2);
    }

    #[test]
    fn columns_stand_below_each_other() {
        assert_eq!(table(&[]), "SERIAL  USB  PORT  BOARD  FIRMWARE  KIND  STATE\n");
        let usb = UsbId {
            vid: 0x1209,
            pid: 1,
            serial: Some("0036002900544850025A0320".to_owned()),
            manufacturer: Some("slitpose".to_owned()),
            product: Some("slitpose board".to_owned()),
        };
        let board = Listed::new(Port { name: "/dev/ttyACM0".to_owned(), usb: Some(usb) });
        let other =
            Listed { state: PortState::InUse, ..Listed::new(Port { name: "/dev/ttyUSB10".to_owned(), usb: None }) };
        assert_eq!(
            table(&[board, other]),
            "SERIAL                    USB        PORT           BOARD  FIRMWARE  KIND  STATE\n\
             0036002900544850025a0320  1209:0001  /dev/ttyACM0   -      -         -     not asked\n\
             -                         -          /dev/ttyUSB10  -      -         -     in use\n"
        );
    }
}
