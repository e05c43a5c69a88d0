//! A head as a microcontroller holds it: cells of two kinds, and one rule for the light of every spot.
//!
//! The rule is that of the exact tier, power and power-weighted centroid, by an expansion about the middle of the spot
//! ([`exact::narrow_light`]): of spots as narrow as those of the shipped scenes it errs by some 10⁻⁵. An ideal cell is a
//! thin mask parallel to its detector before an emitter of the profile cosⁿγ. Whatever else a calibration finds is that of
//! [`CompactImperfect`]; what has no place in that (round openings, extended sources, emitters lit together) has no code.
//! Derivatives are those of the middle of the spot, right to some 10⁻³: of a step of a σ that is nothing, and longer
//! ones are followed by another.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::aperture::{Aperture, Face};
use crate::entries::Scalar;
use crate::exact;
use crate::pose::{Pose, Transform};
use crate::power::Power;
use crate::profile::CompiledProfile;
use crate::rectangle::{Rectangle, Visibility};
use crate::scalar::{Linear3, Number};
use crate::scene::{Cell, Scene};

use super::imperfect::CompactImperfect;
use super::optics::{Instant, Light, Place, Receiver, Seen, Source, of_sides};
use super::{CellTerms, CompiledCell, Near, Optics, Plan};

/// Most cells of a compact plan: what a board has converters for.
pub const BOARD_CELLS: usize = 6;

/// Up to [`BOARD_CELLS`] cells, compiled.
#[derive(Clone, Debug)]
pub struct CompactPlan<S: Number> {
    pub(crate) cells: Vec<CompactCell<S>, BOARD_CELLS>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(bound = "")]
pub(crate) struct CompactCell<S: Number> {
    receiver: Receiver<S>,
    source: Source<S>,
    kind: Kind<S>,
}

/// What is between the emitter and the detector, and behind that.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(bound = "")]
#[allow(clippy::large_enum_variant, reason = "no heap on the board; both are nearly alike")]
enum Kind<S: Number> {
    Ideal(Ideal<S>),
    Imperfect(CompactImperfect<S>),
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(bound = "")]
struct Ideal<S: Number> {
    face: Face<S>,
    profile: Power<S>,
}

impl<S: Scalar> CompactPlan<S> {
    /// The cells of `plan`, [`BOARD_CELLS`] at most, which is that of `scene`, as is `exact`.
    ///
    /// # Errors
    /// The first cell that has no place in a compact plan, and what it has.
    pub(crate) fn of(scene: &Scene, plan: &Plan<S>, exact: &Plan<f64>) -> Result<Self, (usize, &'static str)> {
        let cell = |(index, cell): (usize, _)| {
            let of_scene = &scene.cells[index];
            CompactCell::of(cell, of_scene, &exact.cells[index].emitter.profile).map_err(|what| (index, what))
        };
        Ok(Self { cells: plan.cells.iter().enumerate().map(cell).collect::<Result<_, _>>()? })
    }

    /// The currents of all cells with the tool at rest at `pose`.
    pub(crate) fn currents_at(&self, pose: &Pose) -> Vec<[S; 2], BOARD_CELLS> {
        let pose = &Transform::of(pose);
        let still = [S::Vec3::default(); 2];
        let mut currents = Vec::new();
        self.currents_all(
            &Instant { pose, twist: still, bend: None, offsets_s: &[] },
            |_| true,
            |_, pair| {
                // As many as cells.
                let _ = currents.push(pair);
            },
        );
        currents
    }
}

impl<S: Number> CompactCell<S> {
    /// The same cell, which is that `of_scene` and has the profile `exact`; or what it has that has no place here.
    fn of(cell: &CompiledCell<S>, of_scene: &Cell, exact: &CompiledProfile<f64>) -> Result<Self, &'static str> {
        let kind = match (&cell.aperture, cell.emitter.profile.as_power()) {
            (Aperture::Thin(face), Some(profile)) => Kind::Ideal(Ideal { face: *face, profile: profile.clone() }),
            _ => Kind::Imperfect(CompactImperfect::of(of_scene, exact)?),
        };
        Ok(Self { receiver: cell.receiver.clone(), source: cell.emitter.source.clone(), kind })
    }

    /// The emitter at the exposure of cell number `index`.
    #[inline(always)]
    fn see(&self, index: usize, instant: &Instant<'_, S>) -> Seen<S> {
        match instant.offsets_s.get(index) {
            None => self.receiver.see(&self.source, instant.pose),
            Some(&offset_s) => self.receiver.see_moved(&self.source, instant.pose, instant.displacement(offset_s)),
        }
    }
}

impl<S: Number> Ideal<S> {
    /// The light of the cell's emitter; `None` without a spot, or if part of it is beyond the emitter's horizon.
    #[inline(always)]
    fn light<const GRADIENT: bool>(&self, receiver: &Receiver<S>, seen: &Seen<S>) -> (Option<Light<S>>, Visibility<S>) {
        let emitter = [seen.position.x(), seen.position.y(), seen.position.z()];
        let (spot, visibility) = Rectangle::of_beam([self.face], emitter, receiver.half);
        if !visibility.status(0).has_spot() || !exact::is_wholly_in_front(&spot, seen.axis) {
            return (None, visibility);
        }
        let (light, drift) = exact::narrow_light::<S, GRADIENT>(&spot, seen.axis, |c| self.profile.bends(c));
        let mut light = of_sides::<S, GRADIENT>(&light, &spot, false);
        if let Place::Middle(_, [by_x, by_z]) = &mut light.x_a {
            // The middle moves by so much on the detector, and by one less under the emitter.
            (*by_x, *by_z) = (*by_x + drift * (*by_x - S::one()), *by_z + drift * *by_z);
        }
        (Some(light), visibility)
    }
}

impl<S: Number> Optics<S> for CompactPlan<S> {
    // It costs as much as the covariance.
    const TELLS_RELIABILITY: bool = false;
    // The search would take a board a tenth of a second. Of a head of six cells, five leave four currents to check with.
    const UNIQUE_FROM: usize = 5;
    // A second evaluation takes half a frame. What is left of a frame's work is for another motion, and for the cell that
    // lies.
    const NEAR: Near = Near { sigmas: 2.0, work: 3 };
    // The slower frames follow one another, the farther off is a tool that moves as nobody expects.
    const NEAR_UNHURRIED: Near = Near { sigmas: 0.8, work: 6 };
    const UNHURRIED_S: f64 = 450e-6;
    const HAS_SMALL_FRAMES: bool = true;
    // A blow changes the motion of each tool, and there are evaluations for one of both.
    const DOUBTS_MOTION_FIRST: bool = true;
    // A look takes a third of a frame's work.
    const LOOKS_AGAIN_AFTER: u64 = 16;
    // Emitters are near one in each eighth frame.
    const CROSSES_WALLS: bool = true;
    // A fast hand's 300 m/s² then move the tool by 1.5 µm. There is no time for it in six slots of a frame of 250 µs.
    const BENDS_FROM_S: f64 = 100e-6;

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
            let CompactCell { receiver, source, kind } = cell;
            let terms = match kind {
                Kind::Ideal(ideal) => {
                    let (light, visibility) = ideal.light::<true>(receiver, &seen);
                    let status = visibility.status(0);
                    light.map_or(CellTerms::dark(status), |light| {
                        let (pair, jacobian) = receiver.linearise(source, &light, &seen, false);
                        let slack_m = visibility.slack_m(0);
                        CellTerms { status, pair, jacobian, slack_m, wall_m: S::infinity() }
                    })
                }
                Kind::Imperfect(imperfect) => imperfect.linearise(receiver, source, &seen, instant, index),
            };
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
            let CompactCell { receiver, source, kind } = cell;
            let currents = match kind {
                Kind::Ideal(ideal) => ideal.light::<false>(receiver, &seen).0.map_or([S::zero(); 2], |light| {
                    let photocurrent = receiver.responsivity * source.intensity * light.power.value;
                    receiver.divide(photocurrent, light.x_a.value(), false)
                }),
                // With derivatives: this is rare, and fast code has little room.
                Kind::Imperfect(imperfect) => imperfect.linearise(receiver, source, &seen, instant, index).pair,
            };
            sink(index, currents);
        }
    }
}
