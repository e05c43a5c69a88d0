//! `[workspace]`: the box of poses a head is meant for.

use glam::DVec3;
use slitpose_model::Pose;

use super::document::Document;
use super::error::{KeyPath, SceneFileError};

/// A box around home: translations and rotation vectors whose components stay within it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Workspace {
    /// Half extents of the translation, metres.
    pub half_extent_m: DVec3,
    /// Half extents of the rotation vector, radians.
    pub half_extent_rad: DVec3,
}

/// Bases of the Halton sequence: one prime for each axis.
const BASES: [usize; 6] = [2, 3, 5, 7, 11, 13];

impl Workspace {
    /// Poses spread evenly, the same ones every time.
    ///
    /// A Halton sequence (Halton 1960): the error of a share found with n of its points falls almost like 1/n, with random
    /// points like 1/√n.
    pub fn poses(&self, count: usize) -> impl Iterator<Item = Pose> + use<> {
        let (half_m, half_rad) = (self.half_extent_m, self.half_extent_rad);
        (1..=count).map(move |index| {
            let [tx, ty, tz, rx, ry, rz] = BASES.map(|base| 2.0 * radical_inverse(index, base) - 1.0);
            Pose::from_vectors(half_m * DVec3::new(tx, ty, tz), half_rad * DVec3::new(rx, ry, rz))
        })
    }

    /// All 64 corners: what is farthest from home.
    pub fn corners(&self) -> impl Iterator<Item = Pose> {
        let sign = |corner: u32, axis: u32| if corner >> axis & 1 == 0 { -1.0 } else { 1.0 };
        let vector = move |corner, from| DVec3::new(sign(corner, from), sign(corner, from + 1), sign(corner, from + 2));
        let (half_m, half_rad) = (self.half_extent_m, self.half_extent_rad);
        (0..64).map(move |corner| Pose::from_vectors(vector(corner, 0) * half_m, vector(corner, 3) * half_rad))
    }
}

/// The digits of `index` in `base`, mirrored at the point: in 0 … 1.
fn radical_inverse(mut index: usize, base: usize) -> f64 {
    let (mut inverse, mut place) = (0.0, 1.0);
    while index > 0 {
        place /= base as f64;
        inverse += place * (index % base) as f64;
        index /= base;
    }
    inverse
}

impl Default for Workspace {
    /// ±4 mm and ±15° on every axis: the span in which the paper's cell measures well (its
    /// error grows beyond ±4 mm) and a span of wrist motion.
    fn default() -> Self {
        Self { half_extent_m: DVec3::splat(4e-3), half_extent_rad: DVec3::splat(15f64.to_radians()) }
    }
}

/// The workspace of the file, key by key in place of the default.
pub(super) fn read(document: &Document<'_>) -> Result<Workspace, SceneFileError> {
    let default = Workspace::default();
    let metres = extents(document, "half_extent_mm", f64::INFINITY, "numbers of zero or more")?;
    let degrees = extents(document, "half_extent_deg", 180.0, "numbers from 0 to 180")?;
    Ok(Workspace {
        half_extent_m: metres.map_or(default.half_extent_m, |mm| mm * 1e-3),
        half_extent_rad: degrees.map_or(default.half_extent_rad, |deg| deg.map(f64::to_radians)),
    })
}

fn extents(
    document: &Document<'_>,
    key: &'static str,
    most: f64,
    allowed: &'static str,
) -> Result<Option<DVec3>, SceneFileError> {
    let path = KeyPath::section("workspace", key);
    let Some(entry) = document.find(path) else {
        return Ok(None);
    };
    let extents = document.as_vector::<3>(path, entry, "three numbers, [x, y, z]")?;
    if extents.iter().all(|extent| (0.0..=most).contains(extent)) {
        return Ok(Some(DVec3::from_array(extents)));
    }
    Err(document.out_of_range(path, entry, allowed))
}
