//! The tests of the model, in one program: its generic code is compiled once.

mod acceptance;
mod common;
mod derivatives;
mod effects;
mod images;
mod kinks;
mod layouts;
mod noise;
mod openings;
mod profiles;
mod solve;
mod tolerance;
mod track;
