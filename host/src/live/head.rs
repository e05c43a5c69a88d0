//! The geometry of a head, as the page draws it.

use axum::extract::ws::Utf8Bytes;
use serde::Serialize;
use slitpose_calibration::{Basis, Head};
use slitpose_design::map::{NoiseOf, Outlook};
use slitpose_design::{MaskFrame, mask_half_extents_m};
use slitpose_model::{Cell, Opening, Pose, SceneError};

use super::frame::Optics;
use super::hub::text_of;

/// A head. Detectors and masks are in frame base, metres; emitters, and masks that ride, in frame tool.
#[derive(Serialize)]
#[serde(tag = "kind", rename = "head")]
pub(super) struct HeadMessage {
    board: usize,
    scene: String,
    calibrated: bool,
    workspace: Extents,
    cells: Vec<CellParts>,
}

#[derive(Serialize)]
struct Extents {
    half_extent_m: [f64; 3],
    half_extent_rad: [f64; 3],
}

#[derive(Serialize)]
struct CellParts {
    detector: DetectorPart,
    mask: MaskPart,
    opening: OpeningPart,
    emitter: EmitterPart,
    second_axis_of: Option<usize>,
}

#[derive(Serialize)]
struct DetectorPart {
    centre_m: [f64; 3],
    x: [f64; 3],
    y: [f64; 3],
    z: [f64; 3],
    length_m: f64,
    width_m: f64,
    full_scale_a: Option<f64>,
    faint_a: f64,
}

#[derive(Serialize)]
struct MaskPart {
    centre_m: [f64; 3],
    x: [f64; 3],
    y: [f64; 3],
    half_m: [f64; 2],
    rides: bool,
}

#[derive(Serialize)]
struct OpeningPart {
    kind: &'static str,
    half_m: [f64; 2],
}

#[derive(Serialize)]
struct EmitterPart {
    position_m: [f64; 3],
    axis: [f64; 3],
}

impl HeadMessage {
    pub(super) fn new(board: usize, head: &Head) -> Self {
        let file = &head.file;
        let full_scale_a = file.front_end.map(|front_end| front_end.full_scale_a);
        let cells = &file.scene.cells;
        Self {
            board,
            scene: file.name.clone(),
            calibrated: matches!(head.basis(), Basis::Calibration(_)),
            workspace: Extents {
                half_extent_m: file.workspace.half_extent_m.to_array(),
                half_extent_rad: file.workspace.half_extent_rad.to_array(),
            },
            cells: cells.iter().enumerate().map(|(number, cell)| CellParts::new(number, cell, full_scale_a)).collect(),
        }
    }
}

impl CellParts {
    fn new(number: usize, cell: &Cell, full_scale_a: Option<f64>) -> Self {
        let (detector, emitter, slit) = (&cell.detector, &cell.emitter, &cell.slit);
        let (x, z) = (detector.x_axis_base, detector.normal_base);
        let mask = MaskFrame::at_home(cell);
        let [mask_x, mask_y] = mask.axes.map(|axis| axis.to_array());
        Self {
            detector: DetectorPart {
                centre_m: detector.centre_base_m.to_array(),
                x: x.to_array(),
                y: z.cross(x).to_array(),
                z: z.to_array(),
                length_m: detector.length_m,
                width_m: detector.width_m,
                full_scale_a,
                faint_a: detector.faint_a,
            },
            mask: MaskPart {
                centre_m: mask.centre.to_array(),
                x: mask_x,
                y: mask_y,
                half_m: mask_half_extents_m(cell).to_array(),
                rides: cell.opening() == Opening::RidingSlit,
            },
            opening: OpeningPart {
                kind: match cell.opening() {
                    Opening::Slit | Opening::RidingSlit => "slit",
                    Opening::Pinhole => "pinhole",
                    Opening::Lens { .. } => "lens",
                },
                half_m: [0.5 * slit.width_m, 0.5 * slit.length_m],
            },
            emitter: EmitterPart { position_m: emitter.position_tool_m.to_array(), axis: emitter.axis_tool.to_array() },
            second_axis_of: cell.other_axis().filter(|_| cell.is_second_axis(number)),
        }
    }
}

pub(crate) struct SceneView {
    outlook: Outlook,
    optics: Optics,
}

impl SceneView {
    /// Of `head`.
    pub(crate) fn of(head: &Head) -> Result<Self, SceneError> {
        Ok(Self { outlook: Outlook::of(head.clone())?, optics: Optics::of(head)? })
    }

    /// The frame, number `n`, with the tool at rest at `pose`; accuracy is the Cramér–Rao bound, and absent where the scene
    /// states no noise.
    pub(super) fn frame(&self, n: u64, pose: &Pose) -> Option<Utf8Bytes> {
        let (readings, solution) = self.outlook.frame_at(pose);
        let mut frame = self.optics.solved(0, n, &solution, &readings);
        if self.outlook.noise == NoiseOf::Nothing {
            frame.forget_accuracy();
        }
        text_of(&frame)
    }
}
