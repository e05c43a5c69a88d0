//! The crate `levenberg-marquardt` (MINPACK's algorithm) on nalgebra, with slitpose's own analytic
//! derivatives.

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::storage::Owned;
use nalgebra::{Matrix3, Matrix6, SMatrix, SVector, U6, U12};
use slitpose_model::{CompiledScene, Pair, Pose, Scene, SceneError, Tier};

use crate::chart::{self, ARM_M};
use crate::contender::{Answer, Contender};
use crate::problems::Problem;
use crate::weights::{CELLS, CellNoise, Weighted};

/// The whitened currents of a head, and where the crate looks at them.
///
/// Nearly all of its steps succeed, and a step that succeeds wants derivatives, too: computing both
/// at once is cheaper than the currents first.
struct Currents<'a> {
    plan: &'a CompiledScene<f64>,
    readings: [Weighted; CELLS],
    x: SVector<f64, 6>,
    residuals: SVector<f64, 12>,
    jacobian: SMatrix<f64, 12, 6>,
}

impl<'a> Currents<'a> {
    fn new(plan: &'a CompiledScene<f64>, noise: &[CellNoise; CELLS], pairs: &[Pair<f64>; CELLS], start: &Pose) -> Self {
        let mut currents = Self {
            plan,
            readings: core::array::from_fn(|cell| noise[cell].weigh(&pairs[cell])),
            x: SVector::zeros(),
            residuals: SVector::zeros(),
            jacobian: SMatrix::zeros(),
        };
        currents.set_params(&chart::coordinates(start).into());
        currents
    }
}

impl LeastSquaresProblem<f64, U12, U6> for Currents<'_> {
    type ParameterStorage = Owned<f64, U6>;
    type ResidualStorage = Owned<f64, U12>;
    type JacobianStorage = Owned<f64, U12, U6>;

    fn set_params(&mut self, x: &SVector<f64, 6>) {
        self.x = *x;
        let x = (*x).into();
        let pose = chart::pose(&x);
        for (cell, reading) in self.readings.iter().enumerate() {
            let (_, predicted, by_pose) = self.plan.linearise(cell, &pose);
            let [first, second] = reading.residual(&predicted);
            self.residuals[2 * cell] = first;
            self.residuals[2 * cell + 1] = second;
            let [by_first, by_second] = by_pose.map(|row| chart::by_coordinates(&x, &row));
            for axis in 0..6 {
                let [first, second] = reading.whiten([by_first[axis], by_second[axis]]);
                self.jacobian[(2 * cell, axis)] = first;
                self.jacobian[(2 * cell + 1, axis)] = second;
            }
        }
    }

    fn params(&self) -> SVector<f64, 6> {
        self.x
    }

    fn residuals(&self) -> Option<SVector<f64, 12>> {
        Some(self.residuals)
    }

    fn jacobian(&self) -> Option<SMatrix<f64, 12, 6>> {
        Some(self.jacobian)
    }
}

/// The pose of the least χ², as sharp as rounding allows, from a start nearby.
pub fn strict(plan: &CompiledScene<f64>, noise: &[CellNoise; CELLS], pairs: &[Pair<f64>; CELLS], start: &Pose) -> Pose {
    let (found, _) = LevenbergMarquardt::new().minimize(Currents::new(plan, noise, pairs, start));
    chart::pose(&found.x.into())
}

pub struct Crate {
    plan: CompiledScene<f64>,
    noise: [CellNoise; CELLS],
    minimiser: LevenbergMarquardt<f64>,
}

impl Crate {
    /// For the cells of `scene`.
    pub fn new(scene: &Scene) -> Result<Self, SceneError> {
        Ok(Self {
            plan: CompiledScene::compile(scene, Tier::Paper)?,
            noise: CellNoise::of(scene),
            minimiser: LevenbergMarquardt::new()
                // Of χ², which noise leaves at some 6.
                .with_ftol(2e-5)
                // Of the distance from home: a few thousand σ.
                .with_xtol(1e-5)
                // The default, 100 σ from home, would cut the first step of a cold start.
                .with_stepbound(1e6),
        })
    }
}

impl Contender for Crate {
    fn name(&self) -> &'static str {
        "levenberg-marquardt"
    }

    fn solve(&self, problem: &Problem) -> Answer {
        let currents = Currents::new(&self.plan, &self.noise, &problem.pairs, &problem.start);
        let (found, report) = self.minimiser.minimize(currents);
        let x = found.x.into();
        let information: Matrix6<f64> = found.jacobian.tr_mul(&found.jacobian);
        let covariance = information.cholesky().map(|factor| {
            let turned = Matrix3::from_column_slice(&chart::turn_by_coordinates(&x).to_cols_array());
            let mut to_pose = Matrix6::from_diagonal_element(ARM_M);
            to_pose.fixed_view_mut::<3, 3>(3, 3).copy_from(&turned);
            (to_pose * factor.inverse() * to_pose.transpose()).into()
        });
        Answer {
            pose: chart::pose(&x),
            covariance: covariance.unwrap_or([[f64::NAN; 6]; 6]),
            steps: report.number_of_evaluations - 1,
        }
    }
}
