//! The target `usb` of `tests/fuzz`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| slitpose_fuzz::run("usb", bytes));
