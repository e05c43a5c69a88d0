//! The tests of the whole emulated board, in one program.

mod common;
mod counts;
mod disturbances;
mod facts;
mod facts_page;
mod frames;
mod light;
mod links;
mod panics;
mod poses;
mod schedules;
mod storage;
