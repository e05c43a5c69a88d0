//! The table of sections and keys a scene file may have.

/// Keys at the top level, sections included.
pub(super) const TOP: &[&str] = &[
    "name",
    "detector",
    "slit",
    "emitter",
    "window",
    "stray",
    "converter",
    "noise",
    "front_end",
    "uncertainty",
    "tolerance",
    "lighting",
    "workspace",
    "cell",
];

/// Keys of a `[[cell]]`: its own five, or the cell whose detector it reads the second axis of; and the sections it may
/// override key by key.
pub(super) const CELL: &[&str] = &[
    "detector_mm",
    "x_axis",
    "normal",
    "emitter_mm",
    "emitter_axis",
    "second_axis_of",
    "detector",
    "slit",
    "emitter",
    "window",
    "stray",
    "converter",
];

/// Sections whose keys a cell may override.
pub(super) const PER_CELL: &[&str] = &["detector", "slit", "emitter", "window", "stray", "converter"];

/// The three ways to give an emitter's profile, exactly one of which is needed.
pub(super) const PROFILES: [&str; 3] = ["half_angle_deg", "profile_exponent", "profile"];

/// Every section with its keys.
const SECTIONS: &[(&str, &[&str])] = &[
    (
        "detector",
        &[
            "part",
            "length_mm",
            "width_mm",
            "responsivity_a_per_w",
            "dark_current_a",
            "interelectrode_ohm",
            "saturation_a",
            "faint_a",
            "nonlinearity_mm",
            "electrode_gain",
        ],
    ),
    (
        "slit",
        &[
            "distance_mm",
            "width_mm",
            "length_mm",
            "diameter_mm",
            "focal_length_mm",
            "offset_mm",
            "tilt_deg",
            "thickness_mm",
            "mount",
        ],
    ),
    (
        "emitter",
        &[
            "part",
            "radiant_intensity_w_per_sr",
            "source_diameter_mm",
            "half_angle_deg",
            "profile_exponent",
            "profile",
            "profile_radial",
            "profile_azimuthal",
        ],
    ),
    ("window", &["thickness_mm", "refractive_index"]),
    ("stray", &["current_a", "centre_mm", "linear_a_per_mm", "quadratic_a_per_mm2"]),
    ("converter", &["full_scale_a", "curve_1_a", "curve_2_a"]),
    ("noise", &["bandwidth_hz", "temperature_k", "adc_a"]),
    (
        "front_end",
        &[
            "full_scale_a",
            "adc_bits",
            "raw_noise_lsb",
            "oversampling",
            "time_constant_s",
            "settling_s",
            "conversion_s",
            "frame_rate_hz",
        ],
    ),
    ("uncertainty", &["emitter_gain_relative", "electrode_gain_relative", "position_mm"]),
    (
        "tolerance",
        &[
            "position_mm",
            "angle_deg",
            "slit_width_mm",
            "emitter_angle_deg",
            "emitter_gain_relative",
            "electrode_gain_relative",
            "profile_relative",
            "nonlinearity_mm",
            "window_mm",
            "stray_relative",
        ],
    ),
    ("lighting", &["slots"]),
    ("workspace", &["half_extent_mm", "half_extent_deg"]),
];

/// All sections, with the keys each may have.
pub(super) fn sections() -> impl Iterator<Item = (&'static str, &'static [&'static str])> {
    SECTIONS.iter().copied()
}
