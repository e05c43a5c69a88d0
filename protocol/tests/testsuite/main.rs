//! The tests of the protocol, in one program.

mod golden;
mod stream;
