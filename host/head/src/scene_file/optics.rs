//! From the document to the model's scene: millimetres to metres, degrees to radians, defaults
//! and each cell's own values merged.
//!
//! Which values are physically possible is the model's to say; here stand only the file's
//! shape and the conversion of units.

use glam::{DVec2, DVec3};
use slitpose_model::{
    Cell, DEFAULT_FAINT_A, Detector, Effects, Emitter, Fault, MAX_CELLS, MAX_PROFILE_KNOTS, Noise, Profile, Scene,
    Slit, Uncertainty,
};

use super::document::Document;
use super::effects;
use super::error::{ContentFault, KeyPath, SceneFileError};
use super::opening::Passage;
use super::schema::PROFILES;
use super::second_axis;

pub(super) const M_FROM_MM: f64 = 1e-3;

/// The optics of the scene, not yet checked by the model.
pub(super) fn read(document: &Document<'_>) -> Result<Scene, SceneFileError> {
    let mut scene =
        Scene { noise: read_noise(document)?, uncertainty: read_uncertainty(document)?, ..Scene::default() };
    let count = document.cell_count()?;
    for number in 0..count {
        let cell = match second_axis::read(document, &mut scene, number)? {
            Some(cell) => cell,
            None => read_cell(document, number)?,
        };
        if scene.cells.push(cell).is_err() {
            let path = KeyPath::of_cell(number, "cell", "");
            let most = MAX_CELLS;
            return Err(document.error(path, ContentFault::TooManyCells { count, most }));
        }
    }
    if count == 0 {
        let path = KeyPath::top("cell");
        let fault = Fault::NoCells;
        return Err(document.error_at(0..0, ContentFault::Optics { path, text: None, fault }));
    }
    Ok(scene)
}

fn read_cell(document: &Document<'_>, number: usize) -> Result<Cell, SceneFileError> {
    for section in ["detector", "emitter"] {
        document.text(KeyPath::of_cell(number, section, "part"))?;
    }
    let detector = read_detector(document, number)?;
    let passage = Passage::read(document, number)?;
    Ok(Cell {
        effects: Effects { opening: passage.opening, ..effects::read(document, number, detector.length_m)? },
        detector,
        slit: read_slit(document, number, &passage)?,
        emitter: read_emitter(document, number)?,
    })
}

fn read_detector(document: &Document<'_>, cell: usize) -> Result<Detector, SceneFileError> {
    let key = |key| KeyPath::of_cell(cell, "detector", key);
    Ok(Detector {
        centre_base_m: position(document, cell, "detector_mm")?,
        x_axis_base: direction(document, cell, "x_axis")?,
        normal_base: direction(document, cell, "normal")?,
        length_m: document.required(key("length_mm"))? * M_FROM_MM,
        width_m: document.required(key("width_mm"))? * M_FROM_MM,
        responsivity_a_per_w: document.required(key("responsivity_a_per_w"))?,
        dark_current_a: document.number(key("dark_current_a"))?.unwrap_or(0.0),
        interelectrode_ohm: document.number(key("interelectrode_ohm"))?,
        saturation_a: document.number(key("saturation_a"))?,
        faint_a: document.number(key("faint_a"))?.unwrap_or(DEFAULT_FAINT_A),
    })
}

fn read_slit(document: &Document<'_>, cell: usize, passage: &Passage) -> Result<Slit, SceneFileError> {
    let key = |key| KeyPath::of_cell(cell, "slit", key);
    let offset_mm = document.vector(key("offset_mm"), "two numbers, [x, y]")?;
    let tilt_deg = document.vector(key("tilt_deg"), "three numbers, [x, y, z]")?;
    Ok(Slit {
        distance_m: document.required(key("distance_mm"))? * M_FROM_MM,
        width_m: document.required(key(passage.width))? * M_FROM_MM,
        length_m: document.required(key(passage.length))? * M_FROM_MM,
        offset_m: DVec2::from_array(offset_mm.unwrap_or_default()) * M_FROM_MM,
        tilt_rad: DVec3::from_array(tilt_deg.unwrap_or_default().map(f64::to_radians)),
        thickness_m: document.number(key("thickness_mm"))?.unwrap_or(0.0) * M_FROM_MM,
    })
}

fn read_emitter(document: &Document<'_>, cell: usize) -> Result<Emitter, SceneFileError> {
    Ok(Emitter {
        position_tool_m: position(document, cell, "emitter_mm")?,
        axis_tool: direction(document, cell, "emitter_axis")?,
        radiant_intensity_w_per_sr: document.required(KeyPath::of_cell(
            cell,
            "emitter",
            "radiant_intensity_w_per_sr",
        ))?,
        profile: read_profile(document, cell)?,
    })
}

fn read_profile(document: &Document<'_>, cell: usize) -> Result<Profile, SceneFileError> {
    let given = document.profiles_given(cell);
    let &[key] = given.as_slice() else {
        let path = KeyPath::of_cell(cell, "emitter", given.first().copied().unwrap_or(PROFILES[0]));
        let count = given.len();
        return Err(document.error(path, ContentFault::ProfileChoice { cell, count }));
    };
    let path = KeyPath::of_cell(cell, "emitter", key);
    match key {
        "half_angle_deg" => {
            let half_angle_deg = document.required(path)?;
            if half_angle_deg > 0.0 && half_angle_deg < 90.0 {
                return Ok(Profile::from_half_angle(half_angle_deg.to_radians()));
            }
            let fault = Fault::HalfAngle(half_angle_deg);
            Err(document.error(path, ContentFault::Optics { path, text: None, fault }))
        }
        "profile_exponent" => Ok(Profile::Cosine { exponent: document.required(path)? }),
        _ => read_profile_table(document, path),
    }
}

fn read_profile_table(document: &Document<'_>, path: KeyPath) -> Result<Profile, SceneFileError> {
    let expected = "pairs of numbers, [[degrees, relative intensity], …]";
    let entry = document.find(path).ok_or_else(|| document.missing(path))?;
    let array = document.as_array(path, entry, expected)?;
    let (count, most) = (array.len(), MAX_PROFILE_KNOTS);
    let mut knots = heapless::Vec::new();
    for knot in array.iter() {
        let [angle_deg, relative] = document.as_vector(path, knot, expected)?;
        knots
            .push((angle_deg.to_radians(), relative))
            .map_err(|_| document.error(path, ContentFault::TooManyKnots { path, count, most }))?;
    }
    Ok(Profile::Table(knots))
}

fn read_noise(document: &Document<'_>) -> Result<Option<Noise>, SceneFileError> {
    if !document.has_section("noise") {
        return Ok(None);
    }
    let key = |key| document.required(KeyPath::section("noise", key));
    let bandwidth_hz = key("bandwidth_hz")?;
    Ok(Some(Noise {
        shot_bandwidth_hz: bandwidth_hz,
        johnson_bandwidth_hz: bandwidth_hz,
        temperature_k: key("temperature_k")?,
        adc_a: key("adc_a")?,
    }))
}

fn read_uncertainty(document: &Document<'_>) -> Result<Uncertainty, SceneFileError> {
    let key = |key| Ok(document.number(KeyPath::section("uncertainty", key))?.unwrap_or(0.0));
    Ok(Uncertainty {
        emitter_gain_relative: key("emitter_gain_relative")?,
        electrode_gain_relative: key("electrode_gain_relative")?,
        position_m: key("position_mm")? * M_FROM_MM,
    })
}

fn position(document: &Document<'_>, cell: usize, key: &'static str) -> Result<DVec3, SceneFileError> {
    Ok(direction(document, cell, key)? * M_FROM_MM)
}

fn direction(document: &Document<'_>, cell: usize, key: &'static str) -> Result<DVec3, SceneFileError> {
    let path = KeyPath::of_cell(cell, "cell", key);
    let vector = document.vector(path, "three numbers, [x, y, z]")?;
    vector.map(DVec3::from_array).ok_or_else(|| document.missing(path))
}
