//! How accurate single frames are, plane by plane.

use super::{KINDS, Kind};
use crate::map::{Map, Plane, PlanePoint};
use crate::plot::{Heat, heat_picture};
use crate::report::section::{Picture, Section};
use crate::survey::AXES;

/// `None` if the map has no planes.
pub(super) fn section(map: &Map) -> Option<Section> {
    let pictures = [
        ("position_by_translation", &KINDS[0], "translations"),
        ("position_by_rotation", &KINDS[0], "rotations"),
        ("rotation_by_translation", &KINDS[1], "translations"),
        ("rotation_by_rotation", &KINDS[1], "rotations"),
    ];
    (!map.planes.is_empty()).then(|| Section {
        name: "planes",
        title: "Accuracy over planes through home",
        summary: Vec::new(),
        paragraphs: vec!["Where a point is crossed out, there is a pose at which a frame gives none.".to_owned()],
        pictures: pictures.map(|(name, kind, over)| picture(map, name, kind, over)).into(),
        tables: Vec::new(),
    })
}

/// σ of one kind over the three planes of translations or rotations.
fn picture(map: &Map, name: &'static str, kind: &Kind, over: &str) -> Picture {
    let planes = || map.planes.iter().filter(|plane| (plane.axes[0] < 3) == (over == "translations"));
    let in_plane = |point: &PlanePoint| (kind.of)(&point.view).unwrap_or(f64::INFINITY);
    let heats: Vec<Heat> = planes()
        .map(|plane| heat(plane, "others at home", |point| in_plane(point) * kind.scale))
        .chain(planes().map(|plane| heat(plane, "worst of the others", |point| (kind.worst)(point) * kind.scale)))
        .collect();
    let title = format!("σ of the {} over {over}", kind.name);
    let note = format!(
        "Upper row: the other coordinates at home. Lower row: the worst of {} poses over all of their range.",
        map.behind + 1
    );
    let unit = format!("σ of a single frame, {}, three axes together", kind.unit);
    Picture { name, caption: format!("{title}."), svg: heat_picture(&title, &note, &unit, 3, &heats) }
}

fn heat(plane: &Plane, heading: &str, value: impl Fn(&PlanePoint) -> f64) -> Heat {
    let degrees = |axis: usize| axis >= 3;
    Heat {
        heading: heading.to_owned(),
        labels: plane.axes.map(|axis| format!("{} / {}", AXES[axis], if degrees(axis) { "°" } else { "mm" })),
        extents: [0, 1].map(|k| {
            let extent = plane.extents[k];
            if degrees(plane.axes[k]) { extent.to_degrees() } else { extent * 1e3 }
        }),
        side: plane.side,
        values: plane.points.iter().map(value).collect(),
    }
}
