//! Openings other than a slit on the base: derivatives against differences, and light against a sum over rays that knows
//! nothing of the model's geometry.

use glam::{DMat3, DVec2, DVec3};
use rand_chacha::ChaCha8Rng;
use slitpose_model::{
    Cell, CompiledScene, Effects, Fault, Opening, Pose, Profile, ProfileShape, Scene, Status, Stray, Tier, Window,
    rotation_exp, rotation_log,
};

use super::derivatives::check;
use super::effects::Rays;
use crate::common::{self, Kind, generator, uniform, vector};

const EXACT: Tier = Tier::Exact { tolerance: 1e-10 };

/// A slit on the tool, perhaps turned and in a thick mask.
fn riding(rng: &mut ChaCha8Rng, kind: Kind) -> Scene {
    let mut scene = common::scene(rng, kind);
    scene.cells[0].effects.opening = Opening::RidingSlit;
    scene
}

/// A round hole of a millimetre or two, with a lens or without.
fn round(rng: &mut ChaCha8Rng, has_lens: bool) -> Scene {
    let mut scene = common::scene(rng, Kind::Thin);
    let cell = &mut scene.cells[0];
    cell.detector.width_m = 12e-3;
    cell.slit.width_m = uniform(rng, 0.5e-3, 2e-3);
    cell.slit.length_m = cell.slit.width_m;
    cell.effects.opening = Opening::Pinhole;
    if has_lens {
        // From far out of focus to beyond it, where the spot is upside down.
        cell.effects.opening = Opening::Lens { focal_length_m: uniform(rng, 1.5e-3, 30e-3) };
    }
    scene
}

/// A pose of the first cell's emitter near its opening's axis, with room for the tool's other motions.
fn pose(rng: &mut ChaCha8Rng, scene: &Scene) -> Pose {
    common::pose(rng, scene, 1e-3, 0.1)
}

#[test]
fn derivatives_equal_differences() {
    for is_riding in [true, false] {
        let mut trial = 0;
        let draw = |rng: &mut ChaCha8Rng| {
            trial += 1;
            let kinds = [Kind::Thin, Kind::TiltedThick, Kind::Tilted, Kind::Table];
            let mut scene = if is_riding { riding(rng, kinds[trial % 4]) } else { round(rng, trial % 4 != 0) };
            if trial % 3 == 0 {
                let effects = &mut scene.cells[0].effects;
                effects.profile = ProfileShape { radial: [0.2, -0.3, 0.1, 0.05], azimuthal: [0.02, -0.01, 0.03, 0.02] };
                effects.source_diameter_m = 0.3e-3;
                effects.electrode_gain = [1.01, 0.98];
                effects.nonlinearity_m = (0..6).map(|_| uniform(rng, -20e-6, 20e-6)).collect();
                effects.stray = Some(Stray { linear_a_per_m: [[3e-6, -5e-6, 2e-6]; 2], ..Stray::at(3e-8, 0.0, 12e-3) });
            }
            let pose = pose(rng, &scene);
            (scene, pose)
        };
        // The differences' own error: rounding of the integrals, 1e-10 of the currents over a thousandth of a step.
        check(if is_riding { "riding slit" } else { "hole" }, draw, EXACT, 150, 4e-6);
    }
}

/// Power per axial intensity that lands on the detector, and its first moment along x.
struct Light {
    power: f64,
    x_m: f64,
}

fn cell_axes(cell: &Cell) -> DMat3 {
    let detector = &cell.detector;
    DMat3::from_cols(detector.x_axis_base, detector.normal_base.cross(detector.x_axis_base), detector.normal_base)
}

/// I_rel of the cell's emitter towards `direction`, base frame.
fn relative(cell: &Cell, pose: &Pose, direction: DVec3) -> f64 {
    let cosine = (pose.rotation * cell.emitter.axis_tool).dot(direction.normalize());
    match cell.emitter.profile {
        Profile::Cosine { exponent } if cosine > 0.0 => cosine.powf(exponent),
        _ => 0.0,
    }
}

/// Nodes and weights of the rule by midpoints, on −1 … 1.
fn midpoints(count: usize) -> impl Iterator<Item = (f64, f64)> {
    (0..count).map(move |i| ((2.0 * i as f64 + 1.0) / count as f64 - 1.0, 2.0 / count as f64))
}

/// Through a round hole, by points of the hole: each ray goes on with its slopes less the distance from the middle over
/// the focal length (the ray transfer matrix of a thin lens), and counts if it lands on the detector.
fn through_hole(cell: &Cell, pose: &Pose, per_focal_length: f64) -> Light {
    let axes = cell_axes(cell);
    let (slit, detector) = (&cell.slit, &cell.detector);
    let emitter = pose.rotation * cell.emitter.position_tool_m + pose.translation_m;
    let e = axes.transpose() * (emitter - detector.centre_base_m);
    let mut light = Light { power: 0.0, x_m: 0.0 };
    let radius = 0.5 * slit.width_m;
    for (xi, weight) in midpoints(800) {
        let r = radius * 0.5 * (1.0 + xi);
        for turn in 0..720 {
            let (sine, cosine) = (f64::from(turn) * core::f64::consts::TAU / 720.0).sin_cos();
            let off = DVec2::new(cosine, sine) * r;
            let q = DVec3::new(slit.offset_m.x + off.x, slit.offset_m.y + off.y, slit.distance_m);
            let ray = q - e;
            let slopes = DVec2::new(ray.x, ray.y) / -ray.z - off * per_focal_length;
            let landing = DVec2::new(q.x, q.y) + slopes * slit.distance_m;
            if landing.x.abs() > 0.5 * detector.length_m || landing.y.abs() > 0.5 * detector.width_m {
                continue;
            }
            let area = 0.5 * weight * radius * r * core::f64::consts::TAU / 720.0;
            let power = relative(cell, pose, axes * ray) * area * -ray.z / ray.length().powi(3);
            light.power += power;
            light.x_m += power * landing.x;
        }
    }
    light.x_m /= light.power;
    light
}

/// Power per axial intensity and X_A by the model.
fn by_model(scene: &Scene, pose: &Pose) -> (Light, Status) {
    let plan = CompiledScene::<f64>::compile(scene, EXACT).expect("a valid scene");
    let response = plan.respond(0, pose);
    let cell = &scene.cells[0];
    let gain = cell.detector.responsivity_a_per_w * cell.emitter.radiant_intensity_w_per_sr;
    let total = plan.photocurrents(0, pose).total_a() / gain;
    (Light { power: total, x_m: response.x_a_m.unwrap_or(f64::NAN) }, response.status)
}

#[test]
fn light_through_a_riding_slit_is_the_sum_of_its_rays() {
    let rng = &mut generator();
    let mut clipped = 0;
    for trial in 0..16 {
        let kind = [Kind::Thin, Kind::Thick, Kind::Tilted, Kind::TiltedThick][trial % 4];
        let scene = riding(rng, kind);
        let pose = common::pose(rng, &scene, if trial < 8 { 1e-3 } else { 2.5e-3 }, 0.25);
        let (model, status) = by_model(&scene, &pose);
        let (power, moment) = Rays::of(&scene.cells[0], &pose).sum(midpoints(400));
        if status == Status::Dark {
            assert_eq!(power, 0.0);
            continue;
        }
        clipped += usize::from(status == Status::Clipped);
        // Errors of the midpoint rule: (1/400)² of the rows, more where a corner of the slit cuts rows short.
        assert!((model.power / power - 1.0).abs() < 2e-4, "{kind:?}: {} {power}", model.power);
        assert!((model.x_m - moment / power).abs() < 0.3e-6, "{kind:?}: {} {}", model.x_m, moment / power);
    }
    assert!(clipped > 0);
}

#[test]
fn light_through_a_hole_is_the_sum_of_its_rays() {
    let rng = &mut generator();
    let mut seen = [0; 3];
    for trial in 0..30 {
        let mut scene = round(rng, trial % 3 != 0);
        let (per_focal_length, pinhole) = match scene.cells[0].effects.opening {
            Opening::Lens { focal_length_m } => (focal_length_m.recip(), false),
            _ => (0.0, true),
        };
        if trial % 5 == 4 {
            // The end of the detector runs through the spot.
            let (whole, _) = by_model(&scene, &Pose::HOME);
            scene.cells[0].detector.length_m = 2.0 * whole.x_m.abs();
        }
        let pose = if trial % 5 == 4 { Pose::HOME } else { pose(rng, &scene) };
        let (model, status) = by_model(&scene, &pose);
        let rays = through_hole(&scene.cells[0], &pose, per_focal_length);
        if !status.has_spot() {
            assert_eq!(rays.power, 0.0, "{trial}");
            continue;
        }
        // Whole spots: the second moment of the polygon that stands for the circle is 1e-3 larger, of a second-order
        // effect of a few per cent. Cut spots: that polygon's outline is off by 3 % of the radius, and the rays count whole.
        let (power, x_m) = if status == Status::Lit { (1e-4, 0.1e-6) } else { (2e-2, 10e-6) };
        assert!((model.power / rays.power - 1.0).abs() < power, "{trial} {status:?}: {} {}", model.power, rays.power);
        assert!((model.x_m - rays.x_m).abs() < x_m, "{trial} {status:?}: {} {}", model.x_m, rays.x_m);
        seen[if status == Status::Clipped { 2 } else { usize::from(pinhole) }] += 1;
    }
    assert!(seen.into_iter().all(|count| count > 2), "{seen:?}");
}

#[test]
fn at_home_a_riding_slit_is_one_on_the_base() {
    let rng = &mut generator();
    for (kind, is_flipped) in
        [(Kind::Thin, false), (Kind::Thick, true), (Kind::Tilted, false), (Kind::TiltedThick, true)]
    {
        let mut scene = riding(rng, kind);
        if is_flipped {
            // The other way up it is the same slit.
            let tilt = rotation_exp(scene.cells[0].slit.tilt_rad) * rotation_exp(DVec3::Y * core::f64::consts::PI);
            scene.cells[0].slit.tilt_rad = rotation_log(tilt);
        }
        let mut fixed = scene.clone();
        fixed.cells[0].effects = Effects::default();
        let [riding, fixed] = [scene, fixed].map(|scene| by_model(&scene, &Pose::HOME));
        assert_eq!(riding.1, fixed.1);
        // Twice the tolerance of the integrals.
        assert!((riding.0.power / fixed.0.power - 1.0).abs() < 2e-10, "{kind:?}");
        assert!((riding.0.x_m - fixed.0.x_m).abs() < 1e-12, "{kind:?}");
    }
}

#[test]
fn both_axes_of_a_detector_count_one_emitter_once() {
    let rng = &mut generator();
    let mut scene = round(rng, false);
    let mut other = scene.cells[0].clone();
    let y_axis = other.detector.normal_base.cross(other.detector.x_axis_base);
    other.detector.x_axis_base = y_axis;
    other.slit.offset_m = DVec2::new(other.slit.offset_m.y, -other.slit.offset_m.x);
    (scene.cells[0].effects.other_axis, other.effects.other_axis) = (Some(1), Some(0));
    scene.cells.push(other).expect("room");
    let plan = CompiledScene::<f64>::compile(&scene, EXACT).expect("a valid scene");
    let pose = pose(rng, &scene);
    for cell in 0..2 {
        let alone = plan.photocurrents(cell, &pose);
        assert_eq!(plan.photocurrents_of(cell, [(0, 1.0), (1, 1.0)], &pose), alone, "cell {cell}");
        // Both pairs carry the whole photocurrent.
        let first = plan.photocurrents(0, &pose).total_a();
        assert!((alone.total_a() / first - 1.0).abs() < 2e-3, "{} {first}", alone.total_a());
    }
}

#[test]
fn what_an_opening_cannot_be_computed_with_is_refused() {
    let rng = &mut generator();
    let refusal = |scene: &Scene| CompiledScene::<f64>::compile(scene, Tier::Paper).expect_err("refused").to_string();
    let mut windowed = riding(rng, Kind::Thin);
    windowed.cells[0].effects.window = Some(Window { thickness_m: 0.7e-3, refractive_index: 1.52 });
    assert_eq!(
        refusal(&windowed),
        "cell 0, window.thickness_mm: a window cannot be computed with a slit on the tool; leave it out"
    );
    let mut tilted = round(rng, false);
    tilted.cells[0].slit.tilt_rad = vector(rng, 0.01);
    assert_eq!(refusal(&tilted), "cell 0, slit.tilt_deg: a tilt cannot be computed with a pinhole; leave it out");
    let mut thick = round(rng, true);
    thick.cells[0].slit.thickness_m = 0.1e-3;
    assert_eq!(refusal(&thick), "cell 0, slit.thickness_mm: a thick mask cannot be computed with a lens; leave it out");
    let mut blunt = round(rng, true);
    blunt.cells[0].effects.opening = Opening::Lens { focal_length_m: 0.0 };
    let error = CompiledScene::<f64>::compile(&blunt, Tier::Paper).expect_err("refused");
    assert_eq!((error.place.key, error.fault), ("focal_length_mm", Fault::NotPositive(0.0)));
}

/// Where nothing cuts a spot one rule integrates it, else a polygon is divided, as nearly all are at a tolerance 10⁻⁵ times
/// as small. The tolerance is that of the currents. Derivatives err more, as the light falls off within a millimetre or
/// two: over a million cells by 1.2e-5 of the current per millimetre and 3.2e-5 per 0.1 rad at most, polygons' as well.
#[test]
fn whole_spots_have_the_light_and_the_derivatives_of_divided_ones() {
    let rng = &mut generator();
    let (mut worst, mut whole) = ([0.0_f64; 2], 0);
    for trial in 0..4000 {
        let kinds = [Kind::Thin, Kind::TiltedThick, Kind::Tilted, Kind::Thick];
        let mut scene = if trial % 2 == 0 { riding(rng, kinds[trial / 2 % 4]) } else { round(rng, trial % 8 != 1) };
        // Which each tier divides its own way.
        scene.cells[0].detector.dark_current_a = 0.0;
        let pose = pose(rng, &scene);
        let [paper, exact, finer] = [Tier::Paper, Tier::Exact { tolerance: 1e-6 }, Tier::Exact { tolerance: 1e-11 }]
            .map(|tier| CompiledScene::<f64>::compile(&scene, tier).expect("valid"));
        let evaluations =
            [&exact, &finer].map(|plan| plan.respond(0, &pose).integration.map_or(0, |it| it.evaluations));
        whole += usize::from(trial % 2 == 1 && evaluations[0] == 11 && evaluations[1] > 11);
        let (_, expected, slopes) = finer.linearise(0, &pose);
        for plan in [paper, exact] {
            let (_, pair, jacobian) = plan.linearise(0, &pose);
            let off = (pair.i_x1_a - expected.i_x1_a).abs().max((pair.i_x2_a - expected.i_x2_a).abs());
            assert!(off <= 1e-6 * expected.total_a(), "{trial}: {pair:?} {expected:?}");
            for (axis, (value, slope)) in jacobian.iter().zip(slopes).flat_map(|(a, b)| a.iter().zip(b)).enumerate() {
                let unit = if axis % 6 < 3 { 1e3 } else { 10.0 };
                let worst = &mut worst[axis % 6 / 3];
                *worst = worst.max((value - slope).abs() / (unit * expected.total_a().max(1e-9)));
            }
        }
    }
    println!("{whole} of 2000 holes by one rule; derivatives err by {worst:?}");
    assert!(whole > 400 && worst[0] < 1e-6 && worst[1] < 4e-6, "{whole} {worst:?}");
}

#[test]
fn light_is_continuous_where_the_detector_begins_to_cut_it() {
    let rng = &mut generator();
    let mut compared = [0; 2];
    for trial in 0..200 {
        let is_riding = trial % 2 == 0;
        let kind = if trial % 4 == 0 { Kind::Thin } else { Kind::TiltedThick };
        let scene = if is_riding { riding(rng, kind) } else { round(rng, trial % 3 != 0) };
        let plan = CompiledScene::<f64>::compile(&scene, Tier::Exact { tolerance: 1e-6 }).expect("valid");
        let along = scene.cells[0].detector.x_axis_base;
        let at = |shift_m: f64| Pose { translation_m: along * shift_m, ..Pose::HOME };
        let is_lit = |shift_m: f64| plan.respond(0, &at(shift_m)).status == Status::Lit;
        let (mut low, mut high) = (0.0, 9e-3);
        if !is_lit(low) || is_lit(high) {
            continue;
        }
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            *(if is_lit(middle) { &mut low } else { &mut high }) = middle;
        }
        let [(_, whole, slopes), (_, cut, beyond)] = [low, high].map(|shift_m| plan.linearise(0, &at(shift_m)));
        // Twice the tolerance of the currents, and twice what derivatives err. Those of a slit's light jump.
        let off = (whole.i_x1_a - cut.i_x1_a).abs().max((whole.i_x2_a - cut.i_x2_a).abs());
        assert!(off <= 2e-6 * whole.total_a(), "{trial}: {whole:?} {cut:?}");
        let jump = (slopes[0][0] - beyond[0][0]).abs().max((slopes[1][0] - beyond[1][0]).abs());
        assert!(is_riding || jump <= 2.4e-2 * whole.total_a(), "{trial}: {slopes:?} {beyond:?}");
        compared[usize::from(is_riding)] += 1;
    }
    assert!(compared.iter().all(|&count| count > 20), "{compared:?}");
}

#[test]
fn nothing_passes_an_opening_that_is_not_between_emitter_and_detector() {
    let rng = &mut generator();
    for scene in [riding(rng, Kind::Thick), riding(rng, Kind::Tilted), round(rng, true), round(rng, false)] {
        let cell = &scene.cells[0];
        let height_m = (cell.emitter.position_tool_m - cell.detector.centre_base_m).dot(cell.detector.normal_base);
        let is_riding = cell.effects.opening == Opening::RidingSlit;
        let mut behind = scene.clone();
        behind.cells[0].slit.distance_m = height_m + 0.5e-3;
        // As far down as the emitter is above the detector: a slit on the tool is below it, a hole above the emitter.
        let sunk = Pose { translation_m: cell.detector.normal_base * -(height_m - 1e-3), ..Pose::HOME };
        for (scene, pose) in [(&behind, Pose::HOME), (&scene, sunk)] {
            let plan = CompiledScene::<f64>::compile(scene, EXACT).expect("a valid scene");
            assert_eq!(plan.respond(0, &pose).status, Status::Behind, "riding: {is_riding}");
            assert_eq!(plan.photocurrents(0, &pose).total_a(), 0.0);
            assert!(plan.spot_outline_m(0, &pose).is_empty());
        }
    }
}

/// A slit on the tool is in front of its own emitter: what light of it falls on another detector has passed that slit.
#[test]
fn light_of_a_riding_slit_falls_on_any_detector_it_meets() {
    let rng = &mut generator();
    let mut scene = riding(rng, Kind::Thin);
    let first = scene.cells[0].clone();
    let axes = cell_axes(&first);
    let apart = axes.y_axis * 3e-3;
    let mut second = first.clone();
    second.detector.centre_base_m += apart;
    second.emitter.position_tool_m += apart;
    // The first's slit and emitter before the second's detector, as one cell.
    let mut across = first.clone();
    across.detector.centre_base_m += apart;
    across.slit.offset_m.y -= 3e-3;
    scene.cells.push(second).expect("room");
    let plan = CompiledScene::<f64>::compile(&scene, EXACT).expect("valid");
    let across = Scene { cells: [across].into_iter().collect(), ..scene.clone() };
    let across = CompiledScene::<f64>::compile(&across, EXACT).expect("valid");
    for pose in [Pose::HOME, common::pose(rng, &scene, 0.5e-3, 0.1)] {
        let (light, expected) = (plan.crosstalk(1, 0, &pose), across.photocurrents(0, &pose));
        assert!(expected.total_a() > 1e-8, "{expected:?}");
        assert!((light.i_x1_a - expected.i_x1_a).abs() < 2e-10 * expected.total_a(), "{light:?} {expected:?}");
    }
}
