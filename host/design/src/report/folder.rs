//! A report in a folder: a page, a Markdown text, tables and pictures.

use std::fs;
use std::path::{Path, PathBuf};

use super::section::{Report, Table, Value};
use super::{markdown, page};
use slitpose_head::table::{Output, OutputError, TableWriter};

/// Endings of names that are those of a page, a table or a picture.
const FILES: [&str; 7] = ["csv", "htm", "html", "md", "pdf", "png", "svg"];

/// The folder of a report. Made before anything is measured: an impossible place is refused at once.
#[derive(Debug)]
pub struct Folder {
    path: PathBuf,
}

impl Folder {
    /// Makes the folder if it is not there.
    ///
    /// # Errors
    /// If it cannot be made, or is named as a file.
    pub fn create(path: &Path) -> Result<Self, OutputError> {
        let path = path.to_owned();
        if !path.is_dir() && path.extension().is_some_and(|ending| FILES.iter().any(|file| ending == *file)) {
            return Err(OutputError::Folder { path });
        }
        match fs::create_dir_all(&path) {
            Ok(()) => Ok(Self { path }),
            Err(source) => Err(OutputError::Create { path, source }),
        }
    }

    /// Writes everything; gives the files, the page first.
    ///
    /// # Errors
    /// If something cannot be written.
    pub fn write(&self, report: &Report) -> Result<Vec<PathBuf>, OutputError> {
        let mut written = Vec::new();
        let mut text = |name: String, text: &str| {
            let path = self.path.join(name);
            let done = Output::file(&path)?.write_text(text);
            written.push(path);
            done
        };
        text("index.html".to_owned(), &page::page(report))?;
        text("report.md".to_owned(), &markdown::markdown(report))?;
        for picture in report.sections.iter().flat_map(|section| &section.pictures) {
            text(format!("{}.svg", picture.name), &picture.svg)?;
        }
        for table in report.sections.iter().flat_map(|section| &section.tables).chain(&report.data) {
            let path = self.path.join(format!("{}.csv", table.name));
            write_table(table, Output::file(&path)?)?;
            written.push(path);
        }
        Ok(written)
    }
}

fn write_table(table: &Table, output: Output) -> Result<(), OutputError> {
    let mut writer = TableWriter::new(output, table.columns.iter().map(|column| column.name))?;
    for row in &table.rows {
        for value in row {
            match value {
                Value::Text(text) | Value::Alert(text) => writer.text(text),
                Value::Number(number) => writer.number(*number),
                Value::Count(count) => writer.text(&count.to_string()),
                Value::Missing => writer.optional(None),
            }
        }
        writer.end_row()?;
    }
    writer.finish()
}
