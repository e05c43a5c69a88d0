//! Effects: each key's value in SI, cells of their own, and refusals with their place.

use slitpose_model::{Cell, Effects, Stray, Window};

use super::*;

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
    let Stray { constant_a, linear_a_per_m, quadratic_a_per_m2 } = stray.stray.unwrap();
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
    for (text, parts) in [
        (format!("{LEAST}[window]\nthickness_mm = 0.7\n"), ["scene.toml:18:1", "window.refractive_index is missing"]),
        (
            format!("{LEAST}window = {{ thickness_mm = 1 }}\n"),
            ["scene.toml:12:1", "window.refractive_index is missing"],
        ),
        (
            format!("{LEAST}[window]\nthickness_mm = -1\nrefractive_index = 1.5\n"),
            ["scene.toml:19:16", "-1 is negative"],
        ),
        (format!("{LEAST}[window]\nthickness_mm = 1\nrefractive_index = 0.5\n"), ["scene.toml:20:20", "below 1"]),
        (format!("{LEAST}[stray]\ncurrent_a = -1e-9\n"), ["scene.toml:19:13", "zero or more"]),
        (format!("{LEAST}[stray]\ncentre_mm = 7\n"), ["scene.toml:19:13", "a place on the detector"]),
        (format!("{LEAST}[stray]\nlinear_a_per_mm = [[1, 2, 3]]\n"), ["scene.toml:19:19", "two rows of three numbers"]),
        (format!("{LEAST}stray.linear_a_per_mm = [[1, 2], [3, 4]]\n"), ["scene.toml:18:26", "two rows of three"]),
        (format!("{LEAST}[stray]\nquadratic_a_per_mm2 = 1\n"), ["scene.toml:19:23", "two rows of six numbers"]),
        (format!("{LEAST}[converter]\ncurve_1_a = [1e-9]\n"), ["scene.toml:18:1", "converter.full_scale_a is missing"]),
        (
            format!("{LEAST}[converter]\nfull_scale_a = -1\ncurve_1_a = [1e-9]\n"),
            ["scene.toml:19:16", "-1 is not positive"],
        ),
        (
            format!("{LEAST}[converter]\nfull_scale_a = 1\ncurve_2_a = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10]\n"),
            ["scene.toml:20:13", "at most 10 numbers"],
        ),
        (
            changed("width_mm = 1.0", "nonlinearity_mm = 0.1\nwidth_mm = 1.0", ""),
            ["scene.toml:3:19", "at most 12 numbers"],
        ),
        (changed("width_mm = 1.0", "electrode_gain = [1]\nwidth_mm = 1.0", ""), ["scene.toml:3:18", "two numbers"]),
        (changed("width_mm = 1.0", "electrode_gain = [1, 0]\nwidth_mm = 1.0", ""), ["scene.toml:3:18", "not positive"]),
        (format!("{LEAST}emitter.source_diameter_mm = -0.3\n"), ["scene.toml:18:30", "-0.3 is negative"]),
        (format!("{LEAST}emitter.profile_radial = [1, 2]\n"), ["scene.toml:18:26", "four numbers"]),
        (format!("{LEAST}emitter.profile_azimuthal = [nan, 0, 0, 0]\n"), ["scene.toml:18:30", "a finite number"]),
    ] {
        assert_refused(&text, &parts);
    }
}
