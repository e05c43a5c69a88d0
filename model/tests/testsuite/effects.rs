//! Effects: derivatives against differences, and light against a sum over rays that knows nothing of the model's
//! geometry.

use glam::{DMat3, DQuat, DVec2, DVec3};
use rand_chacha::ChaCha8Rng;
use slitpose_model::{
    Cell, CompiledScene, Converters, DegradedReason, Effects, Opening, Outcome, Pair, Photocurrents, Pose, Profile,
    ProfileShape, Scene, Solver, Status, Stray, Tier, Window, rotation_exp,
};

use super::derivatives::check;
use crate::common::{self, Kind, cold, generator, near, uniform, vector};

const EXACT: Tier = Tier::Exact { tolerance: 1e-10 };

fn set_all(effects: &mut Effects, rng: &mut ChaCha8Rng) {
    effects.window = Some(Window { thickness_m: uniform(rng, 0.3e-3, 1e-3), refractive_index: 1.52 });
    effects.nonlinearity_m = (0..8).map(|_| uniform(rng, -20e-6, 20e-6)).collect();
    effects.profile = ProfileShape { radial: [0.2, -0.3, 0.1, 0.05], azimuthal: [0.02, -0.01, 0.03, 0.02] };
    effects.stray = Some(Stray {
        constant_a: [30e-9, 50e-9],
        linear_a_per_m: [[3e-6, -5e-6, 2e-6], [1e-6, 4e-6, -6e-6]],
        quadratic_a_per_m2: [[1e-3, 2e-3, -1e-3, 3e-3, -2e-3, 1e-3], [2e-3, -1e-3, 1e-3, -2e-3, 1e-3, 3e-3]],
        turning_a: [[3e-8, -2e-8, 1e-8], [-1e-8, 2e-8, 4e-8]],
    });
    effects.electrode_gain = [1.01, 0.98];
    effects.converters = Some(Converters {
        full_scale_a: 10e-6,
        curves_a: [[0.0, 0.0, 3e-9, -2e-9].into_iter().collect(), [0.0, 1e-9, -2e-9].into_iter().collect()],
    });
}

/// A scene with a slit turned by up to `turn_rad` and one emitter more than cells that can see it.
fn imperfect(rng: &mut ChaCha8Rng, kind: Kind, turn_rad: f64) -> Scene {
    let mut scene = common::scene(rng, kind);
    scene.cells[0].slit.tilt_rad = vector(rng, turn_rad);
    set_all(&mut scene.cells[0].effects, rng);
    scene
}

#[test]
fn derivatives_of_all_effects_equal_differences() {
    for kind in [Kind::Thin, Kind::Thick, Kind::Table] {
        for tier in [EXACT, Tier::Paper] {
            let mut count = 0;
            let draw = |rng: &mut ChaCha8Rng| {
                let mut scene = imperfect(rng, kind, 0.05);
                count += 1;
                if count % 4 == 0 {
                    scene.cells[0].effects.source_diameter_m = 0.3e-3;
                }
                let pose = common::pose(rng, &scene, 1e-3, 0.2);
                (scene, pose)
            };
            // As of ideal cells: step error (2e-3)⁴ of a spot width, and rounding of the integrals over the step.
            check(&format!("effects, {kind:?}"), draw, tier, 150, 2e-7);
        }
    }
}

/// Of a luminous disc the position is that of all of its light, and an edge that is lit is a spot.
#[test]
fn the_place_of_the_light_of_a_disc_is_that_of_all_its_points() {
    let rng = &mut generator();
    let mut edges = 0;
    for _ in 0..400 {
        let mut scene = common::scene(rng, Kind::Thin);
        scene.cells[0].effects.source_diameter_m = 0.6e-3;
        scene.cells[0].detector.dark_current_a = 0.0;
        let half_m = 0.5 * scene.cells[0].detector.length_m;
        // The spot is at the end of the detector: the emitter as far off as rays through the slit's middle take it there.
        let (detector, slit) = (&scene.cells[0].detector, &scene.cells[0].slit);
        let height_m = (scene.cells[0].emitter.position_tool_m - detector.centre_base_m).dot(detector.normal_base);
        let to_end_m = half_m * (height_m - slit.distance_m) / slit.distance_m;
        let shift = detector.x_axis_base * (to_end_m + uniform(rng, -1e-3, 1e-3));
        let pose = Pose::from_vectors(shift, DVec3::ZERO);
        let plan = CompiledScene::<f64>::compile(&scene, EXACT).expect("valid");
        let response = plan.respond(0, &pose);
        let Pair { i_x1_a, i_x2_a } = response.currents;
        assert_eq!(response.x_a_m.is_some(), i_x1_a + i_x2_a > 0.0, "{response:?}");
        let Some(x_a_m) = response.x_a_m else { continue };
        let told_m = half_m * (i_x2_a - i_x1_a) / (i_x1_a + i_x2_a);
        assert!((x_a_m - told_m).abs() < 1e-9 * half_m, "{x_a_m} {told_m} {response:?}");
        scene.cells[0].effects.source_diameter_m = 0.0;
        let point = CompiledScene::<f64>::compile(&scene, EXACT).expect("valid").respond(0, &pose);
        if point.x_a_m.is_none() {
            edges += 1;
            assert_eq!(response.status, Status::Clipped);
        }
    }
    assert!(edges > 2, "{edges} spots of edges alone");
}

#[test]
fn effects_that_are_off_change_no_bit() {
    let rng = &mut generator();
    for kind in common::KINDS {
        let scene = common::scene(rng, kind);
        let mut off = scene.clone();
        off.cells[0].effects.window = None;
        off.cells[0].effects.model_error.position_m = 1e-6;
        let pose = common::pose(rng, &scene, 1e-3, 0.2);
        for tier in [EXACT, Tier::Paper] {
            let respond = |scene: &Scene| CompiledScene::<f64>::compile(scene, tier).expect("valid").respond(0, &pose);
            assert_eq!(respond(&scene), respond(&off));
        }
    }
}

#[test]
fn effects_too_small_to_matter_give_the_ideal_cell() {
    let rng = &mut generator();
    for kind in [Kind::Thin, Kind::Thick, Kind::Table] {
        for _ in 0..100 {
            let scene = common::scene(rng, kind);
            let mut nearly = scene.clone();
            nearly.cells[0].effects.electrode_gain = [1.0 + 1e-15, 1.0];
            let pose = common::pose(rng, &scene, 2e-3, 0.2);
            for tier in [EXACT, Tier::Paper] {
                let respond =
                    |scene: &Scene| CompiledScene::<f64>::compile(scene, tier).expect("valid").respond(0, &pose);
                let (ideal, imperfect) = (respond(&scene), respond(&nearly));
                assert_eq!((ideal.status, ideal.flags), (imperfect.status, imperfect.flags));
                let difference = (ideal.currents.i_x1_a - imperfect.currents.i_x1_a).abs();
                // Twice the tolerance of the integrals.
                assert!(difference <= 2e-10 * ideal.i_o_a, "{kind:?} {tier:?}: {ideal:?} {imperfect:?}");
            }
        }
    }
}

/// Light on the detector of a cell, as a sum over rays: power per axial intensity, and its first moment.
///
/// Landing points on the detector; each one's ray in front of the window by Snell's law; limits of the light along x
/// by bisection on whether the ray passes the slit. All in the cell's frame.
pub struct Rays<'a> {
    cell: &'a Cell,
    emitter: DVec3,
    axis: DVec3,
    slit_centre: DVec3,
    into_slit: DQuat,
}

impl<'a> Rays<'a> {
    /// Of a cell whose tool is at `pose`, with the slit on the base or on the tool.
    pub fn of(cell: &'a Cell, pose: &Pose) -> Self {
        let (x, z) = (cell.detector.x_axis_base, cell.detector.normal_base);
        let into_cell = DQuat::from_mat3(&DMat3::from_cols(x, z.cross(x), z)).inverse();
        let placed = |tool: DVec3| pose.rotation * tool + pose.translation_m - cell.detector.centre_base_m;
        let slit = &cell.slit;
        let mut slit_centre = DVec3::new(slit.offset_m.x, slit.offset_m.y, slit.distance_m);
        let mut tilt = rotation_exp(slit.tilt_rad);
        if cell.effects.opening == Opening::RidingSlit {
            slit_centre = into_cell * placed(into_cell.inverse() * slit_centre + cell.detector.centre_base_m);
            tilt = into_cell * pose.rotation * into_cell.inverse() * tilt;
        }
        let emitter = into_cell * placed(cell.emitter.position_tool_m);
        let axis = into_cell * (pose.rotation * cell.emitter.axis_tool);
        Self { cell, emitter, axis, slit_centre, into_slit: tilt.inverse() }
    }

    /// Slopes (dx/dz, dy/dz towards the emitter, in air) of the ray that lands at `point`.
    fn slopes(&self, point: DVec2) -> DVec2 {
        let to = DVec2::new(self.emitter.x, self.emitter.y) - point;
        let Some(window) = self.cell.effects.window else {
            return to / self.emitter.z;
        };
        let (distance, direction) = (to.length(), to.normalize_or_zero());
        // Sum of the ways across in air and in the window, which grows with sin θ.
        let (mut low, mut high) = (0.0, 1.0_f64);
        for _ in 0..80 {
            let sine = 0.5 * (low + high);
            let inside = sine / window.refractive_index;
            let across = (self.emitter.z - window.thickness_m) * sine / (1.0 - sine * sine).sqrt()
                + window.thickness_m * inside / (1.0 - inside * inside).sqrt();
            if across < distance { low = sine } else { high = sine }
        }
        direction * (low / (1.0 - low * low).sqrt())
    }

    /// Whether the ray that lands at `point` passes the slit.
    fn passes(&self, point: DVec2) -> bool {
        let slope = self.slopes(point);
        let slit = &self.cell.slit;
        let start = self.into_slit * (self.emitter - self.slit_centre);
        let direction = self.into_slit * DVec3::new(-slope.x, -slope.y, -1.0);
        [-0.5, 0.5].into_iter().all(|half| {
            let down = (half * slit.thickness_m - start.z) / direction.z;
            let at = start + direction * down;
            (0.0..self.emitter.z).contains(&down)
                && at.x.abs() <= 0.5 * slit.width_m
                && at.y.abs() <= 0.5 * slit.length_m
        })
    }

    /// Power per area of the detector at `point`.
    fn density(&self, point: DVec2) -> f64 {
        let step = 1e-6;
        let by_x = (self.slopes(point + DVec2::X * step) - self.slopes(point - DVec2::X * step)) / (2.0 * step);
        let by_y = (self.slopes(point + DVec2::Y * step) - self.slopes(point - DVec2::Y * step)) / (2.0 * step);
        let slope = self.slopes(point);
        let direction = DVec3::new(-slope.x, -slope.y, -1.0);
        let length = direction.length();
        let cosine = (self.axis.dot(direction) / length).max(0.0);
        let Profile::Cosine { exponent } = self.cell.emitter.profile else { panic!("a cosine") };
        let z = 1.0 - cosine;
        let [a, b, c, d] = self.cell.effects.profile.radial;
        let shape = 1.0 + z * (a + z * (b + z * (c + z * d)));
        by_x.perp_dot(by_y).abs() / length.powi(3) * cosine.powf(exponent) * shape
    }

    /// Power and moment by rows of the detector, with their weights on −1 … 1.
    pub fn sum(&self, rows: impl IntoIterator<Item = (f64, f64)>) -> (f64, f64) {
        let [half_x, half_y] = [0.5 * self.cell.detector.length_m, 0.5 * self.cell.detector.width_m];
        let (mut power, mut moment) = (0.0, 0.0);
        for (eta, weight_y) in rows {
            let y = half_y * eta;
            let inside = (0..=2000).map(|i| -half_x + f64::from(i) * half_x / 1000.0);
            let Some(middle) = inside.into_iter().find(|&x| self.passes(DVec2::new(x, y))) else { continue };
            let limit = |outside: f64| {
                let (mut inside, mut outside) = (middle, outside);
                if self.passes(DVec2::new(outside, y)) {
                    return outside;
                }
                for _ in 0..60 {
                    let x = 0.5 * (inside + outside);
                    if self.passes(DVec2::new(x, y)) { inside = x } else { outside = x }
                }
                inside
            };
            let (low, high) = (limit(-half_x), limit(half_x));
            for (xi, weight_x) in gauss_legendre() {
                let x = 0.5 * (low + high) + 0.5 * (high - low) * xi;
                let part = 0.5 * (high - low) * half_y * weight_x * weight_y * self.density(DVec2::new(x, y));
                power += part;
                moment += part * x;
            }
        }
        (power, moment)
    }
}

/// Nodes and weights of the rule by Gauss and Legendre with six nodes (Abramowitz and Stegun 25.4).
fn gauss_legendre() -> impl Iterator<Item = (f64, f64)> {
    let nodes = [0.238_619_186_083_196_9, 0.661_209_386_466_264_5, 0.932_469_514_203_152];
    let weights = [0.467_913_934_572_691, 0.360_761_573_048_138_6, 0.171_324_492_379_170_36];
    (0..3).flat_map(move |i| [(nodes[i], weights[i]), (-nodes[i], weights[i])])
}

/// By how much the exact tier errs, relative in power, and in position in metres, against the sum over rays.
fn errors(scene: &Scene, pose: &Pose) -> Option<(f64, f64)> {
    let cell = &scene.cells[0];
    let plan = CompiledScene::<f64>::compile(scene, EXACT).expect("valid");
    let response = plan.respond(0, pose);
    if response.status != Status::Lit {
        return None;
    }
    let (power, moment) = Rays::of(cell, pose).sum(gauss_legendre());
    let current = power * cell.detector.responsivity_a_per_w * cell.emitter.radiant_intensity_w_per_sr;
    let Pair { i_x1_a, i_x2_a } = plan.photocurrents(0, pose);
    Some(((i_x1_a + i_x2_a) / current - 1.0, response.x_a_m? - moment / power))
}

#[test]
fn light_through_turned_slits_and_windows_is_the_sum_over_rays() {
    let rng = &mut generator();
    let mut worst = [(0.0_f64, 0.0_f64); 3];
    for (case, worst) in worst.iter_mut().enumerate() {
        for i in 0..60 {
            let mut scene = common::scene(rng, if i % 2 == 0 { Kind::Thin } else { Kind::Thick });
            scene.cells[0].detector.width_m = 1e-3;
            if case != 1 {
                scene.cells[0].slit.tilt_rad = vector(rng, 0.02);
            }
            let effects = &mut scene.cells[0].effects;
            effects.electrode_gain = [1.0 + 1e-15, 1.0];
            if case != 0 {
                effects.window = Some(Window { thickness_m: 0.7e-3, refractive_index: 1.52 });
            }
            effects.profile.radial = [0.1, -0.2, 0.1, 0.05];
            let pose = common::pose(rng, &scene, 2e-3, 0.2);
            let Some((power, position)) = errors(&scene, &pose) else { continue };
            worst.0 = worst.0.max(power.abs());
            worst.1 = worst.1.max(position.abs());
        }
    }
    println!("turned, window, both: power and position {worst:?}");
    // What the geometry leaves out at up to 0.02 rad and 40 degrees of incidence: the slit's turn and the window's
    // curvature within the spot.
    let most = [(1e-4, 0.3e-6), (3e-4, 0.6e-6), (3e-4, 0.8e-6)];
    for (worst, most) in worst.iter().zip(most) {
        assert!(worst.0 < most.0 && worst.1 < most.1, "{worst:?} {most:?}");
    }
}

#[test]
fn converters_beyond_their_range_err_as_at_its_end() {
    let ideal = common::wide();
    let mut scene = ideal.clone();
    let curve: heapless::Vec<f64, 10> = (0..10).map(|k| if k == 9 { 5e-9 } else { 0.0 }).collect();
    // The range ends below the light at home.
    scene.cells[0].effects.converters = Some(Converters { full_scale_a: 1e-6, curves_a: [curve.clone(), curve] });
    let linearise =
        |scene: &Scene| CompiledScene::<f64>::compile(scene, EXACT).expect("valid").linearise(0, &Pose::HOME);
    let ((_, without, slopes), (_, with, same_slopes)) = (linearise(&ideal), linearise(&scene));
    assert!((with.i_x1_a - without.i_x1_a - 5e-9).abs() < 1e-9 * without.i_x1_a, "{with:?} {without:?}");
    for (slope, same) in slopes.as_flattened().iter().zip(same_slopes.as_flattened()) {
        // Twice the tolerance of the integrals, relative to the largest, below 1 mA/m.
        assert!((slope - same).abs() < 1e-12, "{slope:e} {same:e}");
    }
}

#[test]
fn a_cell_with_stray_light_alone_is_faint() {
    let mut scene = common::wide();
    let stray = Stray::at(0.3e-6, 2e-3, scene.cells[0].detector.length_m);
    scene.cells.iter_mut().for_each(|cell| cell.effects.stray = Some(stray));
    let solver = Solver::<f64>::new(&scene, Tier::Exact { tolerance: 1e-6 }).expect("valid");
    let rng = &mut generator();
    for covered in 0..6 {
        let pose = common::pose_in_box(rng, 2.0, 8.0);
        let currents = (0..6).map(|cell| match cell == covered {
            true => Pair { i_x1_a: stray.constant_a[0], i_x2_a: stray.constant_a[1] },
            false => solver.plan().photocurrents(cell, &pose),
        });
        let solution = cold(&solver, &Photocurrents::of_pairs(currents));
        assert_eq!(solution.outcome, Outcome::Degraded(DegradedReason::FewerCells), "{covered}");
        let (shift, turn) = solution.estimate.expect("five cells").pose.displacement_from(&pose);
        // A hundredth of σ, 0.7 µm and 0.1 mrad.
        assert!(shift.length() < 1e-8 && turn.length() < 1e-6, "{covered}: {shift} {turn}");
    }
}

#[test]
fn a_followed_tool_takes_hardly_more_evaluations_with_effects_than_without() {
    let rng = &mut generator();
    let mut thick = common::wide();
    thick.cells.iter_mut().for_each(|cell| cell.slit.thickness_m = 0.15e-3);
    let mut all = thick.clone();
    all.cells.iter_mut().for_each(|cell| set_all(&mut cell.effects, rng));
    for (name, scene) in [("thin", common::wide()), ("thick", thick), ("all effects", all)] {
        let solver = Solver::<f64>::new(&scene, Tier::Exact { tolerance: 1e-6 }).expect("valid");
        let (mut evaluations, count) = (0, 500);
        for _ in 0..count {
            let pose = common::pose_in_box(rng, 3.0, 10.0);
            let currents = common::seen(solver.plan(), &pose);
            let prior = pose.perturbed(DVec3::splat(3e-6), DVec3::splat(3e-4));
            evaluations += near(&solver, &currents, &prior).evaluations;
        }
        println!("{name}: {:.2} evaluations", evaluations as f64 / f64::from(count));
        // Beside a wall of the slit, in one pose of seven, a second one.
        assert!(evaluations < 600, "{evaluations}");
    }
}
