//! The target `optics` of `tests/fuzz`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| slitpose_fuzz::run("optics", bytes));
