//! Poses, velocities and heads as messages of ROS 2, for captures and live servers.
//!
//! Frames: `base`, and `tool` for the tool in front of the first board; a frame of the user by its name, and `tool_tip`. Lengths
//! are in metres.

pub mod cdr;

use std::f64::consts::{FRAC_PI_4, TAU};

use cdr::{Encoder, header, pose, vector};
use glam::{DVec2, DVec3, dvec2};
use slitpose_design::{MaskFrame, mask_half_extents_m};
use slitpose_model::{Cell, Opening, Pose};

use crate::frame::{BASE, View};
use crate::link::DeviceId;
use crate::pipeline::Record;

pub use cdr::{encode_note, encode_pose, encode_pose_stamped, encode_transform, encode_twist};

const TOPICS: &str = "/slitpose/";

/// A topic of a board. No part of a name of ROS may begin with a digit, as numbers of boards do.
pub fn topic(device: DeviceId, name: &str) -> String {
    format!("{TOPICS}board_{device}/{name}")
}

/// The board of a topic, and the name in it; of older captures, too, which have the number alone.
pub fn board_of(topic: &str) -> Option<(DeviceId, &str)> {
    let (board, name) = topic.strip_prefix(TOPICS)?.split_once('/')?;
    Some((board.strip_prefix("board_").unwrap_or(board).parse().ok()?, name))
}

/// Name of the tool's frame: the tools in front of other boards than the first have the number of theirs in it.
pub fn tool_frame(device: DeviceId, is_first: bool) -> String {
    if is_first { "tool".to_owned() } else { format!("tool_{device}") }
}

/// Name of the frame that a record speaks of.
pub fn frame(record: &Record) -> &str {
    record.view.map_or(BASE, View::name)
}

/// The instant of a scan: UTC, or the board's time since its start while that is unknown; nanoseconds.
pub fn stamp_ns(record: &Record) -> u64 {
    // Saturates; times are never negative.
    record.host_time.map_or((record.device_time_s * 1e9) as u64, |time| time.utc_ns)
}

// A definition has the fields of the message, then the types of these, each once.

/// A message type: its name and its definition in the syntax of ROS 2 (`ros2msg`).
#[derive(Clone, Copy, Debug)]
pub struct RosType {
    /// Package, `msg` and type.
    pub name: &'static str,
    /// Its fields, then the types of these.
    pub definition: &'static str,
}

/// A pose `base_from_tool` with the covariance of (translation, rotation) in the base frame.
pub const POSE: RosType = RosType {
    name: "geometry_msgs/msg/PoseWithCovarianceStamped",
    definition: include_str!("msg/PoseWithCovarianceStamped.msg"),
};

/// The velocity of the tool in the base frame with the covariance of (linear, angular).
pub const TWIST: RosType = RosType {
    name: "geometry_msgs/msg/TwistWithCovarianceStamped",
    definition: include_str!("msg/TwistWithCovarianceStamped.msg"),
};

/// The same pose without covariance.
pub const POSE_STAMPED: RosType =
    RosType { name: "geometry_msgs/msg/PoseStamped", definition: include_str!("msg/PoseStamped.msg") };

/// The same pose as a transform from the tool's frame to the base frame.
pub const TRANSFORMS: RosType =
    RosType { name: "tf2_msgs/msg/TFMessage", definition: include_str!("msg/TFMessage.msg") };

/// A head as shapes.
pub const MARKERS: RosType =
    RosType { name: "visualization_msgs/msg/MarkerArray", definition: include_str!("msg/MarkerArray.msg") };

/// A report, as JSON text in CDR: ROS tools refuse files with messages in other encodings.
pub const REPORT: RosType = RosType { name: "std_msgs/msg/String", definition: "string data\n" };

/// What a person noted while a capture was recorded.
pub const NOTE: RosType = RosType { name: "rcl_interfaces/msg/Log", definition: include_str!("msg/Log.msg") };

/// Where notes stand: they are of all boards.
pub const NOTES: &str = "/slitpose/notes";

/// Shapes by their numbers in `visualization_msgs/msg/Marker`.
const LINE_LIST: i32 = 5;
const SPHERE_LIST: i32 = 7;
const TRIANGLE_LIST: i32 = 11;

/// Length of an emitter's axis, diameter of its ball and width of the line, as they are drawn, metres.
const AXIS_M: f64 = 4e-3;
const BALL_M: f64 = 1e-3;
const LINE_M: f64 = 0.3e-3;

/// Corners of a round opening. A multiple of four: the corners of the mask are among those around it.
const ROUND: usize = 16;

struct Marker<'a> {
    namespace: &'static str,
    frame: &'a str,
    kind: i32,
    scale_m: f64,
    colour: [f32; 4],
    points: Vec<DVec3>,
}

/// `visualization_msgs/msg/MarkerArray` of a head. Detectors and masks are in frame base; emitters, and masks that ride, in
/// frame `tool`, with which they move.
pub fn encode_head(cells: &[Cell], tool: &str, bytes: &mut Vec<u8>) {
    // Both axes of a detector have its parts in common.
    let cells =
        || cells.iter().enumerate().filter(|(number, cell)| !cell.is_second_axis(*number)).map(|(_, cell)| cell);
    let rides = |cell: &&Cell| cell.opening() == Opening::RidingSlit;
    let triangles = |namespace, frame, colour, points| {
        // Points of triangles are to scale.
        Marker { namespace, frame, kind: TRIANGLE_LIST, scale_m: 1.0, colour, points }
    };
    let emitters = |kind, scale_m, points| {
        let namespace = if kind == LINE_LIST { "emitter_axes" } else { "emitters" };
        Marker { namespace, frame: tool, kind, scale_m, colour: [0.9, 0.2, 0.15, 1.0], points }
    };
    let mask_colour = [0.45, 0.48, 0.55, 0.6];
    let markers = [
        triangles("detectors", BASE, [0.1, 0.45, 0.7, 1.0], cells().flat_map(detector).collect()),
        triangles("masks", BASE, mask_colour, cells().filter(|cell| !rides(cell)).flat_map(mask).collect()),
        triangles("masks_on_tool", tool, mask_colour, cells().filter(rides).flat_map(mask).collect()),
        emitters(SPHERE_LIST, BALL_M, cells().map(|cell| cell.emitter.position_tool_m).collect()),
        emitters(LINE_LIST, LINE_M, cells().flat_map(axis).collect()),
    ];
    let drawn = || markers.iter().filter(|marker| !marker.points.is_empty());
    let mut encoder = Encoder::new(bytes);
    encoder.length(drawn().count());
    drawn().for_each(|marker| marker.encode(&mut encoder));
}

fn detector(cell: &Cell) -> [DVec3; 6] {
    let detector = &cell.detector;
    let (x, y) = (detector.x_axis_base, detector.normal_base.cross(detector.x_axis_base));
    let half_m = 0.5 * dvec2(detector.length_m, detector.width_m);
    let [a, b, c, d] = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|corner| {
        let at = DVec2::from_array(corner) * half_m;
        detector.centre_base_m + x * at.x + y * at.y
    });
    [a, b, c, a, c, d]
}

/// Triangles between the edge of a mask and that of its opening.
fn mask(cell: &Cell) -> Vec<DVec3> {
    let frame = MaskFrame::at_home(cell);
    let is_slit = matches!(cell.opening(), Opening::Slit | Opening::RidingSlit);
    let corners = if is_slit { 4 } else { ROUND };
    let (outer_m, inner_m) = (mask_half_extents_m(cell), 0.5 * dvec2(cell.slit.width_m, cell.slit.length_m));
    // Both edges at a corner, the outer first.
    let edges = |corner: usize| {
        let round = DVec2::from_angle(FRAC_PI_4 + TAU * corner as f64 / corners as f64);
        let square = round / round.abs().max_element();
        [square * outer_m, if is_slit { square } else { round } * inner_m]
            .map(|at| frame.centre + frame.axes[0] * at.x + frame.axes[1] * at.y)
    };
    let between = |corner| {
        let ([a, b], [d, c]) = (edges(corner), edges((corner + 1) % corners));
        [a, b, c, a, c, d]
    };
    (0..corners).flat_map(between).collect()
}

fn axis(cell: &Cell) -> [DVec3; 2] {
    let emitter = &cell.emitter;
    [emitter.position_tool_m, emitter.position_tool_m + AXIS_M * emitter.axis_tool]
}

impl Marker<'_> {
    fn encode(&self, encoder: &mut Encoder<'_>) {
        // Zero: whenever it is looked at.
        header(encoder, 0, self.frame);
        encoder.text(self.namespace);
        // Number; kind; add or replace.
        [0, self.kind, 0].into_iter().for_each(|value| encoder.i32(value));
        pose(encoder, &Pose::HOME);
        vector(encoder, DVec3::splat(self.scale_m));
        self.colour.into_iter().for_each(|value| encoder.f32(value));
        // No end of its life.
        encoder.i32(0);
        encoder.u32(0);
        // It moves with its frame.
        encoder.bool(true);
        encoder.length(self.points.len());
        self.points.iter().for_each(|point| vector(encoder, *point));
        // No colours of points; no texture: name, image, coordinates; no text; no mesh: name, file, materials.
        encoder.length(0);
        encoder.text("");
        header(encoder, 0, "");
        encoder.text("");
        encoder.length(0);
        encoder.length(0);
        encoder.text("");
        encoder.text("");
        encoder.text("");
        encoder.length(0);
        encoder.bool(false);
    }
}

#[cfg(test)]
mod tests {
    use slitpose_head::scene_file::{MAGLEV, SPACEMOUSE, WIDE};

    use super::*;

    fn area_m2(points: &[DVec3]) -> f64 {
        let (triangles, rest) = points.as_chunks();
        assert_eq!(rest.len(), 0);
        triangles.iter().map(|[a, b, c]| 0.5 * (b - a).cross(c - a).length()).sum()
    }

    #[test]
    fn masks_cover_all_but_their_openings() {
        for scene in [WIDE, SPACEMOUSE, MAGLEV] {
            for cell in &scene.read().unwrap().scene.cells {
                let half_m = mask_half_extents_m(cell);
                let opening_m2 = match cell.opening() {
                    Opening::Slit | Opening::RidingSlit => cell.slit.width_m * cell.slit.length_m,
                    // A polygon of `ROUND` corners.
                    _ => 0.125 * cell.slit.width_m.powi(2) * ROUND as f64 * (TAU / ROUND as f64).sin(),
                };
                let expected_m2 = 4.0 * half_m.x * half_m.y - opening_m2;
                assert!((area_m2(&mask(cell)) / expected_m2 - 1.0).abs() < 1e-9);
                let (detector_m2, found_m2) =
                    (cell.detector.length_m * cell.detector.width_m, area_m2(&detector(cell)));
                assert!((found_m2 / detector_m2 - 1.0).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn masks_that_ride_are_in_the_frame_of_their_tool() {
        for (scene, with_masks, with_riding) in [(WIDE, true, false), (SPACEMOUSE, false, true), (MAGLEV, true, false)]
        {
            let mut bytes = Vec::new();
            encode_head(&scene.read().unwrap().scene.cells, "tool_7", &mut bytes);
            let has = |text: &[u8]| bytes.windows(text.len()).any(|window| window == text);
            assert_eq!((has(b"\x06\0\0\0masks\0"), has(b"\0masks_on_tool\0")), (with_masks, with_riding));
            assert!(has(b"\0tool_7\0") && has(b"\0base\0"));
            // Markers without points are left out.
            assert_eq!(bytes[4..8], 4_u32.to_le_bytes());
        }
    }
}
