//! Pictures, as SVG.
//!
//! `Canvas` draws lines, areas and labels; `Chart` draws curves over axes on a canvas;
//! [`scene_picture`] and [`cell_picture`] draw a sensor head. A canvas has its origin at the top
//! left, y down, in pixels at 96 per inch; pictures of things are in millimetres and degrees.

mod canvas;
mod chart;
mod close_up;
mod heat;
mod scene;
mod shape;

pub(crate) use canvas::{Anchor, Canvas, SOFT_INK, TextStyle, three_digits};
pub(crate) use chart::{Axis, Chart, Curve, CurveStyle, Note, Scale, curve};
pub use close_up::cell_picture;
pub(crate) use heat::{Heat, heat_picture};
pub use scene::scene_picture;
pub use shape::{MaskFrame, mask_half_extents_m};

#[cfg(test)]
mod tests {
    use glam::{DVec3, dvec2};
    use quick_xml::Reader;
    use quick_xml::events::Event;
    use slitpose_head::scene_file::SHIPPED;
    use slitpose_model::{CompiledScene, Pose, Tier};

    use super::*;

    /// Home, an ordinary pose, and poses where cells are clipped, dark, behind their slit or turned away.
    fn poses() -> Vec<Pose> {
        let pose = |tx: f64, tz: f64, ry: f64| Pose::from_vectors(DVec3::new(tx, 0.0, tz) * 1e-3, DVec3::Y * ry);
        vec![Pose::HOME, pose(2.0, -3.0, 0.2), pose(0.0, 5.7, 0.0), pose(14.0, -20.0, 0.0), pose(0.0, 0.0, 3.0)]
    }

    /// Reads the whole text and returns what its labels say.
    fn labels(svg: &str) -> String {
        let mut reader = Reader::from_str(svg);
        let mut labels = String::new();
        loop {
            match reader.read_event().unwrap() {
                Event::Text(text) => labels.push_str(&text),
                Event::Eof => return labels,
                _ => {}
            }
        }
    }

    /// Also with a name of characters that XML cannot hold, of which only those are lost.
    #[test]
    fn every_picture_is_well_formed_and_all_coordinates_are_numbers() {
        for file in SHIPPED.map(|shipped| shipped.read().unwrap()) {
            let plan = CompiledScene::<f64>::compile(&file.scene, Tier::Paper).unwrap();
            for pose in poses() {
                let name = "a\u{1}b\u{fffe} 1 < 2";
                let mut pictures = vec![scene_picture(name, &file.scene, &plan, &pose)];
                for (number, cell) in file.scene.cells.iter().enumerate() {
                    pictures.push(cell_picture(name, number, cell, &plan, &pose));
                }
                for picture in pictures {
                    assert!(picture.contains("ab 1 &lt; 2") && !picture.contains(['\u{1}', '\u{fffe}']));
                    assert!(labels(&picture).contains("ab 1 "));
                    assert!(!picture.contains("NaN") && !picture.contains("inf"), "{}: {pose:?}", file.name);
                }
            }
        }
    }

    #[test]
    fn an_arrow_shorter_than_its_head_has_none() {
        let stroke = canvas::Stroke::new(canvas::INK, 1.6);
        for (length, heads) in [(0.0, 0), (1e-9, 0), (2.0, 0), (7.9, 0), (8.5, 1), (60.0, 1)] {
            let mut canvas = Canvas::new(100.0, 100.0, "arrow");
            let before = canvas_parts(Canvas::new(100.0, 100.0, "arrow"));
            canvas.arrow(dvec2(10.0, 10.0), dvec2(10.0 + length, 10.0), stroke);
            assert_eq!(canvas_parts(canvas) - before, heads, "{length}");
        }
    }

    fn canvas_parts(canvas: Canvas) -> usize {
        canvas.into_svg().matches("<polygon").count()
    }

    #[test]
    fn a_picture_tells_what_the_model_says() {
        let file =
            SHIPPED.map(|shipped| shipped.read().unwrap()).into_iter().find(|file| file.origin == "bench").unwrap();
        let plan = CompiledScene::<f64>::compile(&file.scene, Tier::Paper).unwrap();
        let at = |tx_mm: f64| Pose::from_vectors(DVec3::X * tx_mm * 1e-3, DVec3::ZERO);
        let text = labels(&scene_picture(&file.name, &file.scene, &plan, &at(3.0)));
        assert!(text.contains("XA = −3 mm") && text.contains("lit"), "{text}");
        let text = labels(&scene_picture(&file.name, &file.scene, &plan, &at(9.0)));
        assert!(text.contains("no light") && text.contains("dark"), "{text}");
        let text = labels(&cell_picture(&file.name, 0, &file.scene.cells[0], &plan, &at(3.0)));
        for part in ["dA = 15 mm", "dB = 7.5 mm", "w = 0.4 mm", "XA = −3 mm", "Lx = 12 mm", "tool at (3, 0, 0) mm"] {
            assert!(text.contains(part), "`{part}` is not in: {text}");
        }
        let text = labels(&cell_picture(&file.name, 0, &file.scene.cells[0], &plan, &Pose::HOME));
        assert!(text.contains("tool at home"), "{text}");
    }

    #[test]
    fn each_of_six_cells_side_by_side_has_its_own_number_beside_it() {
        let file = SHIPPED[0].read().unwrap();
        let mut scene = file.scene.clone();
        for (number, cell) in scene.cells.iter_mut().enumerate() {
            let (sin, cos) = (number as f64 * std::f64::consts::FRAC_PI_3).sin_cos();
            let across = DVec3::new(15e-3 * cos, 15e-3 * sin, 0.0);
            cell.detector.centre_base_m = across + DVec3::Z * 20e-3;
            (cell.detector.normal_base, cell.detector.x_axis_base) = (-DVec3::Z, DVec3::new(cos, sin, 0.0));
            (cell.emitter.position_tool_m, cell.emitter.axis_tool) = (across, DVec3::Z);
        }
        let plan = CompiledScene::<f64>::compile(&scene, Tier::Paper).unwrap();
        let labels = labels(&scene_picture("flat", &scene, &plan, &Pose::HOME));
        let top = labels.split("top view").nth(1).and_then(|rest| rest.split("front view").next()).unwrap();
        assert!(!top.contains(", "), "{top}");
    }
}
