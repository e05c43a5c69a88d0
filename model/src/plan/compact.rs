//! A head as a microcontroller holds it: cells of one kind, and one rule for the light of every spot.
//!
//! The rule is that of the exact tier, power and power-weighted centroid by Gauss–Legendre nodes on the spot, with
//! as many nodes everywhere as the worst spot of the head's workspace needs. What other cells have (slits turned
//! against their detector, tabulated profiles, effects) has no place in it, and no code.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::aperture::Aperture;
use crate::exact::{self, Rules};
use crate::pose::{Pose, Transform};
use crate::power::Power;
use crate::rectangle::{Rectangle, Visibility};
use crate::scalar::Scalar;

use super::optics::{Instant, Light, Receiver, Seen, Source, of_sides};
use super::pack::Faces;
use super::{CellTerms, CompiledCell, Optics, Plan};

/// Most nodes along one side of a spot.
const MOST_NODES: usize = 4;

/// Rules, by their nodes along and across the detector, the shortest first. The position of the light asks for more
/// along the detector than its power does across.
pub(crate) const NODES: [[usize; 2]; 8] = [[2, 1], [2, 2], [3, 2], [2, 3], [3, 3], [4, 3], [3, 4], [4, 4]];

/// Nodes and weights along one side.
type Nodes<S> = Vec<(S, S), MOST_NODES>;

/// Up to `N` cells, compiled.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct CompactPlan<S: Scalar, const N: usize> {
    cells: Vec<CompactCell<S>, N>,
    /// Along x and y.
    nodes: [Nodes<S>; 2],
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(bound = "")]
struct CompactCell<S: Scalar> {
    receiver: Receiver<S>,
    faces: Faces<S>,
    source: Source<S>,
    profile: Power<S>,
}

impl<S: Scalar, const N: usize> CompactPlan<S, N> {
    /// The cells of `plan` with `nodes` along and across their detectors; `None` if there are more than `N` of them, if
    /// one is of another kind, or if those are more nodes than a compact plan has room for.
    pub(crate) fn of(plan: &Plan<S>, nodes: [usize; 2]) -> Option<Self> {
        let rules = Rules::new();
        if nodes.iter().any(|count| !(1..=MOST_NODES).contains(count)) || plan.cells.len() > N {
            return None;
        }
        Some(Self {
            cells: plan.cells.iter().map(CompactCell::of).collect::<Option<_>>()?,
            nodes: nodes.map(|count| rules.get(count).collect()),
        })
    }
}

impl<S: Scalar, const N: usize> CompactPlan<S, N> {
    /// The currents of all cells with the tool at rest at `pose`.
    pub(crate) fn currents_at(&self, pose: &Pose) -> Vec<[S; 2], N> {
        let pose = &Transform::of(pose);
        let (linear, angular) = (S::Vec3::default(), S::Vec3::default());
        let mut currents = Vec::new();
        self.currents_all(&Instant { pose, linear, angular, offsets_s: &[] }, |_| true, |_, pair| {
            // As many as cells.
            let _ = currents.push(pair);
        });
        currents
    }
}

impl<S: Scalar> Plan<S> {
    /// The first cell that has no place in a compact plan, and what it has.
    pub(crate) fn not_compact(&self) -> Option<(usize, &'static str)> {
        self.cells.iter().enumerate().find_map(|(index, cell)| {
            let what = match &cell.aperture {
                Aperture::Turned(_) => "a slit that is turned against its detector",
                Aperture::Imperfect(_) => "effects",
                Aperture::Thin(_) | Aperture::Thick(..) if cell.emitter.profile.as_power().is_none() => {
                    "an emitter whose profile is no power of the cosine"
                }
                Aperture::Thin(_) | Aperture::Thick(..) => return None,
            };
            Some((index, what))
        })
    }
}

impl<S: Scalar> CompactCell<S> {
    fn of(cell: &CompiledCell<S>) -> Option<Self> {
        let faces = match &cell.aperture {
            Aperture::Thin(face) => Faces::Thin(*face),
            Aperture::Thick(lower, upper) => Faces::Thick([*lower, *upper]),
            Aperture::Turned(_) | Aperture::Imperfect(_) => return None,
        };
        let profile = cell.emitter.profile.as_power()?.clone();
        Some(Self { receiver: cell.receiver.clone(), faces, source: cell.emitter.source.clone(), profile })
    }

    /// The emitter at the exposure of cell number `index`.
    #[inline(always)]
    fn see(&self, index: usize, instant: &Instant<'_, S>) -> Seen<S> {
        match instant.offsets_s.get(index) {
            None => self.receiver.see(&self.source, instant.pose),
            Some(&offset_s) => {
                self.receiver.see_moved(&self.source, instant.pose, [instant.linear, instant.angular], offset_s)
            }
        }
    }

    /// The light of the cell's emitter; `None` without a spot, or if part of it is beyond the emitter's horizon.
    #[inline(always)]
    fn light<const GRADIENT: bool>(&self, seen: &Seen<S>, nodes: &[Nodes<S>; 2]) -> (Option<Light<S>>, Visibility<S>) {
        use crate::scalar::Linear3;
        let emitter = [seen.position.x(), seen.position.y(), seen.position.z()];
        let (spot, visibility) = match &self.faces {
            Faces::Thin(face) => Rectangle::of_beam([*face], emitter, self.receiver.half),
            Faces::Thick(faces) => Rectangle::of_beam(*faces, emitter, self.receiver.half),
        };
        if !visibility.status(0).has_spot() || !exact::is_wholly_in_front(&spot, seen.axis) {
            return (None, visibility);
        }
        let [x, y] = nodes.each_ref().map(|nodes| nodes.iter().copied());
        let light = exact::fixed_rectangle_light::<S, _, GRADIENT>(&spot, seen.axis, &self.profile, x, y);
        (Some(of_sides::<S, GRADIENT>(&light, &spot, true)), visibility)
    }
}

impl<S: Scalar, const N: usize> Optics<S> for CompactPlan<S, N> {
    fn cell_count(&self) -> usize {
        self.cells.len()
    }

    fn arm(&self, cell: usize, base_from_tool: &Transform<S>) -> S::Vec3 {
        base_from_tool.rotate(self.cells[cell].source.position)
    }

    #[inline(always)]
    fn linearise_all(
        &self,
        instant: &Instant<'_, S>,
        wanted: impl Fn(usize) -> bool,
        mut sink: impl FnMut(usize, &CellTerms<S>),
    ) {
        for (index, cell) in self.cells.iter().enumerate().filter(|&(index, _)| wanted(index)) {
            let seen = cell.see(index, instant);
            let (light, visibility) = cell.light::<true>(&seen, &self.nodes);
            let status = visibility.status(0);
            let terms = light.map_or(CellTerms::dark(status), |light| {
                let (pair, jacobian) = cell.receiver.linearise(&cell.source, &light, &seen, false);
                CellTerms { status, pair, jacobian, slack_m: visibility.slack_m(0) }
            });
            sink(index, &terms);
        }
    }

    #[inline(always)]
    fn currents_all(
        &self,
        instant: &Instant<'_, S>,
        wanted: impl Fn(usize) -> bool,
        mut sink: impl FnMut(usize, [S; 2]),
    ) {
        for (index, cell) in self.cells.iter().enumerate().filter(|&(index, _)| wanted(index)) {
            let seen = cell.see(index, instant);
            let currents = cell.light::<false>(&seen, &self.nodes).0.map_or([S::zero(); 2], |light| {
                let photocurrent = cell.receiver.responsivity * cell.source.intensity * light.power.value;
                cell.receiver.divide(photocurrent, light.x_a.value(), false)
            });
            sink(index, currents);
        }
    }
}
