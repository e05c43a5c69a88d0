//! Cells in SIMD lanes against single cells, and the outputs of a plan other than currents.

use glam::{DVec2, DVec3};

use super::*;
use crate::response::Flags;
use crate::scene::{Cell, Fault, Profile};

const EXACT: Tier = Tier::Exact { tolerance: 1e-9 };

/// A cell along the base frame's axes, slightly asymmetric in every respect, so that a mix-up of
/// sides, faces, electrodes or cells is detected.
fn cell(index: usize) -> Cell {
    let shift = 0.1e-3 * (index as f64 + 1.0);
    let mut cell = crate::solve::fixture::head().cells[0].clone();
    let Cell { detector, slit, emitter, .. } = &mut cell;
    detector.centre_base_m = DVec3::new(shift, -shift, 0.0);
    (detector.x_axis_base, detector.normal_base) = (DVec3::X, DVec3::Z);
    detector.width_m = 1e-3 + shift;
    detector.responsivity_a_per_w = 0.5 + 0.02 * index as f64;
    detector.dark_current_a = 2e-6 * (index as f64 + 1.0);
    (slit.distance_m, slit.width_m) = (7e-3 + shift, 0.5e-3 + shift);
    slit.offset_m = DVec2::new(0.3e-3, 0.1e-3);
    emitter.position_tool_m = DVec3::new(0.2e-3, shift, 15e-3 + shift);
    emitter.axis_tool = DVec3::new(0.1, -0.05 * (index as f64 + 1.0), -1.0).normalize();
    emitter.radiant_intensity_w_per_sr = 3e-3 + shift;
    emitter.profile = Profile::Cosine { exponent: 1.2 + 0.1 * index as f64 };
    cell
}

fn scene(count: usize, change: impl Fn(&mut Cell)) -> Scene {
    let cells = (0..count).map(|index| {
        let mut cell = cell(index);
        change(&mut cell);
        cell
    });
    Scene { cells: cells.collect(), ..Scene::default() }
}

/// Fully lit, displaced, clipped, dark, and behind the mask.
fn poses() -> [Pose; 5] {
    [
        ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
        ([1.1e-3, 0.2e-3, -1e-3], [0.05, -0.2, 0.1]),
        ([6.4e-3, 0.0, 0.0], [0.0, 0.1, 0.0]),
        ([7.05e-3, 0.1e-3, 0.0], [0.0, 0.0, 0.0]),
        ([0.0, 0.0, -9e-3], [0.0, 0.0, 0.0]),
    ]
    .map(|(t, r)| Pose::from_vectors(DVec3::from(t), DVec3::from(r)))
}

#[cfg(all(feature = "lanes", target_arch = "x86_64"))]
fn bits(terms: &CellTerms<f64>) -> Vec<u64, 16> {
    let numbers = terms.pair.into_iter().chain(terms.jacobian.into_iter().flatten());
    numbers.chain([terms.slack_m, terms.wall_m]).map(f64::to_bits).collect()
}

/// A profile like that of a data sheet: every 5°, three decimals.
#[cfg(all(feature = "lanes", target_arch = "x86_64"))]
fn tabulated() -> Profile {
    let relative = |gamma: f64| libm::round(libm::pow(libm::cos(gamma), 1.3) * 1e3) * 1e-3;
    let knots = (0..18).map(|i| f64::from(5 * i).to_radians());
    Profile::Table(knots.map(|gamma| (gamma, relative(gamma))).collect())
}

/// Some numbers of cells of one kind, with and without each effect, at rest and moving, all or some of them.
#[cfg(all(feature = "lanes", target_arch = "x86_64"))]
#[test]
fn cells_in_lanes_have_the_bits_of_cells_alone() {
    use crate::scene::MAX_CELLS;
    use crate::solve::fixture::{EFFECTS, Effect};

    // A tool in motion, m/s and rad/s, and half its acceleration.
    const TWIST: [DVec3; 2] = [DVec3::new(0.3, -0.2, 0.5), DVec3::new(2.0, 5.0, -3.0)];
    const BEND: [DVec3; 2] = [DVec3::new(90.0, 150.0, -70.0), DVec3::new(-900.0, 800.0, 1500.0)];

    // Spots that no single rule integrates, for the horizon of an emitter that lies on its side crosses them.
    let mut turned = Pose::from_vectors(DVec3::ZERO, DVec3::new(1.56, 0.0, 0.0));
    let emitter = cell(0).emitter.position_tool_m;
    turned.translation_m = emitter - turned.rotation * emitter;
    let (mut lit, mut clipped, mut dark, mut divided) = (0, 0, 0, 0);
    let ideal = [(1, 0.0), (2, 0.3e-3), (3, 0.0), (4, 0.0), (5, 0.3e-3), (6, 0.0), (8, 0.0), (13, 0.3e-3)];
    let ideal = ideal.map(|(count, thickness_m)| scene(count, |cell| cell.slit.thickness_m = thickness_m));
    // Each effect by itself and all together, of cells that differ.
    let with = |effects: &[Effect], scene: &mut Scene| {
        for (index, cell) in scene.cells.iter_mut().enumerate() {
            effects.iter().for_each(|(_, effect)| effect(cell, 1.0 + 0.1 * index as f64));
            // Some readings are beyond the range.
            cell.effects.converters.iter_mut().for_each(|converters| converters.full_scale_a = 6e-6);
        }
    };
    let effects = EFFECTS.chunks(1).chain([&EFFECTS[..]]).map(|effects| {
        let mut scene = scene(6, |_| ());
        with(effects, &mut scene);
        scene
    });
    // Narrow lobes, tables with and without a smooth factor, and one emitter of each.
    let profiles = [(30.0, 0), (1.3, 2), (1.3, 1), (5.0, 0b111)].map(|(exponent, tables)| {
        let mut scene = scene(3, |cell| cell.emitter.profile = Profile::Cosine { exponent });
        for (index, cell) in scene.cells.iter_mut().enumerate() {
            if tables >> index & 1 == 1 {
                cell.emitter.profile = tabulated();
            }
        }
        with(if tables == 0 { &[] } else { &EFFECTS[4..5] }, &mut scene);
        scene
    });
    for scene in ideal.into_iter().chain(effects).chain(profiles) {
        let count = scene.cells.len();
        let mut plan = CompiledScene::<f64>::compile(&scene, EXACT).expect("scene");
        let offsets: Vec<f64, MAX_CELLS> = (0..count).map(|i| 34e-6 * i as f64).collect();
        for pose in poses().into_iter().chain([turned]) {
            let pose = Transform::of(&pose);
            for offsets_s in [&offsets[..0], &offsets[..]] {
                let instant = Instant { pose: &pose, twist: TWIST, bend: Some(BEND), offsets_s };
                for lanes in CellsInLanes::all(&plan).collect::<Vec<_, 2>>() {
                    plan.lanes = lanes;
                    for wanted in [u16::MAX, 0b0101_0110_1101_1011, 0b1000] {
                        let wanted = |cell: usize| wanted >> cell & 1 != 0;
                        let mut expected = (0..count).filter(|&cell| wanted(cell));
                        plan.linearise_all(&instant, wanted, |cell, terms| {
                            assert_eq!(Some(cell), expected.next());
                            let alone = evaluate::linearise(&plan, cell, &instant.pose_of(cell));
                            assert_eq!(terms.status, alone.status, "cell {cell} of {count}");
                            assert_eq!(bits(terms), bits(&alone), "cell {cell} of {count}");
                            lit += usize::from(terms.status == Status::Lit);
                            clipped += usize::from(terms.status == Status::Clipped);
                            dark += usize::from(!terms.status.has_spot());
                        });
                        assert_eq!(expected.next(), None);
                        let mut expected = (0..count).filter(|&cell| wanted(cell));
                        plan.currents_all(&instant, wanted, |cell, pair| {
                            assert_eq!(Some(cell), expected.next());
                            let Pair { i_x1_a, i_x2_a } = evaluate::photocurrents(&plan, cell, &instant.pose_of(cell));
                            assert_eq!(pair.map(f64::to_bits), [i_x1_a, i_x2_a].map(f64::to_bits));
                        });
                        assert_eq!(expected.next(), None);
                    }
                }
                let rule = |cell| evaluate::respond(&plan, cell, &pose).integration.map_or(0, |of| of.evaluations);
                // Across the horizon 104; a single rule has 25 at most here.
                divided += (0..count).filter(|&cell| rule(cell) > 100).count();
            }
        }
    }
    // Every kind of cell was there.
    assert!(lit > 100 && clipped > 100 && dark > 100 && divided > 0, "{lit} {clipped} {dark} {divided}");
}

#[cfg(all(feature = "lanes", target_arch = "x86_64"))]
#[test]
fn cells_of_several_kinds_have_no_lanes() {
    // What the third cell may differ by.
    let kinds: [&dyn Fn(&mut Cell); 6] = [
        &|cell| cell.slit.thickness_m = 0.2e-3,
        &|cell| cell.slit.tilt_rad.x = 0.1,
        &|cell| cell.effects.electrode_gain = [1.01, 1.0],
        &|cell| cell.effects.source_diameter_m = 0.2e-3,
        &|cell| cell.effects.lit_together = 1,
        &|cell| cell.effects.opening = crate::Opening::Pinhole,
    ];
    let is_alone = |scene: &Scene, tier| {
        let plan = CompiledScene::<f64>::compile(scene, tier).expect("scene");
        matches!(plan.lanes, CellsInLanes::Alone)
    };
    for (kind, change) in kinds.into_iter().enumerate() {
        let mut scene = scene(4, |cell| cell.emitter.profile = Profile::Cosine { exponent: 1.3 });
        assert!(!is_alone(&scene, EXACT));
        change(&mut scene.cells[2]);
        assert!(is_alone(&scene, EXACT), "{kind}");
        assert!(is_alone(&scene, Tier::Paper));
    }
}

/// PHYSICS: the paper tier divides I_D by equation (1) like the light, the exact tier into halves; the
/// sum of the currents contains all of I_D.
#[test]
fn dark_current_is_divided_as_each_tier_says() {
    for (tier, divided) in [(Tier::Paper, true), (EXACT, false)] {
        let dark_a = cell(0).detector.dark_current_a;
        let plan = CompiledScene::<f64>::compile(&scene(1, |_| ()), tier).expect("scene");
        let clear =
            CompiledScene::<f64>::compile(&scene(1, |cell| cell.detector.dark_current_a = 0.0), tier).expect("scene");
        let (with, without) = (plan.respond(0, &poses()[1]), clear.respond(0, &poses()[1]));
        let share = if divided { with.x_a_m.expect("light") / cell(0).detector.length_m } else { 0.0 };
        assert!((with.i_o_a - without.i_o_a - dark_a).abs() < 1e-20);
        for (a, b, share) in [
            (with.currents.i_x1_a, without.currents.i_x1_a, 0.5 - share),
            (with.currents.i_x2_a, without.currents.i_x2_a, 0.5 + share),
        ] {
            // Rounding of currents of 1e-5 A.
            assert!((a - b - share * dark_a).abs() < 1e-20, "{tier:?}: {a:e} {b:e}");
        }
        let dark = plan.respond(0, &poses()[4]);
        assert_eq!((dark.i_o_a, dark.currents.i_x1_a, dark.currents.i_x2_a), (dark_a, 0.5 * dark_a, 0.5 * dark_a));
    }
}

#[test]
fn flags_follow_the_whole_current_or_the_light_alone() {
    for tier in [Tier::Paper, EXACT] {
        let flags = |change: &dyn Fn(&mut Cell)| {
            CompiledScene::<f64>::compile(&scene(1, change), tier).expect("scene").respond(0, &Pose::HOME).flags
        };
        let response = CompiledScene::<f64>::compile(&scene(1, |_| ()), tier).expect("scene").respond(0, &Pose::HOME);
        let dark_a = cell(0).detector.dark_current_a;
        let light_a = response.i_o_a - dark_a;
        assert_eq!(response.flags, Flags::default());
        // The saturation threshold applies to the total current.
        let saturated = |limit_a: f64| flags(&|cell| cell.detector.saturation_a = Some(limit_a)).saturated;
        assert!(saturated(light_a + 0.9 * dark_a) && !saturated(light_a + 1.1 * dark_a));
        // The faint threshold applies to the photocurrent.
        let faint = |limit_a: f64| flags(&|cell| cell.detector.faint_a = limit_a).faint;
        assert!(faint(light_a + 0.1 * dark_a) && !faint(light_a - 0.1 * dark_a));
    }
}

#[test]
fn an_emitter_turned_away_is_flagged_and_sends_nothing() {
    for tier in [Tier::Paper, EXACT] {
        let turned = scene(1, |cell| cell.emitter.axis_tool = DVec3::new(0.05, 0.0, 1.0).normalize());
        let response = CompiledScene::<f64>::compile(&turned, tier).expect("scene").respond(0, &Pose::HOME);
        assert!(response.flags.facing_away && response.flags.faint && response.status == Status::Lit);
        assert_eq!(response.i_o_a, cell(0).detector.dark_current_a);
        // 90.4°: the beam's axis is behind the horizon, but part of the spot is in front of it.
        let grazing = scene(1, |cell| {
            cell.emitter.axis_tool = DVec3::X;
            cell.emitter.position_tool_m = DVec3::new(0.45e-3, 0.0, 15e-3);
        });
        let response = CompiledScene::<f64>::compile(&grazing, tier).expect("scene").respond(0, &Pose::HOME);
        assert!(response.flags.facing_away && response.gamma_rad.expect("spot") > core::f64::consts::FRAC_PI_2);
        assert_eq!(response.x_a_m.is_some(), response.i_o_a > cell(0).detector.dark_current_a || tier == Tier::Paper);
    }
}

#[test]
fn half_the_mask_reaches_down_to_the_detector() {
    let with = |thickness_m: f64| {
        CompiledScene::<f64>::compile(
            &scene(1, |cell| (cell.slit.distance_m, cell.slit.thickness_m) = (1e-3, thickness_m)),
            Tier::Paper,
        )
        .map(|_| ())
        .map_err(|error| error.fault)
    };
    assert_eq!(with(1.9e-3), Ok(()));
    assert!(matches!(with(2.2e-3), Err(Fault::MaskInDetector(below)) if (below - 0.1e-3).abs() < 1e-15));
}

/// A lowered emitter falls behind the upper face of a thick mask first.
#[test]
fn an_emitter_inside_a_thick_mask_is_behind() {
    let inside = |distance_m: f64| {
        let scene = scene(1, |cell| {
            (cell.slit.distance_m, cell.slit.thickness_m) = (7e-3, 1e-3);
            cell.emitter.position_tool_m = DVec3::new(0.0, 0.0, distance_m);
        });
        CompiledScene::<f64>::compile(&scene, Tier::Paper).expect("scene").respond(0, &Pose::HOME).status
            == Status::Behind
    };
    assert_eq!([6.8e-3, 7.2e-3, 7.5e-3, 7.6e-3].map(inside), [true, true, true, false]);
}

/// Light of one emitter through another cell's slit follows that emitter's profile and intensity.
#[test]
fn crosstalk_is_the_other_emitter_on_this_detector() {
    for tier in [Tier::Paper, EXACT] {
        let all = scene(2, |cell| cell.emitter.axis_tool = DVec3::new(0.3, 0.2, -1.0).normalize());
        let mut swapped = all.clone();
        swapped.cells[0].emitter = all.cells[1].emitter.clone();
        let (plan, alone) = (CompiledScene::<f64>::compile(&all, tier), CompiledScene::<f64>::compile(&swapped, tier));
        let (plan, alone) = (plan.expect("scene"), alone.expect("scene"));
        let pose = poses()[1];
        assert_eq!(plan.crosstalk(0, 1, &pose), alone.photocurrents(0, &pose));
        assert!(plan.crosstalk(0, 1, &pose) != plan.photocurrents(0, &pose));
    }
}

/// A small rotation of the slit changes the currents by a proportionally small amount, for any angle and
/// axis, starting from either parallel orientation.
#[test]
fn currents_are_continuous_in_the_tilt_of_the_slit() {
    for tier in [Tier::Paper, Tier::Exact { tolerance: 1e-12 }] {
        let current = |base_deg: f64, axis: DVec3, tilt_deg: f64| {
            let turned = scene(1, |cell| {
                cell.slit.tilt_rad = (DVec3::Z * base_deg + axis * tilt_deg) * core::f64::consts::PI / 180.0;
            });
            let plan = CompiledScene::<f64>::compile(&turned, tier).expect("scene");
            plan.respond(0, &Pose::from_vectors(DVec3::new(1e-3, 0.0, 0.0), DVec3::new(0.0, 0.1, 0.0))).currents
        };
        for base_deg in [0.0, 90.0] {
            for axis in [DVec3::X, DVec3::Y, DVec3::Z, DVec3::new(0.6, 0.0, 0.8)] {
                let mut tilts = [0.0; 101];
                for (i, tilt) in tilts.iter_mut().enumerate().skip(1) {
                    *tilt = libm::pow(10.0, -8.0 + 0.08 * i as f64);
                }
                for pair in tilts.windows(2) {
                    let (a, b) = (current(base_deg, axis, pair[0]), current(base_deg, axis, pair[1]));
                    let step_rad = (pair[1] - pair[0]).to_radians();
                    // Rotating a slit of 10 mm by 1 rad moves its ends by 5 mm, ten widths: currents change at most by
                    // 20 times their size. 1e-12: rounding of lengths of millimetres against a spot of 1 mm.
                    let allowed = (20.0 * step_rad + 1e-12) * a.total_a();
                    let change = (a.i_x1_a - b.i_x1_a).abs().max((a.i_x2_a - b.i_x2_a).abs());
                    assert!(change <= allowed, "{tier:?} {base_deg} {axis} {pair:?}: {change:e} > {allowed:e}");
                }
            }
        }
    }
}

#[test]
fn what_no_head_can_have_is_refused_with_its_place() {
    type Change<'a> = &'a dyn Fn(&mut Cell);
    let changes: [(&str, Change<'_>); 7] = [
        ("detector_mm", &|cell| cell.detector.centre_base_m.y = 1e197),
        ("emitter_mm", &|cell| cell.emitter.position_tool_m.z = -1e197),
        ("offset_mm", &|cell| cell.slit.offset_m.x = 1e7),
        ("distance_mm", &|cell| cell.slit.distance_m = 1e7),
        ("profile_exponent", &|cell| cell.emitter.profile = Profile::Cosine { exponent: 1e12 }),
        ("profile", &|cell| cell.emitter.profile = Profile::Table([(0.0, 1e300), (1.0, 0.0)].into_iter().collect())),
        ("radiant_intensity_w_per_sr", &|cell| cell.emitter.radiant_intensity_w_per_sr = 1e300),
    ];
    for (key, change) in changes {
        let error = CompiledScene::<f64>::compile(&scene(1, change), EXACT).map(|_| ()).expect_err("too large");
        assert!(matches!(error.fault, Fault::TooLarge(_)) && error.place.key == key, "{error}");
    }
}
