//! The tests of what the board does, in one program.

mod behaviour;
mod common;
mod reference;
