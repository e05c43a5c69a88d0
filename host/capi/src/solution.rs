//! What C reads: results, and the pose of one frame.

#![forbid(unsafe_code)]

use slitpose_model::{DegradedReason, NoTwist, Outcome, Solution, TwistEstimate};
use slitpose_tracking::columns::no_twist;
use slitpose_tracking::pipeline::Outcomes;

/// Whether a function has done what it was called for.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorCode {
    /// Done. Whether there is a pose is in the solution.
    Ok = 0,
    /// A pointer that must not be NULL is.
    Null = 1,
    /// Another count of numbers than the scene's cells need.
    Count = 2,
    /// A number that is not finite.
    NotFinite = 3,
    /// A rate, exposure or acceleration that is out of range.
    Range = 4,
    /// Frames cannot be tracked before slitpose_solver_start().
    NotStarted = 5,
    /// The instant is not later than that of the frame before.
    Time = 6,
    /// There is no pose or no velocity to predict with.
    NoTwist = 7,
    /// A defect of this library: close the solver, and report it.
    Defect = 8,
}

/// Values of `status`, as in slitpose_pose.h. The first two have a pose.
#[repr(C)]
pub enum StatusCode {
    /// A pose from all cells, and the currents fit it.
    Converged = 0,
    /// A pose that deserves less trust: see `reason`.
    Degraded = 1,
    /// Several distinct poses explain the currents.
    Ambiguous = 2,
    /// The currents leave directions free.
    Unobservable = 3,
    /// Too few cells see enough light.
    TooDark = 4,
    /// No pose near the currents was found.
    Diverged = 5,
}

/// Values of `reason`: why a pose is degraded.
#[repr(C)]
pub enum ReasonCode {
    /// It is not.
    None = 0,
    /// Some cells are saturated or faint; the others decide.
    FewerCells = 1,
    /// A cell contradicted all others and was left out.
    CellExcluded = 2,
    /// The residuals are larger than the noise explains.
    Misfit = 3,
    /// The solver had to stop before the minimum.
    Unfinished = 4,
    /// The head is known by the tolerances of its parts alone: calibrate it.
    Uncalibrated = 5,
    /// Frames shortly before contradicted the scene.
    Doubted = 6,
}

/// Values of `no_twist`, as in slitpose_pose.h.
#[repr(C)]
pub enum NoTwistCode {
    /// There is a velocity, or no pose.
    Known = 0,
    /// Too few poses yet.
    Start = 1,
    /// The tool is not where its motion led: it has hit something, or the pose is wrong.
    Jump = 2,
}

/// The pose of one frame. What is not known is NaN. Fields have names, units and numbers of those in slitpose_pose.h.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseSolution {
    /// The instant the pose refers to, as the caller gave it; 0 of slitpose_solver_solve().
    pub time_ns: u64,
    /// See slitpose_solution_status.
    pub status: u16,
    /// See slitpose_solution_reason.
    pub reason: u16,
    /// 1: translation, rotation and covariance are numbers; else 0.
    pub has_pose: u16,
    /// 1: so are the velocities; else 0.
    pub has_twist: u16,
    /// How many cells were used.
    pub cells_used: u16,
    /// Bit k: cell k contradicts all others and was left out.
    pub excluded_cells: u16,
    /// Data minus unknowns: what chi2 is distributed over.
    pub redundancy: u16,
    /// Why a pose has no velocity: see slitpose_solution_no_twist.
    pub no_twist: u16,
    /// Of base_from_tool.
    pub translation_m: [f64; 3],
    /// Unit quaternion.
    pub rotation_xyzw: [f64; 4],
    /// Of (t, theta), row-major: m^2, m rad, rad^2; t' = t + dt, R' = exp(dtheta) R.
    pub covariance: [f64; 36],
    /// Velocity in the base frame.
    pub linear_m_per_s: [f64; 3],
    /// Angular velocity in the base frame.
    pub angular_rad_per_s: [f64; 3],
    /// Standard deviations of the six.
    pub twist_sigma: [f64; 6],
    /// Brightness of all light, relative to scene or calibration.
    pub light_level: f64,
    /// Sum of the squared whitened residuals.
    pub chi2: f64,
}

impl PoseSolution {
    pub(crate) fn new(
        time_ns: u64,
        solution: &Solution,
        twist: &Result<TwistEstimate, NoTwist>,
        light_level: Option<f64>,
    ) -> Self {
        let (estimate, moving) = (solution.estimate.as_ref(), twist.as_ref().ok());
        let mut covariance = [f64::NAN; 36];
        if let Some(estimate) = estimate {
            covariance.copy_from_slice(estimate.covariance.as_flattened());
        }
        Self {
            time_ns,
            status: Outcomes::number_of(&solution.outcome),
            reason: reason(&solution.outcome) as u16,
            has_pose: estimate.is_some().into(),
            has_twist: moving.is_some().into(),
            cells_used: solution.cells_used.count() as u16,
            excluded_cells: solution.excluded.bits(),
            redundancy: solution.redundancy as u16,
            no_twist: no_twist(twist) as u16,
            translation_m: estimate.map_or([f64::NAN; 3], |estimate| estimate.pose.translation_m.to_array()),
            rotation_xyzw: estimate.map_or([f64::NAN; 4], |estimate| estimate.pose.rotation.to_array()),
            covariance,
            linear_m_per_s: moving.map_or([f64::NAN; 3], |moving| moving.twist.linear_m_per_s.to_array()),
            angular_rad_per_s: moving.map_or([f64::NAN; 3], |moving| moving.twist.angular_rad_per_s.to_array()),
            twist_sigma: moving.map_or([f64::NAN; 6], |moving| std::array::from_fn(|i| moving.covariance[i][i].sqrt())),
            light_level: light_level.unwrap_or(f64::NAN),
            chi2: solution.chi2,
        }
    }

    /// Moves the pose on as `slitpose_predict` of slitpose_pose.h does. `false`: it has no pose or no velocity.
    pub(crate) fn predict(&mut self, later_ns: u64, rms: [f64; 2]) -> bool {
        if self.has_pose == 0 || self.has_twist == 0 {
            return false;
        }
        let (t, w, p) = (later_ns as f64 * 1e-9, self.angular_rad_per_s, self.rotation_xyzw);
        let half = (w[0] * w[0] + w[1] * w[1] + w[2] * w[2]).sqrt() * t / 2.0;
        let factor = if half > 0.0 { half.sin() / half * t / 2.0 } else { 0.0 };
        let scalar = half.cos();
        for i in 0..3 {
            let (j, k) = ((i + 1) % 3, (i + 2) % 3);
            self.translation_m[i] += self.linear_m_per_s[i] * t;
            self.rotation_xyzw[i] = scalar * p[i] + factor * (w[i] * p[3] + w[j] * p[k] - w[k] * p[j]);
        }
        self.rotation_xyzw[3] = scalar * p[3] - factor * (w[0] * p[0] + w[1] * p[1] + w[2] * p[2]);
        for i in 0..6 {
            // Errors of a pose and of its velocity may go together.
            let sigma = self.covariance[7 * i].sqrt() + self.twist_sigma[i] * t;
            let bend = rms[i / 3] * t * t / 2.0;
            self.covariance[7 * i] = sigma * sigma + bend * bend;
        }
        self.time_ns = self.time_ns.saturating_add(later_ns);
        true
    }
}

fn reason(outcome: &Outcome) -> ReasonCode {
    match outcome {
        Outcome::Degraded(reason) => match reason {
            DegradedReason::FewerCells => ReasonCode::FewerCells,
            DegradedReason::CellExcluded => ReasonCode::CellExcluded,
            DegradedReason::Misfit => ReasonCode::Misfit,
            DegradedReason::Unfinished => ReasonCode::Unfinished,
            DegradedReason::Uncalibrated => ReasonCode::Uncalibrated,
            DegradedReason::Doubted => ReasonCode::Doubted,
        },
        _ => ReasonCode::None,
    }
}
