//! What the file says besides the optics: electronics, lighting, tolerances, workspace.

use glam::DVec3;
use slitpose_model::{Cell, Pose, Scene};

use super::document::{Document, entries_of, integer_of};
use super::keys::{KeyPath, SceneFileError};

/// The widest result the converters give: 12 bits, 16 with oversampling (STM32G4).
pub(super) const WIDEST_BITS: u64 = 16;

/// The most conversions the converters' hardware adds up to one result (STM32G4).
pub(super) const MAX_OVERSAMPLING: u64 = 256;

/// Gain, noise and timing of the electronics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrontEnd {
    /// Electrode current at the converter's top code, amperes.
    pub full_scale_a: f64,
    /// Resolution of one conversion, bits.
    pub adc_bits: u32,
    /// Standard deviation of one conversion, in steps of the converter.
    pub raw_noise_lsb: f64,
    /// Conversions summed to one result.
    pub oversampling: u32,
    /// Of detector and transimpedance stage together, first order, seconds.
    pub time_constant_s: f64,
    /// From switching the emitters to the first conversion, seconds.
    pub settling_s: f64,
    /// Duration of one conversion, seconds.
    pub conversion_s: f64,
    /// Frames per second; a frame is one pass through all lighting slots.
    pub frame_rate_hz: f64,
}

impl FrontEnd {
    /// Duration of one lighting slot: settling, then the conversions of all cells one after the
    /// other. Both currents of a cell are converted at the same time, by two converters.
    pub fn slot_duration_s(&self, cells: usize) -> f64 {
        self.settling_s + cells as f64 * f64::from(self.oversampling) * self.conversion_s
    }

    /// Duration of one frame.
    pub fn frame_period_s(&self) -> f64 {
        1.0 / self.frame_rate_hz
    }
}

/// The front end, if the file has one. Scale, resolution and rate must be given; a noise, a
/// delay or a repetition that is not given is not there.
pub(super) fn read_front_end(document: &Document<'_>) -> Result<Option<FrontEnd>, SceneFileError> {
    if !document.has_section("front_end") {
        return Ok(None);
    }
    let path = |key| KeyPath::section("front_end", key);
    let positive =
        |key| document.within(path(key), document.required(path(key))?, |value| value > 0.0, "a number above zero");
    let not_negative = |key| document.not_negative(path(key), 0.0);
    Ok(Some(FrontEnd {
        full_scale_a: document.within(
            path("full_scale_a"),
            document.required(path("full_scale_a"))?,
            |value| (1e-12..=1.0).contains(&value),
            "amperes from 1e-12 to 1, such as 10e-6",
        )?,
        adc_bits: document.whole(path("adc_bits")).ok_or_else(|| document.missing(path("adc_bits")))?,
        raw_noise_lsb: not_negative("raw_noise_lsb")?,
        oversampling: document.whole(path("oversampling")).unwrap_or(1),
        time_constant_s: not_negative("time_constant_s")?,
        settling_s: not_negative("settling_s")?,
        conversion_s: not_negative("conversion_s")?,
        frame_rate_hz: positive("frame_rate_hz")?,
    }))
}

/// The slots of one frame, in the order they are lit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lighting {
    /// Emitter numbers of each slot; the dark slot is empty.
    pub slots: Vec<Vec<usize>>,
}

impl Lighting {
    /// Every emitter in a slot of its own, then the dark slot. Both axes of a detector share a slot.
    pub fn one_by_one(scene: &Scene) -> Self {
        let lit = scene.cells.iter().enumerate().filter(|(number, cell)| !cell.is_second_axis(*number));
        let slots = lit.map(|(number, cell)| [number].into_iter().chain(cell.other_axis()).collect());
        Self { slots: slots.chain([Vec::new()]).collect() }
    }

    pub(crate) fn slot_of(&self, emitter: usize) -> Option<usize> {
        self.slots.iter().position(|slot| slot.contains(&emitter))
    }

    /// The slot in which nothing is lit.
    pub fn dark_slot(&self) -> Option<usize> {
        self.slots.iter().position(Vec::is_empty)
    }
}

/// The lighting of the file, or [`Lighting::one_by_one`].
pub(super) fn read_lighting(document: &Document<'_>, scene: &Scene) -> Result<Lighting, SceneFileError> {
    let path = KeyPath::section("lighting", "slots");
    let Some(entry) = document.find(path) else {
        return Ok(Lighting::one_by_one(scene));
    };
    let cells = scene.cells.len();
    let mut lighting = Lighting { slots: Vec::new() };
    for (number, slot) in entries_of(entry).iter().enumerate() {
        let emitters = entries_of(slot);
        let refuse = |span, fault| Err(document.error_at(span, format!("lighting.slots: {fault}")));
        if let (true, Some(first)) = (emitters.is_empty(), lighting.dark_slot()) {
            return refuse(slot.span(), format!("slots {first} and {number} are both dark; keep one `[]`"));
        }
        lighting.slots.push(Vec::new());
        for entry in emitters.iter() {
            let given = integer_of(entry).unwrap_or(-1);
            let Some(emitter) = usize::try_from(given).ok().filter(|emitter| *emitter < cells) else {
                let last = cells - 1;
                let fault = format!("emitter {given} does not exist; the scene has the cells 0 to {last}");
                return refuse(entry.span(), fault);
            };
            if let Some(first) = lighting.slot_of(emitter) {
                let fault = format!(
                    "emitter {emitter} is lit in slot {first} and again in slot {number}; light each emitter in one slot only"
                );
                return refuse(entry.span(), fault);
            }
            lighting.slots[number].push(emitter);
        }
    }
    let refuse = |fault| Err(document.error(path, format!("lighting.slots: {fault}")));
    if let Some(emitter) = (0..cells).find(|emitter| lighting.slot_of(*emitter).is_none()) {
        return refuse(format!("emitter {emitter} is in no slot; add it to one, or remove its cell"));
    }
    let others = scene.cells.iter().map(Cell::other_axis).enumerate();
    let mut pairs = others.filter_map(|(cell, other)| Some((cell, other?)));
    match pairs.find(|&(cell, other)| lighting.slot_of(cell) != lighting.slot_of(other)) {
        None => Ok(lighting),
        Some((first, second)) => refuse(format!(
            "cells {first} and {second} read both axes of one detector; give them one slot, for they have one emitter"
        )),
    }
}

/// Standard deviations of the parts of an uncalibrated head, from data sheets and drawings. Zero: known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// Positions of detectors, slits and emitters, each axis, and the slits' distances, metres.
    pub position_m: f64,
    /// Rotations of detectors and slits about each axis, radians.
    pub angle_rad: f64,
    /// Width of the slits, metres.
    pub slit_width_m: f64,
    /// Rotations of the emitters' axes, radians.
    pub emitter_angle_rad: f64,
    /// Intensity of the emitters, relative.
    pub emitter_gain_relative: f64,
    /// Gain of each electrode, relative.
    pub electrode_gain_relative: f64,
    /// Shape of the emitters' profiles, relative to the intensity on the axis.
    pub profile_relative: f64,
    /// Non-linearity of the detectors, metres.
    pub nonlinearity_m: f64,
    /// Thickness of the detectors' cover, metres.
    pub window_m: f64,
    /// Stray light of a cell, of both electrodes together, relative to its current with the tool at home.
    pub stray_relative: f64,
}

impl Default for Tolerance {
    /// Of the parts named in the shipped scenes, from data sheets, and of a milled head.
    fn default() -> Self {
        Self {
            position_m: 0.06e-3,
            angle_rad: 0.6_f64.to_radians(),
            slit_width_m: 0.012e-3,
            emitter_angle_rad: 2.0_f64.to_radians(),
            emitter_gain_relative: 0.3,
            electrode_gain_relative: 0.01,
            profile_relative: 0.05,
            nonlinearity_m: 0.06e-3,
            window_m: 0.15e-3,
            stray_relative: 0.03,
        }
    }
}

/// Tolerances of a head in use, not of its parts before calibration.
const IN_USE: [&str; 3] = ["light_level_relative", "emitter_drift_relative", "emitter_drift_minutes"];

/// The section `[tolerance]`; `None` if the scene has none, or one of light levels alone, which are not those of a part.
/// Keys that it leaves out have their defaults.
pub(super) fn read_tolerance(document: &Document<'_>) -> Result<Option<Tolerance>, SceneFileError> {
    if !document.has_section("tolerance") || document.has_only("tolerance", &IN_USE) {
        return Ok(None);
    }
    let value = |key, default| document.not_negative(KeyPath::section("tolerance", key), default);
    let default = Tolerance::default();
    Ok(Some(Tolerance {
        position_m: value("position_mm", default.position_m)?,
        angle_rad: value("angle_deg", default.angle_rad)?,
        slit_width_m: value("slit_width_mm", default.slit_width_m)?,
        emitter_angle_rad: value("emitter_angle_deg", default.emitter_angle_rad)?,
        emitter_gain_relative: value("emitter_gain_relative", default.emitter_gain_relative)?,
        electrode_gain_relative: value("electrode_gain_relative", default.electrode_gain_relative)?,
        profile_relative: value("profile_relative", default.profile_relative)?,
        nonlinearity_m: value("nonlinearity_mm", default.nonlinearity_m)?,
        window_m: value("window_mm", default.window_m)?,
        stray_relative: value("stray_relative", default.stray_relative)?,
    }))
}

/// A box around home: translations and rotation vectors whose components stay within it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Workspace {
    /// Half extents of the translation, metres.
    pub half_extent_m: DVec3,
    /// Half extents of the rotation vector, radians.
    pub half_extent_rad: DVec3,
}

/// Bases of the Halton sequence: one prime for each axis.
const BASES: [usize; 6] = [2, 3, 5, 7, 11, 13];

impl Workspace {
    /// Poses spread evenly, the same ones every time.
    ///
    /// A Halton sequence (Halton 1960): the error of a share found with n of its points falls almost like 1/n, with random
    /// points like 1/√n.
    pub fn poses(&self, count: usize) -> impl Iterator<Item = Pose> + use<> {
        let (half_m, half_rad) = (self.half_extent_m, self.half_extent_rad);
        (1..=count).map(move |index| {
            let [tx, ty, tz, rx, ry, rz] = BASES.map(|base| 2.0 * radical_inverse(index, base) - 1.0);
            Pose::from_vectors(half_m * DVec3::new(tx, ty, tz), half_rad * DVec3::new(rx, ry, rz))
        })
    }

    /// All 64 corners: what is farthest from home.
    pub fn corners(&self) -> impl Iterator<Item = Pose> {
        let sign = |corner: u32, axis: u32| if corner >> axis & 1 == 0 { -1.0 } else { 1.0 };
        let vector = move |corner, from| DVec3::new(sign(corner, from), sign(corner, from + 1), sign(corner, from + 2));
        let (half_m, half_rad) = (self.half_extent_m, self.half_extent_rad);
        (0..64).map(move |corner| Pose::from_vectors(vector(corner, 0) * half_m, vector(corner, 3) * half_rad))
    }
}

/// The digits of `index` in `base`, mirrored at the point: in 0 … 1.
fn radical_inverse(mut index: usize, base: usize) -> f64 {
    let (mut inverse, mut place) = (0.0, 1.0);
    while index > 0 {
        place /= base as f64;
        inverse += place * (index % base) as f64;
        index /= base;
    }
    inverse
}

impl Default for Workspace {
    /// ±4 mm and ±15° on every axis: the span in which the paper's cell measures well (its
    /// error grows beyond ±4 mm) and a span of wrist motion.
    fn default() -> Self {
        Self { half_extent_m: DVec3::splat(4e-3), half_extent_rad: DVec3::splat(15f64.to_radians()) }
    }
}

/// The workspace of the file, key by key in place of the default.
pub(super) fn read_workspace(document: &Document<'_>) -> Result<Workspace, SceneFileError> {
    let default = Workspace::default();
    let extents = |key, default, most, allowed| {
        let path = KeyPath::section("workspace", key);
        let Some(extents) = document.vector::<3>(path) else { return Ok(default) };
        document.within(path, extents[0], |_| extents.iter().all(|extent| (0.0..=most).contains(extent)), allowed)?;
        Ok(DVec3::from_array(extents))
    };
    Ok(Workspace {
        half_extent_m: extents("half_extent_mm", default.half_extent_m, f64::INFINITY, "numbers of zero or more")?,
        half_extent_rad: extents(
            "half_extent_deg",
            default.half_extent_rad,
            180_f64.to_radians(),
            "numbers from 0 to 180",
        )?,
    })
}
