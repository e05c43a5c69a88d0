//! The solver on the board's processor: cycles, as the emulated board counts them.

use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::process::Command;

use super::head::Head;
use super::section::{Picture, Section, Table, Value, column};
use super::sheet::{Sheet, curve};
use super::{ReportError, Settings};
use crate::plot::{Axis, Chart, CurveStyle};
use slitpose_head::table::{TableError, TableReader};

pub(super) const TITLE: &str = "On the board: cycles of the solver";

/// The program that counts cycles: the emulator's, which knows the processor.
const PROGRAM: &str = "slitpose-cycles";

/// One way to solve, as counted.
struct Entry {
    words: [String; 3],
    cells: f64,
    poses: f64,
    median_cycles: f64,
    max_cycles: f64,
    median_us: f64,
    rms_um: f64,
    rms_urad: f64,
}

pub(super) fn section(head: &Head<'_>, settings: &Settings) -> Result<Section, ReportError> {
    let mut section = Section {
        name: "cycles",
        title: TITLE,
        summary: Vec::new(),
        paragraphs: Vec::new(),
        pictures: Vec::new(),
        tables: Vec::new(),
    };
    let (source, entries) = match (&settings.cycles, program()) {
        (Some(file), _) => {
            let file = file.display().to_string();
            let entries = read(TableReader::open(&file)?)?;
            (format!("the table {file}"), entries)
        }
        (None, Some(program)) => match run(&program, &head.file.origin) {
            Ok(text) => (format!("`{PROGRAM}`"), read(TableReader::new(PROGRAM, Cursor::new(text))?)?),
            Err(talk) => {
                let text = format!("`{}` lies beside this program but gave no table: {talk}.", program.display());
                section.paragraphs = vec![text, how_to()];
                return Ok(section);
            }
        },
        (None, None) => {
            section.paragraphs = vec!["No cycles were counted for this report.".to_owned(), how_to()];
            return Ok(section);
        }
    };
    section.paragraphs.push(format!(
        "The same solver in f32, run instruction by instruction on the emulated Cortex-M4F of the board, 170 MHz; from \
         {source}. Currents are free of noise, so that errors are the method's own. Cycles are those of the \
         emulator's timing model, not of silicon."
    ));
    section.pictures.push(picture(&entries));
    section.tables.push(table(&entries));
    Ok(section)
}

fn how_to() -> String {
    format!(
        "To have them: `firmware/build --stopwatch` and `cargo build --release -p slitpose-emulator`; then `{PROGRAM}` \
         lies beside this program, which runs it. Or save what it prints, and give it with `--cycles FILE`."
    )
}

/// The program that counts, if it lies beside this one.
fn program() -> Option<PathBuf> {
    let path = std::env::current_exe().ok()?.with_file_name(format!("{PROGRAM}{}", std::env::consts::EXE_SUFFIX));
    path.is_file().then_some(path)
}

/// The output of `program` for `scene`, or its last message.
fn run(program: &Path, scene: &str) -> Result<Vec<u8>, String> {
    let output = Command::new(program).arg(scene).output().map_err(|error| error.to_string())?;
    if output.status.success() {
        return Ok(output.stdout);
    }
    let talk = String::from_utf8_lossy(&output.stderr);
    let last = talk.lines().last().unwrap_or("it said nothing");
    Err(format!("it ended with {}: {last}", output.status))
}

fn read(mut table: TableReader) -> Result<Vec<Entry>, TableError> {
    let words = [table.column("scene")?, table.column("tier")?, table.column("start")?];
    let numbers = [
        table.column("cells")?,
        table.column("poses")?,
        table.column("median_cycles")?,
        table.column("max_cycles")?,
        table.column("median_us_at_170mhz")?,
        table.column("rms_error_um")?,
        table.column("rms_error_urad")?,
    ];
    let mut entries = Vec::new();
    while let Some(row) = table.next_row()? {
        let mut values = [0.0; 7];
        for (value, column) in values.iter_mut().zip(numbers) {
            *value = row.number(column)?;
        }
        let [cells, poses, median_cycles, max_cycles, median_us, rms_um, rms_urad] = values;
        let words = words.map(|column| row.text(column).to_owned());
        entries.push(Entry { words, cells, poses, median_cycles, max_cycles, median_us, rms_um, rms_urad });
    }
    Ok(entries)
}

fn table(entries: &[Entry]) -> Table {
    let row = |entry: &Entry| {
        let words = entry.words.iter().map(|word| Value::from(word.as_str()));
        let counts =
            [entry.cells, entry.poses, entry.median_cycles, entry.max_cycles].map(|n| Value::Count(n as usize));
        let numbers = [entry.median_us, entry.rms_um, entry.rms_urad].map(Value::from);
        words.chain(counts).chain(numbers).collect()
    };
    Table {
        name: "cycles",
        caption: "Cycles per solve on the emulated processor".to_owned(),
        columns: vec![
            column("scene", "scene"),
            column("tier", "tier"),
            column("start", "start"),
            column("cells", "cells"),
            column("poses", "poses"),
            column("median_cycles", "median cycles"),
            column("max_cycles", "most cycles"),
            column("median_us_at_170mhz", "median at 170 MHz / µs"),
            column("rms_error_um", "rms / µm"),
            column("rms_error_urad", "rms / µrad"),
        ],
        rows: entries.iter().map(row).collect(),
    }
}

fn picture(entries: &[Entry]) -> Picture {
    let point = |(index, entry): (usize, &Entry)| {
        let label = format!("{}, {} cells", entry.words.join(", "), entry.cells);
        curve(&label, index, CurveStyle::Markers, vec![[entry.median_us, entry.rms_um]])
    };
    let x = Axis::logarithmic("median time at 170 MHz / µs", entries.iter().map(|entry| entry.median_us));
    let y = Axis::logarithmic("rms error of the translation / µm", entries.iter().map(|entry| entry.rms_um));
    let curves = entries.iter().enumerate().map(point).collect();
    Sheet {
        title: TITLE.to_owned(),
        note: "f32 on the emulated Cortex-M4F: scene, tier, start, number of cells".to_owned(),
        panels: vec![(String::new(), Chart { x, y, curves, notes: Vec::new() })],
    }
    .draw("cycles", "Error of the translation against time on the board's processor.")
}
