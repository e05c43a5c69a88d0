//! Tests of the behaviour of a board, in one program.

mod behaviour;
mod common;
mod reference;
mod start;
