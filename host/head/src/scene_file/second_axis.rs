//! Detectors with two axes: a cell for each pair of electrodes.

use glam::{DVec2, DVec3};
use slitpose_model::{Cell, Detector, Scene, Slit};

use super::document::Document;
use super::error::{ContentFault, KeyPath, SceneFileError};
use super::schema;

const KEY: &str = "second_axis_of";

/// Cell `number`, if it reads the second axis of the detector of an earlier cell; notes that in the earlier one.
pub(super) fn read(document: &Document<'_>, scene: &mut Scene, number: usize) -> Result<Option<Cell>, SceneFileError> {
    let path = KeyPath::of_cell(number, "cell", KEY);
    let Some(entry) = document.find_own(number, "cell", KEY) else {
        return Ok(None);
    };
    let given = document.as_integer(path, entry)?;
    let refuse = |why| Err(document.error(path, ContentFault::SecondAxis { path, given, why }));
    let Some(first) = usize::try_from(given).ok().filter(|&first| first < scene.cells.len()) else {
        return refuse("is no earlier cell");
    };
    match scene.cells[first].effects.other_axis {
        Some(other) if other < first => return refuse("is a second axis itself"),
        Some(_) => return refuse("has a second axis already"),
        None => {}
    }
    if let Some(key) = schema::CELL.iter().find(|&&key| key != KEY && document.find_own(number, "cell", key).is_some())
    {
        let path = KeyPath::of_cell(number, "cell", key);
        return Err(document.error(path, ContentFault::OfFirstAxis { path, first }));
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
