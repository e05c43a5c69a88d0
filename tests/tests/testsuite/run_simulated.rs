//! `slitpose run --device sim`: every scan arrives, says what the interface promises, and is as near
//! to the truth as it claims; and light of other emitters, which the simulator adds and the solver takes away.

use std::fmt::Write;
use std::ops::Range;

use serde_json::Value;
use slitpose_head::simulator::{Trajectory, TrajectoryKind};
use slitpose_model::{Outcome, Pose};
use slitpose_tests::capture::{STREAM, capture, solve};
use slitpose_tests::consistency::{Honesty, error};
use slitpose_tests::ndjson::{self, Line};
use slitpose_tests::poses::{self, between};
use slitpose_tests::process::{Finished, written};
use slitpose_tests::scenes::{parse, wide_with};
use slitpose_tests::slitpose;
use slitpose_tests::table::Table;
use slitpose_tests::terminal::FRAME_RATE_HZ;

/// χ² of six degrees has the median 5.35: a covariance 19 % too large or 18 % too small fails.
const USUAL_NEES: Range<f64> = 4.5..6.5;

fn run(arguments: &[&str]) -> Finished {
    let finished = slitpose!().run(["run", "--device", "sim", "--speed", "max"].iter().chain(arguments));
    assert_eq!((finished.code, finished.stderr.as_str()), (0, ""));
    finished
}

fn lines(arguments: &[&str]) -> Vec<Line> {
    println!("{arguments:?}");
    ndjson::parse(&run(arguments).done())
}

/// Asserts that scans 0 to `count` − 1 are there, each with its truth.
fn assert_complete(lines: &[Line], count: usize) {
    ndjson::assert_complete(lines, 0, count, FRAME_RATE_HZ);
    assert!(lines.iter().all(|line| line.truth.is_some() && line.cells_used <= 6));
}

fn honesty(lines: &[Line]) -> Honesty {
    Honesty::of(lines.iter().filter_map(Line::beside_truth))
}

#[test]
fn ten_seconds_of_the_default() {
    let lines = lines(&["--duration", "10s"]);
    assert_complete(&lines, 40_000);
    // The mean lit instant in ticks of 170 MHz: even cells in the first and odd ones in the second slot, of 2210 settling ticks
    // and 48 conversions of 148, so half a slot on average, settling, and the middle of rank 2.5.
    let reference_ticks = 0.5 * (2210.0 + 48.0 * 148.0) + 2210.0 + (2.5 * 8.0 + 3.5) * 148.0;
    assert!((lines[0].device_time_s - reference_ticks / 170e6).abs() < 1e-12, "{}", lines[0].device_time_s);
    let honesty = honesty(&lines);
    assert!(honesty.poses >= 39_960, "99.9 % of the scans must give a pose");
    honesty.assert(USUAL_NEES, 3);
}

/// Motions, and how their poses are: arguments, the fewest of 8 000 scans with a pose, the range of the median NEES, and the
/// most poses beyond 5 σ.
const MOTIONS: [(&[&str], usize, Range<f64>, usize); 4] = [
    (&["--tier", "paper", "--seed", "2"], 7_992, USUAL_NEES, 3),
    // Nothing but noise is left.
    (&["--trajectory", "still", "--seed", "3"], 8_000, USUAL_NEES, 3),
    // Four times the usual speed: a parabola through five frames misses part of such bends, a covariance a quarter too small.
    (&["--trajectory", "fast", "--seed", "4"], 7_992, 4.5..7.1, 3),
    // Only a frame with a reversal between its exposures, 68 µs of 250, has no one twist: 36 of the 133 that
    // legs of 15 ms on average make in 2 s. Of those 2 do not show in the currents; of 2 on average more than
    // 10 come in one draw of 100 000.
    (&["--trajectory", "contact", "--seed", "5"], 7_992, USUAL_NEES, 10),
];

#[test]
fn whatever_the_motion_poses_are_as_honest() {
    for (arguments, least_poses, nees, most_beyond) in MOTIONS {
        let lines = lines(&[arguments, &["--duration", "2s"]].concat());
        assert_complete(&lines, 8_000);
        let honesty = honesty(&lines);
        assert!(honesty.poses >= least_poses, "{honesty:?}");
        honesty.assert(nees, most_beyond);
        // Of abrupt reversals: the longest leg, 5 mm along each axis, in the shortest time, 5 ms, is 59 µm a slot of 34 µs.
        assert!(honesty.largest_m < 59e-6, "{honesty:?}");
        assert!(!arguments.contains(&"still") || lines.iter().all(|line| line.truth == Some(Pose::HOME)));
    }
}

#[test]
fn the_seed_decides_every_byte() {
    let bytes = |seed| run(&["--duration", "200ms", "--seed", seed]).stdout;
    let first = bytes("7");
    assert_eq!(first, bytes("7"));
    assert_ne!(first, bytes("8"));
}

#[test]
fn duration_is_device_time_whatever_the_format() {
    for (duration, scans) in [("1ms", 4), ("10ms", 40), ("10200us", 41), ("250us", 1)] {
        assert_complete(&lines(&["--duration", duration]), scans);
        let table = Table::parse(&run(&["--duration", duration, "--format", "csv"]).done());
        let sequences: Vec<f64> = table.rows().map(|row| row.number("seq")).collect();
        assert_eq!(sequences, (0..scans).map(|i| i as f64).collect::<Vec<_>>());
        assert!(table.rows().all(|row| row.text("simulated") == "true"));
    }
    let summary = run(&["--duration", "100ms", "--format", "summary"]).done();
    assert!(summary.contains("400 scans") && summary.contains("lost        nothing"), "{summary}");
}

#[test]
fn a_path_from_a_table_is_followed() {
    // Knots every 7 ms: corners fall inside frames, and the last one comes before the end.
    let knots: Vec<(f64, Pose)> = poses::in_box(&mut poses::generator(6), 1.0, 3.0, 20)
        .into_iter()
        .enumerate()
        .map(|(i, row)| (0.01 + 0.007 * i as f64, poses::pose(row)))
        .collect();
    let mut text = "id,time_s,tx_mm,ty_mm,tz_mm,rx_rad,ry_rad,rz_rad\n".to_owned();
    for (time_s, pose) in &knots {
        let (t, r) = (pose.translation_m * 1e3, pose.rotation.to_scaled_axis());
        // Writing to a String cannot fail.
        let _ = writeln!(text, "-,{time_s:?},{:?},{:?},{:?},{:?},{:?},{:?}", t.x, t.y, t.z, r.x, r.y, r.z);
    }
    let folder = tempfile::tempdir().expect("temporary folder");
    let lines = lines(&["--duration", "200ms", "--trajectory", &written(folder.path(), "path.csv", text)]);
    assert_complete(&lines, 800);
    for line in &lines {
        let after = knots.partition_point(|(time_s, _)| *time_s <= line.device_time_s);
        let expected = match (after.checked_sub(1).map(|i| knots[i]), knots.get(after)) {
            (Some((start_s, start)), Some((end_s, end))) => {
                between(&start, end, (line.device_time_s - start_s) / (end_s - start_s))
            }
            (Some((_, rest)), None) | (None, Some(&(_, rest))) => rest,
            (None, None) => panic!("no knots"),
        };
        let off = error(&line.truth.expect("simulated"), &expected);
        // Millimetres and radians of at most 1.7, through sines, products and text: rounding.
        assert!(off.iter().all(|axis| axis.abs() < 1e-14), "{line:?}: {off:?}");
    }
    let honesty = honesty(&lines);
    assert_eq!(honesty.poses, 800);
    honesty.assert(USUAL_NEES, 0);
}

#[test]
fn twist_and_filtered_pose_come_with_their_worth() {
    let text = run(&["--duration", "500ms", "--trajectory", "smooth", "--seed", "9", "--filter", "5ms"]).done();
    let objects: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).expect("an object a line")).collect();
    assert_eq!(objects.len(), 2000);
    let numbers = |value: &Value| -> Vec<f64> {
        value.as_array().map(|array| array.iter().filter_map(Value::as_f64).collect()).unwrap_or_default()
    };
    let (mut squares, mut counted, mut well, mut withheld) = (0.0, 0.0, 0, 0);
    for (index, pair) in objects.windows(3).enumerate().skip(20) {
        let [before, now, after] = pair else { unreachable!("windows of three") };
        assert!(["well", "weakly", "not"].contains(&now["verified"].as_str().unwrap_or("")), "scan {index}: {now}");
        well += usize::from(now["verified"] == "well");
        assert!(now.get("excluded_cells").is_none() && now.get("reason").is_none(), "scan {index}");
        // The tool's velocity by the truths before and after.
        let [a, b] = [before, after].map(|object| numbers(&object["truth"]["translation_m"]));
        if now["twist"].is_null() {
            // While the filters learn how the tool moves.
            assert!(now["no_twist"] == "jump", "scan {index}: {now}");
            withheld += 1;
        } else {
            let (velocity, sigma) = (numbers(&now["twist"]["linear_m_per_s"]), numbers(&now["twist"]["sigma"]));
            assert_eq!((velocity.len(), numbers(&now["twist"]["angular_rad_per_s"]).len(), sigma.len()), (3, 3, 6));
            for axis in 0..3 {
                let error = velocity[axis] - (b[axis] - a[axis]) / 500e-6;
                squares += (error / sigma[axis]).powi(2);
                counted += 1.0;
            }
        }
        let filtered = &now["filtered"];
        assert_eq!((numbers(&filtered["covariance"]).len(), numbers(&filtered["rotation_xyzw"]).len()), (36, 4));
        let lag_s = filtered["lag_s"].as_f64().expect("lag");
        // Of 5 ms at most, some 20 frames.
        assert!((0.0..1.2e-3).contains(&lag_s), "{lag_s}");
        let variance = |object: &Value| numbers(&object["covariance"])[0];
        assert!(variance(filtered) < 1.01 * variance(now), "scan {index}");
    }
    // A third of the poses of this head, as its geometry has it.
    assert!((450..900).contains(&well), "{well} of 1978 well verified");
    let mean = squares / counted;
    println!("squared error of the velocity in units of its variance: {mean:.2}");
    assert!((0.5..1.4).contains(&mean), "{mean}");
    assert!(withheld < 60, "{withheld} scans without velocity");
}

#[test]
fn a_head_that_lights_all_cells_at_once_knows_their_cross_talk() {
    let file = parse(&wide_with(&[("slots = [[0, 2, 4], [1, 3, 5], []]", "slots = [[0, 1, 2, 3, 4, 5], []]")]));
    // Of each cell the two neighbours. Those 120° on would have to shine 135° from their axes, and turn by 26° at most.
    let neighbours = |cell: usize| 1 << ((cell + 1) % 6) | 1 << ((cell + 5) % 6);
    let together: Vec<u16> = file.scene.cells.iter().map(|cell| cell.effects.lit_together).collect();
    assert_eq!(together, (0..6).map(neighbours).collect::<Vec<u16>>());

    println!("seed 72");
    let bytes = capture(&file, Trajectory::of_kind(TrajectoryKind::Smooth, 72, 10.0), STREAM, 72, 500);
    let (records, _) = solve(&file, STREAM, &bytes);
    assert_eq!(records.len(), 500);
    assert!(records.iter().all(|record| record.solution.outcome == Outcome::Converged));
    let honesty = Honesty::of(
        records.iter().map(|record| (record.solution.estimate.expect("converged"), record.truth.expect("simulated"))),
    );
    // χ² of six degrees has the median 5.35, of 500 it scatters by 2.6 %; of 3000 normal numbers one in 5000 draws has
    // one beyond 5.5 σ.
    assert!((4.3..6.2).contains(&honesty.median_nees) && honesty.worst_sigmas < 5.5);

    let mut ignoring = file.clone();
    ignoring.scene.cells.iter_mut().for_each(|cell| cell.effects.lit_together = 0);
    let (records, _) = solve(&ignoring, STREAM, &bytes);
    let converged = records.iter().filter(|record| record.solution.outcome == Outcome::Converged).count();
    println!("ignoring it, {converged} of 500 fit");
    assert!(converged < 50);
}
