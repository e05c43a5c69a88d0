//! A report as Markdown: all words and tables.

use super::section::{Report, Section, Table, Value};

/// The whole report.
pub(super) fn markdown(report: &Report) -> String {
    let mut text = format!("# {}: {}\n\n", report.title, report.scene);
    for warning in &report.warnings {
        text += &format!("**{warning}**\n\n");
    }
    text += "## In short\n\n";
    for sentence in report.summary() {
        text += &format!("* {sentence}\n");
    }
    text += "\n## Conditions\n\n";
    for (name, value) in &report.conditions {
        text += &format!("* {name}: {value}\n");
    }
    for section in &report.sections {
        text += &of_section(section);
    }
    for table in &report.data {
        text += &format!("\n{} (`{}.csv`)\n", table.caption, table.name);
    }
    // Names of scenes come from strangers, and Markdown passes elements of HTML on.
    text.replace('<', "&lt;")
}

fn of_section(section: &Section) -> String {
    let mut text = format!("\n## {}\n", section.title);
    for paragraph in &section.paragraphs {
        text += &format!("\n{paragraph}\n");
    }
    for picture in &section.pictures {
        text += &format!("\n![{}]({}.svg)\n", picture.caption, picture.name);
    }
    for table in &section.tables {
        text += &of_table(table);
    }
    text
}

fn of_table(table: &Table) -> String {
    let line = |fields: Vec<String>| format!("| {} |\n", fields.join(" | "));
    let mut text = format!("\n{} (`{}.csv`)\n\n", table.caption, table.name);
    text += &line(table.columns.iter().map(|column| column.heading.to_owned()).collect());
    let first = table.rows.first();
    let is_number = |index: usize| first.is_some_and(|row| row.get(index).is_some_and(Value::is_number));
    text += &line((0..table.columns.len()).map(|i| if is_number(i) { "--:" } else { "---" }.to_owned()).collect());
    for row in &table.rows {
        text += &line(row.iter().map(|value| value.shown().replace('|', "\\|")).collect());
    }
    text
}
