//! Identification of an emission profile from measured currents.

/// Equation (6) of De La Cruz, Gosselin, Bachta, Morel 2018: the relative radiant intensity that
/// explains a measured photocurrent, I_rel = I_Om/(S·Ω·I_e).
///
/// `i_om_a` is the measured photocurrent without dark current (amperes), `solid_angle_sr` the
/// spot's Ω (steradians), `radiant_intensity_w_per_sr` the axial I_e, `responsivity_a_per_w` the
/// detector's S. `None` if the model expects no light there (the product S·Ω·I_e is not positive).
pub fn identified_relative_intensity(
    i_om_a: f64,
    solid_angle_sr: f64,
    radiant_intensity_w_per_sr: f64,
    responsivity_a_per_w: f64,
) -> Option<f64> {
    let full = responsivity_a_per_w * solid_angle_sr * radiant_intensity_w_per_sr;
    (full > 0.0).then(|| i_om_a / full)
}
