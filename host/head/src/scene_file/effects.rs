//! What real parts do beyond the ideal cell. What is absent or zero leaves a cell ideal.

use glam::DVec3;
use heapless::Vec;
use slitpose_model::{
    AZIMUTHAL_TERMS, Cell, Converters, Effects, Opening, Pose, ProfileShape, RADIAL_TERMS, Scene, Stray, Window,
};

use super::document::Document;
use super::keys::{KeyPath, SceneFileError};
use super::settings::{Lighting, Workspace};

const PER_M_FROM_PER_MM: f64 = 1e3;

/// Cosine of 100°. Light leaves an emitter up to 90° from its axis; ten more are for poses beyond the workspace.
const FACING_AWAY: f64 = -0.173_648_177_666_930_33;

/// The effects of one cell with a detector of `length_m`, not yet checked by the model.
pub(super) fn read(document: &Document<'_>, cell: usize, length_m: f64) -> Result<Effects, SceneFileError> {
    let detector = |key| KeyPath::of_cell(cell, "detector", key);
    let emitter = |key| KeyPath::of_cell(cell, "emitter", key);
    let nonlinearity = document.list(detector("nonlinearity_mm"), "a list of at most 12 numbers")?;
    let gain = document.vector(detector("electrode_gain"), "two numbers, those of I_X1 and I_X2")?;
    let radial = document.vector::<RADIAL_TERMS>(emitter("profile_radial"), "four numbers")?;
    let azimuthal = document.vector::<AZIMUTHAL_TERMS>(emitter("profile_azimuthal"), "four numbers")?;
    Ok(Effects {
        source_diameter_m: document.number(emitter("source_diameter_mm"))?.unwrap_or(0.0),
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
    let centre_m = document.number(key("centre_mm"))?.unwrap_or(0.0);
    let allowed = "a place on the detector, at most half its length";
    let centre_m = document.within(key("centre_mm"), centre_m, |at_m| at_m.abs() <= 0.5 * length_m, allowed)?;
    let linear = document.matrix::<2, 3>(key("linear_a_per_mm"), "two rows of three numbers, by t_x, t_y, t_z")?;
    let quadratic = document.matrix::<2, 6>(
        key("quadratic_a_per_mm2"),
        "two rows of six numbers, by t_x², t_y², t_z², t_x·t_y, t_y·t_z, t_z·t_x",
    )?;
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
    let curve = |name| document.list(key(name), "a list of at most 10 numbers");
    let curves_a = [curve("curve_1_a")?, curve("curve_2_a")?];
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
