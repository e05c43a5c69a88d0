//! What a board started with: its clock and its settings.

use core::fmt;

use serde::{Deserialize, Serialize};

/// What a board's ticks are counted by, since its start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClockSource {
    /// The MCU's own RC oscillator, of the 1 % class: the board has no crystal.
    Internal,
    /// A crystal.
    Crystal,
    /// The MCU's own RC oscillator, as the board's crystal did not start.
    CrystalFailed,
}

/// Where a board's configuration came from when it started; after a Store or Forget, where the
/// next start would take it from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SettingsSource {
    /// From the firmware: none are stored, or they are not for this board.
    Defaults,
    /// From the settings stored on the board.
    Stored,
    /// From the firmware, although settings are stored: the board failed three times in a row
    /// while starting with them.
    PassedOver,
}

impl ClockSource {
    /// All of them, in the order of the wire.
    pub const ALL: [Self; 3] = [Self::Internal, Self::Crystal, Self::CrystalFailed];

    /// One word, for programs.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Internal => "internal",
            Self::Crystal => "crystal",
            Self::CrystalFailed => "crystal_failed",
        }
    }
}

impl SettingsSource {
    /// All of them, in the order of the wire.
    pub const ALL: [Self; 3] = [Self::Defaults, Self::Stored, Self::PassedOver];

    /// One word, for programs.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Defaults => "defaults",
            Self::Stored => "stored",
            Self::PassedOver => "passed_over",
        }
    }
}

/// For people.
impl fmt::Display for ClockSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Internal => "internal oscillator",
            Self::Crystal => "crystal",
            Self::CrystalFailed => "internal oscillator, as the crystal did not start",
        })
    }
}

/// For people.
impl fmt::Display for SettingsSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Defaults => "defaults of the firmware",
            Self::Stored => "stored on the board",
            Self::PassedOver => "defaults of the firmware, as three starts in a row with the stored ones failed",
        })
    }
}
