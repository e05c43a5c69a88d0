use super::*;
use slitpose_head::scene_file::{BASE, BENCH, WIDE};
use slitpose_model::{Response, Status};

/// Enough for shares to a percent, few enough for a fast test.
const SAMPLES: usize = 3000;

fn survey_of(text: &str) -> Survey {
    Survey::of(&SceneFile::parse("scene.toml", text).unwrap(), SAMPLES, |_| {}).unwrap()
}

fn warnings(text: &str) -> String {
    survey_of(text).warnings.iter().map(|warning| format!("{warning}\n")).collect()
}

#[test]
fn shares_of_the_shipped_scenes_are_those_of_an_independent_program() {
    // 99.9 % and 66 % of ±4 mm / ±15° in its random samples; theirs and ours tell a share of two
    // thirds to about one percent each.
    let wide = survey_of(WIDE.text);
    assert!((wide.coverage.at_least_lit[6] - 0.999).abs() < 0.002, "{:?}", wide.coverage.at_least_lit);
    let base = survey_of(BASE.text);
    assert!((base.coverage.at_least_lit[6] - 0.66).abs() < 0.03, "{:?}", base.coverage.at_least_lit);
}

#[test]
fn each_pose_that_is_evaluated_counts_as_progress() {
    for samples in [30, 300] {
        let mut told = 0;
        Survey::of(&SceneFile::parse("scene.toml", BENCH.text).unwrap(), samples, |poses| told += poses).unwrap();
        assert_eq!(told, Survey::poses_of(samples));
    }
}

#[test]
fn the_bench_travels_as_far_as_its_geometry_says() {
    // With d_A = 2 d_B the spot is 2w = 0.8 mm wide and moves as far as the emitter, so it
    // touches the end of the active area at 6 − 0.4 = 5.6 mm.
    let survey = survey_of(BENCH.text);
    let tx = &survey.travel[0];
    assert!((tx.positive.at - 5.6e-3).abs() < 1e-9 && (tx.negative.at + 5.6e-3).abs() < 1e-9, "{tx:?}");
    assert_eq!((tx.positive.cell, tx.positive.becomes), (Some(0), Some("clipped")));
}

/// Those of `wide`.
const SLOTS: &str = "[[0, 2, 4], [1, 3, 5], []]";

/// The first four cells of `wide`: one solution, while two redundancies do not outweigh parts that are off.
fn four_cells() -> String {
    let cells: Vec<&str> = WIDE.text.split("[[cell]]").take(5).collect();
    cells.join("[[cell]]").replace(SLOTS, "[[0, 2], [1, 3], []]")
}

#[test]
fn warnings_carry_the_number_and_a_remedy() {
    let with = |from: &str, to: &str| WIDE.text.replace(from, to);
    // Cells are 117.4 µs apart: a slot of 20 µs and 6 · 16 conversions of 0.87 µs, and 16 conversions for the cell's turn
    // in it. Six of them have a mean square of 35/12 · 117.4²; half of 100 m/s² times that.
    let in_turn = with(SLOTS, "[[0], [1], [2], [3], [4], [5], []]")
        .replace("oversampling = 8", "oversampling = 16")
        .replace("settling_s = 13e-6", "settling_s = 20e-6")
        .replace("frame_rate_hz = 4000", "frame_rate_hz = 1000");
    let long_sums =
        with("oversampling = 8", "oversampling = 32").replace("frame_rate_hz = 4000", "frame_rate_hz = 100");
    // 12 mm/4 · 1 % · √2.
    let uncertain = WIDE.text.to_owned() + "\n[uncertainty]\nemitter_gain_relative = 0.01\n";
    // A slip of the unit.
    let near = "tz of a single frame by 6.11 mm (1 σ), in a workspace of ±3.30 mm";
    let [settling, settled] = ["gets 6.51 % of its own signal", "raise front_end.settling_s to 7.7 µs"];
    let aside = "emitter_mm = [30.0, 0.0, 0.0]";
    let cases = [
        (with("scale_a = 10e-6", "scale_a = 5e-6"), "front_end.full_scale_a = 5.00 µA", "raise the full scale"),
        (with("saturation_a = 100e-6", "saturation_a = 8e-6"), "saturates in", "narrow the slit"),
        (with("3.16e-3", "3.16e-5"), "all cells: faint in up to ", "widen the slit"),
        (with("[1, 3, 5], []]", "[1, 3, 5]]"), "no lighting slot is dark", "add []"),
        (with("half_angle_deg = 55.0", "half_angle_deg = 0.2"), "at tolerance 1e-6", "--tolerance 1e-4"),
        (with(SLOTS, "[[0, 1, 2, 3, 4, 5], []]"), "% of its own signal", "different slots"),
        (uncertain, "moves a spot by up to 42 µm", "set electrode_gain_relative"),
        (with("frame_rate_hz = 4000", "frame_rate_hz = 9000"), "frame period is 111.1 µs", "frame_rate_hz"),
        (four_cells(), "a frame tells 0 % of its poses", "calibrate --known"),
        (BENCH.text.to_owned(), "six coordinates take 3 cells, it has 1", "add cells"),
        // 2 µs + 1.36 µs · ln 65.1 is 7.7 µs.
        (with("settling_s = 13e-6", "settling_s = 2e-6"), settling, settled),
        (with("distance_mm = 5.0 ", "distance_mm = 0.005 "), near, "raise slit"),
        (in_turn, "bends the motion by 2.0 µm, where noise leaves 1.4 µm", "light more emitters together"),
        (with("adc_bits = 12", "adc_bits = 16"), "sums 8 conversions of 16 bits", "lower front_end"),
        (long_sums, "sums 32 conversions", "lower front_end.oversampling"),
        (with("[3.3, 3.3, 3.3]", "[3.3, 9.0, 3.3]"), "beyond ty", "shrink the workspace"),
        (with("emitter_mm = [10.0, 0.0, 0.0]", aside), "cell 0: behind at home", "into line"),
    ];
    for (text, finding, remedy) in cases {
        let warnings = warnings(&text);
        assert!(warnings.contains(finding) && warnings.contains(remedy), "`{finding}` is not in:\n{warnings}");
    }
}

#[test]
fn cells_that_are_alike_share_a_warning_that_names_the_worst() {
    let of_scale = |text: &str| {
        let mut warnings = survey_of(&text.replace("full_scale_a = 10e-6", "full_scale_a = 5e-6")).warnings;
        warnings.retain(|warning| warning.text.contains("full_scale_a"));
        let [warning] = warnings.try_into().expect("one warning");
        (warning.place.into_owned(), warning.text)
    };
    let (cells, text) = of_scale(WIDE.text);
    let most = survey_of(WIDE.text).coverage.cells.iter().map(|cell| cell.most_electrode_a).fold(0.0, f64::max);
    let worst = format!("{:.2} µA on one electrode of cell ", most * 1e6);
    assert!(cells == "all cells" && text.starts_with(&worst) && text.contains("(up to "), "{text}");
    // A fifth of the intensity, a third of the full scale at most; then in all cells but one.
    let dim = "emitter = { radiant_intensity_w_per_sr = 0.6e-3 }\nnormal =";
    let (cells, _) = of_scale(&WIDE.text.replacen("normal =", dim, 1));
    assert_eq!(cells, "5 of 6 cells");
    let (cells, text) = of_scale(&WIDE.text.replace("normal =", dim).replacen(dim, "normal =", 1));
    assert!(cells == "cell 0" && text.contains("on one electrode at ") && !text.contains("up to"), "{text}");
}

#[test]
fn a_profile_that_meets_the_limit_of_work_is_named() {
    // Light and dark in turns of 3° over a spot of 130°.
    let saw: String = (0..29).map(|i| format!("[{}.0, {}.0], ", 3 * i, (i + 1) % 2)).collect();
    let wide = BENCH.text.replace("distance_mm = 7.5", "distance_mm = 1.0").replace("width_mm = 0.4", "width_mm = 4.0");
    let wide = wide.replace("width_mm = 1.0", "width_mm = 5.0").replace("[0.0, 0.0, -15.0]", "[0.0, 0.0, -2.3]");
    let file =
        SceneFile::parse("saw.toml", &wide.replace("half_angle_deg = 55.0", &format!("profile = [{saw}]"))).unwrap();
    let warnings = Survey::of(&file, 20, |_| {}).unwrap().warnings;
    let warnings: String = warnings.iter().map(|warning| format!("{warning}\n")).collect();
    assert!(warnings.contains("the limit, do not suffice; give the profile fewer bends"), "{warnings}");
}

#[test]
fn the_sample_fills_the_box_evenly() {
    let workspace = Workspace::default();
    let mut mean = [0.0; 6];
    for pose in workspace.poses(SAMPLES) {
        let (t, r) = (pose.translation_m / workspace.half_extent_m, pose.rotation_rad() / workspace.half_extent_rad);
        for (sum, component) in mean.iter_mut().zip([t.x, t.y, t.z, r.x, r.y, r.z]) {
            assert!(component.abs() <= 1.0 + 1e-12);
            *sum += component / SAMPLES as f64;
        }
    }
    // Random points would leave 0.01 (one standard deviation).
    assert!(mean.iter().all(|mean| mean.abs() < 5e-3), "{mean:?}");
}

#[test]
fn heads_with_mirror_images_or_nothing_to_tell_at_home_are_named() {
    // Rolls of 0 ± `roll` in turn: at home, by the geometry of a ring, rolls of 0 leave heights and tilts
    // free, and mirror every pose in its plane.
    let ring = |roll: f64| {
        let head = WIDE.text.split("[[cell]]").next().unwrap().replace("six cells, rolled 45 degrees", "mirror");
        (0..6).fold(head, |text, k| {
            let (sin, cos) = (std::f64::consts::FRAC_PI_3 * f64::from(k)).sin_cos();
            let (rise, along) = if k % 2 == 0 { roll } else { -roll }.sin_cos();
            text + &format!(
                "[[cell]]\ndetector_mm = [{:?}, {:?}, 0.0]\nx_axis = [{:?}, {:?}, {rise:?}]\nnormal = [{:?}, {:?}, 0.0]\n\
                 emitter_mm = [{:?}, {:?}, 0.0]\nemitter_axis = [{cos:?}, {sin:?}, 0.0]\n",
                25.0 * cos, 25.0 * sin, -sin * along, cos * along, -cos, -sin, 10.0 * cos, 10.0 * sin,
            )
        })
    };
    assert!(warnings(&ring(0.0)).contains("leave tz;rx;ry free"), "{}", warnings(&ring(0.0)));
    for roll in [0.0, 1e-3] {
        assert!(warnings(&ring(roll)).contains("head `mirror` have mirror images"), "{}", warnings(&ring(roll)));
    }
    for ordinary in [ring(std::f64::consts::FRAC_PI_4), WIDE.text.to_owned(), BASE.text.to_owned()] {
        let warnings = warnings(&ordinary);
        assert!(!warnings.contains("mirror images") && !warnings.contains("free:"), "{warnings}");
    }
}

#[test]
fn pieces_of_the_sample_add_up_to_all_of_it() {
    let file = SceneFile::parse("scene.toml", WIDE.text).unwrap();
    // More than two pieces.
    let samples = 2100;
    let survey = Survey::of(&file, samples, |_| {}).unwrap();
    let compile = |tolerance| CompiledScene::<f64>::compile(&file.scene, Tier::Exact { tolerance }).unwrap();
    let (plan, solving) = (compile(TOLERANCE), compile(SOLVING_TOLERANCE));
    let poses: Vec<Pose> = file.workspace.poses(samples).collect();
    for (number, cell) in survey.coverage.cells.iter().enumerate() {
        let responses: Vec<_> = poses.iter().map(|pose| plan.respond(number, pose)).collect();
        let electrodes = || responses.iter().map(|response| response.currents.i_x1_a.max(response.currents.i_x2_a));
        let most = electrodes().fold(0.0, f64::max);
        let first = electrodes().position(|electrode| electrode == most).unwrap();
        assert_eq!((cell.most_electrode_a, cell.most_electrode_at), (most, poses[first]), "cell {number}");
        let currents = responses.iter().filter(|response| response.status.has_spot()).map(|response| response.i_o_a);
        let range =
            currents.fold([f64::INFINITY, 0.0], |[least, most]: [f64; 2], i_o_a| [least.min(i_o_a), most.max(i_o_a)]);
        assert_eq!(cell.i_o_range_a, Some(range), "cell {number}");
        let share = |counts: &dyn Fn(&Response<f64>) -> bool| {
            responses.iter().filter(|response| counts(response)).count() as f64 / samples as f64
        };
        let status = |status: Status| share(&|response| response.status == status);
        let statuses = [Status::Lit, Status::Clipped, Status::Dark, Status::Behind].map(status);
        assert_eq!([cell.lit, cell.clipped, cell.dark, cell.behind], statuses, "cell {number}");
        let evaluations =
            poses.iter().take(coverage::poses_of(samples)).filter_map(|pose| solving.respond(number, pose).integration);
        let most = evaluations.map(|integration| integration.evaluations).max();
        assert_eq!(Some(survey.cost[number].most_evaluations), most, "cell {number}");
    }
    let lit = |pose: &Pose| (0..6).filter(|&cell| plan.respond(cell, pose).status == Status::Lit).count();
    let at_least = |least| poses.iter().filter(|pose| lit(pose) >= least).count() as f64 / samples as f64;
    assert_eq!(survey.coverage.at_least_lit, (0..=6).map(at_least).collect::<Vec<_>>());
    for slot in &survey.crosstalk {
        let shares = |pose| slot.emitters.iter().map(move |&cell| (cell, pose));
        let worst =
            poses.iter().flat_map(shares).map(|(cell, pose)| share_of_others(&plan, cell, &slot.emitters, pose));
        assert_eq!(slot.share, worst.fold(0.0, f64::max), "slot {}", slot.slot);
    }
}

#[test]
fn light_of_the_slot_before_counts_as_a_slow_front_end_leaves_it() {
    // Three emitters at a time without a dark slot; 0.4 µs are left of a frame.
    let text = WIDE.text.replace("settling_s = 13e-6", "settling_s = 2e-6").replace("[1, 3, 5], []]", "[1, 3, 5]]");
    let slot_s = survey_of(&text).timing.unwrap().slot_s;
    let rate = format!("frame_rate_hz = {}", (2.0 * slot_s + 0.4e-6).recip());
    let text = text.replace("frame_rate_hz = 4000", &rate);
    let file = SceneFile::parse("scene.toml", &text).unwrap();
    let survey = survey_of(&text);
    let plan = CompiledScene::<f64>::compile(&file.scene, Tier::Exact { tolerance: TOLERANCE }).unwrap();
    // Eight conversions, 0.87 µs apart, 2 µs after switching: the mean of exp(−t/1.36 µs), and exp(−0.4/1.36) of it.
    let weights = [(0, [0, 2, 4], [1, 3, 5], 0.04502), (1, [1, 3, 5], [0, 2, 4], 0.06042)];
    assert_eq!(survey.carried.len(), weights.len());
    for (carried, (slot, cells, before, weight)) in survey.carried.iter().zip(weights) {
        let most = file.workspace.poses(SAMPLES).flat_map(|pose| cells.map(|cell| (cell, pose)));
        let most = most.map(|(cell, pose)| share_of_others(&plan, cell, &before, &pose)).fold(0.0, f64::max);
        assert_eq!(carried.slot, slot);
        // The weights have four digits.
        assert!((carried.share / (weight * most) - 1.0).abs() < 1e-3, "{carried:?}: {}", carried.share / most);
    }
    // 13 µs are 9.6 time constants.
    assert!(survey_of(WIDE.text).carried.is_empty());
}
