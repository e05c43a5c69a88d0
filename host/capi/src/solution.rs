//! The pose of one frame, as C reads it.

#![forbid(unsafe_code)]

use slitpose_model::{DegradedReason, NoTwist, Outcome, Solution, TwistEstimate};
use slitpose_tracking::columns::no_twist;
use slitpose_tracking::pipeline::Outcomes;

/// The pose of one frame. What is not known is NaN. Fields have names, units and numbers of those in slitpose_pose.h.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct PoseSolution {
    /// The instant the pose refers to, as the caller gave it; 0 of slitpose_solver_solve().
    pub time_ns: u64,
    /// See slitpose_status_of_solution.
    pub status: u16,
    /// Why a pose is degraded: see slitpose_reason_of_solution.
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
    /// Why a pose has no velocity. 1: too few poses yet; 2: the tool is not where its motion led; else 0.
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

// The numbers of `reason` in C follow its order.
const _: () = assert!(DegradedReason::FewerCells as u16 == 0 && DegradedReason::Doubted as u16 == 5);

impl PoseSolution {
    pub(crate) fn new(solution: &Solution, twist: &Result<TwistEstimate, NoTwist>, light_level: Option<f64>) -> Self {
        let (estimate, moving) = (solution.estimate.as_ref(), twist.as_ref().ok());
        Self {
            time_ns: 0,
            status: Outcomes::number_of(&solution.outcome),
            reason: if let Outcome::Degraded(reason) = solution.outcome { 1 + reason as u16 } else { 0 },
            has_pose: estimate.is_some().into(),
            has_twist: moving.is_some().into(),
            cells_used: solution.cells_used.count() as u16,
            excluded_cells: solution.excluded.bits(),
            redundancy: solution.redundancy as u16,
            no_twist: no_twist(twist) as u16,
            translation_m: or_nan(estimate.map(|it| it.pose.translation_m.to_array())),
            rotation_xyzw: or_nan(estimate.map(|it| it.pose.rotation.to_array())),
            covariance: or_nan(estimate.map(|it| std::array::from_fn(|i| it.covariance[i / 6][i % 6]))),
            linear_m_per_s: or_nan(moving.map(|it| it.twist.linear_m_per_s.to_array())),
            angular_rad_per_s: or_nan(moving.map(|it| it.twist.angular_rad_per_s.to_array())),
            twist_sigma: or_nan(moving.map(|it| std::array::from_fn(|i| it.covariance[i][i].sqrt()))),
            light_level: light_level.unwrap_or(f64::NAN),
            chi2: solution.chi2,
        }
    }

    /// Moves the pose on as `slitpose_predict` of slitpose_pose.h does, line by line.
    pub(crate) fn predict(&mut self, later_ns: u64, rms: [f64; 2]) {
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
            let sigma = self.covariance[7 * i].sqrt() + self.twist_sigma[i] * t;
            let bend = rms[i / 3] * t * t / 2.0;
            self.covariance[7 * i] = sigma * sigma + bend * bend;
        }
        self.time_ns = self.time_ns.saturating_add(later_ns);
    }
}

fn or_nan<const N: usize>(numbers: Option<[f64; N]>) -> [f64; N] {
    numbers.unwrap_or([f64::NAN; N])
}
