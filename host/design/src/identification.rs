//! An emitter's profile from measured currents, by equation (6).

use std::collections::BTreeMap;

use slitpose_model::{Cell, CompiledScene, Pose, Status, identified_relative_intensity};
use thiserror::Error;

/// One point of a profile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Identified {
    /// Angle between the emitter's axis and the beam, radians.
    pub gamma_rad: f64,
    /// Relative radiant intensity I_rel at that angle.
    pub relative_intensity: f64,
    /// The spot's solid angle that was used, steradians.
    pub solid_angle_sr: f64,
}

/// Equation (6) of De La Cruz et al. 2018 for one cell at a known pose:
/// I_rel(γ) = I_Om/(S·Ω·I_e), with the known dark current taken off I_Om first.
///
/// `None` unless the cell is lit.
pub fn identify(cell: &Cell, plan: &CompiledScene<f64>, number: usize, pose: &Pose, i_om_a: f64) -> Option<Identified> {
    let response = plan.respond(number, pose);
    let relative_intensity = identified_relative_intensity(
        i_om_a - cell.detector.dark_current_a,
        response.solid_angle_sr,
        cell.emitter.radiant_intensity_w_per_sr,
        cell.detector.responsivity_a_per_w,
    );
    let (gamma_rad, relative_intensity) = response.gamma_rad.zip(relative_intensity)?;
    let solid_angle_sr = response.solid_angle_sr;
    (response.status == Status::Lit).then_some(Identified { gamma_rad, relative_intensity, solid_angle_sr })
}

/// Why points are no profile.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
#[allow(missing_docs, reason = "the texts say what each is")]
pub enum ProfileError {
    #[error("no row has it lit and its emitter facing the slit; add such poses")]
    NoPoints,
    #[error(
        "no current was taken within {0}° of the emitter's axis, the nearest at {1:.1}°; add such a pose, or use larger steps"
    )]
    NothingOnAxis(f64, f64),
    #[error(
        "all currents were taken within {0}° of the emitter's axis; add poses at larger angles, or use smaller steps"
    )]
    OnlyOnAxis(f64),
}

/// A profile table (degrees, relative intensity) from scattered points: the means of all points
/// within half a step of each multiple of the step. Points at 90° and beyond are left out.
pub fn profile_table(points: &[Identified], step_deg: f64) -> Result<Vec<[f64; 2]>, ProfileError> {
    let mut bins: BTreeMap<u32, Vec<[f64; 2]>> = BTreeMap::new();
    for point in points {
        let gamma_deg = point.gamma_rad.to_degrees();
        if gamma_deg < 90.0 {
            let bin = (gamma_deg / step_deg).round() as u32;
            bins.entry(bin).or_default().push([gamma_deg, point.relative_intensity]);
        }
    }
    if bins.is_empty() {
        return Err(ProfileError::NoPoints);
    }
    if !bins.contains_key(&0) {
        let nearest_deg = points.iter().map(|point| point.gamma_rad.to_degrees()).fold(f64::INFINITY, f64::min);
        return Err(ProfileError::NothingOnAxis(0.5 * step_deg, nearest_deg));
    }
    if bins.len() < 2 {
        return Err(ProfileError::OnlyOnAxis(step_deg));
    }
    let mean = |points: &[[f64; 2]], column: usize| {
        points.iter().map(|point| point[column]).sum::<f64>() / points.len() as f64
    };
    // The profile is even in γ, so points around the axis stand for the axis itself.
    let knot = |(bin, points): (&u32, &Vec<[f64; 2]>)| [if *bin == 0 { 0.0 } else { mean(points, 0) }, mean(points, 1)];
    Ok(bins.iter().map(knot).collect())
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use slitpose_head::scene_file::WIDE;
    use slitpose_model::Tier;

    use super::*;

    fn point(gamma_deg: f64, relative_intensity: f64) -> Identified {
        Identified { gamma_rad: gamma_deg.to_radians(), relative_intensity, solid_angle_sr: 1e-3 }
    }

    #[test]
    fn a_clipped_spot_gives_no_point() {
        let scene = WIDE.read().unwrap().scene;
        let plan = CompiledScene::compile(&scene, Tier::Paper).unwrap();
        let found = [0.0, 16e-3].map(|height_m| {
            let pose = Pose { translation_m: DVec3::Z * height_m, ..Pose::HOME };
            (plan.respond(0, &pose).status, identify(&scene.cells[0], &plan, 0, &pose, 1e-6).is_some())
        });
        assert_eq!(found, [(Status::Lit, true), (Status::Clipped, false)]);
    }

    #[test]
    fn points_are_averaged_around_multiples_of_the_step() {
        let points = [point(11.0, 0.8), point(1.0, 1.01), point(0.5, 0.99), point(9.0, 0.9), point(95.0, 0.1)];
        let table = profile_table(&points, 10.0).unwrap();
        let expected = [[0.0, 1.0], [10.0, 0.85]];
        let off = table.iter().flatten().zip(expected.iter().flatten()).map(|(a, b)| (a - b).abs());
        assert!(table.len() == 2 && off.fold(0.0, f64::max) < 1e-12, "{table:?}");
    }

    #[test]
    fn a_profile_needs_its_axis_and_something_else() {
        assert_eq!(profile_table(&[point(95.0, 0.1)], 5.0), Err(ProfileError::NoPoints));
        let message = profile_table(&[point(20.0, 0.9)], 5.0).unwrap_err().to_string();
        assert!(
            message.contains("2.5°") && message.contains("20.0°") && message.contains("add such a pose"),
            "{message}"
        );
        let message = profile_table(&[point(1.0, 0.9)], 5.0).unwrap_err().to_string();
        assert!(message.contains("5°") && message.contains("larger angles"), "{message}");
    }
}
