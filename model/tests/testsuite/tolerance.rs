//! Each electrode keeps the tolerance that the exact tier is given, and the tier does not waste nodes on much less.

use glam::{DQuat, DVec2, DVec3};
use rand_chacha::ChaCha8Rng;
use slitpose_model::{Cell, CompiledScene, Pose, Profile, Scene, Tier};

use crate::common::{KINDS, Kind, generator, pose, scene, uniform, vector};

/// The rule of [`photocurrents`] on each panel.
const ORACLE_NODES: usize = 16;

/// Electrode currents of a cell whose profile is a low power of cos γ, without its dark current: Gauss–Legendre on panels
/// that are narrow beside the distance and the distance from the line γ = 90°. It shares no code with the model.
fn photocurrents(cell: &Cell, pose: &Pose) -> Option<[f64; 2]> {
    let Profile::Cosine { exponent: exponent @ 0.0..=4.0 } = &cell.emitter.profile else { return None };
    let detector = &cell.detector;
    let axes = [detector.x_axis_base, detector.normal_base.cross(detector.x_axis_base), detector.normal_base];
    let to_cell = |v: DVec3| DVec3::from(axes.map(|axis| axis.dot(v)));
    let emitter = to_cell(pose.rotation * cell.emitter.position_tool_m + pose.translation_m - detector.centre_base_m);
    let axis = to_cell(pose.rotation * cell.emitter.axis_tool);
    // The spot, from the emitter's foot: the detector within the shadow of each face of the mask.
    let [hx, hy] = [0.5 * detector.length_m, 0.5 * detector.width_m];
    let foot = emitter.truncate();
    let mut spot: Vec<DVec2> =
        [[-hx, -hy], [hx, -hy], [hx, hy], [-hx, hy]].map(|corner| DVec2::from(corner) - foot).to_vec();
    let slit = &cell.slit;
    let turn = DQuat::from_scaled_axis(slit.tilt_rad);
    for side in [-0.5, 0.5] {
        let corners = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]].map(|[i, j]| {
            let within = DVec3::new(i * slit.width_m, j * slit.length_m, side * slit.thickness_m);
            DVec3::new(slit.offset_m.x, slit.offset_m.y, slit.distance_m) + turn * within
        });
        if corners.iter().any(|corner| corner.z >= emitter.z) {
            return None;
        }
        let shadow = corners.map(|corner| (corner.truncate() - foot) * (emitter.z / (emitter.z - corner.z)));
        for (i, &from) in shadow.iter().enumerate() {
            let along = shadow[(i + 1) % 4] - from;
            spot = clipped(&spot, |point| along.perp_dot(point - from));
        }
    }
    let front = |point: DVec2| axis.dot(point.extend(-emitter.z));
    spot = clipped(&spot, front);
    let rule = gauss_legendre();
    // Across the line γ = 90°, in slabs between the corners.
    let inclination = axis.truncate().length();
    let across = if inclination > 0.0 { axis.truncate() / inclination } else { DVec2::Y };
    let to_turned = |point: DVec2| DVec2::new(across.perp_dot(point), across.dot(point));
    let turned: Vec<DVec2> = spot.iter().map(|&point| to_turned(point)).collect();
    let mut levels: Vec<f64> = turned.iter().map(|point| point.y).collect();
    levels.sort_by(f64::total_cmp);
    let horizon = if inclination > 0.0 { axis.z * emitter.z / inclination } else { f64::NEG_INFINITY };
    let widest = 0.5 * emitter.z;
    let mut sums = [0.0; 2];
    for level in levels.windows(2) {
        let ends = |t: f64| {
            let crossings = turned.iter().enumerate().filter_map(|(i, a)| {
                let b = turned[(i + 1) % turned.len()];
                let is_crossed = a.y.min(b.y) <= level[0] && a.y.max(b.y) >= level[1] && a.y != b.y;
                is_crossed.then(|| a.x + (b.x - a.x) * (t - a.y) / (b.y - a.y))
            });
            crossings.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], s| [low.min(s), high.max(s)])
        };
        let [low, high] = ends(0.5 * (level[0] + level[1]));
        if level[1] <= level[0] || high <= low {
            continue;
        }
        let mut from = level[0];
        while from < level[1] {
            // Half of the way from the horizon, but for the last bit of it.
            let depth = (from - horizon).max(1e-12 * (level[1] - level[0])).max(1e-15 * from.abs());
            let to = level[1].min(from + widest.min(depth));
            let to = if level[1] - to < 0.25 * (to - from) { level[1] } else { to };
            for &(eta, weight_t) in &rule {
                let t = from + 0.5 * (to - from) * (1.0 + eta);
                let [low, high] = ends(t);
                let panels = ((high - low) / widest).ceil();
                let half = 0.5 * (high - low) / panels;
                for panel in 0..panels as usize {
                    for &(xi, weight_s) in &rule {
                        let s = low + half * (2.0 * panel as f64 + 1.0 + xi);
                        let point = across * t + across.perp() * s;
                        let inverse = point.extend(emitter.z).length().recip();
                        let relative = (front(point) * inverse).max(0.0).powf(*exponent);
                        let light =
                            weight_t * 0.5 * (to - from) * weight_s * half * relative * emitter.z * inverse.powi(3);
                        let share = 0.5 + (point.x + foot.x) / detector.length_m;
                        sums[0] += light * (1.0 - share);
                        sums[1] += light * share;
                    }
                }
            }
            from = to;
        }
    }
    Some(sums.map(|sum| sum * detector.responsivity_a_per_w * cell.emitter.radiant_intensity_w_per_sr))
}

/// The part of a convex polygon where `inside`, which is linear, is not negative.
fn clipped(spot: &[DVec2], inside: impl Fn(DVec2) -> f64) -> Vec<DVec2> {
    let sides = spot.iter().zip(spot.iter().cycle().skip(1));
    let mut kept = Vec::new();
    for (&a, &b) in sides {
        let (fa, fb) = (inside(a), inside(b));
        if fa >= 0.0 {
            kept.push(a);
        }
        if fa * fb < 0.0 {
            kept.push(a + (b - a) * (fa / (fa - fb)));
        }
    }
    kept
}

/// Nodes and weights on −1…1.
fn gauss_legendre() -> [(f64, f64); ORACLE_NODES] {
    core::array::from_fn(|i| {
        let n = ORACLE_NODES as f64;
        let mut x = -(core::f64::consts::PI * (i as f64 + 0.75) / (n + 0.5)).cos();
        let mut slope = 0.0;
        for _ in 0..6 {
            let (mut before, mut value) = (1.0, x);
            for k in 2..=ORACLE_NODES {
                let k = k as f64;
                (before, value) = (value, ((2.0 * k - 1.0) * x * value - (k - 1.0) * before) / k);
            }
            slope = n * (x * value - before) / (x * x - 1.0);
            x -= value / slope;
        }
        (x, 2.0 / ((1.0 - x * x) * slope * slope))
    })
}

/// Errors of the electrode currents relative to the total, ascending, of scenes that are changed: against [`photocurrents`],
/// and for tables and narrow lobes against a tolerance a hundred times tighter.
fn errors(
    kind: Kind,
    change: impl Fn(&mut Scene, &mut ChaCha8Rng),
    tolerance: f64,
    turn_rad: f64,
    count: usize,
) -> Vec<f64> {
    let mut rng = generator();
    let mut errors = Vec::new();
    while errors.len() < count {
        let mut scene = scene(&mut rng, kind);
        change(&mut scene, &mut rng);
        let coarse = CompiledScene::<f64>::compile(&scene, Tier::Exact { tolerance }).expect("scene");
        let fine = CompiledScene::<f64>::compile(&scene, Tier::Exact { tolerance: 1e-2 * tolerance }).expect("scene");
        let pose = pose(&mut rng, &scene, 2.5e-3, turn_rad);
        let (a, b) = (coarse.photocurrents(0, &pose), fine.photocurrents(0, &pose));
        let [x1, x2] = photocurrents(&scene.cells[0], &pose).unwrap_or([b.i_x1_a, b.i_x2_a]);
        // Fainter light has fewer digits.
        if x1 + x2 > 1e-290 {
            errors.push((a.i_x1_a - x1).abs().max((a.i_x2_a - x2).abs()) / (x1 + x2));
        }
    }
    errors.sort_by(f64::total_cmp);
    errors
}

/// Detectors and slits of any size.
fn sizes(scene: &mut Scene, rng: &mut ChaCha8Rng) {
    let cell = &mut scene.cells[0];
    cell.detector.length_m = uniform(rng, 3e-3, 20e-3);
    cell.detector.width_m = uniform(rng, 0.3e-3, 6e-3);
    cell.slit.width_m = 10_f64.powf(uniform(rng, -4.0, -2.5));
    cell.slit.length_m = uniform(rng, 0.3e-3, 16e-3);
    if let Profile::Cosine { exponent } = &mut cell.emitter.profile {
        *exponent = uniform(rng, 0.0, 4.0);
    }
}

/// Emitters up to 1 m away: the first moment of light on a slit that far errs more than its power.
fn far(scene: &mut Scene, rng: &mut ChaCha8Rng) {
    sizes(scene, rng);
    let Cell { detector, emitter, .. } = &mut scene.cells[0];
    let y_axis = detector.normal_base.cross(detector.x_axis_base);
    let toward =
        detector.normal_base + detector.x_axis_base * uniform(rng, -0.7, 0.7) + y_axis * uniform(rng, -0.5, 0.5);
    emitter.position_tool_m = detector.centre_base_m + toward * 10_f64.powf(uniform(rng, -1.8, 0.0));
    emitter.axis_tool = (-toward.normalize() + vector(rng, 0.5)).normalize();
}

/// Half angles from 0.5° to 30°, in and beside the spot.
fn narrow(scene: &mut Scene, rng: &mut ChaCha8Rng) {
    scene.cells[0].emitter.profile = Profile::Cosine { exponent: 10_f64.powf(uniform(rng, 0.7, 4.3)) };
}

/// Per kind of slit and tolerance: the worst of so many scenes, turned by so much about the emitter (by 90° many beams
/// leave at grazing angles). Tables are slow, and fewer.
#[test]
fn each_electrode_keeps_the_tolerance() {
    type Change = fn(&mut Scene, &mut ChaCha8Rng);
    type Condition<'a> = (&'a str, Change, f64, &'a [Kind], &'a [f64], [usize; 2]);
    let as_they_are: Change = |_, _| ();
    let conditions: [Condition<'_>; 6] = [
        ("ordinary", as_they_are, 0.4, &KINDS, &[1e-3, 1e-6, 1e-9], [1000, 150]),
        ("across the horizon", as_they_are, 1.6, &KINDS, &[1e-6, 1e-9], [500, 50]),
        ("near", sizes, 0.4, &KINDS, &[1e-3, 1e-4, 1e-6, 1e-10], [250, 20]),
        ("hidden", sizes, 1.6, &KINDS, &[1e-3, 1e-4, 1e-6, 1e-10], [250, 20]),
        ("far", far, 0.2, &KINDS, &[1e-3, 1e-4, 1e-6, 1e-10], [250, 20]),
        ("narrow lobes", narrow, 0.4, &[Kind::Thin, Kind::TiltedThick], &[1e-3, 1e-6, 1e-9], [700, 0]),
    ];
    for (name, change, turn_rad, kinds, tolerances, counts) in conditions {
        for &kind in kinds {
            for &tolerance in tolerances {
                let errors = errors(kind, change, tolerance, turn_rad, counts[usize::from(kind == Kind::Table)]);
                let (median, worst) = (errors[errors.len() / 2] / tolerance, errors[errors.len() - 1] / tolerance);
                println!("{name} {kind:?} at {tolerance:e}: median {median:.2} of it, worst {worst:.2}");
                assert!(worst <= 1.0, "{name} {kind:?} at {tolerance:e}: {worst}");
            }
        }
    }
}

/// Work is counted, not timed: what a lobe of half angle 1° takes of the workspace of a head of six.
#[test]
fn a_lobe_narrower_than_its_spot_takes_few_values_of_its_profile() {
    let mut rng = generator();
    let mut scene = crate::common::wide();
    for cell in &mut scene.cells {
        cell.emitter.profile = Profile::from_half_angle(1_f64.to_radians());
    }
    let plan = CompiledScene::<f64>::compile(&scene, Tier::Exact { tolerance: 1e-6 }).expect("scene");
    let poses: Vec<Pose> = (0..300).map(|_| crate::common::pose_in_box(&mut rng, 4.0, 15.0)).collect();
    let integrations = poses.iter().flat_map(|pose| (0..6).filter_map(|cell| plan.respond(cell, pose).integration));
    let evaluations: Vec<usize> = integrations.map(|integration| integration.evaluations).collect();
    let mean = evaluations.iter().sum::<usize>() as f64 / evaluations.len() as f64;
    println!("{} cells: {mean:.0} values on average", evaluations.len());
    // Without leaving out where the lobe has faded it is 1200, with nodes for the whole angle's slope 900.
    assert!(mean < 450.0, "{mean}");
}

/// Work is counted, not timed: what spots take where the light may end at the emitter's horizon.
#[test]
fn a_spot_across_the_horizon_takes_few_values_of_its_profile() {
    let mut rng = generator();
    let mut evaluations: Vec<usize> = Vec::new();
    while evaluations.len() < 5000 {
        let scene = scene(&mut rng, Kind::Thin);
        let plan = CompiledScene::<f64>::compile(&scene, Tier::Exact { tolerance: 1e-6 }).expect("scene");
        let pose = pose(&mut rng, &scene, 2.5e-3, 1.6);
        evaluations.extend(plan.respond(0, &pose).integration.map(|integration| integration.evaluations));
    }
    evaluations.sort_unstable();
    let of_99 = evaluations[evaluations.len() * 99 / 100];
    let mean = evaluations.iter().sum::<usize>() as f64 / evaluations.len() as f64;
    println!("{mean:.1} values on average, 99 %: {of_99}");
    // Panels halved towards the horizon take 41 and 436.
    assert!(mean < 24.0 && of_99 < 120, "{mean} on average, 99 %: {of_99}");
}
