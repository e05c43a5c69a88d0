//! What the data left open, in words, and what would show it.

use slitpose_head::scene_file::Workspace;
use slitpose_model::Pose;

use crate::data::{Constraint, Data};
use crate::parameters::Parameter;
use crate::pose_error::{COEFFICIENTS, PoseError};

/// Errors of poses below these are not worth a word, metres and radians: those of a single frame.
const WORTH_M: f64 = 4e-6;
const WORTH_RAD: f64 = 4e-4;

/// Share of the prior σ from which a parameter counts as unseen.
const UNSEEN: f64 = 0.9;

/// Sentences, the gravest first.
pub(crate) fn of(error: &PoseError, parameters: &[Parameter], workspace: &Workspace, data: &Data) -> Vec<String> {
    let mut found = Vec::new();
    let home = error.covariance(&Pose::HOME);
    let rms = |from: usize| ((from..from + 3).map(|k| home[k][k]).sum::<f64>() / 3.0).sqrt();
    let has = |constraint| data.groups.iter().any(|group| group.constraint == constraint);
    if rms(0) > WORTH_M || rms(3) > WORTH_RAD {
        let reason = if has(Constraint::Known) {
            "more known poses would fix it"
        } else {
            "only poses by an instrument in the scene's own frames (--known) would fix it, and a common offset does no \
             harm to motions"
        };
        found.push(format!(
            "where the base and the tool frame lie: {:.0} µm and {:.2} mrad per axis; {reason}",
            rms(0) * 1e6,
            rms(3) * 1e3
        ));
    }
    let scale = scale_sigma(error);
    let extent_m = workspace.half_extent_m.max_element();
    if scale * extent_m > WORTH_M {
        found.push(format!(
            "the scale of translations: {:.2e}, {:.0} µm at {:.0} mm; known steps along a line (--stage) or poses by an \
             instrument (--known) would fix it",
            scale,
            scale * extent_m * 1e6,
            extent_m * 1e3
        ));
    }
    let mut unseen: Vec<&Parameter> =
        parameters.iter().filter(|entry| entry.sigma > UNSEEN * entry.prior_sigma).collect();
    if !unseen.is_empty() {
        let count = unseen.len();
        unseen.sort_by(|a, b| (b.sigma / b.prior_sigma).total_cmp(&(a.sigma / a.prior_sigma)));
        let names: Vec<String> = unseen.iter().take(6).map(|entry| entry.name()).collect();
        let more = if count > names.len() { format!(", and {} more", count - names.len()) } else { String::new() };
        found.push(format!(
            "{count} of {} parameters stay as the tolerances have them: {}{more}; poses farther out and turned farther \
             would show them",
            parameters.len(),
            names.join(", ")
        ));
    }
    found
}

/// Standard deviation of the common factor of all translations.
fn scale_sigma(error: &PoseError) -> f64 {
    // The mean of ∂t_x/∂t_x, ∂t_y/∂t_y and ∂t_z/∂t_z: coordinate k of coefficient k + 1.
    let place = |k: usize| 6 * (k + 1) + k;
    let sum: f64 = (0..3)
        .flat_map(|i| (0..3).map(move |j| (i, j)))
        .map(|(i, j)| error.coefficients[place(i) * COEFFICIENTS + place(j)])
        .sum();
    (sum / 9.0).max(0.0).sqrt() / error.length_scale_m
}
