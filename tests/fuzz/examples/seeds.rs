//! Makes those inputs anew that follow from scenes, formats and the wire: `cargo run -p slitpose-fuzz --example seeds`, in the
//! top folder. Others, texts and scripts written by hand or inputs that were found, stay.

use std::ffi::OsString;
use std::fs;
use std::path::Path;

use slitpose_firmware::pcb::{default_configuration, default_scaling};
use slitpose_fuzz::wire;
use slitpose_head::board_head;
use slitpose_head::scene_file::{SHIPPED, WIDE};
use slitpose_head::simulator::{SimulatedBoard, Trajectory, TrajectoryKind};
use slitpose_model::Tier;
use slitpose_protocol::{BootTarget, Command, Hashes, HeadPart, MAX_REQUEST_BYTES, Request, Stream, encode};

type Failure = Box<dyn std::error::Error>;

/// Measurements of test heads.
const HEADS: &str = "tests/data/heads";

fn main() -> Result<(), Failure> {
    wire()?;
    files()?;
    captures()
}

fn write(target: &str, name: &str, bytes: impl AsRef<[u8]>) -> Result<(), Failure> {
    Ok(fs::write(Path::new("tests/fuzz/corpus").join(target).join(name), bytes)?)
}

/// Every command.
fn commands() -> Result<Vec<(&'static str, Command)>, Failure> {
    let part = HeadPart::all(&head(&WIDE)?).next().ok_or("an empty head")?;
    Ok(vec![
        ("hello", Command::Hello),
        ("start", Command::Start),
        ("stop", Command::Stop),
        ("configure", Command::Configure(default_configuration())),
        ("ping", Command::Ping { token: 7 }),
        ("identify", Command::Identify { seconds: 1 }),
        ("store", Command::Store(Hashes { scene: Some(1), calibration: None })),
        ("forget", Command::Forget),
        ("reboot", Command::Reboot(BootTarget::Firmware)),
        ("head", Command::Head(part)),
        ("stream", Command::Stream(Stream::SCANS)),
    ])
}

fn head(shipped: &slitpose_head::scene_file::Shipped) -> Result<Vec<u8>, Failure> {
    let (schedule, scaling) = (default_configuration().schedule, default_scaling());
    Ok(board_head::encode(&shipped.read()?, &schedule, &scaling, Hashes::default())?)
}

fn wire() -> Result<(), Failure> {
    // As payloads: the target `board` adds the checksums.
    let mut whole = Vec::new();
    for (number, (name, command)) in (1..).zip(commands()?) {
        let mut buffer = [0; MAX_REQUEST_BYTES];
        let packet = encode(&Request { number, command }, &mut buffer)?;
        write("decoder", name, [&[128], packet].concat())?;
        let payload = wire::payload(&packet[..packet.len() - 1]).ok_or("no packet")?;
        let step = [&[1, payload.len() as u8], &payload[..], &[2, 3, 9, 200, 90], &[3, 1, 200]].concat();
        write("board", name, &step)?;
        if name != "reboot" {
            whole.extend(step);
        }
    }
    write("board", "all_of_them", &whole)?;
    let start = [&[1, 2, 1, 1][..], &[2, 4, 1, 2, 3, 4]].concat();
    for fault in 0..6 {
        write(
            "board",
            &format!("fault_{fault}"),
            [&start[..], &[5, 1, fault, 2, 2, 5, 6, 1, 2, 2, 2, 4, 0, 3, 1, 255]].concat(),
        )?;
    }
    for shipped in [&WIDE, &SHIPPED[1], &SHIPPED[3]] {
        if let Ok(bytes) = head(shipped) {
            write("head", shipped.name, [&[0, 40, 90, 200], &bytes[..]].concat())?;
        }
    }
    for (name, seed) in [("smooth", 1), ("other", 2)] {
        let stream = stream(seed, 12)?;
        write("decoder", name, [&[77], &stream[..]].concat())?;
        write("pipeline", name, [&[77], &stream[..]].concat())?;
        write("capture", &format!("{name}_bytes"), [&[77], &stream[..]].concat())?;
    }
    Ok(())
}

/// What a simulated board says from its start on.
fn stream(seed: u64, scans: usize) -> Result<Vec<u8>, Failure> {
    let smooth = Trajectory::of_kind(TrajectoryKind::Smooth, seed, 1.0);
    let mut board = SimulatedBoard::new(&WIDE.read()?, smooth, Tier::Paper, seed)?;
    let mut bytes = Vec::new();
    board.transmit(&mut bytes);
    board.write(encode(&Request { number: 1, command: Command::Start }, &mut [0; MAX_REQUEST_BYTES])?);
    (0..scans).for_each(|_| board.step(&mut bytes));
    Ok(bytes)
}

fn files() -> Result<(), Failure> {
    for shipped in SHIPPED {
        write("scene", &format!("{}.toml", shipped.name), shipped.text)?;
    }
    write("scene", "nominal.toml", fs::read(format!("{HEADS}/nominal.toml"))?)?;
    for name in ["head_1_free", "head_1_known", "head_1_quiet"] {
        let text = fs::read_to_string(format!("{HEADS}/{name}.csv"))?;
        write("table", &format!("{name}.csv"), text.lines().take(4).collect::<Vec<_>>().join("\n"))?;
    }
    Ok(())
}

/// Runs the command.
fn slitpose(arguments: &[OsString]) {
    let name = OsString::from("slitpose");
    let _ = slitpose::commands::main(std::iter::once(name).chain(arguments.iter().cloned()));
}

fn captures() -> Result<(), Failure> {
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("head.toml");
    let (scene, known) = (format!("{HEADS}/nominal.toml"), format!("{HEADS}/head_1_quiet.csv"));
    let path = file.display().to_string();
    slitpose(&["calibrate", &scene, "--known", &known, "--output", &path].map(OsString::from));
    write("calibration", "head.toml", shortened(&fs::read_to_string(&file)?)?)?;
    for (name, scene) in [("wide", "wide"), ("fine", "fine")] {
        let file = folder.path().join(format!("{name}.mcap"));
        let path = file.display().to_string();
        slitpose(&["simulate", "--scene", scene, "--duration", "5ms", "--output", &path].map(OsString::from));
        write("capture", name, [&[200], &fs::read(&file)?[..]].concat())?;
    }
    Ok(())
}

/// A calibration with the first parameters of each cell, as if they were all: a whole one has the correlations of
/// hundreds. The target puts its hash right.
fn shortened(text: &str) -> Result<String, Failure> {
    let mut table: toml::Table = text.parse()?;
    let mut kept = 0;
    for cell in table.get_mut("cell").and_then(|cells| cells.as_array_mut()).ok_or("no cells")? {
        let list = cell.get_mut("parameters").and_then(|list| list.as_array_mut()).ok_or("no parameters")?;
        list.truncate(3);
        kept += list.len();
    }
    let rows = (0..kept).map(|row| toml::Value::Array(vec![toml::Value::Float(0.0); row])).collect();
    if let Some(converter) = table.get_mut("converter").and_then(|converter| converter.get_mut("parameters")) {
        *converter = toml::Value::Array(Vec::new());
    }
    table["correlation"]["rows"] = toml::Value::Array(rows);
    table.remove("hash");
    Ok(format!("hash = \"0\"\n{}", toml::to_string(&table)?))
}
