//! From the document to the model's scene: defaults and each cell's own values merged.
//!
//! Which values are physically possible is the model's to say; here stand only the file's
//! shape.

use glam::{DVec2, DVec3};
use heapless::Vec;
use slitpose_model::{
    Cell, Converters, DEFAULT_FAINT_A, Detector, Effects, Emitter, Fault, MAX_CELLS, Noise, Opening, Pose, Profile,
    ProfileShape, Scene, Slit, Stray, Uncertainty, Window,
};

use super::document::{Document, entries_of, vector_of};
use super::keys::{KeyPath, PROFILES, SceneFileError, of_cell};
use super::settings::{Lighting, Workspace};

/// The optics of the scene, not yet checked by the model.
pub(super) fn read(document: &Document<'_>) -> Result<Scene, SceneFileError> {
    let mut scene = Scene { noise: read_noise(document)?, uncertainty: read_uncertainty(document), ..Scene::default() };
    let count = document.cells().len();
    for number in 0..count {
        let cell = match read_second_axis(document, &mut scene, number)? {
            Some(cell) => cell,
            None => read_cell(document, number)?,
        };
        if scene.cells.push(cell).is_err() {
            let text = format!("the scene has {count} cells; at most {MAX_CELLS} are possible, remove the others");
            return Err(document.error(KeyPath::of_cell(number, "cell", ""), text));
        }
    }
    if count == 0 {
        return Err(document.error_at(0..0, format!("{}: {}", KeyPath::top("cell"), Fault::NoCells)));
    }
    Ok(scene)
}

fn read_cell(document: &Document<'_>, number: usize) -> Result<Cell, SceneFileError> {
    let detector = read_detector(document, number)?;
    let passage = Passage::read(document, number)?;
    Ok(Cell {
        effects: Effects { opening: passage.opening, ..read_effects(document, number, detector.length_m)? },
        detector,
        slit: read_slit(document, number, &passage)?,
        emitter: read_emitter(document, number)?,
    })
}

fn read_detector(document: &Document<'_>, cell: usize) -> Result<Detector, SceneFileError> {
    let key = |key| KeyPath::of_cell(cell, "detector", key);
    Ok(Detector {
        centre_base_m: vector(document, cell, "detector_mm")?,
        x_axis_base: vector(document, cell, "x_axis")?,
        normal_base: vector(document, cell, "normal")?,
        length_m: document.required(key("length_mm"))?,
        width_m: document.required(key("width_mm"))?,
        responsivity_a_per_w: document.required(key("responsivity_a_per_w"))?,
        dark_current_a: document.number(key("dark_current_a")).unwrap_or(0.0),
        interelectrode_ohm: document.number(key("interelectrode_ohm")),
        saturation_a: document.number(key("saturation_a")),
        faint_a: document.number(key("faint_a")).unwrap_or(DEFAULT_FAINT_A),
    })
}

fn read_slit(document: &Document<'_>, cell: usize, passage: &Passage) -> Result<Slit, SceneFileError> {
    let key = |key| KeyPath::of_cell(cell, "slit", key);
    let offset_m = document.vector(key("offset_mm"));
    let tilt_rad = document.vector(key("tilt_deg"));
    Ok(Slit {
        distance_m: document.required(key("distance_mm"))?,
        width_m: document.required(key(passage.width))?,
        length_m: document.required(key(passage.length))?,
        offset_m: DVec2::from_array(offset_m.unwrap_or_default()),
        tilt_rad: DVec3::from_array(tilt_rad.unwrap_or_default()),
        thickness_m: document.number(key("thickness_mm")).unwrap_or(0.0),
    })
}

fn read_emitter(document: &Document<'_>, cell: usize) -> Result<Emitter, SceneFileError> {
    Ok(Emitter {
        position_tool_m: vector(document, cell, "emitter_mm")?,
        axis_tool: vector(document, cell, "emitter_axis")?,
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
        let text = format!(
            "cell {cell} has {} emission profiles; give exactly one of half_angle_deg, profile_exponent, profile in [emitter]",
            given.len()
        );
        return Err(document.error(path, text));
    };
    let path = KeyPath::of_cell(cell, "emitter", key);
    match key {
        "half_angle_deg" => {
            let half_angle_deg = document.written(path).ok_or_else(|| document.missing(path))?;
            if half_angle_deg > 0.0 && half_angle_deg < 90.0 {
                return Ok(Profile::from_half_angle(half_angle_deg.to_radians()));
            }
            Err(document.error(path, format!("{path}: {}", Fault::HalfAngle(half_angle_deg))))
        }
        "profile_exponent" => Ok(Profile::Cosine { exponent: document.required(path)? }),
        _ => {
            let knots = document.find(path).map_or(&[][..], entries_of).iter().map(vector_of);
            Ok(Profile::Table(
                knots.map(|[angle_deg, relative]: [f64; 2]| (angle_deg.to_radians(), relative)).collect(),
            ))
        }
    }
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

/// How well the common level of all light is known, unless the scene says: emitters are brighter when cool, and age.
const LIGHT_LEVEL_RELATIVE: f64 = 0.1;

/// How far emitters that have been calibrated drift apart, unless the scene says: some kelvin between them, or months of use.
const EMITTER_DRIFT_RELATIVE: f64 = 0.01;
const EMITTER_DRIFT_MINUTES: f64 = 120.0;

/// [`Uncertainty::emitter_drift_relative`] as far as the file gives it.
pub(super) fn read_emitter_drift(document: &Document<'_>) -> Option<f64> {
    document.number(KeyPath::section("tolerance", "emitter_drift_relative"))
}

/// [`Uncertainty::light_level_relative`] as far as the file gives it.
pub(super) fn read_light_level(document: &Document<'_>) -> Option<f64> {
    document.number(KeyPath::section("tolerance", "light_level_relative"))
}

fn read_uncertainty(document: &Document<'_>) -> Uncertainty {
    let key = |key| document.number(KeyPath::section("uncertainty", key)).unwrap_or(0.0);
    let minutes = document.number(KeyPath::section("tolerance", "emitter_drift_minutes"));
    Uncertainty {
        emitter_gain_relative: key("emitter_gain_relative"),
        electrode_gain_relative: key("electrode_gain_relative"),
        position_m: key("position_mm"),
        light_level_relative: read_light_level(document).unwrap_or(LIGHT_LEVEL_RELATIVE),
        emitter_drift_relative: read_emitter_drift(document).unwrap_or(EMITTER_DRIFT_RELATIVE),
        emitter_drift_s: 60.0 * minutes.unwrap_or(EMITTER_DRIFT_MINUTES),
    }
}

fn vector(document: &Document<'_>, cell: usize, key: &'static str) -> Result<DVec3, SceneFileError> {
    let path = KeyPath::of_cell(cell, "cell", key);
    document.vector(path).map(DVec3::from_array).ok_or_else(|| document.missing(path))
}

/// What the light of a cell passes through, and the keys of its sizes.
struct Passage {
    opening: Opening,
    width: &'static str,
    length: &'static str,
}

impl Passage {
    /// That of cell `cell`. A hole is given by its diameter, a slit by width and length: a cell that gives either has no
    /// use for the other's defaults.
    fn read(document: &Document<'_>, cell: usize) -> Result<Self, SceneFileError> {
        let path = |key| KeyPath::of_cell(cell, "slit", key);
        let own = |key| document.find_own(cell, "slit", key).is_some();
        let given = |key| document.find(path(key)).is_some();
        let refuse = |key, why: &str| {
            let path = path(key);
            Err(document.error(path, format!("{path} = {}: {why}", document.quoted(path))))
        };
        let (own_hole, own_slit) = (own("diameter_mm"), own("width_mm") || own("length_mm"));
        let is_hole = given("diameter_mm") && (own_hole || !own_slit);
        if is_hole && own_hole == own_slit && (given("width_mm") || given("length_mm")) {
            return refuse("diameter_mm", "a round hole has neither width_mm nor length_mm; remove those or this");
        }
        let rides = document.text(path("mount")) == Some("tool");
        // A cell with sizes of its own has a lens of its own, too, if any.
        let may_focus = !(own_hole || own_slit) || own("focal_length_mm");
        let focal_length_m = document.number(path("focal_length_mm")).filter(|_| may_focus);
        let opening = match (is_hole, rides, focal_length_m) {
            (true, true, _) => return refuse("mount", "a round hole is on the base; give \"base\", or a slit"),
            (false, _, Some(_)) => {
                return refuse(
                    "focal_length_mm",
                    "a lens fills a round hole; give its diameter_mm in place of width_mm and length_mm",
                );
            }
            (true, false, Some(focal_length_m)) => Opening::Lens { focal_length_m },
            (true, false, None) => Opening::Pinhole,
            (false, true, None) => Opening::RidingSlit,
            (false, false, None) => Opening::Slit,
        };
        let (width, length) = if is_hole { ("diameter_mm", "diameter_mm") } else { ("width_mm", "length_mm") };
        Ok(Self { opening, width, length })
    }
}

const SECOND_AXIS: &str = "second_axis_of";

/// Cell `number`, if it reads the second axis of the detector of an earlier cell; notes that in the earlier one.
fn read_second_axis(document: &Document<'_>, scene: &mut Scene, number: usize) -> Result<Option<Cell>, SceneFileError> {
    let path = KeyPath::of_cell(number, "cell", SECOND_AXIS);
    if document.find_own(number, "cell", SECOND_AXIS).is_none() {
        return Ok(None);
    }
    let given = document.whole(path).unwrap_or(u32::MAX);
    let refuse = |why: &str| {
        let next_step = "give the number of an earlier cell that has a detector of its own";
        Err(document.error(path, format!("{path} = {given} {why}; {next_step}")))
    };
    let first = given as usize;
    if first >= scene.cells.len() {
        return refuse("is no earlier cell");
    }
    match scene.cells[first].effects.other_axis {
        Some(other) if other < first => return refuse("is a second axis itself"),
        Some(_) => return refuse("has a second axis already"),
        None => {}
    }
    if let Some(key) =
        of_cell().into_iter().find(|&key| key != SECOND_AXIS && document.find_own(number, "cell", key).is_some())
    {
        let path = KeyPath::of_cell(number, "cell", key);
        let why = format!("cannot be given for a second axis, which has everything from cell {first}; remove it");
        return Err(document.error(path, format!("{path} {why}")));
    }
    scene.cells[first].effects.other_axis = Some(number);
    Ok(Some(turned(&scene.cells[first], first)))
}

/// The same parts in a cell frame turned by 90 degrees about z: its x is the y of `cell`, number `first`.
fn turned(cell: &Cell, first: usize) -> Cell {
    let Cell { detector, slit, emitter, effects } = cell.clone();
    let mut effects = effects;
    effects.other_axis = Some(first);
    Cell {
        detector: Detector {
            x_axis_base: detector.normal_base.cross(detector.x_axis_base),
            length_m: detector.width_m,
            width_m: detector.length_m,
            ..detector
        },
        slit: Slit {
            width_m: slit.length_m,
            length_m: slit.width_m,
            offset_m: DVec2::new(slit.offset_m.y, -slit.offset_m.x),
            tilt_rad: DVec3::new(slit.tilt_rad.y, -slit.tilt_rad.x, slit.tilt_rad.z),
            ..slit
        },
        emitter,
        effects,
    }
}

const PER_M_FROM_PER_MM: f64 = 1e3;

/// Cosine of 100°. Light leaves an emitter up to 90° from its axis; ten more are for poses beyond the workspace.
const FACING_AWAY: f64 = -0.173_648_177_666_930_33;

/// The effects of one cell with a detector of `length_m`, not yet checked by the model.
fn read_effects(document: &Document<'_>, cell: usize, length_m: f64) -> Result<Effects, SceneFileError> {
    let detector = |key| KeyPath::of_cell(cell, "detector", key);
    let emitter = |key| KeyPath::of_cell(cell, "emitter", key);
    let nonlinearity = document.list(detector("nonlinearity_mm"));
    let gain = document.vector(detector("electrode_gain"));
    let radial = document.vector(emitter("profile_radial"));
    let azimuthal = document.vector(emitter("profile_azimuthal"));
    Ok(Effects {
        source_diameter_m: document.number(emitter("source_diameter_mm")).unwrap_or(0.0),
        profile: ProfileShape { radial: radial.unwrap_or_default(), azimuthal: azimuthal.unwrap_or_default() },
        window: read_window(document, cell)?,
        nonlinearity_m: if is_zero(&nonlinearity) { Vec::new() } else { nonlinearity },
        stray: read_stray(document, cell, length_m)?,
        electrode_gain: gain.unwrap_or([1.0; 2]),
        converters: read_converters(document, cell)?,
        ..Effects::default()
    })
}

fn is_zero(values: &[f64]) -> bool {
    values.iter().all(|&value| value == 0.0)
}

fn read_window(document: &Document<'_>, cell: usize) -> Result<Option<Window>, SceneFileError> {
    if !document.has_section_for(cell, "window") {
        return Ok(None);
    }
    let key = |key| document.required(KeyPath::of_cell(cell, "window", key));
    let window = Window { thickness_m: key("thickness_mm")?, refractive_index: key("refractive_index")? };
    Ok(Some(window).filter(|window| window.thickness_m != 0.0))
}

fn read_stray(document: &Document<'_>, cell: usize, length_m: f64) -> Result<Option<Stray>, SceneFileError> {
    let key = |key| KeyPath::of_cell(cell, "stray", key);
    let current_a = document.not_negative(key("current_a"), 0.0)?;
    let centre_m = document.number(key("centre_mm")).unwrap_or(0.0);
    let allowed = "a place on the detector, at most half its length";
    let centre_m = document.within(key("centre_mm"), centre_m, |at_m| at_m.abs() <= 0.5 * length_m, allowed)?;
    let linear: Option<[[f64; 3]; 2]> = document.matrix(key("linear_a_per_mm"));
    let quadratic: Option<[[f64; 6]; 2]> = document.matrix(key("quadratic_a_per_mm2"));
    let stray = Stray {
        linear_a_per_m: linear.unwrap_or_default().map(|row| row.map(|value| value * PER_M_FROM_PER_MM)),
        quadratic_a_per_m2: quadratic
            .unwrap_or_default()
            .map(|row| row.map(|value| value * PER_M_FROM_PER_MM * PER_M_FROM_PER_MM)),
        ..Stray::at(current_a, centre_m, length_m)
    };
    Ok(Some(stray).filter(|stray| *stray != Stray::default()))
}

fn read_converters(document: &Document<'_>, cell: usize) -> Result<Option<Converters>, SceneFileError> {
    if !document.has_section_for(cell, "converter") {
        return Ok(None);
    }
    let key = |key| KeyPath::of_cell(cell, "converter", key);
    let full_scale_a = document.required(key("full_scale_a"))?;
    let curves_a = ["curve_1_a", "curve_2_a"].map(|name| document.list(key(name)));
    Ok(Some(Converters { full_scale_a, curves_a }).filter(|it| !it.curves_a.iter().all(|curve| is_zero(curve))))
}

/// Notes in each cell of `scene` which emitters of its slot can reach it besides its own.
pub(super) fn light_together(scene: &mut Scene, lighting: &Lighting, workspace: &Workspace) {
    let poses: std::vec::Vec<Pose> = workspace.corners().chain([Pose::HOME]).collect();
    for emitters in &lighting.slots {
        for &cell in emitters {
            let others = emitters.iter().filter(|&&other| scene.cells[other].shines_on(other, cell));
            let reaching = others.filter(|&&other| may_reach(&scene.cells[other], &scene.cells[cell], &poses));
            scene.cells[cell].effects.lit_together = reaching.fold(0, |set, other| set | 1 << other);
        }
    }
}

/// Whether the emitter of `other` may shine through the slit of `cell`, by their directions at `poses`.
fn may_reach(other: &Cell, cell: &Cell, poses: &[Pose]) -> bool {
    let Cell { detector, slit, .. } = cell;
    let y_axis = detector.normal_base.cross(detector.x_axis_base);
    let offset = DVec3::new(slit.offset_m.x, slit.offset_m.y, slit.distance_m);
    let slit =
        detector.centre_base_m + detector.x_axis_base * offset.x + y_axis * offset.y + detector.normal_base * offset.z;
    poses.iter().any(|pose| {
        // Through a slit that rides with it an emitter shines on any detector in front.
        let rides = other.effects.opening == Opening::RidingSlit;
        let slit = if rides { detector.centre_base_m } else { slit };
        let emitter = pose.rotation * other.emitter.position_tool_m + pose.translation_m;
        (pose.rotation * other.emitter.axis_tool).dot((slit - emitter).normalize_or_zero()) >= FACING_AWAY
    })
}
