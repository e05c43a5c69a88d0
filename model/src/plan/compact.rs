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
use crate::effects::{AZIMUTHAL_TERMS, Effects};
use crate::entries::Scalar;
use crate::exact;
use crate::polygon::EmitterGradient;
use crate::pose::{Pose, Transform};
use crate::power::Power;
use crate::profile::{CompiledProfile, Curve};
use crate::rectangle::{Rectangle, Visibility};
use crate::scalar::{Linear3, Number};
use crate::scene::{Cell, Scene};

use super::imperfect::beam::Beam;
use super::imperfect::electrical::Electrical;
use super::imperfect::passage::Passage;
use super::imperfect::source::azimuthal_factor;
use super::imperfect::{Imperfect, Sums};
use super::optics::{Instant, Light, Place, Receiver, Seen, Source, of_sides};
use super::{CellTerms, CompiledCell, CompiledScene, Near, Optics};

/// Most cells of a compact plan: what a board has converters for.
pub const BOARD_CELLS: usize = 6;

/// Up to [`BOARD_CELLS`] cells, compiled.
#[derive(Clone, Debug)]
pub struct CompactPlan<S: Number> {
    pub(crate) cells: Vec<CompactCell<S>, BOARD_CELLS>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct CompactCell<S: Number> {
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
    pub(crate) fn of(
        scene: &Scene,
        plan: &CompiledScene<S>,
        exact: &CompiledScene<f64>,
    ) -> Result<Self, (usize, &'static str)> {
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
            (Aperture::Thin(face), Some(profile)) if cell.imperfect.is_none() => {
                Kind::Ideal(Ideal { face: *face, profile: profile.clone() })
            }
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
    // There is room for neither the code nor the time.
    const FINDS_LIGHT_LEVEL: bool = false;
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

/// A cell with effects as a microcontroller computes it: one point of light through a slit, a narrow spot, one polynomial
/// for the profile.
///
/// Its currents are those of the exact tier to some 10⁻⁵. Its derivatives are right to some 10⁻²: they leave out how a
/// window bends the light at the detector's edges and within the spot, and what a turn of the emitter about its own axis
/// does to its azimuth.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct CompactImperfect<S: Number> {
    beam: Beam<S>,
    curve: Curve<S>,
    azimuth: Option<Azimuth<S>>,
    electrical: Electrical<S>,
}

/// Of [`super::imperfect::source::ExtendedSource`], that of a point.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(bound = "")]
struct Azimuth<S: Number> {
    /// Direction v across the axis, tool frame.
    across: S::Vec3,
    coefficients: [S; AZIMUTHAL_TERMS],
}

impl<S: Number> CompactImperfect<S> {
    /// That of `cell`, its `profile` compiled; or what it has that has no place here.
    pub fn of(cell: &Cell, profile: &CompiledProfile<f64>) -> Result<Self, &'static str> {
        let ideal = Effects::default();
        let effects = cell.acting_effects().unwrap_or(&ideal);
        if effects.other_axis.is_some() {
            return Err("a detector of two axes");
        }
        if effects.source_diameter_m > 0.0 {
            return Err("an emitter that is no point");
        }
        if effects.lit_together != 0 {
            return Err("emitters that are lit together");
        }
        let imperfect = Imperfect::compile(cell, effects).ok_or("a slit that is turned far against its detector")?;
        let Passage::Beam(beam) = imperfect.passage else { return Err("another opening than a slit") };
        let curve = Curve::fit(profile).ok_or("an emitter whose profile is no smooth curve")?;
        let [across, _] = imperfect.source.across;
        let azimuth = imperfect.source.azimuthal.map(|coefficients| Azimuth { across, coefficients });
        Ok(Self { beam, curve, azimuth, electrical: imperfect.electrical })
    }

    /// The terms of cell number `index`, whose emitter is `seen` at its exposure.
    // Apart: of ideal cells none of this is executed.
    #[inline(never)]
    pub fn linearise(
        &self,
        receiver: &Receiver<S>,
        source: &Source<S>,
        seen: &Seen<S>,
        instant: &Instant<'_, S>,
        index: usize,
    ) -> CellTerms<S> {
        let (spot, visibility) = self.beam.spot::<true, false>(seen.position, receiver.half);
        let status = visibility.status(0);
        let (mut sums, mut slack_m, mut wall_m) = (Sums::none(S::zero()), S::zero(), S::infinity());
        if status.has_spot() && exact::is_wholly_in_front(&spot.rectangle, seen.axis) {
            (slack_m, wall_m) = (spot.slack, spot.wall);
            let (light, drift) = exact::narrow_light::<S, true>(&spot.rectangle, seen.axis, |c| self.curve.bends(c));
            let (mut power, x_a, x_by) = spot.of_narrow(&light, drift);
            if let Some(azimuth) = &self.azimuth {
                let to_spot =
                    S::Vec3::new(x_a - seen.position.x(), -seen.position.y(), spot.raise.height - seen.position.z());
                power = azimuth.of_light(&power, to_spot, x_by, receiver, seen, instant);
            }
            let (x_m, slope) = self.electrical.measured(x_a);
            let gain = receiver.responsivity * source.intensity;
            (sums.total, sums.moment) = (gain * power.value, gain * power.value * x_m);
            let (power_by, x_by) = (receiver.of_pose(&power, seen), receiver.of_position(x_by, seen));
            let per_place = sums.total * slope;
            for i in 0..6 {
                sums.total_by[i] = gain * power_by[i];
                sums.moment_by[i] = sums.total_by[i] * x_m + per_place * x_by[i];
            }
        }
        let translation = instant.translation_of(index);
        let (pair, jacobian) =
            self.electrical.currents::<true>(receiver, false, &sums, S::one(), (translation, instant.pose));
        if status.has_spot() {
            CellTerms { status, pair, jacobian, slack_m, wall_m }
        } else {
            // Without direct light, what is left says next to nothing of the pose.
            CellTerms { pair, ..CellTerms::dark(status) }
        }
    }
}

impl<S: Number> Azimuth<S> {
    /// `power` times the factor of the ray `to_spot`, cell frame, that ends `x_by` farther along x per motion of the
    /// emitter.
    #[inline(always)]
    fn of_light(
        &self,
        power: &EmitterGradient<S>,
        to_spot: S::Vec3,
        x_by: S::Vec3,
        receiver: &Receiver<S>,
        seen: &Seen<S>,
        instant: &Instant<'_, S>,
    ) -> EmitterGradient<S> {
        let per_distance = to_spot.dot(to_spot).inverse_root();
        let ray = to_spot * per_distance;
        // Between two exposures of a frame the tool turns too little to be seen here.
        let v_axis = receiver.to_cell(instant.pose.rotate(self.across));
        let axes = [v_axis, seen.axis.cross(v_axis), seen.axis];
        let (factor, by_ray) = azimuthal_factor::<S>(&self.coefficients, axes, ray);
        let by_end = (by_ray - ray * ray.dot(by_ray)) * per_distance;
        // The tool turns under the ray: about its axis that is left out.
        let turn = by_ray.cross(ray);
        EmitterGradient {
            value: power.value * factor,
            by_position: power.by_position * factor + (x_by * by_end.x() - by_end) * power.value,
            by_axis: power.by_axis * factor + turn.cross(seen.axis) * power.value,
        }
    }
}
