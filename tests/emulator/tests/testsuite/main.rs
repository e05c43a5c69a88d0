//! The tests of the whole emulated board, in one program.

mod common;
mod disturbances;
mod documents;
mod facts;
mod figures;
mod frames;
mod lab_clock;
mod light;
mod links;
mod poses;
mod schedules;
mod storage;
