//! From a scene to a plan: validation, normalisation, and everything that does not depend on the
//! pose.

use glam::DVec3;

use crate::aperture::Aperture;
use crate::effects::{Effects, Opening, RADIAL_TERMS};
use crate::exact::Orders;
use crate::profile::CompiledProfile;
use crate::scalar::{Number, Vector3};
use crate::scene::{Cell, Detector, Emitter, Fault, Place, Profile, Scene, SceneError, Slit};

use super::imperfect::Imperfect;
use super::optics::{Receiver, Source};
use super::{CompiledCell, CompiledEmitter, Tier};

/// Greatest deviation of an axis from unit length or perpendicularity that normalisation corrects.
const AXIS_TOLERANCE: f64 = 1e-6;

/// Greatest length or position, metres: squares and cubes of larger ones leave the range of `f32`.
const MAX_M: f64 = 1e6;

/// Greatest intensity, responsivity, current or relative intensity, SI units.
const LARGEST: f64 = 1e9;

/// Relative error of the integrals over an opening in the paper tier.
const OPENING_TOLERANCE: f64 = 1e-6;

/// Greatest exponent of a profile: a half angle of 0.07°.
const MAX_EXPONENT: f64 = 1e6;

/// Checks of single values; holds their place in the scene for the error.
struct Check {
    cell: Option<usize>,
    section: &'static str,
}

impl Check {
    fn fault(&self, key: &'static str, fault: Fault) -> SceneError {
        SceneError { place: Place { cell: self.cell, section: self.section, key }, fault }
    }

    fn finite(&self, key: &'static str, values: &[f64]) -> Result<(), SceneError> {
        match values.iter().find(|value| !value.is_finite()) {
            Some(&value) => Err(self.fault(key, Fault::NotFinite(value))),
            None => Ok(()),
        }
    }

    /// Requires finite `values` of at most `most`.
    fn within(&self, key: &'static str, values: &[f64], most: f64) -> Result<(), SceneError> {
        self.finite(key, values)?;
        match values.iter().find(|value| value.abs() > most) {
            Some(&value) => Err(self.fault(key, Fault::TooLarge(value))),
            None => Ok(()),
        }
    }

    fn not_negative(&self, key: &'static str, value: f64) -> Result<(), SceneError> {
        self.finite(key, &[value])?;
        if value < 0.0 {
            return Err(self.fault(key, Fault::Negative(value)));
        }
        Ok(())
    }

    fn positive(&self, key: &'static str, value: f64) -> Result<(), SceneError> {
        self.finite(key, &[value])?;
        if value <= 0.0 {
            return Err(self.fault(key, Fault::NotPositive(value)));
        }
        Ok(())
    }

    fn unit(&self, key: &'static str, axis: DVec3) -> Result<DVec3, SceneError> {
        self.finite(key, &axis.to_array())?;
        let length = axis.length();
        if (length - 1.0).abs() > AXIS_TOLERANCE {
            return Err(self.fault(key, Fault::NotUnit(length)));
        }
        Ok(axis * length.recip())
    }
}

/// Passes the cells of `scene` on, one by one: together they may be too long for a stack.
#[inline(never)]
pub fn cells<S: Number>(scene: &Scene, tier: Tier, mut sink: impl FnMut(CompiledCell<S>)) -> Result<(), SceneError> {
    let of_scene = Check { cell: None, section: "cell" };
    if scene.cells.is_empty() {
        return Err(of_scene.fault("detector_mm", Fault::NoCells));
    }
    check_noise(scene)?;
    for (index, cell) in scene.cells.iter().enumerate() {
        let mut compiled = compile_cell(index, cell, tier)?;
        compiled.imperfect = cell.acting_effects().map(|effects| compile_effects(index, cell, effects)).transpose()?;
        sink(compiled);
    }
    Ok(())
}

fn compile_effects<S: Number>(index: usize, cell: &Cell, effects: &Effects) -> Result<Imperfect<S>, SceneError> {
    check_effects(index, effects)?;
    check_opening(index, cell, effects)?;
    let turned = Check { cell: Some(index), section: "slit" };
    let tilt = cell.slit.tilt_rad.length().to_degrees();
    Imperfect::compile(cell, effects).ok_or(turned.fault("tilt_deg", Fault::TurnedWithEffects(tilt)))
}

fn check_noise(scene: &Scene) -> Result<(), SceneError> {
    if let Some(noise) = &scene.noise {
        let check = Check { cell: None, section: "noise" };
        check.not_negative("bandwidth_hz", noise.shot_bandwidth_hz)?;
        check.not_negative("bandwidth_hz", noise.johnson_bandwidth_hz)?;
        check.not_negative("temperature_k", noise.temperature_k)?;
        check.not_negative("adc_a", noise.adc_a)?;
    }
    let check = Check { cell: None, section: "uncertainty" };
    check.not_negative("emitter_gain_relative", scene.uncertainty.emitter_gain_relative)?;
    check.not_negative("electrode_gain_relative", scene.uncertainty.electrode_gain_relative)?;
    check.not_negative("position_mm", scene.uncertainty.position_m)?;
    let check = Check { cell: None, section: "tolerance" };
    check.not_negative("light_level_relative", scene.uncertainty.light_level_relative)?;
    check.not_negative("emitter_drift_relative", scene.uncertainty.emitter_drift_relative)?;
    if scene.uncertainty.emitter_drift_relative > 0.0 {
        check.positive("emitter_drift_minutes", scene.uncertainty.emitter_drift_s)?;
    }
    Ok(())
}

fn compile_cell<S: Number>(index: usize, cell: &Cell, tier: Tier) -> Result<CompiledCell<S>, SceneError> {
    let at = |section| Check { cell: Some(index), section };
    let (x_axis, normal) = check_detector(&at("detector"), &at("cell"), &cell.detector)?;
    check_slit(&at("slit"), &cell.slit)?;
    let axis = check_emitter(&at("emitter"), &at("cell"), &cell.emitter)?;

    let has_opening = cell.opening() != Opening::Slit;
    let tolerance = match tier {
        Tier::Paper if has_opening => OPENING_TOLERANCE,
        Tier::Paper => 0.0,
        Tier::Exact { tolerance } => tolerance.max(4.0 * S::epsilon().as_f64()),
    };
    let radial = cell.acting_effects().map_or([0.0; RADIAL_TERMS], |effects| effects.profile.radial);
    let (profile, exponent) = CompiledProfile::<S>::compile(&cell.emitter.profile, radial, tolerance);
    let orders = (tier != Tier::Paper || has_opening).then(|| Orders::new(exponent, tolerance, cell.detector.length_m));
    let y_axis = normal.cross(x_axis);
    let vector = |v: DVec3| S::Vec3::of(v);
    Ok(CompiledCell {
        receiver: Receiver {
            axes: [x_axis, y_axis, normal].map(vector),
            centre: vector(cell.detector.centre_base_m),
            half: [S::of(0.5 * cell.detector.length_m), S::of(0.5 * cell.detector.width_m)],
            per_length: S::of(cell.detector.length_m).recip(),
            responsivity: S::of(cell.detector.responsivity_a_per_w),
            dark: S::of(cell.detector.dark_current_a),
        },
        aperture: Aperture::compile(&cell.slit),
        imperfect: None,
        emitter: CompiledEmitter {
            source: Source {
                position: vector(cell.emitter.position_tool_m),
                axis: vector(axis),
                intensity: S::of(cell.emitter.radiant_intensity_w_per_sr),
            },
            profile,
            orders,
        },
        saturation: cell.detector.saturation_a.map(S::of),
        faint: S::of(cell.detector.faint_a),
    })
}

fn check_detector(section: &Check, cell: &Check, detector: &Detector) -> Result<(DVec3, DVec3), SceneError> {
    cell.within("detector_mm", &detector.centre_base_m.to_array(), MAX_M)?;
    let x_axis = cell.unit("x_axis", detector.x_axis_base)?;
    let normal = cell.unit("normal", detector.normal_base)?;
    let cosine = x_axis.dot(normal);
    if cosine.abs() > AXIS_TOLERANCE {
        return Err(cell.fault("x_axis", Fault::NotPerpendicular(cosine)));
    }
    section.positive("length_mm", detector.length_m)?;
    section.positive("width_mm", detector.width_m)?;
    section.within("length_mm", &[detector.length_m], MAX_M)?;
    section.within("width_mm", &[detector.width_m], MAX_M)?;
    section.not_negative("responsivity_a_per_w", detector.responsivity_a_per_w)?;
    section.not_negative("dark_current_a", detector.dark_current_a)?;
    section.not_negative("faint_a", detector.faint_a)?;
    section.within("responsivity_a_per_w", &[detector.responsivity_a_per_w], LARGEST)?;
    section.within("dark_current_a", &[detector.dark_current_a], LARGEST)?;
    if let Some(resistance) = detector.interelectrode_ohm {
        section.positive("interelectrode_ohm", resistance)?;
    }
    if let Some(saturation) = detector.saturation_a {
        section.positive("saturation_a", saturation)?;
    }
    Ok(((x_axis - normal * cosine).normalize(), normal))
}

fn check_slit(check: &Check, slit: &Slit) -> Result<(), SceneError> {
    check.not_negative("distance_mm", slit.distance_m)?;
    check.not_negative("width_mm", slit.width_m)?;
    check.not_negative("length_mm", slit.length_m)?;
    check.not_negative("thickness_mm", slit.thickness_m)?;
    check.within("distance_mm", &[slit.distance_m], MAX_M)?;
    check.within("width_mm", &[slit.width_m], MAX_M)?;
    check.within("length_mm", &[slit.length_m], MAX_M)?;
    check.within("thickness_mm", &[slit.thickness_m], MAX_M)?;
    check.within("offset_mm", &slit.offset_m.to_array(), MAX_M)?;
    check.finite("tilt_deg", &slit.tilt_rad.to_array())?;
    let below = 0.5 * slit.thickness_m - slit.distance_m;
    if below > 0.0 {
        return Err(check.fault("distance_mm", Fault::MaskInDetector(below)));
    }
    Ok(())
}

fn check_opening(index: usize, cell: &Cell, effects: &Effects) -> Result<(), SceneError> {
    let (slit, window) = ("slit", "window");
    let at = |section| Check { cell: Some(index), section };
    let refused = |section, key, part| at(section).fault(key, Fault::NotThrough { part, opening: effects.opening });
    if effects.opening != Opening::Slit && effects.window.is_some() {
        return Err(refused(window, "thickness_mm", "a window"));
    }
    if let Opening::Lens { focal_length_m } = effects.opening {
        at(slit).positive("focal_length_mm", focal_length_m)?;
        at(slit).within("focal_length_mm", &[focal_length_m], MAX_M)?;
    }
    if effects.opening.is_hole() {
        if cell.slit.tilt_rad != DVec3::ZERO {
            return Err(refused(slit, "tilt_deg", "a tilt"));
        }
        if cell.slit.thickness_m > 0.0 {
            return Err(refused(slit, "thickness_mm", "a thick mask"));
        }
    }
    Ok(())
}

fn check_effects(cell: usize, effects: &Effects) -> Result<(), SceneError> {
    let at = |section| Check { cell: Some(cell), section };
    let (detector, emitter, stray) = (at("detector"), at("emitter"), at("stray"));
    emitter.not_negative("source_diameter_mm", effects.source_diameter_m)?;
    emitter.within("source_diameter_mm", &[effects.source_diameter_m], MAX_M)?;
    emitter.within("profile_radial", &effects.profile.radial, LARGEST)?;
    emitter.within("profile_azimuthal", &effects.profile.azimuthal, LARGEST)?;
    if let Some(window) = effects.window {
        at("window").not_negative("thickness_mm", window.thickness_m)?;
        at("window").within("thickness_mm", &[window.thickness_m], MAX_M)?;
        at("window").within("refractive_index", &[window.refractive_index], LARGEST)?;
        if window.refractive_index < 1.0 {
            return Err(at("window").fault("refractive_index", Fault::BelowOne(window.refractive_index)));
        }
    }
    detector.within("nonlinearity_mm", &effects.nonlinearity_m, MAX_M)?;
    if let Some(of) = &effects.stray {
        stray.within("current_a", &of.constant_a, LARGEST)?;
        stray.within("linear_a_per_mm", of.linear_a_per_m.as_flattened(), LARGEST)?;
        stray.within("quadratic_a_per_mm2", of.quadratic_a_per_m2.as_flattened(), LARGEST)?;
        stray.within("turning_a", of.turning_a.as_flattened(), LARGEST)?;
    }
    for gain in effects.electrode_gain {
        detector.positive("electrode_gain", gain)?;
    }
    detector.within("electrode_gain", &effects.electrode_gain, LARGEST)?;
    if let Some(converters) = &effects.converters {
        at("converter").positive("full_scale_a", converters.full_scale_a)?;
        at("converter").within("curve_1_a", &converters.curves_a[0], LARGEST)?;
        at("converter").within("curve_2_a", &converters.curves_a[1], LARGEST)?;
    }
    Ok(())
}

fn check_emitter(section: &Check, cell: &Check, emitter: &Emitter) -> Result<DVec3, SceneError> {
    cell.within("emitter_mm", &emitter.position_tool_m.to_array(), MAX_M)?;
    let axis = cell.unit("emitter_axis", emitter.axis_tool)?;
    section.not_negative("radiant_intensity_w_per_sr", emitter.radiant_intensity_w_per_sr)?;
    section.within("radiant_intensity_w_per_sr", &[emitter.radiant_intensity_w_per_sr], LARGEST)?;
    match &emitter.profile {
        Profile::Cosine { exponent } => {
            section.not_negative("profile_exponent", *exponent)?;
            section.within("profile_exponent", &[*exponent], MAX_EXPONENT)?;
        }
        Profile::Table(knots) => {
            for &(angle, value) in knots {
                section.finite("profile", &[angle])?;
                section.not_negative("profile", value)?;
                section.within("profile", &[value], LARGEST)?;
            }
            let degrees = |angle: f64| angle.to_degrees();
            match knots.as_slice() {
                [] | [_] => return Err(section.fault("profile", Fault::TooFewKnots(knots.len()))),
                [(first, _), ..] if *first != 0.0 => {
                    return Err(section.fault("profile", Fault::FirstKnotNotZero(degrees(*first))));
                }
                knots => {
                    // Tolerates the rounding of the conversion from degrees.
                    let limit = core::f64::consts::FRAC_PI_2 * (1.0 + 4.0 * f64::EPSILON);
                    if let Some(pair) = knots.windows(2).find(|pair| pair[1].0 <= pair[0].0 || pair[1].0 > limit) {
                        return Err(section.fault("profile", Fault::KnotOrder(degrees(pair[0].0), degrees(pair[1].0))));
                    }
                }
            }
        }
    }
    Ok(axis)
}
