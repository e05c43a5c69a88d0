//! Opens the board of a reader, at the start and after each loss.

use std::sync::{Arc, Mutex, MutexGuard};

use slitpose_protocol::{Configuration, Hello, Stream};

use super::error::BoardError;
use crate::device::{Contact, Conversation, DeviceError, HELLO_WITHIN, Selector, SimulatedDevice, SimulatedPort};
use slitpose_head::threads::lock;
use slitpose_tracking::link::{DeviceId, Segment};
use slitpose_tracking::pipeline::PipelineError;

/// Decides from a board's hello whether it can be followed.
pub(crate) type Admit = Box<dyn Fn(&Hello<'_>) -> Result<(), PipelineError> + Send>;

/// The stream of a board: of one that this host speaks to, or of one that another host follows.
pub(crate) trait Feed {
    fn name(&self) -> String;

    /// Waits for the board's hello, which `admit` accepts or refuses.
    fn greet(&mut self, admit: &mut dyn FnMut(&Hello<'_>) -> Result<(), BoardError>) -> Result<(), BoardError>;

    /// Has the board send scans by `configuration`, and what `stream` says of them, unless another host says by which.
    /// With a `head` it solves poses.
    fn start(&mut self, configuration: &Configuration, stream: Stream, head: Option<&[u8]>) -> Result<(), DeviceError>;

    /// Waits for bytes, a few hundredths of a second at most. `false` if the stream has ended.
    fn listen(&mut self) -> Result<bool, DeviceError>;

    /// Appends to `segment` what came since the last call.
    fn fill(&mut self, segment: &mut Segment);

    /// Ends what [`start`](Self::start) began.
    fn stop(&mut self) -> Result<(), DeviceError>;
}

impl Feed for Conversation {
    fn name(&self) -> String {
        self.name()
    }

    fn greet(&mut self, admit: &mut dyn FnMut(&Hello<'_>) -> Result<(), BoardError>) -> Result<(), BoardError> {
        self.greet(HELLO_WITHIN, admit)
    }

    fn start(&mut self, configuration: &Configuration, stream: Stream, head: Option<&[u8]>) -> Result<(), DeviceError> {
        self.configure(configuration.clone())?;
        if let Some(head) = head {
            self.send_head(head)?;
        }
        self.stream(stream)?;
        self.start()
    }

    fn listen(&mut self) -> Result<bool, DeviceError> {
        self.listen()
    }

    fn fill(&mut self, segment: &mut Segment) {
        self.fill(segment);
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        self.stop()
    }
}

/// Held while ports are searched for boards, until the board found has answered: two simultaneous searches would find
/// each other's ports in use.
static LOOKING: Mutex<()> = Mutex::new(());

pub(crate) trait Opener: Send {
    fn name(&self) -> String;

    /// Waits until no other reader searches for boards, if that would disturb the search.
    fn turn(&self) -> Option<MutexGuard<'static, ()>> {
        None
    }

    fn open(&mut self) -> Result<Box<dyn Feed>, DeviceError>;

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

    fn open(&mut self) -> Result<Box<dyn Feed>, DeviceError> {
        Ok(Box::new(Conversation::open(Box::new(self.open()?))?))
    }

    fn greeted(&mut self, device: DeviceId) {
        self.greeted(device);
    }
}

/// Opens a simulated board: once, or again after faults on its link.
pub(crate) struct SimulatedOpener {
    port: SimulatedPort,
    is_opened: bool,
}

impl SimulatedOpener {
    /// For `device`, which its user calls `name`.
    pub(crate) fn new(device: SimulatedDevice, name: String) -> Self {
        Self { port: SimulatedPort { name, device: Arc::new(Mutex::new(device)) }, is_opened: false }
    }
}

impl Opener for SimulatedOpener {
    fn name(&self) -> String {
        self.port.name.clone()
    }

    fn open(&mut self) -> Result<Box<dyn Feed>, DeviceError> {
        let is_there = !std::mem::replace(&mut self.is_opened, true) || lock(&self.port.device).reopen();
        match is_there {
            true => Ok(Box::new(Conversation::open(Box::new(self.port.clone()))?)),
            false => Err(DeviceError::Missing { name: self.name() }),
        }
    }
}
