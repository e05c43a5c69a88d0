//! A report in a folder: one page that needs nothing else, the same in Markdown, tables and pictures.

use std::fs;
use std::path::{Path, PathBuf};

use quick_xml::escape::escape;
use slitpose_head::table::{Output, OutputError, TableWriter};

use super::section::{Picture, Report, Section, Table, Value};

const STYLE: &str = include_str!("page.css");

fn page(report: &Report) -> String {
    let title = format!("{}: {}", report.title, escape(&report.scene));
    let mut page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>\n"
    );
    for warning in &report.warnings {
        page += &format!("<p class=\"alert\">{}</p>\n", words(warning));
    }
    page += "<h2 id=\"summary\">In short</h2>\n<ul>\n";
    page.extend(report.summary().map(|sentence| format!("<li>{}</li>\n", words(sentence))));
    page += "</ul>\n<h2 id=\"conditions\">Conditions</h2>\n<dl>\n";
    for (name, value) in &report.conditions {
        page += &format!("<dt>{name}</dt><dd>{}</dd>\n", words(value));
    }
    page += "</dl>\n<nav>";
    for Section { name, title, .. } in &report.sections {
        page += &format!("<a href=\"#{name}\">{}</a> ", escape(*title));
    }
    page += "</nav>\n";
    for Section { name, title, paragraphs, pictures, tables, .. } in &report.sections {
        page += &format!("<h2 id=\"{name}\">{}</h2>\n", escape(*title));
        page.extend(paragraphs.iter().map(|paragraph| format!("<p>{}</p>\n", words(paragraph))));
        for Picture { svg, caption, .. } in pictures {
            page += &format!("<figure>\n{svg}<figcaption>{}</figcaption>\n</figure>\n", words(caption));
        }
        page.extend(tables.iter().map(of_table));
    }
    for Table { name, caption, .. } in &report.data {
        page += &format!("<p>{} (<a href=\"{name}.csv\">{name}.csv</a>)</p>\n", words(caption));
    }
    page + "</body>\n</html>\n"
}

fn of_table(table: &Table) -> String {
    let Table { name, caption, columns, rows } = table;
    let class = |is_number: bool| if is_number { " class=\"number\"" } else { "" };
    let mut text = format!(
        "<div class=\"wide\"><table>\n<caption>{} (<a href=\"{name}.csv\">{name}.csv</a>)</caption>\n<thead><tr>",
        words(caption)
    );
    for (index, (_, heading)) in columns.iter().enumerate() {
        text += &format!("<th{}>{}</th>", class(table.is_number(index)), escape(*heading));
    }
    text += "</tr></thead>\n<tbody>\n";
    for row in rows {
        text += "<tr>";
        for value in row {
            let class = if matches!(value, Value::Alert(_)) { " class=\"alert\"" } else { class(value.is_number()) };
            text += &format!("<td{class}>{}</td>", escape(value.shown()));
        }
        text += "</tr>\n";
    }
    text + "</tbody>\n</table></div>\n"
}

/// Escaped, with text between back ticks as code.
fn words(text: &str) -> String {
    let parts = text.split('`').enumerate().map(|(index, part)| {
        let part = escape(part);
        if index % 2 == 1 { format!("<code>{part}</code>") } else { part.into_owned() }
    });
    parts.collect()
}

fn markdown(report: &Report) -> String {
    let mut text = format!("# {}: {}\n\n", report.title, report.scene);
    text.extend(report.warnings.iter().map(|warning| format!("**{warning}**\n\n")));
    text += "## In short\n\n";
    text.extend(report.summary().map(|sentence| format!("* {sentence}\n")));
    text += "\n## Conditions\n\n";
    text.extend(report.conditions.iter().map(|(name, value)| format!("* {name}: {value}\n")));
    for Section { title, paragraphs, pictures, tables, .. } in &report.sections {
        text += &format!("\n## {title}\n");
        text.extend(paragraphs.iter().map(|paragraph| format!("\n{paragraph}\n")));
        text.extend(pictures.iter().map(|picture| format!("\n![{}]({}.svg)\n", picture.caption, picture.name)));
        text.extend(tables.iter().map(markdown_table));
    }
    text.extend(report.data.iter().map(|table| format!("\n{} (`{}.csv`)\n", table.caption, table.name)));
    // Names of scenes come from strangers, and Markdown passes elements of HTML on.
    text.replace('<', "&lt;")
}

fn markdown_table(table: &Table) -> String {
    let line = |fields: Vec<String>| format!("| {} |\n", fields.join(" | "));
    let rule = |index| if table.is_number(index) { "--:" } else { "---" }.to_owned();
    let mut text = format!("\n{} (`{}.csv`)\n\n", table.caption, table.name);
    text += &line(table.columns.iter().map(|(_, heading)| (*heading).to_owned()).collect());
    text += &line((0..table.columns.len()).map(rule).collect());
    for row in &table.rows {
        text += &line(row.iter().map(|value| value.shown().replace('|', "\\|")).collect());
    }
    text
}

/// Endings of names that are those of a page, a table or a picture.
const FILES: [&str; 7] = ["csv", "htm", "html", "md", "pdf", "png", "svg"];

/// The folder of a report. Made before anything is measured: an impossible place is refused at once.
#[derive(Debug)]
pub struct Folder {
    path: PathBuf,
}

impl Folder {
    /// Makes the folder if it is not there.
    pub fn create(path: &Path) -> Result<Self, OutputError> {
        let path = path.to_owned();
        if !path.is_dir() && path.extension().is_some_and(|ending| FILES.iter().any(|file| ending == *file)) {
            return Err(OutputError::Folder(path));
        }
        match fs::create_dir_all(&path) {
            Ok(()) => Ok(Self { path }),
            Err(source) => Err(OutputError::Create { path, source }),
        }
    }

    /// Writes everything; gives the files, the page first.
    pub fn write(&self, report: &Report) -> Result<Vec<PathBuf>, OutputError> {
        let mut written = Vec::new();
        let mut text = |name: String, text: &str| {
            let path = self.path.join(name);
            let done = Output::file(&path)?.write_text(text);
            written.push(path);
            done
        };
        text("index.html".to_owned(), &page(report))?;
        text("report.md".to_owned(), &markdown(report))?;
        for picture in report.sections.iter().flat_map(|section| &section.pictures) {
            text(format!("{}.svg", picture.name), &picture.svg)?;
        }
        for table in report.sections.iter().flat_map(|section| &section.tables).chain(&report.data) {
            let path = self.path.join(format!("{}.csv", table.name));
            table.write(Output::file(&path)?)?;
            written.push(path);
        }
        Ok(written)
    }
}

impl Table {
    /// As CSV.
    pub fn write(&self, output: Output) -> Result<(), OutputError> {
        let mut writer = TableWriter::new(output, self.columns.iter().map(|(name, _)| *name))?;
        for row in &self.rows {
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
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_escaped_and_code_is_marked() {
        assert_eq!(words("a < `b & c` > d"), "a &lt; <code>b &amp; c</code> &gt; d");
    }

    #[test]
    fn names_are_no_elements() {
        let conditions = vec![("seed", "1".into())];
        let report = Report { scene: "<script>".into(), conditions, ..Report::default() };
        let page = page(&report);
        assert!(!page.contains("<script"));
        assert!(!markdown(&report).contains('<'));
        assert!(page.contains("prefers-color-scheme: dark") && page.contains("<dt>seed</dt>"));
    }
}
