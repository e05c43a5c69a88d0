//! Maps, comparisons and searches from the command line: what goes wrong is told with the next step. What goes right is
//! in the guide (`accuracy.md`), which is run.

use std::fs;

use slitpose_tests::slitpose;
use tempfile::TempDir;

fn refused(arguments: &[&str], parts: &[&str]) {
    let finished = slitpose!().run(arguments);
    assert_ne!(finished.code, 0, "{arguments:?}");
    assert_eq!(finished.stdout, b"", "{arguments:?}");
    for part in parts {
        assert!(finished.stderr.contains(part), "{arguments:?}: `{part}` is not in {}", finished.stderr);
    }
}

#[test]
fn what_cannot_be_is_told_before_anything_is_searched() {
    refused(&["scene", "optimise", "wide"], &["--free"]);
    refused(&["scene", "optimise", "wide", "--free", "slit"], &["there is no `slit`", "slit_width"]);
    refused(&["scene", "optimise", "wide", "--free", "roll=9"], &["`9` are no bounds", "roll=0..90"]);
    refused(&["scene", "optimise", "wide", "--free", "roll", "--lit", "999"], &["'999'", "from 0 to 100"]);
    refused(&["scene", "optimise", "wide", "--free", "roll", "--radius", "inf"], &["'inf'", "in mm"]);
    refused(&["scene", "optimise", "bench", "--free", "full_scale"], &["no [front_end]", "leave full_scale out"]);
    refused(&["scene", "map", "base", "--schedule", "4000", "--samples", "10"], &["no [front_end]", "wide"]);
    refused(
        &["scene", "map", "wide", "--schedule", "30000", "--samples", "10"],
        &["the frame period is 33.3 µs", "lower front_end.frame_rate_hz"],
    );
    refused(&["scene", "map", "wide", "--tolerance-study", "0"], &["--tolerance-study"]);
    let study = ["scene", "map", "bench", "--samples", "10", "--tolerance-study", "1"];
    refused(&study, &["no pose anywhere in its workspace", "`wide`"]);
    refused(&["scene", "map", "base", "--samples", "10", "--output", "no/m.svg"], &["no/m.svg is to be a folder"]);
    refused(&["compare"], &["SCENE"]);
    refused(&["compare", "wide", "no.toml"], &["cannot read scene `no.toml`"]);
}

/// Heads of which one cannot be run are compared by what all have, and the reason is told; those of other rates at equal
/// bandwidth, too.
#[test]
fn heads_are_compared_by_one_kind_of_noise_and_at_equal_bandwidth() {
    let folder = TempDir::new().expect("a folder");
    let text = slitpose!().run(["scene", "show", "wide"]).done();
    let at_rate = |rate_hz: &str| {
        let path = folder.path().join(format!("{rate_hz}.toml"));
        fs::write(&path, text.replace("frame_rate_hz = 4000", &format!("frame_rate_hz = {rate_hz}"))).expect("a scene");
        path.to_str().expect("UTF-8").to_owned()
    };
    let compared = |other: &str| slitpose!().run(["compare", "wide", other, "--samples", "50"]);
    for (other, reason) in [(at_rate("20000").as_str(), "the frame period is 50.0 µs"), ("base", "no [front_end]")] {
        let finished = compared(other);
        let said = finished.stderr.clone();
        assert!(said.contains(reason) && said.contains("all are compared"), "{said}");
        let table = finished.done();
        assert!(!table.contains("front end"), "{table}");
    }
    // All by the channel, as they are: nothing to tell.
    let unframed = slitpose!().run(["compare", "base", "bench", "--samples", "50"]);
    assert!(unframed.code == 0 && !unframed.stderr.contains("all are compared"), "{}", unframed.stderr);
    for (other, summaries) in [("fine", 2), (at_rate("1000").as_str(), 4)] {
        let table = compared(other).done();
        assert_eq!(table.matches("Best in ").count(), summaries, "{table}");
        assert_eq!(table.contains("µm/√Hz."), summaries == 4, "{table}");
    }
}

/// One cell gives no pose: the map says so, in words and without an infinite number.
#[test]
fn a_head_without_poses_has_a_map_all_the_same() {
    let folder = TempDir::new().expect("a folder");
    let at = folder.path().join("map");
    let finished = slitpose!().run([
        "scene",
        "map",
        "bench",
        "--samples",
        "200",
        "--side",
        "5",
        "--output",
        at.to_str().expect("UTF-8"),
    ]);
    assert_eq!(finished.code, 0, "{}", finished.stderr);
    let page = fs::read_to_string(at.join("report.md")).expect("a page");
    assert!(page.contains("In 100.00 % of the workspace a frame gives no pose"), "{page}");
    let samples = fs::read_to_string(at.join("samples.csv")).expect("a table");
    assert_eq!(samples.lines().count(), 201);
    for text in [page, samples] {
        assert!(!text.contains("inf") && !text.contains("NaN"), "{text}");
    }
}

/// A search that keeps no limits gives its best, and says with its exit code that it is none.
#[test]
fn limits_that_cannot_be_kept_are_told() {
    let finished = slitpose!().run(["scene", "optimise", "wide", "--free", "slit_width=1.9..2", "--radius", "20"]);
    assert_eq!(finished.code, 1, "{}", finished.stderr);
    // The ends of the detectors, as in `slitpose-design`'s test of limits.
    let out = "limits not kept: detectors 5.49 mm too far out (--radius)";
    assert!(finished.stderr.lines().filter(|line| line.contains(out)).count() == 2, "{}", finished.stderr);
    assert!(String::from_utf8(finished.stdout).expect("text").contains("[[cell]]"));
}
