//! The tests of the protocol, in one program.

mod common;
mod golden;
mod stream;
