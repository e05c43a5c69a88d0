//! Names of boards, as users give them.

use std::fmt;
use std::path::{MAIN_SEPARATOR, Path};
use std::str::FromStr;

use super::error::DeviceError;
use crate::link::DeviceId;

/// The user's choice of a board.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Selector {
    /// The only board connected.
    Auto,
    /// The simulated board.
    Sim,
    /// The board with this number, at any port.
    Serial(DeviceId),
    /// The board at this port.
    Path(String),
}

impl FromStr for Selector {
    type Err = DeviceError;

    /// `auto`, `sim`, the serial number of a board, or the path of a port.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "auto" => Ok(Self::Auto),
            "sim" => Ok(Self::Sim),
            _ => match text.parse() {
                Ok(device) => Ok(Self::Serial(device)),
                Err(_) if is_path(text) => Ok(Self::Path(text.to_owned())),
                Err(_) => Err(DeviceError::NotAPath { name: text.to_owned() }),
            },
        }
    }
}

impl fmt::Display for Selector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Sim => f.write_str("sim"),
            Self::Serial(device) => device.fmt(f),
            Self::Path(path) => f.write_str(path),
        }
    }
}

/// Whether `name` looks like the path of a port, and not like the name of a board.
pub(super) fn is_path(name: &str) -> bool {
    name.contains(['/', MAIN_SEPARATOR]) || (cfg!(windows) && name.starts_with("COM")) || Path::new(name).exists()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_boards_are_no_paths() {
        for path in ["/dev/ttyACM0", "./port", "/dev/serial/by-id/board"] {
            assert_eq!(path.parse::<Selector>().unwrap(), Selector::Path(path.to_owned()));
        }
        for name in ["3600290054485002", "usb", "", "Auto"] {
            assert!(name.parse::<Selector>().is_err(), "{name}");
        }
    }

    #[test]
    fn what_is_written_is_read() {
        for text in ["auto", "sim", "0036002900544850025a0320", "/dev/slitpose/0036002900544850025a0320"] {
            assert_eq!(text.parse::<Selector>().unwrap().to_string(), text);
        }
        let large = "0036002900544850025A0320".parse::<Selector>().unwrap();
        assert_eq!(large, "0036002900544850025a0320".parse().unwrap());
    }
}
