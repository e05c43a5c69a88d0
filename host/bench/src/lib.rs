//! A virtual bench: one head drawn from the tolerances of a scene, and what an instrument and a board measure on it.
//!
//! * [`DrawnHead`] is the head: parts off their places as `[tolerance]` says, and, if asked for, physics beyond the model;
//! * [`Session`] measures on it: tables for `calibrate` and `solve`, with the truth apart;
//! * [`write()`] makes a folder of them.
//!
//! Nothing here has been measured. A seed determines every byte.

#![forbid(unsafe_code)]

mod chance;
mod drawn;
mod folder;
mod session;

pub use drawn::{Beyond, DrawnHead, Within};
pub use folder::{BenchError, write};
pub use session::{Session, Settings, Table};
