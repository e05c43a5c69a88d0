//! A cell with effects as a microcontroller computes it: one point of light through a slit, a narrow spot, one
//! polynomial for the profile.
//!
//! Its currents are those of the exact tier to some 10⁻⁵. Its derivatives are right to some 10⁻²: they leave out how a
//! window bends the light at the detector's edges and within the spot, and what a turn of the emitter about its own axis
//! does to its azimuth.

use serde::{Deserialize, Serialize};

use crate::effects::{AZIMUTHAL_TERMS, Effects};
use crate::exact;
use crate::polygon::EmitterGradient;
use crate::profile::{CompiledProfile, Curve};
use crate::scalar::{Linear3, Number};
use crate::scene::Cell;

use super::super::optics::{Instant, Receiver, Seen, Source};
use super::super::{CellTerms, Imperfect};
use super::beam::Beam;
use super::electrical::Electrical;
use super::passage::Passage;
use super::{Sums, azimuthal_factor};

/// What stands between an emitter and two currents.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(bound = "")]
pub(in super::super) struct CompactImperfect<S: Number> {
    beam: Beam<S>,
    curve: Curve<S>,
    azimuth: Option<Azimuth<S>>,
    electrical: Electrical<S>,
}

/// Of [`super::ExtendedSource`], that of a point.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(bound = "")]
struct Azimuth<S: Number> {
    /// Direction v across the axis, tool frame.
    across: S::Vec3,
    coefficients: [S; AZIMUTHAL_TERMS],
}

impl<S: Number> CompactImperfect<S> {
    /// That of `cell`, its `profile` compiled; or what it has that has no place here.
    pub(in super::super) fn of(cell: &Cell, profile: &CompiledProfile<f64>) -> Result<Self, &'static str> {
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
    pub(in super::super) fn linearise(
        &self,
        receiver: &Receiver<S>,
        source: &Source<S>,
        seen: &Seen<S>,
        instant: &Instant<'_, S>,
        index: usize,
    ) -> CellTerms<S> {
        let spot = self.beam.spot::<true, false>(seen.position, receiver.half);
        let status = spot.as_ref().map_or_else(|&status| status, |&(_, status)| status);
        let (mut sums, mut slack_m, mut wall_m) = (Sums::none(), S::zero(), S::infinity());
        if let Ok((spot, _)) = &spot
            && exact::is_wholly_in_front(&spot.rectangle, seen.axis)
        {
            (slack_m, wall_m) = (spot.slack_m, spot.wall_m);
            let (light, drift) = exact::narrow_light::<S, true>(&spot.rectangle, seen.axis, |c| self.curve.bends(c));
            let (mut power, x_a, x_by) = spot.of_narrow(&light, drift);
            if let Some(azimuth) = &self.azimuth {
                let to_spot =
                    S::Vec3::new(x_a - seen.position.x(), -seen.position.y(), spot.raise().0 - seen.position.z());
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
        let (pair, jacobian) = self.electrical.currents::<true>(receiver, false, &sums, S::one(), translation);
        match spot {
            Ok(_) => CellTerms { status, pair, jacobian, slack_m, wall_m },
            // Without direct light, what is left says next to nothing of the pose.
            Err(_) => CellTerms { pair, ..CellTerms::dark(status) },
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
