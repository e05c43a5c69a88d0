//! What several whole-chain tests share.
//!
//! * [`process`] runs the `slitpose` command;
//! * [`terminal`] puts boards on pseudo-terminals, [`latency`] times their poses up to a client in C;
//! * [`scenes`] writes scene files, [`poses`] draws poses, [`capture`] records a simulated board;
//! * [`table`] and [`ndjson`] read what commands print;
//! * [`mod@reference`] holds independent numbers;
//! * [`consistency`] judges poses against the truth, [`statistics`] says how far chance goes;
//! * [`monte_carlo`] studies the solver over many random poses;
//! * [`lit_cells`] counts what a tracker costs whatever its head sees;
//! * [`faults`] injects every kind of fault and says what became of it;
//! * [`acceptance`] puts the whole daemon to long, rough and fast use; [`verdicts`] counts what is out of bounds.
//!
//! Nothing here calls the product to judge the product: errors, their covariances and
//! interpolations are computed anew.

pub mod acceptance;
pub mod capture;
pub mod consistency;
pub mod faults;
pub mod latency;
pub mod lit_cells;
pub mod monte_carlo;
pub mod ndjson;
pub mod poses;
pub mod process;
pub mod reference;
pub mod scenes;
pub mod statistics;
pub mod table;
pub mod terminal;
pub mod verdicts;
