//! Links to the host: the port that is opened first has the board until it is closed.

#[cfg(feature = "uart")]
pub mod uart;
#[cfg(feature = "usb")]
pub mod usb;

use core::cell::Cell;

use embassy_executor::{SpawnError, SpawnToken, Spawner};
use embassy_sync::blocking_mutex::raw::ThreadModeRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::Duration;
use slitpose_firmware::pcb::TICK_HZ;
use slitpose_firmware::{Link, TransmitBuffer};

use crate::Core;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Port {
    /// The MCU's own USB.
    #[cfg(feature = "usb")]
    Usb,
    #[cfg(feature = "uart")]
    Uart,
}

/// The core, and the port that has it.
pub struct Links {
    core: &'static Core,
    owner: Cell<Option<Port>>,
    /// Raised when there may be bytes to send by a port.
    outgoing: [Signal<ThreadModeRawMutex, ()>; 2],
    /// Raised when the board has become free.
    freed: Signal<ThreadModeRawMutex, ()>,
}

impl Links {
    /// Links to `core`, of which no port has it.
    pub fn new(core: &'static Core) -> Self {
        Self { core, owner: Cell::new(None), outgoing: [Signal::new(), Signal::new()], freed: Signal::new() }
    }

    /// Polls the core; gives the time until the next batch is due.
    pub fn poll(&self) -> Duration {
        let link = if self.owner.get().is_some() { Link::Open } else { Link::Closed };
        let ticks = self.core.lock(|core| {
            let mut core = core.borrow_mut();
            core.poll(link);
            let scans = core.scans_to_poll();
            if scans == 0 { Some(0) } else { core.hardware_mut().ticks_to(scans) }
        });
        self.wake();
        // Rounded up: a poll that comes a little early finds no batch.
        ticks.map_or(Duration::MAX, |ticks| Duration::from_micros(ticks / TICKS_PER_US + 1))
    }

    /// Gives the board to `port` if it is free; whether `port` has the board then.
    fn claim(&self, port: Port) -> bool {
        if self.owner.get().is_none() {
            self.owner.set(Some(port));
            self.poll();
        }
        self.owns(port)
    }

    /// Frees the board because `port` has been closed.
    fn release(&self, port: Port) {
        if self.owns(port) {
            self.owner.set(None);
            self.poll();
            self.freed.signal(());
        }
    }

    fn wake(&self) {
        if let Some(owner) = self.owner.get() {
            self.outgoing[owner as usize].signal(());
        }
    }

    fn owns(&self, port: Port) -> bool {
        self.owner.get() == Some(port)
    }

    /// Hands `bytes` from `port` to the core if `port` has the board. Whether a command
    /// ended in them.
    fn receive(&self, port: Port, bytes: &[u8]) -> bool {
        if !self.owns(port) {
            return false;
        }
        let commands = self.core.lock(|core| core.borrow_mut().receive(bytes));
        self.wake();
        commands > 0
    }

    /// Waits for bytes to send by `port`.
    async fn transmit<'b>(&self, port: Port, buffer: &'b mut TransmitBuffer) -> &'b [u8] {
        let length = loop {
            if self.owns(port) {
                let length = self.core.lock(|core| core.borrow_mut().transmit(buffer).len());
                if length > 0 {
                    break length;
                }
            }
            self.outgoing[port as usize].wait().await;
        };
        &buffer[..length]
    }
}

const TICKS_PER_US: u64 = TICK_HZ as u64 / 1_000_000;

/// Starts a task. The executor refuses only a task that runs already, and each is started
/// once.
fn start<S>(spawner: Spawner, task: Result<SpawnToken<S>, SpawnError>) {
    if let Ok(task) = task {
        spawner.spawn(task);
    }
}
