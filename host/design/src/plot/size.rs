//! Sizes of sheets, and the form of numbers on them.

use slitpose_model::Cell;
use thiserror::Error;

/// The largest size or distance that a picture can show: 1000 km.
const LARGEST_M: f64 = 1e6;

/// The smallest detector that a picture can show: a nanometre.
const SMALLEST_M: f64 = 1e-9;

/// Why a scene cannot be drawn.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum PlotError {
    /// Something too large or too small to have a picture.
    #[error(
        "cell {cell} has a size or distance of {size_mm:e} mm; pictures can show 1e-6 to 1e9 mm, correct the scene"
    )]
    OutOfProportion {
        /// The cell.
        cell: usize,
        /// The size, millimetres.
        size_mm: f64,
    },
}

/// Refuses values whose coordinates would not be finite.
pub(super) fn require_drawable(number: usize, cell: &Cell) -> Result<(), PlotError> {
    let (detector, slit) = (&cell.detector, &cell.slit);
    let distances = [slit.distance_m, slit.width_m, slit.length_m, slit.thickness_m];
    let vectors = [detector.centre_base_m, cell.emitter.position_tool_m, slit.offset_m.extend(0.0)];
    let sizes = [detector.length_m, detector.width_m];
    let too_large = distances
        .into_iter()
        .chain(vectors.into_iter().flat_map(|vector| vector.to_array()))
        .chain(sizes)
        .find(|distance| distance.abs() > LARGEST_M);
    match too_large.or_else(|| sizes.into_iter().find(|size| *size < SMALLEST_M)) {
        None => Ok(()),
        Some(size_m) => Err(PlotError::OutOfProportion { cell: number, size_mm: size_m * 1e3 }),
    }
}

/// A number for a label: three decimals at most and none that say nothing, powers of ten where
/// those would not do, a true minus sign.
pub(super) fn quantity(value: f64) -> String {
    let plain = (1e-3..1e6).contains(&value.abs()) || value.abs() < 1e-9;
    let text = if plain { format!("{}", (value * 1e3).round() / 1e3 + 0.0) } else { format!("{value:.2e}") };
    text.replace('-', "−")
}

#[cfg(test)]
mod tests {
    use super::*;
    use slitpose_head::scene_file::BENCH;

    #[test]
    fn numbers_are_short() {
        let cases = [(1.0, "1"), (-2.345_678, "−2.346"), (-1e-17, "0"), (4.2e-5, "4.20e−5"), (1e300, "1.00e300")];
        for (value, text) in cases {
            assert_eq!(quantity(value), text);
        }
    }

    #[test]
    fn a_scene_too_large_for_a_picture_is_refused_with_its_size() {
        let mut cell = BENCH.read().unwrap().scene.cells[0].clone();
        assert_eq!(require_drawable(0, &cell), Ok(()));
        cell.slit.width_m = 1e300;
        let message = require_drawable(3, &cell).unwrap_err().to_string();
        assert!(message.contains("cell 3") && message.contains("1e303 mm"), "{message}");
    }
}
