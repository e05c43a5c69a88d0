//! What the tests of the whole board share; each test binary uses its part of it.
#![allow(dead_code)]

pub mod light;
pub mod talk;
