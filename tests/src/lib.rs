//! What several whole-chain tests share, and the studies that run at any size.
//!
//! * [`process`] runs the `slitpose` command, [`daemon`] watches it while it runs;
//! * [`terminal`] puts boards on pseudo-terminals;
//! * [`scenes`] writes scene files, [`poses`] draws poses, [`capture`] records a simulated board;
//! * [`table`] and [`ndjson`] read what commands print, and independent numbers;
//! * [`consistency`] judges poses against the truth and says how far chance goes;
//! * [`studies`] has all that is also run for long: by the example `study` in full size, by the tests in small.
//!
//! Nothing here calls the product to judge the product: errors, their covariances and
//! interpolations are computed anew. Whatever cannot be prepared panics, which fails the test that asked for it.
#![allow(missing_docs, reason = "no library, but the common part of tests: comments say what names do not")]

pub mod capture;
pub mod consistency;
pub mod daemon;
pub mod ndjson;
pub mod poses;
pub mod process;
pub mod scenes;
pub mod studies;
pub mod table;
pub mod terminal;
