//! Under which conditions the numbers of a report hold.

use std::fs;

use super::Settings;
use slitpose_head::scene_file::SceneFile;

/// Optimisation level of the compiler, from the build script.
const OPT_LEVEL: &str = env!("SLITPOSE_OPT_LEVEL");

/// The program and its version.
pub(crate) fn program() -> (&'static str, String) {
    ("program", format!("slitpose {}", env!("CARGO_PKG_VERSION")))
}

/// The scene, where it came from, and its hash.
pub(crate) fn scene(file: &SceneFile) -> (&'static str, String) {
    ("scene", format!("{} ({}), hash {:016x}", file.name, file.origin, file.hash))
}

/// Name and value of each condition.
pub(super) fn conditions(file: &SceneFile, settings: &Settings) -> Vec<(&'static str, String)> {
    let checks = if cfg!(debug_assertions) { "debug" } else { "release" };
    let counts = format!(
        "{} poses spread evenly over the workspace with every cell lit, the same ones every time; {} rounds of \
         timing, least and median shown",
        settings.poses,
        settings.rounds()
    );
    vec![
        program(),
        scene(file),
        ("processor", processor()),
        (
            "build",
            format!("{checks}, optimisation level {OPT_LEVEL}, {} {}", std::env::consts::ARCH, std::env::consts::OS),
        ),
        ("threads", "one".to_owned()),
        ("seed", settings.seed.to_string()),
        ("counts", counts),
        ("data", "computed by the model and disturbed by computed noise; nothing was measured".to_owned()),
    ]
}

/// Conditions under which times were measured.
pub(super) fn warnings() -> Vec<String> {
    let slow = format!(
        "This program was built with optimisation level {OPT_LEVEL}{}: its times say little. Build it with \
         `cargo build --release`.",
        if cfg!(debug_assertions) { " and with debug checks" } else { "" }
    );
    if is_fast(OPT_LEVEL, cfg!(debug_assertions)) { Vec::new() } else { vec![slow] }
}

/// Whether a build is one whose times are worth reading.
fn is_fast(opt_level: &str, debug_checks: bool) -> bool {
    !debug_checks && matches!(opt_level, "2" | "3")
}

/// The processor's name, from Linux.
fn processor() -> String {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let name = fs::read_to_string("/proc/cpuinfo").ok().and_then(|text| model_name(&text));
    format!("{}, {cores} of its cores usable", name.as_deref().unwrap_or("unknown"))
}

fn model_name(cpuinfo: &str) -> Option<String> {
    let value = |key: &str| {
        let line = cpuinfo.lines().find(|line| line.starts_with(key))?;
        Some(line.split_once(':')?.1.trim().to_owned()).filter(|value| !value.is_empty())
    };
    value("model name").or_else(|| value("Model")).or_else(|| value("CPU part"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_of_slow_builds_are_warned_of() {
        assert!(is_fast("3", false) && !is_fast("0", false) && !is_fast("2", true) && !is_fast("", false));
    }

    #[test]
    fn a_processor_is_called_what_the_system_calls_it() {
        let x86 = "processor\t: 0\nvendor_id\t: A\nmodel name\t: Some CPU @ 2 GHz\n";
        assert_eq!(model_name(x86).as_deref(), Some("Some CPU @ 2 GHz"));
        assert_eq!(model_name("CPU part\t: 0xd0b\n").as_deref(), Some("0xd0b"));
        assert_eq!(model_name("nothing"), None);
        assert!(!processor().is_empty());
    }
}
