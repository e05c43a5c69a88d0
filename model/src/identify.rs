//! Identification of an emission profile from measured currents.

/// The relative radiant intensity that gives a measured photocurrent, I_rel = I_Om/(S·Ω·I_e):
/// equation (6) of De La Cruz, Gosselin, Bachta, Morel 2018.
///
/// `i_om_a` is the measured photocurrent without dark current (amperes), `solid_angle_sr` the
/// spot's Ω (steradians), `radiant_intensity_w_per_sr` the axial I_e, `responsivity_a_per_w` the
/// detector's S. `None` if the model expects no light: S·Ω·I_e is not positive, or so small that the
/// quotient is not finite.
pub fn identified_relative_intensity(
    i_om_a: f64,
    solid_angle_sr: f64,
    radiant_intensity_w_per_sr: f64,
    responsivity_a_per_w: f64,
) -> Option<f64> {
    let full = responsivity_a_per_w * solid_angle_sr * radiant_intensity_w_per_sr;
    (full > 0.0).then(|| i_om_a / full).filter(|relative| relative.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_equation_5_gives_equation_6_takes_back() {
        // I_O = Ω·I_e·I_rel·S of the bench: 3.5523 msr, 3.16 mW/sr, 0.54 A/W, I_rel = ½.
        let i_o_a = 3.5523e-3 * 3.16e-3 * 0.5 * 0.54;
        let relative = identified_relative_intensity(i_o_a, 3.5523e-3, 3.16e-3, 0.54);
        assert!((relative.expect("light") - 0.5).abs() < 1e-15);
        for dark in [[0.0, 3.16e-3, 0.54], [3.5523e-3, 0.0, 0.54], [3.5523e-3, 3.16e-3, 0.0]] {
            assert_eq!(identified_relative_intensity(i_o_a, dark[0], dark[1], dark[2]), None);
        }
        assert_eq!(identified_relative_intensity(i_o_a, 1e-312, 3.16e-3, 0.54), None);
    }
}
