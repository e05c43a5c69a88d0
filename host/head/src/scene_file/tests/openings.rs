//! Slits on the tool, holes, lenses, and detectors with two axes.

use glam::DVec3;
use slitpose_model::Opening;

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
    for (keys, parts) in [
        ("mount = \"air\"", ["scene.toml:9:9", "slit.mount = \"air\": give \"base\" or \"tool\""]),
        ("diameter_mm = 1", ["scene.toml:9:15", "neither width_mm nor length_mm; remove those or this"]),
        ("focal_length_mm = 9.0", ["scene.toml:9:19", "slit.focal_length_mm = 9.0: a lens fills a round hole"]),
    ] {
        assert_refused(&changed(SIZES, &format!("{SIZES}{keys}\n"), ""), &parts);
    }
    let rides = changed(SIZES, "diameter_mm = 1\nmount = \"tool\"\n", "");
    assert_refused(&rides, &["scene.toml:8:9", "a round hole is on the base"]);
    let flat = changed(SIZES, "diameter_mm = 1\nfocal_length_mm = 0\n", "");
    assert_refused(&flat, &["scene.toml:8:19", "slit.focal_length_mm = 0: 0 is not positive"]);
    let small = changed(SIZES, "diameter_mm = -5\n", "");
    assert_refused(&small, &["scene.toml:7:15", "slit.diameter_mm = -5: -5 is negative"]);
    let tilted = changed(SIZES, "diameter_mm = 1\ntilt_deg = [0, 0, 1]\n", "");
    assert_refused(&tilted, &["scene.toml:8:12", "a tilt cannot be computed with a pinhole; leave it out"]);
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
    let with = |cells: &str| format!("{LEAST}{cells}");
    let second = "[[cell]]\nsecond_axis_of = ";
    let apart = format!("{LEAST}{second}0\n[lighting]\nslots = [[0], [1], []]\n");
    assert_refused(&apart, &["scene.toml:21:9", "cells 0 and 1 read both axes of one detector; give them one slot"]);
    assert_refused(
        &with(&format!("{second}1\n")),
        &["scene.toml:19:18", "second_axis_of = 1 is no earlier cell; give"],
    );
    assert_refused(&with(&format!("{second}-1\n")), &["second_axis_of = -1 is no earlier cell"]);
    assert_refused(&with(&format!("{second}0\n{second}0\n")), &["scene.toml:21:18", "has a second axis already"]);
    assert_refused(&with(&format!("{second}0\n{second}1\n")), &["is a second axis itself"]);
    assert_refused(
        &with(&format!("{second}0\nslit = {{ width_mm = 1 }}\n")),
        &["scene.toml:20:8", "slit cannot be given for a second axis, which has everything from cell 0; remove it"],
    );
}
