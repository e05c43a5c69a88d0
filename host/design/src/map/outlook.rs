//! What a single frame says about the pose.

use slitpose_calibration::Head;
use slitpose_model::{
    CompiledScene, Estimate, MotionPrior, Outcome, Pair, Photocurrents, Pose, Reading, Response, SceneError, Solution,
    Solver, Start, Status, Tier,
};

use crate::report::frame_scene;

/// Relative error of the integrals: a designer's decision turns on percents, but the derivatives of narrow parts of a spot
/// need more.
const TIER: Tier = Tier::Exact { tolerance: 1e-6 };

/// Where the noise of a frame comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoiseOf {
    /// Section `[front_end]` and the schedule.
    FrontEnd,
    /// Section `[noise]`.
    Channel,
    /// There is none: what is left is the arithmetic.
    Nothing,
}

impl NoiseOf {
    /// What has that noise, at the beginning of a sentence.
    pub(crate) fn reading(self) -> &'static str {
        match self {
            Self::FrontEnd => "A single frame",
            Self::Channel => "A reading of the measuring channel (`[noise]`)",
            Self::Nothing => "A reading without noise",
        }
    }
}

/// What to expect of single frames of a head.
#[derive(Debug)]
pub struct Outlook {
    head: Head,
    solver: Solver<f64>,
    /// Largest current of an electrode.
    full_scale_a: f64,
    /// Where the noise comes from.
    pub noise: NoiseOf,
    /// Frames per second; `None` without front end.
    pub frame_rate_hz: Option<f64>,
}

/// What a single frame says at one pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Cells whose whole spot is on the detector.
    pub lit: usize,
    /// Standard deviations of the pose, metres and radians: the Cramér–Rao bound, with what a calibration left open;
    /// `None` where a frame gives no pose.
    pub sigma: Option<[f64; 6]>,
    /// The covariance that they belong to, of (δt, δθ): m², m·rad, rad².
    pub covariance: Option<[[f64; 6]; 6]>,
    /// See [`slitpose_model::Solution::condition`].
    pub condition: Option<f64>,
    /// See [`slitpose_model::Solution::unnoticed_sigmas`].
    pub unnoticed_sigmas: f64,
    /// Full scale over the greatest current of an electrode; infinite without front end.
    pub full_scale: f64,
    /// Saturation of a detector over its photocurrent, the least of all cells; infinite if none is stated.
    pub saturation: f64,
    /// Photocurrent over what counts as faint, the least of all cells; zero where one is dark.
    pub faint: f64,
}

impl View {
    /// Standard deviation of the position: root of the sum of the three variances, metres.
    pub fn sigma_m(&self) -> Option<f64> {
        self.sigma.map(|[x, y, z, ..]| (x * x + y * y + z * z).sqrt())
    }

    /// The same of the rotation, radians.
    pub fn sigma_rad(&self) -> Option<f64> {
        self.sigma.map(|[.., x, y, z]| (x * x + y * y + z * z).sqrt())
    }
}

impl Outlook {
    /// The head.
    pub fn head(&self) -> &Head {
        &self.head
    }

    /// Of `head`, with the noise of its front end and schedule, else with that of its scene.
    pub fn of(head: Head) -> Result<Self, SceneError> {
        let (scene, frame) = frame_scene(&head.file);
        let noise = match (&frame, &scene.noise) {
            (Some(_), _) => NoiseOf::FrontEnd,
            (None, Some(_)) => NoiseOf::Channel,
            (None, None) => NoiseOf::Nothing,
        };
        Ok(Self {
            solver: Solver::new(&scene, TIER)?,
            full_scale_a: head.file.front_end.map_or(f64::INFINITY, |front_end| front_end.full_scale_a),
            noise,
            frame_rate_hz: frame.map(|frame| frame.period_s.recip()),
            head,
        })
    }

    /// How many cells there are.
    pub fn cells(&self) -> usize {
        self.plan().cell_count()
    }

    pub(crate) fn plan(&self) -> &CompiledScene<f64> {
        self.solver.plan()
    }

    /// With the tool at rest at `pose`.
    pub fn at(&self, pose: &Pose) -> View {
        self.at_without(pose, None)
    }

    /// The same while a cell is `dark`: occluded, or its emitter dead.
    pub fn at_without(&self, pose: &Pose, dark: Option<usize>) -> View {
        let mut view = View {
            lit: 0,
            sigma: None,
            covariance: None,
            condition: None,
            unnoticed_sigmas: f64::INFINITY,
            full_scale: f64::INFINITY,
            saturation: f64::INFINITY,
            faint: f64::INFINITY,
        };
        let (_, solution) = self.measure(pose, dark, |cell, response, full_scale| {
            let detector = &self.head.file.scene.cells[cell].detector;
            view.lit += usize::from(response.status == Status::Lit);
            view.full_scale = view.full_scale.min(full_scale);
            view.saturation = view.saturation.min(detector.saturation_a.unwrap_or(f64::INFINITY) / response.i_o_a);
            view.faint = view.faint.min((response.i_o_a - detector.dark_current_a) / detector.faint_a);
        });
        // Far from the pose that the light came from is another one.
        let estimate = solution.estimate.filter(|estimate| is_at(estimate, pose));
        view.sigma = estimate.map(|estimate| estimate.sigma());
        view.covariance = estimate.map(|estimate| estimate.covariance);
        if view.sigma.is_some() {
            view.condition = solution.condition();
            view.unnoticed_sigmas = solution.unnoticed_sigmas;
        }
        view
    }

    /// A frame without noise, and its solution, with the tool at rest at `pose`. A solution elsewhere, which such a frame
    /// does not tell from this pose, is [`Outcome::Ambiguous`].
    pub fn frame_at(&self, pose: &Pose) -> (Photocurrents, Solution) {
        let (readings, mut solution) = self.measure(pose, None, |_, _, _| ());
        if solution.estimate.is_some_and(|estimate| !is_at(&estimate, pose)) {
            (solution.outcome, solution.estimate) = (Outcome::Ambiguous, None);
        }
        (readings, solution)
    }

    /// Reads all cells but `dark` and solves; `note` gets each response, and full scale over its greater current.
    fn measure(
        &self,
        pose: &Pose,
        dark: Option<usize>,
        mut note: impl FnMut(usize, &Response<f64>, f64),
    ) -> (Photocurrents, Solution) {
        let mut read = |cell: usize| {
            if dark == Some(cell) {
                return Reading::Missing;
            }
            let response = self.plan().respond(cell, pose);
            let above_dark =
                |current_a: f64| current_a - 0.5 * self.head.file.scene.cells[cell].detector.dark_current_a;
            let [i_x1_a, i_x2_a] = [response.currents.i_x1_a, response.currents.i_x2_a].map(above_dark);
            let full_scale = self.full_scale_a / i_x1_a.max(i_x2_a);
            note(cell, &response, full_scale);
            if full_scale < 1.0 { Reading::Saturated } else { Reading::Light(Pair { i_x1_a, i_x2_a }) }
        };
        let readings = Photocurrents { cells: (0..self.cells()).map(&mut read).collect() };
        let mut solution = self.solver.solve(&readings, Start::Near(pose), &MotionPrior::AT_REST);
        self.head.complete(&mut solution);
        (readings, solution)
    }
}

/// Whether an estimate without noise is that of `pose`, not of a pose with the same light.
fn is_at(estimate: &Estimate, pose: &Pose) -> bool {
    estimate.nees(pose).is_some_and(|nees| nees < 1.0)
}
