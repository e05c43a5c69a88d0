//! Two six-cell heads and every single cell, ordinary and extreme, through the `slitpose model` process, against
//! independent multi-precision integration; and single precision against double.

use std::path::Path;

use slitpose_model::{CompiledScene, Pose, Tier};
use slitpose_tests::process::Slitpose;
use slitpose_tests::reference::{self, data, single_cell_scene_file};
use slitpose_tests::table::{Row, Table};
use slitpose_tests::{scenes, slitpose};

const HOME: &str = "id,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad\nhome,0,0,0,0,0,0\n";

/// The promise of both tiers: nine digits of every current. The exact tier integrates to 1e-10 by
/// default, the reference to 1e-14, the paper's closed forms to rounding.
const RELATIVE: f64 = 1e-9;

fn model(command: Slitpose, scene: &Path, poses: &str, tier: &str) -> Table {
    let scene = scene.to_str().expect("UTF-8 path");
    let output = command.run_with_input(["model", scene, "--poses", "-", "--tier", tier], poses);
    assert_eq!(output.stderr, "");
    Table::parse(&output.done())
}

/// Compares a current and returns its relative error.
fn compare(row: &Row<'_>, column: &str, expected: f64) -> f64 {
    let value = row.number(column);
    let error = (value - expected).abs();
    assert!(error <= RELATIVE * expected, "{} {column}: {value:e}, reference {expected:e}", row.text("id"));
    if expected > 0.0 { error / expected } else { 0.0 }
}

fn check_six_cells(scene: &str, tier: &str) {
    let reference = reference::table(&format!("reference/six_cell_{scene}_poses.csv"));
    let poses = std::fs::read_to_string(data(&format!("reference/six_cell_{scene}_poses.csv"))).expect("poses");
    // The whole reference table goes in: its other columns must not disturb.
    let table = model(slitpose!(), &data(&format!("reference/six_cell_{scene}.toml")), &poses, tier);
    assert_eq!(table.rows().len(), reference.rows().len());
    let (mut largest, mut without_light) = (0_f64, 0);
    for (row, expected) in table.rows().zip(reference.rows()) {
        assert_eq!(row.text("id"), expected.text("id"));
        for cell in 0..6 {
            let status = row.text(&format!("status_{cell}"));
            assert_eq!(status, expected.text(&format!("status_{cell}")), "{}, cell {cell}", row.text("id"));
            let reference = |electrode| expected.number(&format!("{tier}_i_x{electrode}_{cell}_a"));
            for electrode in 1..=2 {
                largest = largest.max(compare(&row, &format!("i_x{electrode}_{cell}_a"), reference(electrode)));
            }
            largest = largest.max(compare(&row, &format!("i_o_{cell}_a"), reference(1) + reference(2)));
            let has_light = reference(1) + reference(2) > 0.0;
            without_light += usize::from(!has_light);
            // In the paper tier X_A is the middle of the spot, whether or not the emitter looks at it.
            let has_x_a = if tier == "paper" { matches!(status, "lit" | "clipped") } else { has_light };
            assert_eq!(!row.text(&format!("x_a_{cell}_mm")).is_empty(), has_x_a, "{}", row.text("id"));
        }
    }
    println!(
        "{scene}, {tier}: {} poses, {without_light} cells without light, largest error {largest:.1e}",
        table.rows().len()
    );
    assert!(table.rows().len() >= 30, "the reference table has shrunk");
}

#[test]
fn six_cells_of_two_heads_in_both_tiers() {
    for scene in ["base", "wide"] {
        for tier in ["paper", "exact"] {
            check_six_cells(scene, tier);
        }
    }
}

#[test]
fn every_single_cell_goes_through_scene_file_and_process() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("cell.toml");
    // X_A: rounding of 12 mm in the paper tier, a nanometre where integrated to 1e-10.
    for (tier, x_tolerance_mm) in [("paper", 1e-9), ("exact", 1e-6)] {
        for expected in reference::table("reference/single_cell.csv").rows() {
            let name = expected.text("name");
            std::fs::write(&path, single_cell_scene_file(&expected)).expect("scene");
            let table = model(slitpose!(), &path, HOME, tier);
            let row = table.rows().next().expect("one row");
            assert_eq!(row.text("status_0"), expected.text("status"), "{name}");
            let reference = |column: &str| expected.number(&format!("{tier}_{column}"));
            for (column, current) in [("i_o_0_a", "i_o_a"), ("i_x1_0_a", "i_x1_a"), ("i_x2_0_a", "i_x2_a")] {
                let error = compare(&row, column, reference(current));
                println!("{name}, {tier}, {column}: {error:.1e}");
            }
            compare(&row, "solid_angle_0_sr", reference("solid_angle_sr"));
            match row.text("x_a_0_mm") {
                "" => assert!(reference("x_a_mm").is_nan(), "{name}: X_A missing"),
                _ => {
                    let error = (row.number("x_a_0_mm") - reference("x_a_mm")).abs();
                    assert!(error <= x_tolerance_mm, "{name}, {tier}: X_A off by {error:e} mm");
                }
            }
        }
    }
}

#[test]
fn single_precision_follows_double_precision() {
    for row in reference::table("reference/single_cell.csv").rows() {
        // Cut by an edge of the detector, or far beyond what single precision resolves of the
        // distance between emitter and horizon: no bound is claimed there.
        if row.text("status") != "lit" || row.text("name").starts_with("grazing") {
            continue;
        }
        let scene = scenes::parse(&single_cell_scene_file(&row)).scene;
        for tier in [Tier::Paper, Tier::Exact { tolerance: 1e-6 }] {
            let double = CompiledScene::<f64>::compile(&scene, tier).expect("scene").respond(0, &Pose::HOME);
            let single = CompiledScene::<f32>::compile(&scene, tier).expect("scene").respond(0, &Pose::HOME);
            if double.i_o_a == 0.0 {
                assert_eq!(single.i_o_a, 0.0, "{}", row.text("name"));
                continue;
            }
            let error = (f64::from(single.i_o_a) - double.i_o_a).abs() / double.i_o_a;
            println!("{} {tier:?}: {error:.1e}", row.text("name"));
            assert!(error <= 1e-5, "{}: {error:e}", row.text("name"));
        }
    }
}
