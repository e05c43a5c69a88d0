//! Arguments that take one of a few names, or something of the user's own, such as a file.

use std::ffi::OsStr;

use clap::builder::{PossibleValue, StringValueParser, TypedValueParser};
use clap::{Arg, Command, ValueEnum};

use slitpose_head::scene_file::SHIPPED;
use slitpose_head::simulator::TrajectoryKind;

/// Takes any text, and has shells complete some names.
#[derive(Clone)]
pub(super) struct Names(Vec<String>);

impl TypedValueParser for Names {
    type Value = String;

    fn parse_ref(&self, command: &Command, arg: Option<&Arg>, value: &OsStr) -> Result<String, clap::Error> {
        StringValueParser::new().parse_ref(command, arg, value)
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(self.0.iter().map(PossibleValue::new)))
    }
}

impl Names {
    /// The names, as the scripts of shells list them.
    pub(super) fn list(&self) -> &[String] {
        &self.0
    }
}

/// A scene file, or the name of a shipped scene.
pub(super) fn scenes() -> Names {
    Names(SHIPPED.iter().map(|shipped| shipped.name.to_owned()).collect())
}

/// The path of a port, the number of a board, or a name that stands for boards.
pub(super) fn devices() -> Names {
    Names(["auto", "sim"].map(str::to_owned).to_vec())
}

/// A table of poses, or the name of a motion.
pub(super) fn motions() -> Names {
    let values = TrajectoryKind::value_variants().iter().filter_map(ValueEnum::to_possible_value);
    Names(values.map(|value| value.get_name().to_owned()).collect())
}
