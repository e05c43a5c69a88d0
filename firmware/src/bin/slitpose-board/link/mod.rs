//! Links to the host: whoever opens one first has the board until it closes it.

#[cfg(feature = "uart")]
pub mod uart;
#[cfg(feature = "usb")]
pub mod usb;

use core::cell::Cell;

use embassy_executor::{SpawnError, SpawnToken, Spawner};
use embassy_sync::blocking_mutex::raw::ThreadModeRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::Duration;
use slitpose_firmware::{Link, TICK_HZ, Transfer};

use crate::Core;

/// A way to the host.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Port {
    /// The controller's own USB.
    #[cfg(feature = "usb")]
    Usb,
    /// The debugger's serial port.
    #[cfg(feature = "uart")]
    Uart,
}

/// The core and who talks to it.
pub struct Links {
    core: &'static Core,
    owner: Cell<Option<Port>>,
    /// There may be something to send by this port.
    outgoing: [Signal<ThreadModeRawMutex, ()>; 2],
    /// The board has become free.
    freed: Signal<ThreadModeRawMutex, ()>,
}

impl Links {
    /// Nobody talks yet.
    pub fn new(core: &'static Core) -> Self {
        Self { core, owner: Cell::new(None), outgoing: [Signal::new(), Signal::new()], freed: Signal::new() }
    }

    /// Polls the core; gives how long it can be left alone.
    pub fn poll(&self) -> Duration {
        let link = if self.owner.get().is_some() { Link::Open } else { Link::Closed };
        let ticks = self.core.lock(|core| {
            let mut core = core.borrow_mut();
            core.poll(link);
            let scans = core.scans_to_batch();
            core.hardware_mut().ticks_to(scans)
        });
        self.wake();
        // Rounded up: a poll a little early would only have to come again.
        ticks.map_or(Duration::MAX, |ticks| Duration::from_micros(ticks / TICKS_PER_US + 1))
    }

    /// Whether `port` has the board, or has it from now on.
    fn claim(&self, port: Port) -> bool {
        if self.owner.get().is_none() {
            self.owner.set(Some(port));
            self.poll();
        }
        self.owns(port)
    }

    /// `port` has been closed.
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

    /// Hands on what came in by `port`, if it has the board. Whether there was a command
    /// in it.
    fn receive(&self, port: Port, bytes: &[u8]) -> bool {
        if !self.owns(port) {
            return false;
        }
        let commands = self.core.lock(|core| core.borrow_mut().receive(bytes));
        self.wake();
        commands > 0
    }

    /// What is to be sent by `port`, as soon as there is something.
    async fn transmit<'t>(&self, port: Port, transfer: &'t mut Transfer) -> &'t [u8] {
        let length = loop {
            if self.owns(port) {
                let length = self.core.lock(|core| core.borrow_mut().transmit(transfer).len());
                if length > 0 {
                    break length;
                }
            }
            self.outgoing[port as usize].wait().await;
        };
        &transfer[..length]
    }
}

const TICKS_PER_US: u64 = TICK_HZ as u64 / 1_000_000;

/// Starts a task. Only one that runs already can be refused, and each is started once.
fn start<S>(spawner: Spawner, task: Result<SpawnToken<S>, SpawnError>) {
    if let Ok(task) = task {
        spawner.spawn(task);
    }
}
