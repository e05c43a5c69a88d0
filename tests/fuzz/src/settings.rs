//! Calibrations from strangers, and the configuration file of `run`.

use slitpose::inputs;
use slitpose_calibration::Calibration;
use slitpose_head::scene_file::{WIDE, fnv1a_64};
use slitpose_model::{Plan, Pose, Tier};

/// A calibration is refused with a message that names the file, or gives a head whose covariance is a number. The hash in
/// its first line is put right, else no mutation would be read.
pub(crate) fn calibration(bytes: &[u8]) {
    let rest = after_the_first_line(bytes);
    let repaired = [format!("hash = \"{:016x}\"\n", fnv1a_64(rest)).as_bytes(), rest].concat();
    for bytes in [bytes, &repaired] {
        let calibration = match Calibration::from_bytes("stranger.toml", bytes) {
            Ok(calibration) => calibration,
            Err(error) => {
                assert!(error.to_string().contains("stranger.toml"), "no place: {error}");
                continue;
            }
        };
        let covariance = calibration.pose_covariance(&Pose::HOME);
        assert!(covariance.iter().flatten().all(|value| !value.is_nan()), "a covariance is no number");
        let own = calibration.scene_file().ok();
        for file in own.into_iter().chain(WIDE.read()) {
            if let Ok(scene) = calibration.apply(&file) {
                assert!(Plan::<f64>::compile(&scene, Tier::Paper).is_ok());
            }
        }
    }
}

fn after_the_first_line(bytes: &[u8]) -> &[u8] {
    bytes.iter().position(|&byte| byte == b'\n').map_or(&[], |end| &bytes[end + 1..])
}

/// A configuration sets each option once, or is refused with a message that names the place.
pub(crate) fn configuration(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    match inputs::configuration(text) {
        Ok(mut options) => {
            let count = options.len();
            options.sort_unstable();
            options.dedup();
            assert_eq!(options.len(), count, "an option is set twice");
        }
        Err(message) => assert!(message.contains("config.toml"), "no place: {message}"),
    }
}
