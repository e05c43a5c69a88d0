//! Scene files for tests: the shipped default with a line changed, or a ring of any number of cells.

use slitpose_head::scene_file::{SceneFile, WIDE};

/// The shipped default scene with each `(old, new)` of `changes` replaced.
pub fn wide_with(changes: &[(&str, &str)]) -> String {
    changed(WIDE.text, changes)
}

/// `text` with each `(old, new)` of `changes` replaced.
pub fn changed(text: &str, changes: &[(&str, &str)]) -> String {
    changes.iter().fold(text.to_owned(), |text, (old, new)| {
        assert_eq!(text.matches(old).count(), 1, "`{old}` should stand in the scene once");
        text.replace(old, new)
    })
}

pub fn parse(text: &str) -> SceneFile {
    SceneFile::parse("test.toml", text).unwrap_or_else(|error| panic!("{error}"))
}

/// Everything of the default scene but its lighting, workspace and cells.
const OPTICS: &str = "\
[detector]
length_mm = 12.0
width_mm = 1.0
responsivity_a_per_w = 0.54
interelectrode_ohm = 50e3
saturation_a = 100e-6
[slit]
distance_mm = 5.0
width_mm = 0.6
length_mm = 10.0
[emitter]
radiant_intensity_w_per_sr = 3.16e-3
half_angle_deg = 55.0
[noise]
bandwidth_hz = 10e3
temperature_k = 300.0
adc_a = 0.6e-9
";

/// The electronics of the default scene at `frame_rate_hz`.
pub fn front_end(frame_rate_hz: f64) -> String {
    format!(
        "[front_end]\nfull_scale_a = 10e-6\nadc_bits = 12\nraw_noise_lsb = 1.0\noversampling = 4\n\
         time_constant_s = 1.36e-6\nsettling_s = 13e-6\nconversion_s = 0.87e-6\nframe_rate_hz = {frame_rate_hz:?}\n"
    )
}

/// Cells at equal angles around the tool with the dimensions of the default scene, cell k with its
/// detector's x axis `rolls_deg[k]` out of the ring's plane.
pub fn ring(rolls_deg: &[f64]) -> String {
    let mut text = OPTICS.to_owned();
    for (k, roll_deg) in rolls_deg.iter().enumerate() {
        let (sin, cos) = (std::f64::consts::TAU * k as f64 / rolls_deg.len() as f64).sin_cos();
        let (rise, along) = roll_deg.to_radians().sin_cos();
        text += &format!(
            "[[cell]]\ndetector_mm = [{:?}, {:?}, 0.0]\nx_axis = [{:?}, {:?}, {rise:?}]\nnormal = [{:?}, {:?}, 0.0]\n\
             emitter_mm = [{:?}, {:?}, 0.0]\nemitter_axis = [{cos:?}, {sin:?}, 0.0]\n",
            25.0 * cos,
            25.0 * sin,
            -sin * along,
            cos * along,
            -cos,
            -sin,
            10.0 * cos,
            10.0 * sin,
        );
    }
    text
}
