//! How a reader comes by its board, the first time and again.

use crate::device::{
    Device, DeviceError, DeviceId, Found, Search, Selector, SerialDevice, SimulatedDevice, find, locate,
};

/// How a reader comes by its board.
pub trait Opener: Send {
    /// What the user calls the board.
    fn name(&self) -> String;

    /// Opens a way to it.
    ///
    /// # Errors
    /// If it is not there, or cannot be had.
    fn open(&mut self) -> Result<Box<dyn Device>, DeviceError>;

    /// The board that was opened last has introduced itself.
    fn greeted(&mut self, _: DeviceId) {}
}

/// Opens the port of a board, wherever it is by then.
#[derive(Debug)]
pub struct PortOpener {
    selector: Selector,
    search: Vec<Search>,
    known: Option<Found>,
}

impl PortOpener {
    /// For the board that `selector` names, sought in the places of `search`, too.
    pub fn new(selector: Selector, search: Vec<Search>) -> Self {
        Self { selector, search, known: None }
    }
}

impl Opener for PortOpener {
    fn name(&self) -> String {
        self.selector.to_string()
    }

    fn open(&mut self) -> Result<Box<dyn Device>, DeviceError> {
        let port = match locate(&self.selector, self.known.as_ref()) {
            Some(port) => port,
            None => {
                let found = find(&self.selector, &self.search)?;
                self.known.insert(found).port.clone()
            }
        };
        Ok(Box::new(SerialDevice::open(&port)?))
    }

    fn greeted(&mut self, device: DeviceId) {
        if let Some(found) = &mut self.known {
            found.device = Some(device);
        }
    }
}

/// A simulated board, which is there once.
pub struct SimulatedOpener {
    device: Option<SimulatedDevice>,
}

impl SimulatedOpener {
    /// For `device`.
    pub fn new(device: SimulatedDevice) -> Self {
        Self { device: Some(device) }
    }
}

impl Opener for SimulatedOpener {
    fn name(&self) -> String {
        Selector::Sim.to_string()
    }

    fn open(&mut self) -> Result<Box<dyn Device>, DeviceError> {
        match self.device.take() {
            Some(device) => Ok(Box::new(device)),
            None => Err(DeviceError::Missing { name: self.name() }),
        }
    }
}
