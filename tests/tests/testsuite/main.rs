//! Tests of the whole chain and of the command, in one program.

mod bad_scenes_and_tables;
mod board_solver;
mod calibrate;
mod calibrated_heads;
mod configuration;
mod damaged_files;
mod device_commands;
mod device_update;
mod doctor;
mod foreign_text;
mod guide;
mod live_page;
mod outputs;
mod physics_chain;
mod refusals;
mod replay_identical;
mod report;
mod run_emulated;
mod run_serial;
mod run_simulated;
mod shared_memory;
mod solve_process;
mod status;
mod studies;
mod terminal_view;
mod unusable_boards;
