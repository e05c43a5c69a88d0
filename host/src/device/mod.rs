//! Boards at the other end of a byte stream, real or simulated.
//!
//! [`Device`] carries bytes without decoding them: [`SerialDevice`] is a serial port, `SimulatedDevice` a simulated
//! board. `Conversation` speaks the protocol over one of them: it greets, configures, starts and stops the board,
//! checks every reply, and passes on all other bytes.
//!
//! `find` searches for the board that a `Selector` names, `list` for all boards; a `Contact` opens one again and again,
//! wherever it is then.
//!
//! The host drops no bytes: those not fetched wait in the operating system, then in the board's queue, which drops its
//! oldest scans when full and so leaves gaps in their numbers.

pub(crate) use boot_loader::BootLoader;
pub(crate) use conversation::{Conversation, HELLO_WITHIN};
pub(crate) use discovery::{Contact, Found, Selector, find, list};
pub use error::{DeviceError, Scanless};
pub(crate) use listed::{BoardInfo, Listed, Port, PortState, UsbId};
pub use orders::KeepAlive;
pub(crate) use ports::{Search, ports};
pub use serial::SerialDevice;
pub(crate) use serial::{SimulatedDevice, SimulatedPort};
pub use stream::Device;

mod boot_loader;
mod conversation;
mod discovery;
mod error;
mod listed;
mod orders;
mod ports;
mod serial;
mod stream;
#[doc(hidden)]
pub mod update;
