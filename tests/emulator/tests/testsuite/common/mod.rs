//! What the tests of the whole board share.

pub mod chain;
pub mod light;
pub mod talk;
