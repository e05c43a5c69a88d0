//! `slitpose scene list`: the scenes that come with the program.

use super::{CommandError, Outcome};
use crate::scene_file::SHIPPED;
use crate::table::Output;

pub(super) fn run() -> Result<Outcome, CommandError> {
    let lines: String = SHIPPED.iter().map(|shipped| format!("{:<6} {}\n", shipped.name, shipped.about)).collect();
    Output::open(None)?.write_text(&lines)?;
    Ok(Outcome::Done)
}
