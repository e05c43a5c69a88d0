//! The tests of the model, in one program: its generic code is compiled once.

mod acceptance;
#[cfg(feature = "batch")]
mod batch;
mod common;
mod derivatives;
mod effects;
mod honesty;
mod images;
mod kinks;
mod misfit;
mod noise;
mod numbers;
mod openings;
mod profiles;
mod solve;
mod tolerance;
mod track;
