//! What the reader accepts, and that each refusal names place, value and remedy.

use slitpose_model::{Pose, Profile, Status, Uncertainty};

use super::*;

mod optics;

/// The least a scene needs; line numbers below count from its first line.
const LEAST: &str = "\
[detector]
length_mm = 12.0
width_mm = 1.0
responsivity_a_per_w = 0.54
[slit]
distance_mm = 5.0
width_mm = 0.6
length_mm = 10.0
[emitter]
radiant_intensity_w_per_sr = 3.16e-3
half_angle_deg = 55.0
[[cell]]
detector_mm = [25.0, 0.0, 0.0]
x_axis = [0.0, 1.0, 0.0]
normal = [-1.0, 0.0, 0.0]
emitter_mm = [10.0, 0.0, 0.0]
emitter_axis = [1.0, 0.0, 0.0]
";

fn parse(text: &str) -> Result<SceneFile, SceneFileError> {
    SceneFile::parse("scene.toml", text)
}

/// `LEAST` with one piece of text replaced, and more lines after it.
fn changed(old: &str, new: &str, more: &str) -> String {
    assert!(LEAST.contains(old), "`{old}` is not in the scene to be changed");
    format!("{}{more}", LEAST.replacen(old, new, 1))
}

fn assert_refused(text: &str, parts: &[&str]) {
    let message = match parse(text) {
        Ok(_) => panic!("accepted:\n{text}"),
        Err(error) => error.to_string(),
    };
    for part in parts {
        assert!(message.contains(part), "`{part}` is not in: {message}");
    }
}

/// Refused at this line and column of the file.
fn assert_refused_at(text: &str, place: &str, fault: &str) {
    assert_refused(text, &[&format!("scene.toml:{place}: "), fault]);
}

#[test]
fn the_shipped_scenes_are_lit_at_home() {
    for shipped in &SHIPPED {
        let file = SceneFile::open(shipped.name).unwrap();
        let plan = CompiledScene::<f64>::compile(&file.scene, Tier::Paper).unwrap();
        for cell in 0..plan.cell_count() {
            assert_eq!(plan.respond(cell, &Pose::HOME).status, Status::Lit, "{}, cell {cell}", shipped.name);
        }
        file.require_slots_fit().unwrap();
    }
}

#[test]
fn what_is_absent_is_off() {
    let file = parse(LEAST).unwrap();
    let cell = &file.scene.cells[0];
    assert_eq!(file.name, "scene");
    assert_eq!((&file.scene.noise, &file.front_end), (&None, &None));
    let usual = Uncertainty {
        light_level_relative: 0.1,
        emitter_drift_relative: 0.01,
        emitter_drift_s: 7200.0,
        ..Uncertainty::default()
    };
    assert_eq!((file.scene.uncertainty, file.gives_light_level, file.gives_emitter_drift), (usual, false, false));
    for (given, light_level_relative) in [("0", 0.0), ("0.02", 0.02)] {
        let text = format!("{LEAST}\n[tolerance]\nlight_level_relative = {given}\nemitter_drift_minutes = 1\n");
        let file = parse(&text).unwrap();
        assert_eq!(file.scene.uncertainty, Uncertainty { light_level_relative, emitter_drift_s: 60.0, ..usual });
        assert!(file.tolerance.is_none(), "levels are no tolerances of parts");
    }
    assert_eq!((cell.detector.saturation_a, cell.detector.interelectrode_ohm), (None, None));
    assert_eq!((cell.detector.dark_current_a, cell.slit.thickness_m), (0.0, 0.0));
    assert_eq!(file.workspace, Workspace::default());
    assert_eq!(file.lighting.slots, [vec![0], vec![]]);
}

#[test]
fn units_become_si() {
    let text = changed(
        "length_mm = 10.0",
        "length_mm = 10\noffset_mm = [1, -2.5]\ntilt_deg = [0.0, 0.0, 45.0]\nthickness_mm = 0.15",
        "[uncertainty]\nposition_mm = 0.02\n[noise]\nbandwidth_hz = 10e3\ntemperature_k = 300\nadc_a = 0.6e-9\n",
    );
    let scene = parse(&text).unwrap().scene;
    let (detector, slit) = (&scene.cells[0].detector, &scene.cells[0].slit);
    assert_eq!((detector.length_m, detector.centre_base_m.x), (12.0 * 1e-3, 25.0 * 1e-3));
    assert_eq!((slit.offset_m.x, slit.offset_m.y), (1.0 * 1e-3, -2.5 * 1e-3));
    assert_eq!((slit.tilt_rad.z, slit.thickness_m), (45f64.to_radians(), 0.15 * 1e-3));
    assert_eq!(scene.uncertainty.position_m, 0.02 * 1e-3);
    let noise = scene.noise.unwrap();
    assert_eq!((noise.shot_bandwidth_hz, noise.johnson_bandwidth_hz), (10e3, 10e3));
}

#[test]
fn a_cell_overrides_key_by_key_and_the_profile_as_one() {
    let more = "slit = { width_mm = 0.4 }\nemitter = { profile = [[0, 1.0], [60, 0.5]] }\n";
    let cell = parse(&format!("{LEAST}{more}")).unwrap().scene.cells[0].clone();
    assert_eq!((cell.slit.width_m, cell.slit.distance_m), (0.4 * 1e-3, 5.0 * 1e-3));
    let Profile::Table(knots) = &cell.emitter.profile else {
        panic!("the defaults' half angle was kept: {:?}", cell.emitter.profile);
    };
    assert_eq!(knots.as_slice(), [(0.0, 1.0), (60f64.to_radians(), 0.5)]);
}

#[test]
fn what_every_cell_gives_itself_needs_no_default() {
    let text = changed("width_mm = 0.6\n", "", "slit = { width_mm = 0.4 }\n");
    assert_eq!(parse(&text).unwrap().scene.cells[0].slit.width_m, 0.4 * 1e-3);
}

#[test]
fn what_is_refused_is_told_with_its_place_its_value_in_the_files_own_unit_and_the_next_step() {
    for (text, place, fault) in [
        // Keys that there are not.
        (changed("width_mm = 0.6", "widht_mm = 0.6", ""), "7:1", "`widht_mm` in [slit]; did you mean `width_mm`?"),
        (format!("{LEAST}slit = {{ colour = 1 }}\n"), "18:10", "`colour` in `slit` of cell 0; known keys: distance_mm"),
        (format!("{LEAST}axis = 1\n"), "18:1", "`axis` in [[cell]] number 0; did you mean `x_axis`?"),
        (format!("{LEAST}[front-end]\n"), "18:2", "`front-end` in the scene file; did you mean `front_end`?"),
        // Values that cannot be.
        (changed("0.6", "\"0.6 mm\"", ""), "7:12", "slit.width_mm = \"0.6 mm\" is a text; give a number"),
        (changed("0.6", "nan", ""), "7:12", "slit.width_mm = nan is out of range; give a finite number"),
        (changed("0.6", "-inf", ""), "7:12", "slit.width_mm = -inf"),
        (changed("0.6", "1e999", ""), "7:12", "slit.width_mm = 1e999"),
        (
            changed("[25.0, 0.0, 0.0]", "[25.0, 0.0]", ""),
            "13:15",
            "cell 0, detector_mm = [25.0, 0.0] is an array; give three numbers, [x, y, z]",
        ),
        (changed("[25.0, 0.0, 0.0]", "[25.0, 0.0, true]", ""), "13:27", "true is true or false; give a number"),
        (format!("{LEAST}slit = 3\n"), "18:8", "slit = 3 is a number; give a table"),
        (format!("name = 3\n{LEAST}"), "1:8", "name = 3 is a number; give a text"),
        (format!("{LEAST}[lighting]\nslots = [[0.5]]\n"), "19:11", "0.5 is a number; give a whole number"),
        ("cell = 3\n".to_owned(), "1:8", "[[cell]]"),
        (changed("[slit]\n", "[slit\n", ""), "5:6", "not valid TOML"),
        (changed("width_mm = 0.6", "width_mm = 0.6\nwidth_mm = 0.6", ""), "8:1", "duplicate key"),
        (changed("0.6", "-0.6", ""), "7:12", "slit.width_mm = -0.6: -0.6 is negative; give zero or more"),
        (changed("12.0", "0", ""), "2:13", "detector.length_mm = 0: 0 is not positive"),
        (changed("[0.0, 1.0, 0.0]", "[0.0, 1.1, 0.0]", ""), "14:10", "length 1.1, not 1"),
        (changed("[0.0, 1.0, 0.0]", "[1.0, 0.0, 0.0]", ""), "14:10", "not perpendicular"),
        (changed("55.0", "90", ""), "11:18", "half angle 90 degrees"),
        (changed("half_angle_deg = 55.0", "profile = [[1, 1.0], [60, 0.5]]", ""), "11:11", "starts at 0 degrees"),
        (format!("{LEAST}slit = {{ thickness_mm = 20 }}\n"), "6:15", "distance_mm = 5.0: the mask reaches"),
        (format!("{LEAST}[noise]\nbandwidth_hz = -1\ntemperature_k = 0\nadc_a = 0\n"), "19:16", "-1 is negative"),
        (LEAST.split("[[cell]]").next().unwrap().to_owned(), "1:1", "no cell; add at least one [[cell]]"),
        (changed("width_mm = 0.6\n", "", ""), "5:1", "slit.width_mm is missing; add `width_mm = …` to [slit]"),
        (
            changed("normal = [-1.0, 0.0, 0.0]\n", "", ""),
            "12:1",
            "normal is missing; add `normal = …` to [[cell]] number 0",
        ),
        (changed("half_angle_deg = 55.0\n", "", ""), "9:1", "0 emission profiles; give exactly one"),
        (
            changed("half_angle_deg", "profile_exponent = 1\nhalf_angle_deg", ""),
            "12:18",
            "2 emission profiles; give exactly one",
        ),
        (format!("{LEAST}[noise]\nadc_a = 1e-9\n"), "18:1", "noise.bandwidth_hz is missing"),
        // The key that counts for the cell, not that of the other cells.
        (
            changed("half_angle_deg = 55.0", "profile_exponent = 2.0", "emitter = { half_angle_deg = 0.011 }\n"),
            "18:30",
            "cell 0, emitter.half_angle_deg = 0.011 degrees is too narrow",
        ),
        (format!("{LEAST}[front_end]\nfull_scale_a = 1e-5\n"), "18:1", "front_end.adc_bits is missing"),
    ] {
        assert_refused_at(&text, place, fault);
    }
}

#[test]
fn axes_that_are_nearly_right_are_accepted() {
    parse(&changed("[0.0, 1.0, 0.0]", "[5e-7, 1.0000005, 0.0]", "")).unwrap();
}

#[test]
fn a_lighting_that_cannot_be_is_refused() {
    let two =
        LEAST.replace("[[cell]]", "[lighting]\nslots = SLOTS\n[[cell]]") + &LEAST[LEAST.find("[[cell]]").unwrap()..];
    let cases = [
        ("[[0, 1], [1], []]", "13:19", "emitter 1 is lit in slot 0 and again in slot 1; light each"),
        ("[[0], []]", "13:9", "emitter 1 is in no slot; add it"),
        ("[[0, 2], [1], []]", "13:14", "emitter 2 does not exist; the scene has the cells 0 to 1"),
        ("[[0, -1], [1], []]", "13:14", "-1 is out of range; give a whole number from 0 to 15"),
        ("[[], [0], [1], []]", "13:24", "slots 0 and 3 are both dark; keep one"),
        ("[0, 1]", "13:10", "0 is a number; give slots"),
    ];
    for (slots, place, fault) in cases {
        assert_refused_at(&two.replace("SLOTS", slots), place, fault);
    }
    let lighting = parse(&two.replace("SLOTS", "[[1], [], [0]]")).unwrap().lighting;
    assert_eq!((lighting.slot_of(0), lighting.dark_slot()), (Some(2), Some(1)));
}

#[test]
fn the_front_end_is_read_and_its_limits_kept() {
    let section = "[front_end]\nfull_scale_a = 10e-6\nadc_bits = 12\noversampling = 4\nsettling_s = 13e-6\nconversion_s = 0.87e-6\nframe_rate_hz = 4000\n";
    let front_end = parse(&format!("{LEAST}{section}")).unwrap().front_end.unwrap();
    assert_eq!((front_end.raw_noise_lsb, front_end.time_constant_s), (0.0, 0.0));
    assert!((front_end.slot_duration_s(6) - 33.88e-6).abs() < 1e-12);
    let cases = [
        ("adc_bits = 12", "adc_bits = 40", "20:12", "adc_bits = 40 is out of range; give a whole number from 1 to 16"),
        ("adc_bits = 12", "adc_bits = 12.5", "20:12", "12.5 is a number; give a whole number"),
        ("oversampling = 4", "oversampling = 0", "21:16", "from 1 to 256"),
        ("10e-6", "0.0", "19:16", "full_scale_a = 0.0 is out of range; give amperes from 1e-12 to 1"),
        ("10e-6", "1e300", "19:16", "out of range; give amperes from 1e-12 to 1"),
        ("13e-6", "-1e-6", "22:14", "settling_s = -1e-6 is out of range; give zero or more"),
    ];
    for (old, new, place, fault) in cases {
        assert_refused_at(&format!("{LEAST}{}", section.replacen(old, new, 1)), place, fault);
    }
}

#[test]
fn the_workspace_must_be_a_box() {
    let text = format!("{LEAST}[workspace]\nhalf_extent_mm = [4.0, -4.0, 4.0]\n");
    assert_refused(&text, &["scene.toml:19:18", "[4.0, -4.0, 4.0] is out of range", "zero or more"]);
    let text = format!("{LEAST}[workspace]\nhalf_extent_deg = [200, 0, 0]\n");
    assert_refused(&text, &["scene.toml:19:19", "[200, 0, 0]", "0 to 180"]);
}

#[test]
fn too_many_cells_are_counted() {
    let cell = &LEAST[LEAST.find("[[cell]]").unwrap()..];
    let text = format!("{LEAST}{}", cell.repeat(16));
    assert_refused(&text, &["scene.toml:108:1", "17 cells; at most 16"]);
}

#[test]
fn a_file_that_is_no_text_is_told_so() {
    let message = SceneFile::from_bytes("scene.toml", b"name = \"a\"\n# \xff").unwrap_err().to_string();
    assert!(message.contains("scene.toml:2:3") && message.contains("0xff"), "{message}");
}

#[test]
fn the_hash_is_that_of_the_reference_text() {
    // Test vectors of the FNV authors for 64-bit FNV-1a.
    assert_eq!(fnv1a_64(b""), 0xcbf2_9ce4_8422_2325);
    assert_eq!(fnv1a_64(b"foobar"), 0x8594_4171_f739_67e8);
}

#[test]
fn line_ends_and_byte_order_mark_do_not_matter() {
    let dos = format!("\u{feff}{}", LEAST.replace('\n', "\r\n"));
    assert_eq!(parse(&dos).unwrap().scene, parse(LEAST).unwrap().scene);
}

#[test]
fn profiles_that_are_neither_in_degrees_nor_relative_are_told() {
    for (profile, parts) in [
        ("[[0, 1.0], [45, 0.7], [90, 0.02]]", &[][..]),
        // A narrow beam, and the mean of measured points.
        ("[[0, 1.04], [2, 0.5], [4, 0.0]]", &[]),
        ("[[0, 1.0], [0.785, 0.7], [1.571, 0.02]]", &["cell 0, emitter.profile: it ends at 1.5710", "radians?"]),
        ("[[0, 100], [45, 70], [90, 2]]", &["begins with 100", "per cent"]),
        ("[[0, 312.0], [0.785, 219.0], [1.571, 6.0]]", &["begins with 312", "an intensity?", "radians?"]),
    ] {
        let file = parse(&changed("half_angle_deg = 55.0", &format!("profile = {profile}"), "")).unwrap();
        let said: Vec<String> = file.findings().iter().map(ToString::to_string).collect();
        assert_eq!(said.is_empty(), parts.is_empty(), "{profile}: {said:?}");
        parts.iter().for_each(|part| assert!(said.concat().contains(part), "{profile}: {said:?}"));
    }
    assert!(SHIPPED.iter().all(|shipped| shipped.read().unwrap().findings().is_empty()));
}
