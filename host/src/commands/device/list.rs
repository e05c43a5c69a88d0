//! `slitpose device list`: which boards there are.

use clap::ValueEnum;
use serde::Serialize;

use crate::commands::talk;
use crate::commands::{CommandError, Outcome};
use crate::device::{Listed, PortState, Search, UsbId, list};
use crate::link::DeviceId;
use slitpose_head::foreign::printable;
use slitpose_head::table::Output;

/// Lists the boards there are, and the ports that might have one.
///
/// Boards with a USB port of their own are known without asking. Serial ports of ST-LINK debuggers, and those
/// found with --search, are asked: they are opened, if nobody else has them, and sent one Hello.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  slitpose device list\n  slitpose device list --search '/dev/ttyUSB*' --format ndjson"
)]
pub(super) struct Args {
    /// Look here, too: a path with * and ?, such as '/dev/ttyUSB*'; may be repeated
    #[arg(long, value_name = "GLOB")]
    search: Vec<Search>,
    /// Open no port: list what USB tells
    #[arg(long)]
    no_probe: bool,
    /// For people, or for programs: one JSON object a port
    #[arg(long, value_enum, default_value_t = Format::Table)]
    format: Format,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    Table,
    Ndjson,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let listed = list(&args.search, !args.no_probe)?;
    let output = Output::open(None)?;
    let text = match args.format {
        Format::Table => table(&listed),
        Format::Ndjson => ndjson(&listed).map_err(|error| output.error(error.into()))?,
    };
    output.write_text(&text)?;
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
            "no board found. Check its power, and that the cable carries data: `lsusb` shows a board as 1209:0001, and \
             an ST-LINK as 0483:374e. Look at other ports with --search '/dev/ttyUSB*', or use a simulated board: \
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
const LONGEST_NAME: usize = 40;

const HEADINGS: [&str; 7] = ["SERIAL", "USB", "PORT", "BOARD", "FIRMWARE", "KIND", "STATE"];

/// Columns as wide as they need to be.
fn table(listed: &[Listed]) -> String {
    let mut rows = vec![HEADINGS.map(str::to_owned)];
    rows.extend(listed.iter().map(row));
    let widths: [usize; HEADINGS.len()] =
        std::array::from_fn(|i| rows.iter().map(|row| row[i].chars().count()).max().unwrap_or(0));
    let line = |row: &[String; HEADINGS.len()]| {
        let fields: Vec<_> = row.iter().zip(widths).map(|(field, width)| format!("{field:width$}")).collect();
        format!("{}\n", fields.join("  ").trim_end())
    };
    rows.iter().map(line).collect()
}

fn row(listed: &Listed) -> [String; HEADINGS.len()] {
    let name = |text: &str| printable(text).at_most(LONGEST_NAME).to_string();
    let or_dash = |text: Option<String>| text.unwrap_or_else(|| "-".to_owned());
    let board = listed.board.as_ref();
    [
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

#[derive(Serialize)]
struct Line<'a> {
    serial: Option<DeviceId>,
    usb: Option<&'a UsbId>,
    port: &'a str,
    board: Option<&'a str>,
    firmware: Option<&'a str>,
    kind: Option<&'a str>,
    protocol: Option<String>,
    state: String,
}

fn ndjson(listed: &[Listed]) -> serde_json::Result<String> {
    let mut text = String::new();
    for it in listed {
        let board = it.board.as_ref();
        let protocol = match it.state {
            PortState::OtherVersion(version) => Some(version),
            _ => board.map(|board| board.protocol),
        };
        text += &serde_json::to_string(&Line {
            serial: it.device(),
            usb: it.port.usb.as_ref(),
            port: &it.port.name,
            board: board.map(|board| board.board.as_str()),
            firmware: board.map(|board| board.firmware.as_str()),
            kind: board.map(|board| board.kind_name()),
            protocol: protocol.map(|version| version.to_string()),
            state: it.state.as_str().replace(' ', "_"),
        })?;
        text.push('\n');
    }
    Ok(text)
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
