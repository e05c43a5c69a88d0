//! The experiments of De La Cruz, Gosselin, Bachta, Morel 2018 (section V), calculated.
//!
//! Experiment 1 moves the emitter along the detector, experiment 2 turns it about the vertical
//! axis. The paper publishes its measurements as figures, without numbers; nothing here is
//! measured, and where a current stands in for a measured one it is called simulated.

mod figures;

use glam::DVec3;
use slitpose_model::{CompiledScene, Pose, Profile, Response, SceneError, Tier};

use slitpose_head::scene_file::SceneFile;

use crate::identification::{Identified, identify};
use crate::report::{Table, Value};

pub use figures::paper_report;

/// Relative error of the exact tier's integrals: far below anything a figure shows.
const TOLERANCE: f64 = 1e-10;

/// One of the paper's two experiments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Experiment {
    /// Experiment 1: the emitter moves along x_PSD from −5.5 to 5.5 mm in steps of 0.5 mm.
    Translation,
    /// Experiment 2: the emitter turns from −65° to 65° in steps of 5°, clockwise from above.
    Rotation,
}

impl Experiment {
    /// Positions in millimetres, or angles in degrees.
    fn amounts(self) -> impl Iterator<Item = f64> {
        let (steps, step) = match self {
            Self::Translation => (11, 0.5),
            Self::Rotation => (13, 5.0),
        };
        (-steps..=steps).map(move |index| f64::from(index) * step)
    }

    /// The tool's pose in the `bench` scene: its x is that of the detector, its y is vertical, and
    /// the tool frame sits on the emitter.
    fn pose(self, amount: f64) -> Pose {
        match self {
            Self::Translation => Pose::from_vectors(DVec3::X * amount * 1e-3, DVec3::ZERO),
            Self::Rotation => Pose::from_vectors(DVec3::ZERO, -DVec3::Y * amount.to_radians()),
        }
    }
}

/// One position or angle of an experiment, in both tiers.
#[derive(Clone, Copy, Debug)]
struct Point {
    /// Position in millimetres, or angle in degrees.
    amount: f64,
    paper: Response<f64>,
    exact: Response<f64>,
    /// Of experiment 2, the profile by equation (6) from the exact tier's currents: the paper's procedure, on simulated
    /// instead of measured currents.
    identified: Option<Identified>,
    /// Of experiment 1, what is calculated as printed, with that profile instead of the emitter's.
    refit: Option<Response<f64>>,
}

/// Both experiments, and what follows from the second for the first.
#[derive(Clone, Debug)]
pub struct Study {
    translation: Vec<Point>,
    rotation: Vec<Point>,
}

impl Study {
    /// Calculates everything for the first cell of the `bench` scene.
    pub fn of(bench: &SceneFile) -> Result<Self, SceneError> {
        let scene = &bench.scene;
        let paper = CompiledScene::<f64>::compile(scene, Tier::Paper)?;
        let exact = CompiledScene::<f64>::compile(scene, Tier::Exact { tolerance: TOLERANCE })?;
        let run = |experiment: Experiment| -> Vec<Point> {
            let point = |amount| {
                let pose = experiment.pose(amount);
                let [paper, exact] = [&paper, &exact].map(|plan| plan.respond(0, &pose));
                Point { amount, paper, exact, identified: None, refit: None }
            };
            experiment.amounts().map(point).collect()
        };
        let (mut translation, mut rotation) = (run(Experiment::Translation), run(Experiment::Rotation));
        for point in &mut rotation {
            let pose = Experiment::Rotation.pose(point.amount);
            point.identified = identify(&scene.cells[0], &paper, 0, &pose, point.exact.i_o_a);
        }
        let identified: Vec<_> = rotation.iter().filter_map(|point| point.identified).collect();
        let mut refit = scene.clone();
        refit.cells[0].emitter.profile = Profile::Table(mean_of_both_sides(&identified));
        let refit = CompiledScene::<f64>::compile(&refit, Tier::Paper)?;
        for point in &mut translation {
            point.refit = Some(refit.respond(0, &Experiment::Translation.pose(point.amount)));
        }
        Ok(Self { translation, rotation })
    }
}

/// All points of both experiments, in both tiers; the profile stands with experiment 2, its currents with experiment 1.
pub fn experiments(study: &Study) -> Table {
    let translation = study.translation.iter().map(|point| (1, point));
    let rows: Vec<(usize, &Point)> = translation.chain(study.rotation.iter().map(|point| (2, point))).collect();
    let amount = |row: &(usize, &Point), of: usize| Value::from(if row.0 == of { row.1.amount } else { 0.0 });
    let mm = |value: Option<f64>| Value::optional(value.map(|value_m| value_m * 1e3));
    Table::of(
        "experiments",
        "Both experiments, calculated",
        &rows,
        &[
            ("experiment", "experiment", &|row| row.0.into()),
            ("position_mm", "position / mm", &|row| amount(row, 1)),
            ("angle_deg", "angle / °", &|row| amount(row, 2)),
            ("status", "status", &|row| row.1.paper.status.as_str().into()),
            ("gamma_deg", "γ / °", &|row| Value::optional(row.1.paper.gamma_rad.map(f64::to_degrees))),
            ("paper_x_a_mm", "X_A / mm", &|row| mm(row.1.paper.x_a_m)),
            ("exact_x_a_mm", "exact", &|row| mm(row.1.exact.x_a_m)),
            ("paper_solid_angle_sr", "Ω / sr", &|row| row.1.paper.solid_angle_sr.into()),
            ("exact_solid_angle_sr", "exact", &|row| row.1.exact.solid_angle_sr.into()),
            ("paper_i_o_a", "I_O / A", &|row| row.1.paper.i_o_a.into()),
            ("exact_i_o_a", "exact", &|row| row.1.exact.i_o_a.into()),
            ("identified_relative_intensity", "I_rel", &|row| {
                Value::optional(row.1.identified.map(|it| it.relative_intensity))
            }),
            ("identified_i_o_a", "I_O / A", &|row| Value::optional(row.1.refit.map(|refit| refit.i_o_a))),
        ],
    )
}

/// Angles left and right of the axis give the same γ twice: their mean, from the axis outward.
fn mean_of_both_sides<const N: usize>(identified: &[Identified]) -> heapless::Vec<(f64, f64), N> {
    let axis = identified.len() / 2;
    let (left, right) = (identified[..=axis].iter().rev(), &identified[axis..]);
    let mean = |(a, b): (&Identified, &Identified)| {
        (0.5 * (a.gamma_rad + b.gamma_rad), 0.5 * (a.relative_intensity + b.relative_intensity))
    };
    left.zip(right).map(mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use slitpose_head::scene_file::BENCH;

    #[test]
    fn the_experiments_are_those_of_the_paper() {
        let study = Study::of(&BENCH.read().unwrap()).unwrap();
        assert_eq!((study.translation.len(), study.rotation.len()), (23, 27));
        for point in &study.translation {
            // d_A = 2·d_B mirrors the emitter's position onto the detector.
            let x_a_mm = point.paper.x_a_m.unwrap() * 1e3;
            assert!((x_a_mm + point.amount).abs() < 1e-12, "{}: {x_a_mm}", point.amount);
        }
        // Ω·I_e·S at the centre, with Ω of a plate of 0.8 mm × 1 mm seen from 15 mm (equation 3).
        let centre = study.translation[11].paper.i_o_a;
        assert!((centre - 6.061_678_056_413e-6).abs() < 1e-17, "{centre}");
        for point in &study.rotation {
            assert!((point.paper.gamma_rad.unwrap().to_degrees() - point.amount.abs()).abs() < 1e-9);
        }
    }

    #[test]
    fn the_identified_profile_is_that_of_the_emitter() {
        let study = Study::of(&BENCH.read().unwrap()).unwrap();
        let exponent = -std::f64::consts::LN_2 / 55f64.to_radians().cos().ln();
        for point in study.rotation.iter().filter_map(|point| point.identified) {
            let cosine = point.gamma_rad.cos().powf(exponent);
            // One γ for the whole beam leaves less than a thousandth (equation 5's assumption).
            let error = (point.relative_intensity - cosine).abs();
            assert!(error < 1e-3 && error > 1e-6, "γ = {}: {error}", point.gamma_rad.to_degrees());
        }
        for point in &study.translation {
            assert!((point.refit.unwrap().i_o_a / point.exact.i_o_a - 1.0).abs() < 2e-3, "{}", point.amount);
        }
    }
}
