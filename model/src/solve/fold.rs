//! Where three cells leave two poses.
//!
//! Six currents for six unknowns fold the space of poses: on both sides of a fold lie poses with the
//! same currents, which move towards each other and vanish where a tool meets it. Near a fold the
//! currents hardly change along one direction v, and bend: a step of s along it changes the whitened
//! currents by j·s + ½c·s², so that the twin of a pose lies at s = −2j/c.

use crate::plan::Optics;
use crate::pose::{Pose, Transform};
use crate::scalar::Number;

use super::accept::{DISTINCT_SIGMAS, Fit};
use super::algebra::square;
use super::compiled::{Compiled, Prior};
use super::levenberg_marquardt::{Minimum, Stopping};
use super::normal_equations::Workspace;
use super::observability;
use super::outcome::Solution;
use super::readings::Sorted;

/// How far the currents are probed along the direction they hold least, in σ of the pose there.
const PROBE_SIGMAS: f64 = 2.0;

/// The furthest that is, in radians or its equivalent in translation: of a fold σ is as large as you like, and
/// beyond some hundredths the currents bend by more than a square.
const LONGEST_PROBE: f64 = 0.01;

/// A twin further than this, in σ of the pose along that direction, is told apart by any motion.
const FAR_SIGMAS: f64 = 60.0;

/// Steps of an inverse iteration: each leaves less of the other directions by the square of a ratio
/// of condition numbers, which is large near a fold.
const INVERSE_STEPS: usize = 3;

impl<S: Number, P: Optics<S>> Compiled<S, P> {
    /// Whether a solution without redundancy has a near twin of which `is_expected` holds, too.
    pub(super) fn has_twin(
        &self,
        sorted: &Sorted<S>,
        motion: &Prior<S>,
        solution: &Solution<S>,
        is_expected: impl Fn(&Pose) -> bool,
        workspace: &mut Workspace<S>,
    ) -> bool {
        solution.redundancy == 0
            && self.twin(sorted, motion, solution, workspace).is_some_and(|twin| is_expected(&twin.to_pose()))
    }

    /// The twin of a solution without redundancy, if it is near and explains the currents as well. So
    /// near that the currents do not tell the two apart, it is where it is expected.
    fn twin(
        &self,
        sorted: &Sorted<S>,
        motion: &Prior<S>,
        solution: &Solution<S>,
        workspace: &mut Workspace<S>,
    ) -> Option<Transform<S>> {
        let pose = Transform::of(&solution.estimate?.pose);
        let factor = solution.factor.as_ref()?;
        let mut loose = [S::one(); 6];
        for _ in 0..INVERSE_STEPS {
            let next = factor.backward(&factor.forward(&loose));
            let scale = square(&next).root().recip();
            loose = next.map(|value| value * scale);
        }
        let sigma = factor.length(&loose).recip();
        let problem = self.problem(sorted, motion);
        let whiteners = problem.whiteners();
        let here = problem.whitened(&pose, &whiteners, workspace);
        let along = |share: S| loose.map(|value| value * (share * sigma));
        let probe = S::of(PROBE_SIGMAS).min(S::of(LONGEST_PROBE) / sigma);
        let [there, back] =
            [probe, -probe].map(|share| problem.whitened(&problem.moved(&pose, &along(share)), &whiteners, workspace));
        // (j·probe)² and j·c·probe³, both by what one σ along v does.
        let (mut slope, mut bend) = (S::zero(), S::zero());
        for ((here, there), back) in here.iter().zip(&there).zip(&back) {
            for k in 0..2 {
                let first = S::half() * (there[k] - back[k]);
                slope += first * first;
                bend += first * (there[k] + back[k] - S::two() * here[k]);
            }
        }
        let distance = -S::two() * probe * slope / bend;
        // Written so that NaN is far.
        let is_near = distance.abs() <= S::of(FAR_SIGMAS);
        if !is_near {
            return None;
        }
        let twin = problem.moved(&pose, &along(distance));
        if distance.abs() <= S::of(DISTINCT_SIGMAS) {
            return Some(twin);
        }
        let twin = problem.minimise(twin, &whiteners, Stopping::near(), workspace);
        let own = Minimum { pose, chi2: solution.chi2, factor: solution.factor, iterations: 0, converged: true };
        let [own, its] = [&own, &twin].map(|minimum| self.fit(sorted, &problem, minimum));
        let is_another =
            observability::sigmas_between(factor, &pose, &twin.pose, self.length_scale_m) > S::of(DISTINCT_SIGMAS);
        (is_another && its != Fit::None && its >= own).then_some(twin.pose)
    }
}
