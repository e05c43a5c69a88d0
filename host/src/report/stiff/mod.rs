//! stub
use crate::report::head::Head;
use crate::report::section::Section;
use crate::report::{ReportError, Settings};
pub(in crate::report) const TITLE: &str = "stiff";
pub(in crate::report) fn section(_: &Head<'_>, _: &Settings) -> Result<Section, ReportError> {
    Ok(Section { name: "stiff", title: TITLE, paragraphs: vec![], pictures: vec![], tables: vec![] })
}
