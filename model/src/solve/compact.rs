//! A solver small enough for a microcontroller, made where there is room.

use heapless::Vec;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::entries::Scalar;
use crate::plan::{BOARD_CELLS, CompactCell, CompactPlan, CompiledScene, Tier};
use crate::pose::{Rigid, Transform};
use crate::scalar::Number;
use crate::scene::{MAX_CELLS, Scene, SceneError};

use super::compiled::Compiled;
use super::home::{home, spread};
use super::outcome::Solution;
use super::planes::PlaneCell;
use super::readings::{Limits, Photocurrents};
use super::solver::Solver;
use super::tracker::{Budget, PoseTracker};
use super::weights::CellNoise;

/// Relative error of the currents that is always counted with: a fiftieth of what noise does to them in a frame at 4 kHz.
const TOLERANCE: f64 = 2e-5;

/// The largest relative error with which a head is accepted. Thin masks whose slits are turned by a degree, as a
/// calibration may find them, exceed [`TOLERANCE`] by a little; the error then counts as noise.
const MAX_ERROR: f64 = 5e-5;

/// Of the currents that it is measured by.
const TRUE_TOLERANCE: f64 = 1e-9;

/// Poses of the reach at which it is measured, and home.
const LOOKS: usize = 64;

/// Why a head cannot be held by a microcontroller.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum CompactError {
    /// It cannot be held by anything.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// It has too many cells.
    #[error("{cells} cells, and the board has {most}: leave cells out")]
    Cells {
        /// Of the scene.
        cells: usize,
        /// That fit.
        most: usize,
    },
    /// A cell is of a kind that has no place there.
    #[error("cell {cell} has what the board does not compute, {what}: and the host does")]
    Kind {
        /// Number of the cell.
        cell: usize,
        /// What it has.
        what: &'static str,
    },
    /// The light on a spot is too uneven for the rule.
    #[error(
        "the spots are too wide or too near, or slits turned too far, for the board: its sums would err by {error:.1e} of the light"
    )]
    Spots {
        /// Relative error of a current.
        error: f64,
    },
}

/// A compact solver but for its cells, to be stored or sent.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct CompactFrame<S: Number> {
    gates: [S; MAX_CELLS + 1],
    has_offsets: bool,
    length_scale_m: S,
    /// Translation, and rotation as a quaternion x, y, z, w.
    home: ([S; 3], [S; 4]),
    jacobian_change_rate: S,
    has_images: bool,
}

/// One cell of a compact solver.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(bound = "")]
pub struct CompactPart<S: Number> {
    optics: CompactCell<S>,
    plane: PlaneCell<S>,
    noise: CellNoise<S>,
    limits: Limits<S>,
    offset_s: S,
}

impl<S: Scalar> Solver<S, CompactPlan<S>> {
    /// A solver for `scene` in the exact tier, with one short rule for the light of all spots, whose currents are right to
    /// 5·10⁻⁵ at poses spread over 4 mm and 17° about home; σ includes that error. For cells exposed at the reference instant.
    ///
    /// # Errors
    /// If the scene is impossible, has more than [`BOARD_CELLS`] cells, or a cell that is not a slit in a thin mask, parallel to
    /// its detector, before an emitter of the profile cosⁿγ.
    pub fn compact(scene: &Scene) -> Result<Self, CompactError> {
        if scene.cells.len() > BOARD_CELLS {
            return Err(CompactError::Cells { cells: scene.cells.len(), most: BOARD_CELLS });
        }
        let other_kind = |(cell, what)| CompactError::Kind { cell, what };
        let truth = CompiledScene::<f64>::compile(scene, Tier::Exact { tolerance: TRUE_TOLERANCE })?;
        let plan = CompactPlan::of(scene, &truth, &truth).map_err(other_kind)?;
        let error = worst_error(scene, &plan, &truth);
        if error > MAX_ERROR {
            return Err(CompactError::Spots { error });
        }
        let tier = Tier::Exact { tolerance: error.max(TOLERANCE) };
        let Compiled { plan, has_images, .. } = Solver::<S>::new(scene, tier)?.compiled;
        let plan = CompactPlan::of(scene, &plan, &truth).map_err(other_kind)?;
        let mut compiled = Compiled { has_images, ..Compiled::of(scene, tier, plan) };
        compiled.take_light_level_for_known();
        Ok(Self { compiled, max_steps: None })
    }

    /// Without cells: it finds no pose.
    #[inline(always)]
    #[must_use]
    pub fn without_cells() -> Self {
        let plan = CompactPlan { cells: Vec::new() };
        Self { compiled: Compiled::without_cells(plan), max_steps: None }
    }

    /// What the solver holds besides its cells.
    pub fn frame(&self) -> CompactFrame<S> {
        let Compiled { gates, offsets_s, length_scale_m, home, jacobian_change_rate, has_images, .. } = &self.compiled;
        CompactFrame {
            gates: *gates,
            has_offsets: !offsets_s.is_empty(),
            length_scale_m: *length_scale_m,
            home: home.numbers(),
            jacobian_change_rate: *jacobian_change_rate,
            has_images: *has_images,
        }
    }

    /// What it holds of each cell, in order.
    pub fn parts(&self) -> impl Iterator<Item = CompactPart<S>> + '_ {
        let Compiled { plan, planes, noise, limits, offsets_s, .. } = &self.compiled;
        (0..plan.cells.len()).map(move |cell| CompactPart {
            optics: plan.cells[cell].clone(),
            plane: planes[cell],
            noise: noise[cell],
            limits: limits[cell],
            offset_s: offsets_s.get(cell).copied().unwrap_or_default(),
        })
    }

    /// Begins anew, in place, with the `frame` of another solver: cells follow by [`Self::push`].
    pub fn begin(&mut self, frame: &CompactFrame<S>) {
        let compiled = &mut self.compiled;
        compiled.plan.cells.clear();
        compiled.planes.clear();
        compiled.noise.clear();
        compiled.limits.clear();
        compiled.offsets_s.clear();
        compiled.gates = frame.gates;
        compiled.length_scale_m = frame.length_scale_m;
        compiled.home = Rigid::of_numbers(frame.home);
        compiled.jacobian_change_rate = frame.jacobian_change_rate;
        compiled.has_images = frame.has_images;
    }

    /// Appends a cell of another solver with the same `frame`; `false`, and nothing changed, if there is no room.
    #[must_use]
    pub fn push(&mut self, frame: &CompactFrame<S>, part: &CompactPart<S>) -> bool {
        let compiled = &mut self.compiled;
        if compiled.plan.cells.push(part.optics.clone()).is_err() {
            return false;
        }
        // These have room for as many cells as any scene has.
        let _ = compiled.planes.push(part.plane);
        let _ = compiled.noise.push(part.noise);
        let _ = compiled.limits.push(part.limits);
        if frame.has_offsets {
            let _ = compiled.offsets_s.push(part.offset_s);
        }
        true
    }
}

/// The tracker of a board.
pub type BoardTracker = PoseTracker<f32, CompactPlan<f32>>;

/// See [`PoseTracker::neglecting_motion`]: too small by 2 % at most.
const NEGLIGIBLE_MOTION: f64 = 0.15;

/// At some 0.1 ms each, while the tool is looked for: a frame then takes no more than two milliseconds, and the
/// motion is not forgotten over the frames that are passed over meanwhile.
const BUDGET: Budget = Budget { frame: 12, saved_a_frame: 0, most_saved: 0, first: 0 };

impl BoardTracker {
    /// Without cells and frames: see [`PoseTracker::solver_mut`] and [`PoseTracker::restart`].
    #[inline(always)]
    pub fn without_cells() -> Self {
        Self::new(Solver::without_cells(), 1.0).neglecting_motion(NEGLIGIBLE_MOTION).with_budget(BUDGET)
    }

    /// The solution of frame `frame`, made here: generic code is compiled by its caller's profile, which is for size
    /// on a board.
    #[inline(never)]
    pub fn track_on_board(&mut self, frame: u64, readings: &Photocurrents<f32>) -> Solution<f32> {
        self.track_here(frame, readings)
    }
}

/// The greatest relative error of a current of `plan`, over the reach of the head.
fn worst_error(scene: &Scene, plan: &CompactPlan<f64>, truth: &CompiledScene<f64>) -> f64 {
    let home: Transform<f64> = Transform::of(&home(scene));
    let poses = core::iter::once(home).chain((0..LOOKS).map(|index| spread(&home, index)));
    poses.fold(0.0, |worst: f64, pose| {
        let pose = pose.to_pose();
        let found = plan.currents_at(&pose);
        found.iter().enumerate().fold(worst, |worst, (cell, found)| {
            let expected = truth.photocurrents(cell, &pose);
            let total = expected.i_x1_a + expected.i_x2_a;
            let off = (found[0] - expected.i_x1_a).abs().max((found[1] - expected.i_x2_a).abs());
            // No light at all is no light on both sides.
            if off == 0.0 { worst } else { worst.max(off / total) }
        })
    })
}

#[cfg(test)]
mod tests {
    extern crate std;

    use glam::DVec3;

    use super::super::fixture::{EFFECTS, head};
    use super::*;
    use crate::effects::Opening;
    use crate::plan::{Instant, Optics};
    use crate::pose::Pose;
    use crate::scene::{Cell, Profile};

    /// By the squares of the angles that the spots subtend, 1 mm and more from 10 to 18 mm: up to 1e-2.
    const SHORT_RULE: f64 = 1e-2;

    #[test]
    fn derivatives_by_the_middle_of_a_spot_are_nearly_those_of_the_whole() {
        let plan = plan_of(&head());
        check_derivatives(&CompactPlan::of(&head(), &plan, &plan).expect("slits and cosines"), &plan, "ideal");
    }

    fn check_derivatives(compact: &CompactPlan<f64>, plan: &CompiledScene<f64>, name: &str) {
        for index in 0..40 {
            let pose = spread(&Transform::<f64>::of(&Pose::HOME), index).to_pose();
            let here = Transform::of(&pose);
            let instant = Instant { pose: &here, twist: [DVec3::ZERO; 2], bend: None, offsets_s: &[] };
            compact.linearise_all(
                &instant,
                |_| true,
                |cell, terms| {
                    let (status, pair, exact) = plan.linearise(cell, &pose);
                    assert_eq!(terms.status, status);
                    let sum = pair.i_x1_a + pair.i_x2_a;
                    if sum == 0.0 {
                        return;
                    }
                    let share = (pair.i_x2_a - pair.i_x1_a) / sum;
                    // ln of the sum, and the share, by translations in units of the emitters' distance and by turns.
                    let unit = |axis: usize| if axis < 3 { 8e-3 } else { 1.0 };
                    let of = |rows: &[[f64; 6]; 2]| {
                        let total = [0, 1, 2, 3, 4, 5].map(|i| (rows[0][i] + rows[1][i]) / sum * unit(i));
                        let place =
                            [0, 1, 2, 3, 4, 5].map(|i| (rows[1][i] - rows[0][i]) / sum * unit(i) - share * total[i]);
                        [total, place]
                    };
                    for (found, expected) in of(&terms.jacobian).iter().zip(&of(&exact)) {
                        let most = expected.iter().fold(0.0_f64, |most, slope| most.max(slope.abs()));
                        let off = found.iter().zip(expected).fold(0.0_f64, |most, (a, b)| most.max((a - b).abs()));
                        assert!(off <= SHORT_RULE * most, "{name}, pose {index}, cell {cell}: {off} of {most}");
                    }
                },
            );
        }
    }

    /// Of spots of 1 to 2 mm from 10 to 18 mm the fourth order is up to 7·10⁻⁵ of the light.
    #[test]
    fn the_light_of_wide_spots_is_right_to_a_hundred_thousandth() {
        let mut scene = head();
        for cell in &mut scene.cells {
            cell.slit.width_m = 1e-3;
        }
        let plan = plan_of(&scene);
        let error = worst_error(&scene, &CompactPlan::of(&scene, &plan, &plan).expect("slits and cosines"), &plan);
        assert!(error < 1e-5, "{error:e}");
    }

    /// A head whose currents err a little more than usual is accepted, and its σ includes the error.
    #[test]
    fn a_rule_that_errs_a_little_more_counts_with_the_noise() {
        let turned = |degrees: f64| {
            let mut scene = head();
            for cell in &mut scene.cells {
                cell.slit.tilt_rad = DVec3::new(1.0, 0.5, 1.0) * degrees.to_radians();
            }
            let plan = plan_of(&scene);
            let error = worst_error(&scene, &CompactPlan::of(&scene, &plan, &plan).expect("slits and cosines"), &plan);
            (scene, error)
        };
        let (scene, error) = (0..100)
            .map(|tenth| turned(0.1 * f64::from(tenth)))
            .find(|(_, error)| *error > 1.2 * TOLERANCE)
            .expect("turned far enough");
        assert!(error < MAX_ERROR, "{error:e}");
        let solver = Solver::<f64, CompactPlan<f64>>::compact(&scene).expect("accepted");
        let with = |tolerance| Solver::<f64>::new(&scene, Tier::Exact { tolerance }).expect("valid");
        let weighted = |of: &CellNoise<f64>| of.whitener([1e-6; 2]).apply([1e-6, 0.0])[0];
        let [own, as_told, as_ever] =
            [&solver.compiled.noise, &with(error).compiled.noise, &with(TOLERANCE).compiled.noise]
                .map(|of| weighted(&of[0]));
        assert_eq!(own, as_told);
        assert!(own < as_ever, "{own} {as_ever}");
    }

    /// What is sent of a solver makes the same solver.
    #[test]
    fn a_solver_is_the_sum_of_its_parts() {
        let solver = Solver::<f32, CompactPlan<f32>>::compact(&head()).expect("fits").with_exposures(&[1e-6; 6]);
        let mut copy = Solver::<f32, CompactPlan<f32>>::without_cells();
        let frame = solver.frame();
        copy.begin(&frame);
        for part in solver.parts() {
            assert!(copy.push(&frame, &part));
        }
        assert!(!copy.push(&frame, &solver.parts().next().expect("six")), "there is room for six");
        let plan = CompiledScene::<f64>::compile(&head(), Tier::Exact { tolerance: 1e-9 }).expect("valid");
        let readings = super::super::fixture::currents(&plan, &super::super::fixture::pose()).rounded();
        let solved = [&solver, &copy].map(|solver| {
            let solution = solver.solve(&readings, crate::Start::Cold, &crate::MotionPrior::AT_REST);
            (solution.estimate.expect("a pose").covariance, solution.pose_numbers(), solution.chi2)
        });
        assert_eq!(solved[0], solved[1]);
    }

    /// Each alone, and all at once: currents to the bound that a head is accepted by, derivatives to a hundredth.
    #[test]
    fn what_calibration_finds_is_computed_with_its_derivatives() {
        let each = EFFECTS.iter().map(|effect| (effect.0, core::slice::from_ref(effect)));
        for (name, effects) in each.chain([("all of it", &EFFECTS[..])]) {
            let mut scene = head();
            for cell in &mut scene.cells {
                effects.iter().for_each(|(_, effect)| effect(cell, 1.0));
            }
            let plan = plan_of(&scene);
            let compact = CompactPlan::of(&scene, &plan, &plan).expect(name);
            let error = worst_error(&scene, &compact, &plan);
            assert!(error < TOLERANCE, "{name}: {error:e}");
            // Without the change they differ.
            let ideal = CompactPlan::of(&head(), &plan_of(&head()), &plan_of(&head())).expect("ideal");
            assert!(worst_error(&scene, &ideal, &plan) > 5.0 * TOLERANCE, "{name} changes nothing");
            check_derivatives(&compact, &plan, name);
        }
    }

    fn plan_of(scene: &Scene) -> CompiledScene<f64> {
        CompiledScene::compile(scene, Tier::Exact { tolerance: 1e-9 }).expect("valid")
    }

    #[test]
    fn what_a_board_cannot_hold_is_named() {
        let compact = |change: &dyn Fn(&mut Scene)| {
            let mut scene = head();
            change(&mut scene);
            Solver::<f32, CompactPlan<f32>>::compact(&scene).map(|_| ()).expect_err("refused")
        };
        let seven = compact(&|scene| scene.cells.push(scene.cells[0].clone()).expect("seven of sixteen"));
        assert_eq!(seven, CompactError::Cells { cells: 7, most: 6 });
        type Kind = (&'static str, fn(&mut Cell));
        let kinds: [Kind; 6] = [
            ("a slit that is turned far against its detector", |cell| cell.slit.tilt_rad = DVec3::Z * 0.2),
            ("another opening than a slit", |cell| cell.effects.opening = Opening::Pinhole),
            ("an emitter that is no point", |cell| cell.effects.source_diameter_m = 3e-4),
            ("emitters that are lit together", |cell| cell.effects.lit_together = 1),
            ("a detector of two axes", |cell| cell.effects.other_axis = Some(3)),
            ("an emitter whose profile is no smooth curve", |cell| {
                cell.emitter.profile = Profile::Cosine { exponent: 300.0 };
                cell.slit.thickness_m = 1e-4;
            }),
        ];
        for (number, (what, change)) in kinds.into_iter().enumerate() {
            let refused = compact(&|scene| change(&mut scene.cells[number]));
            assert_eq!(refused, CompactError::Kind { cell: number, what });
        }
        let wide = compact(&|scene| scene.cells[1].detector.width_m = 8e-3);
        assert!(matches!(wide, CompactError::Spots { error } if error > MAX_ERROR), "{wide}");
        let empty = compact(&|scene| scene.cells.clear());
        assert!(matches!(empty, CompactError::Scene(_)), "{empty}");
    }
}
