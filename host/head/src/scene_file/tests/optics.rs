//! Effects, slits on the tool, holes, lenses, and detectors with two axes: values in SI, cells of their own, and refusals with
//! their place.

use glam::DVec3;
use slitpose_model::{Cell, Effects, Opening, Stray, Window};

use super::*;

const SIZES: &str = "width_mm = 0.6\nlength_mm = 10.0\n";

/// The first cell's opening, its width and its length in mm.
fn opening(text: &str) -> (Opening, [f64; 2]) {
    let file = parse(text).unwrap_or_else(|error| panic!("{error}"));
    let cell = &file.scene.cells[0];
    (cell.effects.opening, [cell.slit.width_m, cell.slit.length_m].map(|size| (size * 1e6).round() * 1e-3))
}

#[test]
fn the_keys_of_a_slit_say_what_the_light_passes_through() {
    let with = |keys: &str| opening(&changed(SIZES, keys, ""));
    assert_eq!(with(SIZES), (Opening::Slit, [0.6, 10.0]));
    assert_eq!(with("width_mm = 0.6\nlength_mm = 10.0\nmount = \"base\"\n"), (Opening::Slit, [0.6, 10.0]));
    assert_eq!(with("width_mm = 0.6\nlength_mm = 10.0\nmount = \"tool\"\n"), (Opening::RidingSlit, [0.6, 10.0]));
    assert_eq!(with("diameter_mm = 0.4\n"), (Opening::Pinhole, [0.4, 0.4]));
    let lens = Opening::Lens { focal_length_m: 10.6 * 1e-3 };
    assert_eq!(with("diameter_mm = 5\nfocal_length_mm = 10.6\n"), (lens, [5.0, 5.0]));
}

#[test]
fn a_cell_may_have_a_hole_among_slits_and_a_slit_among_holes() {
    assert_eq!(opening(&format!("{LEAST}slit = {{ diameter_mm = 0.4 }}\n")), (Opening::Pinhole, [0.4, 0.4]));
    let holes = changed(SIZES, "diameter_mm = 0.4\n", "slit = { width_mm = 0.5, length_mm = 8 }\n");
    assert_eq!(opening(&holes), (Opening::Slit, [0.5, 8.0]));
    // The lens of the default is not that of a cell with sizes of its own.
    let lens = "diameter_mm = 0.4\nfocal_length_mm = 9\n";
    let lenses = |own: &str| opening(&changed(SIZES, lens, &format!("slit = {{ {own} }}\n")));
    assert_eq!(lenses("width_mm = 0.5, length_mm = 8"), (Opening::Slit, [0.5, 8.0]));
    assert_eq!(lenses("diameter_mm = 0.3"), (Opening::Pinhole, [0.3, 0.3]));
    assert_eq!(lenses("distance_mm = 5.5").0, Opening::Lens { focal_length_m: 9.0 * 1e-3 });
}

#[test]
fn openings_that_cannot_be_are_refused_at_their_place() {
    let slit = |keys: &str| format!("{SIZES}{keys}\n");
    for (keys, place, fault) in [
        (slit("mount = \"air\""), "9:9", "slit.mount = \"air\" is out of range; give \"base\" or \"tool\""),
        (slit("diameter_mm = 1"), "9:15", "neither width_mm nor length_mm; remove those or this"),
        (slit("focal_length_mm = 9.0"), "9:19", "slit.focal_length_mm = 9.0: a lens fills a round hole"),
        ("diameter_mm = 1\nmount = \"tool\"\n".to_owned(), "8:9", "a round hole is on the base"),
        ("diameter_mm = 1\nfocal_length_mm = 0\n".to_owned(), "8:19", "slit.focal_length_mm = 0: 0 is not positive"),
        ("diameter_mm = -5\n".to_owned(), "7:15", "slit.diameter_mm = -5: -5 is negative"),
        (
            "diameter_mm = 1\ntilt_deg = [0, 0, 1]\n".to_owned(),
            "8:12",
            "a tilt cannot be computed with a pinhole; leave",
        ),
    ] {
        assert_refused_at(&changed(SIZES, &keys, ""), place, fault);
    }
}

#[test]
fn a_second_axis_reads_the_same_light_across() {
    let first = "slit = { offset_mm = [0.2, -0.1], tilt_deg = [1, -2, 1], width_mm = 2, length_mm = 3 }\n";
    let text = format!("{LEAST}{first}detector = {{ width_mm = 8 }}\n[[cell]]\nsecond_axis_of = 0\n");
    let file = parse(&text).unwrap();
    assert_eq!(file.lighting.slots, [vec![0, 1], vec![]]);
    let axes = |cell: usize| file.scene.cells[cell].effects.other_axis;
    assert_eq!((axes(0), axes(1)), (Some(1), Some(0)));
    assert!(file.scene.cells.iter().all(|cell| cell.effects.lit_together == 0));
    let plan = CompiledScene::<f64>::compile(&file.scene, Tier::Exact { tolerance: 1e-12 }).unwrap();
    let of = |cell, pose: &Pose| plan.respond(cell, pose);
    let (here, there) = (Pose::HOME, Pose::from_vectors(DVec3::new(0.0, 0.3e-3, 0.2e-3), DVec3::ZERO));
    let outline = |cell, pose: &Pose| {
        let corners = plan.spot_outline_m(cell, pose);
        let count = corners.len() as f64;
        [0, 1].map(|axis| corners.iter().map(|corner| corner[axis]).sum::<f64>() / count)
    };
    for pose in [&here, &there] {
        let (x, y) = (of(0, pose), of(1, pose));
        assert_eq!(x.status, Status::Lit);
        // The whole photocurrent on each pair. A turned slit counts as a rectangle here.
        assert!((x.i_o_a / y.i_o_a - 1.0).abs() < 2e-3, "{} {}", x.i_o_a, y.i_o_a);
        let ([own_x, own_y], [across_x, across_y]) = (outline(0, pose), outline(1, pose));
        assert!(
            (across_x - own_y).abs() < 2e-5 && (across_y + own_x).abs() < 2e-5,
            "{own_x} {own_y} {across_x} {across_y}"
        );
    }
}

#[test]
fn second_axes_of_nothing_are_refused() {
    let second = "[[cell]]\nsecond_axis_of = ";
    let everything = "slit cannot be given for a second axis, which has everything from cell 0; remove it";
    for (cells, place, fault) in [
        (
            format!("{second}0\n[lighting]\nslots = [[0], [1], []]\n"),
            "21:9",
            "both axes of one detector; give them one slot",
        ),
        (format!("{second}1\n"), "19:18", "second_axis_of = 1 is no earlier cell; give"),
        (format!("{second}-1\n"), "19:18", "second_axis_of = -1 is out of range; give a whole number from 0 to 15"),
        (format!("{second}0\n{second}0\n"), "21:18", "has a second axis already"),
        (format!("{second}0\n{second}1\n"), "21:18", "is a second axis itself"),
        (format!("{second}0\nslit = {{ width_mm = 1 }}\n"), "20:8", everything),
    ] {
        assert_refused_at(&format!("{LEAST}{cells}"), place, fault);
    }
}

/// `LEAST` with `keys` in `section`, or in a section of their own, and what they make of the cell.
fn effects(section: &str, keys: &str) -> Effects {
    let header = format!("[{section}]\n");
    let text = if LEAST.contains(&header) {
        changed(&header, &format!("{header}{keys}\n"), "")
    } else {
        format!("{LEAST}{header}{keys}\n")
    };
    parse(&text).unwrap_or_else(|error| panic!("{error}")).scene.cells[0].effects.clone()
}

#[test]
fn every_effect_becomes_si() {
    assert_eq!(effects("emitter", "source_diameter_mm = 0.3").source_diameter_m, 0.3 * 1e-3);
    let shaped = effects("emitter", "profile_radial = [1, -2, 3, 4]\nprofile_azimuthal = [0.1, 0.2, 0.3, 0.4]").profile;
    assert_eq!((shaped.radial, shaped.azimuthal), ([1.0, -2.0, 3.0, 4.0], [0.1, 0.2, 0.3, 0.4]));
    let bent = effects("detector", "nonlinearity_mm = [0.0, 0.06, -0.02, 0, 0.01]");
    assert_eq!(bent.nonlinearity_m.as_slice(), [0.0, 0.06, -0.02, 0.0, 0.01].map(|value| value * 1e-3));
    assert_eq!(effects("detector", "electrode_gain = [1.01, 0.98]").electrode_gain, [1.01, 0.98]);
    let window = Some(Window { thickness_m: 0.7 * 1e-3, refractive_index: 1.52 });
    assert_eq!(effects("window", "thickness_mm = 0.7\nrefractive_index = 1.52").window, window);
    let stray = effects(
        "stray",
        "current_a = 1e-7\ncentre_mm = 3.0\nlinear_a_per_mm = [[1e-9, 2e-9, 3e-9], [4e-9, 5e-9, 6e-9]]\n\
         quadratic_a_per_mm2 = [[0, 0, 0, 0, 0, 2e-9], [1e-9, 0, 0, 0, 0, 0]]",
    );
    let Stray { constant_a, linear_a_per_m, quadratic_a_per_m2, .. } = stray.stray.unwrap();
    // A quarter of the detector's length towards electrode 2.
    assert!((constant_a[0] - 0.25e-7).abs() < 1e-21 && (constant_a[1] - 0.75e-7).abs() < 1e-21);
    assert_eq!(linear_a_per_m, [[1e-9, 2e-9, 3e-9], [4e-9, 5e-9, 6e-9]].map(|row| row.map(|value| value * 1e3)));
    assert_eq!((quadratic_a_per_m2[0][5], quadratic_a_per_m2[1][0]), (2e-9 * 1e3 * 1e3, 1e-9 * 1e3 * 1e3));
    let curves = effects("converter", "full_scale_a = 1e-5\ncurve_1_a = [0, 1e-9]\ncurve_2_a = [0, 0, 2e-9]");
    let converters = curves.converters.unwrap();
    assert_eq!(converters.full_scale_a, 1e-5);
    assert_eq!(converters.curves_a.each_ref().map(|curve| curve.as_slice()), [&[0.0, 1e-9][..], &[0.0, 0.0, 2e-9]]);
}

#[test]
fn effects_at_zero_leave_a_cell_ideal() {
    for (section, keys) in [
        ("emitter", "source_diameter_mm = 0\nprofile_radial = [0, 0, 0, 0]\nprofile_azimuthal = [0, 0, 0, 0]"),
        ("detector", "nonlinearity_mm = [0.0, 0, 0.0]\nelectrode_gain = [1, 1]"),
        ("window", "thickness_mm = 0\nrefractive_index = 1.52"),
        ("stray", "current_a = 0.0\ncentre_mm = 1.0\nlinear_a_per_mm = [[0, 0, 0], [0, 0, 0]]"),
        ("converter", "full_scale_a = 1e-5\ncurve_1_a = [0]"),
    ] {
        assert_eq!(effects(section, keys), Effects::default(), "[{section}]\n{keys}");
    }
    for shipped in &SHIPPED {
        let file = SceneFile::open(shipped.name).unwrap();
        for Cell { effects, .. } in &file.scene.cells {
            let (opening, other_axis) = (effects.opening, effects.other_axis);
            assert_eq!(*effects, Effects { opening, other_axis, ..Effects::default() }, "{}", shipped.name);
        }
    }
}

#[test]
fn a_cell_overrides_effects_key_by_key() {
    let own = "window = { thickness_mm = 0.5 }\nstray = { current_a = 1e-8 }\n\
               converter = { full_scale_a = 1e-5, curve_1_a = [1e-9] }\n";
    let defaults = "[window]\nthickness_mm = 0.7\nrefractive_index = 1.6\n";
    let effects = parse(&format!("{LEAST}{own}{defaults}")).unwrap().scene.cells[0].effects.clone();
    assert_eq!(effects.window, Some(Window { thickness_m: 0.5 * 1e-3, refractive_index: 1.6 }));
    assert_eq!(effects.stray, Some(Stray::at(1e-8, 0.0, 12e-3)));
    assert_eq!(effects.converters.unwrap().curves_a[0].as_slice(), [1e-9]);
}

#[test]
fn effects_that_cannot_be_are_refused_at_their_place() {
    for (text, place, fault) in [
        (format!("{LEAST}[window]\nthickness_mm = 0.7\n"), "18:1", "window.refractive_index is missing"),
        (format!("{LEAST}window = {{ thickness_mm = 1 }}\n"), "12:1", "window.refractive_index is missing"),
        (format!("{LEAST}[window]\nthickness_mm = -1\nrefractive_index = 1.5\n"), "19:16", "-1 is negative"),
        (format!("{LEAST}[window]\nthickness_mm = 1\nrefractive_index = 0.5\n"), "20:20", "below 1"),
        (format!("{LEAST}[stray]\ncurrent_a = -1e-9\n"), "19:13", "zero or more"),
        (format!("{LEAST}[stray]\ncentre_mm = 7\n"), "19:13", "a place on the detector"),
        (format!("{LEAST}[stray]\nlinear_a_per_mm = [[1, 2, 3]]\n"), "19:19", "two rows of three numbers, by t_x"),
        (format!("{LEAST}stray.linear_a_per_mm = [[1, 2], [3, 4]]\n"), "18:26", "two rows of three"),
        (format!("{LEAST}[stray]\nquadratic_a_per_mm2 = 1\n"), "19:23", "two rows of six numbers, by t_x², t_y²"),
        (format!("{LEAST}[converter]\ncurve_1_a = [1e-9]\n"), "18:1", "converter.full_scale_a is missing"),
        (format!("{LEAST}[converter]\nfull_scale_a = -1\ncurve_1_a = [1e-9]\n"), "19:16", "-1 is not positive"),
        (
            format!("{LEAST}[converter]\nfull_scale_a = 1\ncurve_2_a = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10]\n"),
            "20:13",
            "at most 10 numbers",
        ),
        (changed("width_mm = 1.0", "nonlinearity_mm = 0.1\nwidth_mm = 1.0", ""), "3:19", "at most 12 numbers"),
        (changed("width_mm = 1.0", "electrode_gain = [1]\nwidth_mm = 1.0", ""), "3:18", "those of I_X1 and I_X2"),
        (changed("width_mm = 1.0", "electrode_gain = [1, 0]\nwidth_mm = 1.0", ""), "3:18", "not positive"),
        (format!("{LEAST}emitter.source_diameter_mm = -0.3\n"), "18:30", "-0.3 is negative"),
        (format!("{LEAST}emitter.profile_radial = [1, 2]\n"), "18:26", "four numbers"),
        (format!("{LEAST}emitter.profile = {:?}\n", [[0, 1]; 100]), "18:19", "profile has 100 knots; give at most"),
        (format!("{LEAST}emitter.profile_azimuthal = [nan, 0, 0, 0]\n"), "18:30", "a finite number"),
    ] {
        assert_refused_at(&text, place, fault);
    }
}
