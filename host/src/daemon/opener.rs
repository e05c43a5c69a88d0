//! Opens the board of a reader, at the start and after each loss.

use std::sync::{Mutex, MutexGuard};

use slitpose_protocol::Hello;

use crate::device::{Contact, Conversation, DeviceError, Selector, SimulatedPort};
use slitpose_head::threads::lock;
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::pipeline::PipelineError;

/// Decides from a board's hello whether it can be followed.
pub(crate) type Admit = Box<dyn Fn(&Hello<'_>) -> Result<(), PipelineError> + Send>;

/// Held while ports are searched for boards, until the board found has answered: two simultaneous searches would find
/// each other's ports in use.
static LOOKING: Mutex<()> = Mutex::new(());

pub(crate) trait Opener: Send {
    fn name(&self) -> String;

    /// Waits until no other reader searches for boards, if that would disturb the search.
    fn turn(&self) -> Option<MutexGuard<'static, ()>> {
        None
    }

    fn open(&mut self) -> Result<Conversation, DeviceError>;

    /// The board that was opened last has introduced itself.
    fn greeted(&mut self, _: DeviceId) {}
}

impl Opener for Contact {
    fn name(&self) -> String {
        self.selector.to_string()
    }

    fn turn(&self) -> Option<MutexGuard<'static, ()>> {
        let looks = !matches!(self.selector, Selector::Path(_));
        looks.then(|| lock(&LOOKING))
    }

    fn open(&mut self) -> Result<Conversation, DeviceError> {
        Conversation::open(Box::new(self.open()?))
    }

    fn greeted(&mut self, device: DeviceId) {
        self.greeted(device);
    }
}

/// A simulated board opens once, and again after faults on its link.
impl Opener for SimulatedPort {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn open(&mut self) -> Result<Conversation, DeviceError> {
        match lock(&self.device).open() {
            true => Conversation::open(Box::new(self.clone())),
            false => Err(DeviceError::Missing { name: self.name.clone() }),
        }
    }
}
