//! Where the tip of a tool is: the point that stays in place while it rests in a cone and the tool turns.
//!
//! R·p + t = c for the pose (R, t) of each row, with the tip p in the tool frame and the cone c in the base. Least squares,
//! with the inverse covariance of R·p + t as weight, which contains noise, model error and what the calibration left open.
//! All but noise and contact is a smooth function of the pose, which many rows do not average away: it counts as
//! `SHARED_ERRORS` independent errors, however many rows there are.

use glam::{DMat3, DVec3};
use slitpose_calibration::{Data, Head, Row};
use slitpose_model::{Estimate, SceneError, Tier};
use thiserror::Error;

use crate::frame::View;
use crate::measurements::CONTACT;
use crate::solving::{RowSolver, STREAM_TOLERANCE};

/// Rounds of the fit: weights follow from the tip of the round before.
const ROUNDS: usize = 4;

/// Squared distance from the cone, in σ, from which a row is left out: of three numbers one in a million is farther.
const MAX_SQUARE: f64 = 31.0;

/// Share of the rows that must agree.
const MIN_KEPT: f64 = 0.8;

const MIN_ROWS: usize = 6;

/// Independent errors among those that rows share, one for each coordinate of a pose.
const SHARED_ERRORS: f64 = 6.0;

const TIER: Tier = Tier::Exact { tolerance: STREAM_TOLERANCE };

/// σ of a tip that is not known: the tool has turned about one axis, or hardly.
const MAX_SIGMA_M: f64 = 1e-3;

/// The tip of a tool.
#[derive(Clone, Copy, Debug)]
pub struct Tip {
    /// In the tool frame, metres.
    pub tip_m: DVec3,
    /// Its covariance, m².
    pub covariance: DMat3,
    /// Rows that found it.
    pub rows: usize,
    /// Rows that contradict the rest.
    pub left_out: usize,
    /// Root-mean-square distance of the tip from the cone.
    pub rms_m: f64,
}

/// Why the tip cannot be found.
#[derive(Debug, Error)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum TipError {
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error(
        "{found} of {rows} rows give a pose, and a tip needs {MIN_ROWS}; see whether the calibration is of this head"
    )]
    FewPoses { found: usize, rows: usize },
    #[error(
        "the tip is known to {:.2} mm only: turn the tool about two axes, by ten degrees and more, its tip in the cone",
        sigma_m * 1e3
    )]
    LittleTurn { sigma_m: f64 },
    #[error(
        "in {left_out} of {rows} rows the tip is not where it is in the others: it must stay in the cone; take out what comes \
         before and after"
    )]
    Moved { left_out: usize, rows: usize },
}

/// The tip in the readings of `data`, all of which were taken with the tip of the calibrated `head` in one cone.
pub fn find(head: &Head, data: &Data) -> Result<Tip, TipError> {
    let solver = RowSolver::new(head.clone(), TIER, false)?;
    let solve = |row: &Row| Ok::<_, SceneError>(solver.with_frames(row.frames)?.solve(&row.photocurrents()).estimate);
    let solved = data.rows.iter().map(solve).collect::<Result<Vec<_>, _>>()?;
    let mut estimates: Vec<Estimate> = solved.into_iter().flatten().collect();
    let (found, rows) = (estimates.len(), data.rows.len());
    if found < MIN_ROWS {
        return Err(TipError::FewPoses { found, rows });
    }
    let first = Fit::of(&estimates)?;
    estimates.retain(|estimate| first.square(estimate) <= MAX_SQUARE);
    let left_out = found - estimates.len();
    if (estimates.len() as f64) < MIN_KEPT * found as f64 {
        return Err(TipError::Moved { left_out, rows });
    }
    let fit = Fit::of(&estimates)?;
    let redundancy = (3 * estimates.len() - 6) as f64;
    let chi2: f64 = estimates.iter().map(|estimate| fit.square(estimate)).sum();
    let shared = fit.by_shared_errors(&estimates, &solver)?;
    let covariance = fit.covariance * (chi2 / redundancy).max(1.0)
        + shared * (estimates.len() as f64 / SHARED_ERRORS - 1.0).max(0.0);
    let sigma_m = (0..3).map(|k| covariance.col(k)[k].sqrt()).fold(0.0, f64::max);
    if sigma_m > MAX_SIGMA_M {
        return Err(TipError::LittleTurn { sigma_m });
    }
    let squares = estimates.iter().map(|estimate| fit.at(estimate).0.distance_squared(fit.cone_m));
    let rms_m = (squares.sum::<f64>() / estimates.len() as f64).sqrt();
    Ok(Tip { tip_m: fit.tip_m, covariance, rows: estimates.len(), left_out, rms_m })
}

#[derive(Default)]
struct Fit {
    tip_m: DVec3,
    cone_m: DVec3,
    covariance: DMat3,
    /// How the cone follows from the tip.
    share: DMat3,
}

impl Fit {
    fn of(estimates: &[Estimate]) -> Result<Self, TipError> {
        let mut fit = Self::default();
        for _ in 0..ROUNDS {
            let (mut tips, mut mixed, mut cones) = (DMat3::ZERO, DMat3::ZERO, DMat3::ZERO);
            let (mut of_tip, mut of_cone) = (DVec3::ZERO, DVec3::ZERO);
            for estimate in estimates {
                let (weight, r) = (fit.at(estimate).1, DMat3::from_quat(estimate.pose.rotation));
                let turned = r.transpose() * weight;
                (tips, mixed, cones) = (tips + turned * r, mixed + turned, cones + weight);
                of_tip -= turned * estimate.pose.translation_m;
                of_cone += weight * estimate.pose.translation_m;
            }
            // The cone eliminated.
            fit.share = mixed * cones.inverse();
            fit.covariance = (tips - fit.share * mixed.transpose()).inverse();
            fit.tip_m = fit.covariance * (of_tip + fit.share * of_cone);
            fit.cone_m = cones.inverse() * (of_cone + mixed.transpose() * fit.tip_m);
            if !fit.tip_m.is_finite() || (0..3).any(|k| fit.covariance.col(k)[k] <= 0.0) {
                return Err(TipError::LittleTurn { sigma_m: f64::INFINITY });
            }
        }
        Ok(fit)
    }

    /// Where the tip is in the base by a pose, and the covariance of that.
    fn place(&self, estimate: &Estimate) -> (DVec3, DMat3) {
        let Estimate { pose, covariance } = View::with_tip(self.tip_m, DMat3::ZERO).estimate(estimate);
        let block = DMat3::from_cols_array_2d(&std::array::from_fn(|c| std::array::from_fn(|r| covariance[r][c])));
        (pose.translation_m, block)
    }

    /// The same, and the inverse covariance of that and of the contact.
    fn at(&self, estimate: &Estimate) -> (DVec3, DMat3) {
        let contact = DMat3::from_diagonal(DVec3::splat(CONTACT[0] * CONTACT[0]));
        let (tip_m, covariance) = self.place(estimate);
        (tip_m, (covariance + contact).inverse())
    }

    /// The covariance of the tip by errors of poses without noise, as if each row had its own.
    fn by_shared_errors(&self, estimates: &[Estimate], solver: &RowSolver) -> Result<DMat3, SceneError> {
        let solve = solver.without_noise()?;
        let of_row = |estimate: &Estimate| {
            let shared = solve(&estimate.pose)?;
            let (r, weight) = (DMat3::from_quat(estimate.pose.rotation), self.at(estimate).1);
            let gain = self.covariance * (r.transpose() - self.share) * weight;
            Some(gain * self.place(&shared).1 * gain.transpose())
        };
        Ok(estimates.iter().filter_map(of_row).fold(DMat3::ZERO, |sum, of_row| sum + of_row))
    }

    fn square(&self, estimate: &Estimate) -> f64 {
        let (tip_m, weight) = self.at(estimate);
        let off_m = tip_m - self.cone_m;
        off_m.dot(weight * off_m)
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};
    use slitpose_model::{Pose, rotation_exp};

    use super::*;

    const SIGMA: [f64; 2] = [3e-6, 60e-6];

    /// Poses with the tip in a cone, with noise, turned about x and by `about_y` about y.
    fn estimates(tip_m: DVec3, about_y: f64, seed: u64) -> Vec<Estimate> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut normal = || DVec3::from_array(std::array::from_fn(|_| StandardNormal.sample(&mut rng)));
        let covariance =
            std::array::from_fn(|i| std::array::from_fn(|j| if i == j { SIGMA[i / 3] * SIGMA[i / 3] } else { 0.0 }));
        let at = |k: i32| {
            let phase = 0.37 * f64::from(k);
            let rotation = rotation_exp(DVec3::new(0.25 * phase.sin(), about_y * (2.3 * phase).sin(), 0.0));
            let cone_m = DVec3::new(1e-3, 2e-3, -80e-3) + CONTACT[0] * normal();
            let pose = Pose { rotation, translation_m: cone_m - rotation * tip_m };
            Estimate { pose: pose.perturbed(SIGMA[0] * normal(), SIGMA[1] * normal()), covariance }
        };
        (0..200).map(at).collect()
    }

    /// χ² of 60 draws of three numbers, whose standard deviation is 19.
    #[test]
    fn a_tip_is_found_as_exactly_as_it_is_said() {
        let tip_m = DVec3::new(1e-3, -2e-3, -80e-3);
        let nees: f64 = (0..60)
            .map(|seed| {
                let fit = Fit::of(&estimates(tip_m, 0.2, seed)).unwrap();
                let off_m = fit.tip_m - tip_m;
                assert!(off_m.length() < 30e-6, "{off_m}");
                off_m.dot(fit.covariance.inverse() * off_m)
            })
            .sum();
        assert!((123.0..237.0).contains(&nees), "{nees}");
    }

    #[test]
    fn a_tool_that_turns_about_one_axis_tells_no_tip() {
        let fit = Fit::of(&estimates(DVec3::new(0.0, 0.0, -80e-3), 0.0, 1));
        let is_open = fit.ok().is_none_or(|fit| fit.covariance.col(0)[0].sqrt() > MAX_SIGMA_M);
        assert!(is_open, "along the axis nothing is known");
    }
}
