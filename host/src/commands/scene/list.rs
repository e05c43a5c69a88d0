//! `slitpose scene list`: the scenes that come with the program.

use super::{CommandError, Outcome};
use slitpose_head::scene_file::SHIPPED;
use slitpose_head::table::Output;

pub(super) fn run() -> Result<Outcome, CommandError> {
    let lines: String = SHIPPED.iter().map(|shipped| format!("{:<9} {}\n", shipped.name, shipped.about)).collect();
    Output::open(None)?.write_text(&lines)?;
    Ok(Outcome::Done)
}
