//! Reports: in a folder, or in short on standard output.

use slitpose_design::report::{Folder, Report};
use slitpose_head::table::Output;

use super::{CommandError, talk};

/// Writes `report` to `folder`; without one, prints it in short.
pub(super) fn publish(report: &Report, folder: Option<&Folder>) -> Result<(), CommandError> {
    match folder {
        Some(folder) => store(report, folder),
        None => {
            warn(report);
            Ok(Output::open(None)?.write_text(&report.in_short())?)
        }
    }
}

/// Writes `report` to `folder`, and says where.
pub(super) fn store(report: &Report, folder: &Folder) -> Result<(), CommandError> {
    warn(report);
    for path in folder.write(report)? {
        talk(format_args!("wrote {}", path.display()));
    }
    Ok(())
}

fn warn(report: &Report) {
    for warning in &report.warnings {
        talk(format_args!("{warning}"));
    }
}
