//! One cell against independent multi-precision integration, both tiers, ordinary and extreme cases.

use slitpose_model::{Plan, Pose, Response, Tier};
use slitpose_tests::reference::{self, single_cell_scene};
use slitpose_tests::table::Row;

/// 1e-10 is the default tolerance of exact evaluation outside the solver.
const EXACT: Tier = Tier::Exact { tolerance: 1e-10 };

fn respond(row: &Row<'_>, tier: Tier) -> Response<f64> {
    let plan = Plan::<f64>::compile(&single_cell_scene(row), tier).expect("reference scene");
    plan.respond(0, &Pose::HOME)
}

/// Compares with the columns that start with `prefix`: currents relative to I_O, X_A in mm.
fn check(row: &Row<'_>, prefix: &str, response: &Response<f64>, x_tolerance_mm: f64) {
    let name = row.text("name");
    assert_eq!(response.status.as_str(), row.text("status"), "{name}");
    let reference = |column: &str| row.number(&format!("{prefix}_{column}"));
    let scale = reference("i_o_a");
    for (column, value) in
        [("i_o_a", response.i_o_a), ("i_x1_a", response.currents.i_x1_a), ("i_x2_a", response.currents.i_x2_a)]
    {
        let error = (value - reference(column)).abs();
        println!("{name} {prefix} {column}: {:.1e}", error / scale.max(f64::MIN_POSITIVE));
        assert!(
            error <= 1e-9 * reference(column).abs(),
            "{name} {column}: {value:e}, reference {:e}",
            reference(column)
        );
    }
    let omega = reference("solid_angle_sr");
    assert!(
        (response.solid_angle_sr - omega).abs() <= 1e-9 * omega,
        "{name} solid angle {:e}",
        response.solid_angle_sr
    );
    match response.x_a_m {
        Some(x_a) => {
            let error = (x_a * 1e3 - reference("x_a_mm")).abs();
            println!("{name} {prefix} x_a_mm: {error:.1e}");
            assert!(error <= x_tolerance_mm, "{name} x_a {} mm, reference {}", x_a * 1e3, reference("x_a_mm"));
        }
        None => assert!(reference("x_a_mm").is_nan(), "{name}: X_A missing"),
    }
}

#[test]
fn paper_tier_equals_the_reference() {
    for row in reference::table("reference/single_cell.csv").rows() {
        check(&row, "paper", &respond(&row, Tier::Paper), 1e-9);
    }
}

#[test]
fn exact_tier_equals_the_reference() {
    for row in reference::table("reference/single_cell.csv").rows() {
        check(&row, "exact", &respond(&row, EXACT), 1e-6);
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
        for tier in [Tier::Paper, Tier::Exact { tolerance: 1e-6 }] {
            let scene = single_cell_scene(&row);
            let double = Plan::<f64>::compile(&scene, tier).expect("scene").respond(0, &Pose::HOME);
            let single = Plan::<f32>::compile(&scene, tier).expect("scene").respond(0, &Pose::HOME);
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
