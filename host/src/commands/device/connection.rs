//! To one board: found, opened, and asked who it is.

use std::time::Duration;

use clap::builder::TypedValueParser;

use crate::commands::CommandError;
use crate::commands::{options, talk};
use crate::device::{
    BoardInfo, Conversation, Device, DeviceError, Found, Search, Selector, SerialDevice, SimulatedDevice, find, holders,
};
use crate::link::Versions;
use crate::pipeline::PipelineError;
use slitpose_head::scene_file::SceneFile;

/// Time that a board needs if its other port was asked just before.
const HELLO_WITHIN: Duration = Duration::from_millis(2500);

/// Which board.
#[derive(Debug, clap::Args)]
pub(in crate::commands) struct BoardOptions {
    /// The board: its serial number, the path of its port, auto: the one there is, or sim: a simulated one
    #[arg(
        long, value_name = "DEVICE", default_value = "auto", hide_possible_values = true,
        value_parser = options::devices().try_map(|text| text.parse::<Selector>())
    )]
    pub(in crate::commands) device: Selector,
    /// Look for boards here, too: a path with * and ?, such as '/dev/ttyUSB*'; may be repeated
    #[arg(long, value_name = "GLOB")]
    pub(in crate::commands) search: Vec<Search>,
}

pub(in crate::commands) struct Connection {
    pub(in crate::commands) board: Conversation,
    pub(in crate::commands) info: BoardInfo,
    pub(in crate::commands) found: Found,
}

impl BoardOptions {
    /// Finds the board, opens its port and asks who it is; a simulated one has the head of `file`.
    pub(in crate::commands) fn connect(&self, file: &SceneFile) -> Result<Connection, CommandError> {
        let found = find(&self.device, &self.search)?;
        let device: Box<dyn Device> = match &self.device {
            Selector::Sim => Box::new(SimulatedDevice::live(file)?),
            _ => Box::new(SerialDevice::open(&found.port).inspect_err(|error| name_holders(error, &found.port))?),
        };
        let mut board = Conversation::open(device)?;
        let info = board.introduce(HELLO_WITHIN)?;
        Ok(Connection { board, info, found })
    }
}

impl Connection {
    /// The same, if board and program understand each other.
    pub(in crate::commands) fn understood(self) -> Result<Self, CommandError> {
        match self.info.mismatch {
            None => Ok(self),
            Some(source) => {
                let versions = Versions { board: self.info.protocol };
                Err(PipelineError::Schema { board: self.info.board, versions, source }.into())
            }
        }
    }

    pub(in crate::commands) fn name(&self) -> String {
        format!("{} on {}", self.info.device, self.found.port)
    }
}

fn name_holders(error: &DeviceError, port: &str) {
    if let DeviceError::Busy { .. } = error {
        for holder in holders(port) {
            talk(format_args!("{holder} has {port} open"));
        }
    }
}
