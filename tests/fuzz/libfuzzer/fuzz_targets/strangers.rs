//! The target of `tests/fuzz` that the environment variable `SLITPOSE_FUZZ_TARGET` names.
#![no_main]

use std::sync::LazyLock;

static TARGET: LazyLock<String> =
    LazyLock::new(|| std::env::var("SLITPOSE_FUZZ_TARGET").expect("SLITPOSE_FUZZ_TARGET names a target"));

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| slitpose_fuzz::run(&TARGET, bytes));
