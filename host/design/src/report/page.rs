//! A report as one page that needs nothing else: its style and pictures are in it.

use quick_xml::escape::escape;

use super::section::{Report, Section, Table, Value};

const STYLE: &str = include_str!("page.css");

/// The whole page.
pub(super) fn page(report: &Report) -> String {
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
    for sentence in report.summary() {
        page += &format!("<li>{}</li>\n", words(sentence));
    }
    page += "</ul>\n<h2 id=\"conditions\">Conditions</h2>\n<dl>\n";
    for (name, value) in &report.conditions {
        page += &format!("<dt>{name}</dt><dd>{}</dd>\n", words(value));
    }
    page += "</dl>\n<nav>";
    for section in &report.sections {
        page += &format!("<a href=\"#{}\">{}</a> ", section.name, escape(section.title));
    }
    page += "</nav>\n";
    for section in &report.sections {
        page += &of_section(section);
    }
    for table in &report.data {
        let file = format!("{}.csv", table.name);
        page += &format!("<p>{} (<a href=\"{file}\">{file}</a>)</p>\n", words(&table.caption));
    }
    page + "</body>\n</html>\n"
}

fn of_section(section: &Section) -> String {
    let mut text = format!("<h2 id=\"{}\">{}</h2>\n", section.name, escape(section.title));
    for paragraph in &section.paragraphs {
        text += &format!("<p>{}</p>\n", words(paragraph));
    }
    for picture in &section.pictures {
        text += &format!("<figure>\n{}<figcaption>{}</figcaption>\n</figure>\n", picture.svg, words(&picture.caption));
    }
    for table in &section.tables {
        text += &of_table(table);
    }
    text
}

fn of_table(table: &Table) -> String {
    let file = format!("{}.csv", table.name);
    let caption = words(&table.caption);
    let mut text = format!(
        "<div class=\"wide\"><table>\n<caption>{caption} (<a href=\"{file}\">{file}</a>)</caption>\n<thead><tr>"
    );
    let is_number = |index: usize| table.rows.first().is_some_and(|row| row.get(index).is_some_and(Value::is_number));
    for (index, column) in table.columns.iter().enumerate() {
        let class = if is_number(index) { " class=\"number\"" } else { "" };
        text += &format!("<th{class}>{}</th>", escape(column.heading));
    }
    text += "</tr></thead>\n<tbody>\n";
    for row in &table.rows {
        text += "<tr>";
        for value in row {
            let class = match value {
                Value::Alert(_) => " class=\"alert\"",
                Value::Text(_) => "",
                _ => " class=\"number\"",
            };
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

#[cfg(test)]
mod tests {
    use super::super::markdown::markdown;
    use super::*;

    #[test]
    fn words_are_escaped_and_code_is_marked() {
        assert_eq!(words("a < `b & c` > d"), "a &lt; <code>b &amp; c</code> &gt; d");
    }

    #[test]
    fn a_page_fetches_nothing_and_names_are_no_elements() {
        let section = Section {
            name: "a",
            title: "A",
            summary: vec!["Short.".into()],
            paragraphs: vec![],
            pictures: vec![],
            tables: vec![],
        };
        let report = Report {
            title: "t",
            scene: "<script>".into(),
            conditions: vec![("seed", "1".into())],
            warnings: vec![],
            sections: vec![section],
            leading: 0,
            data: Vec::new(),
        };
        let page = page(&report);
        for word in ["src=", "@import", "url(", "<script", "<link"] {
            assert!(!page.contains(word), "{word}");
        }
        assert!(!markdown(&report).contains('<'));
        assert!(page.contains("prefers-color-scheme: dark") && page.contains("<dt>seed</dt>"));
        assert!(page.find("<li>Short.</li>") < page.find("<dt>"), "the summary comes first");
    }
}
