//! What the light passes through: a slit on base or tool, a pinhole, a lens.

use slitpose_model::Opening;

use super::document::Document;
use super::error::{ContentFault, KeyPath, SceneFileError};
use super::optics::M_FROM_MM;

/// What the light of a cell passes through, and the keys of its sizes.
pub(super) struct Passage {
    pub(super) opening: Opening,
    /// Key of the size along x.
    pub(super) width: &'static str,
    /// Key of the size along y.
    pub(super) length: &'static str,
}

impl Passage {
    /// That of cell `cell`. A hole is given by its diameter, a slit by width and length: a cell that gives either has no
    /// use for the other's defaults.
    pub(super) fn read(document: &Document<'_>, cell: usize) -> Result<Self, SceneFileError> {
        let path = |key| KeyPath::of_cell(cell, "slit", key);
        let own = |key| document.find_own(cell, "slit", key).is_some();
        let given = |key| document.find(path(key)).is_some();
        let refuse = |key, why| {
            let path = path(key);
            let text = document.find(path).map(|entry| document.quote(entry.span())).unwrap_or_default();
            Err(document.error(path, ContentFault::Opening { path, text, why }))
        };
        let (own_hole, own_slit) = (own("diameter_mm"), own("width_mm") || own("length_mm"));
        let is_hole = given("diameter_mm") && (own_hole || !own_slit);
        if is_hole && own_hole == own_slit && (given("width_mm") || given("length_mm")) {
            return refuse("diameter_mm", "a round hole has neither width_mm nor length_mm; remove those or this");
        }
        let rides = match document.text(path("mount"))?.as_deref() {
            None | Some("base") => false,
            Some("tool") => true,
            Some(_) => return refuse("mount", "give \"base\" or \"tool\""),
        };
        // A cell with sizes of its own has a lens of its own, too, if any.
        let may_focus = !(own_hole || own_slit) || own("focal_length_mm");
        let focal_length_mm = document.number(path("focal_length_mm"))?.filter(|_| may_focus);
        let opening = match (is_hole, rides, focal_length_mm) {
            (true, true, _) => return refuse("mount", "a round hole is on the base; give \"base\", or a slit"),
            (false, _, Some(_)) => {
                return refuse(
                    "focal_length_mm",
                    "a lens fills a round hole; give its diameter_mm in place of width_mm and length_mm",
                );
            }
            (true, false, Some(focal_length_mm)) => Opening::Lens { focal_length_m: focal_length_mm * M_FROM_MM },
            (true, false, None) => Opening::Pinhole,
            (false, true, None) => Opening::RidingSlit,
            (false, false, None) => Opening::Slit,
        };
        let (width, length) = if is_hole { ("diameter_mm", "diameter_mm") } else { ("width_mm", "length_mm") };
        Ok(Self { opening, width, length })
    }
}
