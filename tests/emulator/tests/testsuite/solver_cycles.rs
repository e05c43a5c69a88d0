//! The pose solver on the board's core: right, and as fast as it is said to be.

use std::process::Command;

use slitpose_emulator::memory::RAM_BYTES;
use slitpose_emulator::peripherals::TICKS_PER_SECOND;
use slitpose_emulator::solver_cost::{Cost, Start, Trial, measure};
use slitpose_emulator::stopwatch::{Stopwatch, StopwatchError, open_stopwatch_image};
use slitpose_head::scene_file::WIDE;
use slitpose_model::Tier;
use slitpose_stopwatch::MAILBOX_SYMBOL;

const POSES: usize = 5;
const SEED: u64 = 1;

fn cost(tier: Tier, start: Start) -> Cost {
    let file = WIDE.read().expect("shipped");
    let image = open_stopwatch_image(None).expect("an image");
    let trial = Trial::new(&file, tier, POSES, SEED).expect("poses");
    let mut stopwatch = Stopwatch::boot(&image, &file.scene, tier).expect("a solver");
    let cost = measure(&mut stopwatch, &trial, start).expect("the host's poses");
    assert!((90_000..RAM_BYTES).contains(&stopwatch.ram_bytes()) && stopwatch.ccm_bytes() > 16_000);
    println!("{tier:?} {start:?}, {POSES} poses, seed {SEED}: {cost:?}, {} bytes of RAM", stopwatch.ram_bytes());
    cost
}

#[test]
fn a_followed_tool_is_solved_for_in_the_paper_tier() {
    let cost = cost(Tier::Paper, Start::Warm);
    // Two currents with six derivatives each are hundreds of operations a cell: less is no solve. More
    // is more than 150 µs.
    assert!((20_000..25_400).contains(&cost.median_cycles));
    // Neither exact, which f32 is not, nor off by more than a few hundredths of σ (0.7 µm, 0.1 mrad),
    // which is what a warm solve may leave of its way.
    assert!((1e-11..3e-8).contains(&cost.rms_error_m) && (1e-9..3e-6).contains(&cost.rms_error_rad));
}

#[test]
fn a_lost_tool_is_found_in_the_paper_tier() {
    let cost = cost(Tier::Paper, Start::Cold);
    assert!((36_000..48_000).contains(&cost.median_cycles) && cost.max_cycles >= cost.median_cycles);
    assert!((1e-11..1e-8).contains(&cost.rms_error_m) && (1e-9..2e-6).contains(&cost.rms_error_rad));
}

#[test]
fn the_exact_tier_costs_more_and_errs_by_its_tolerance() {
    let coarse = cost(Tier::Exact { tolerance: 1e-4 }, Start::Warm);
    let fine = cost(Tier::Exact { tolerance: 1e-6 }, Start::Warm);
    assert!(40_000 < coarse.median_cycles && coarse.median_cycles < fine.median_cycles && fine.median_cycles < 58_000);
    // A ten-thousandth of the spot's millimetre is 0.1 µm.
    assert!(coarse.rms_error_m < 1e-7 && (1e-11..3e-8).contains(&fine.rms_error_m));
}

#[test]
fn a_profile_accounts_for_every_cycle() {
    let file = WIDE.read().expect("shipped");
    let image = open_stopwatch_image(None).expect("an image");
    let trial = Trial::new(&file, Tier::Paper, 1, SEED).expect("poses");
    let mut stopwatch = Stopwatch::boot(&image, &file.scene, Tier::Paper).expect("a solver");
    stopwatch.start_profile();
    let cost = measure(&mut stopwatch, &trial, Start::Warm).expect("the host's pose");
    let profile = stopwatch.take_profile().expect("started");
    // Reading the counter twice is not in the count itself.
    assert!((0..100).contains(&(profile.total() as i64 - i64::from(cost.median_cycles))));
    let functions = profile.functions(&image);
    assert_eq!(functions.iter().map(|function| function.cycles).sum::<u64>(), profile.total());
    assert!(functions.iter().all(|function| !function.name.is_empty()), "{functions:?}");
    assert!(functions.iter().any(|function| function.name.contains("slitpose_model::") && function.calls > 0));
}

fn slitpose_cycles(arguments: &[&str]) -> (Option<i32>, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_slitpose-cycles")).args(arguments).output().expect("runs");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("text");
    (output.status.code(), text(output.stdout), text(output.stderr))
}

#[test]
fn the_table_has_a_row_for_each_tier_and_start() {
    let (code, out, err) = slitpose_cycles(&["base", "--poses", "2", "--profile"]);
    assert_eq!(code, Some(0), "{err}");
    let mut reader = csv::Reader::from_reader(out.as_bytes());
    let columns = reader.headers().expect("a header").clone();
    let column = |name: &str| columns.iter().position(|column| column == name).expect(name);
    let mut cases = Vec::new();
    for row in reader.records() {
        let row = row.expect("as wide as its header");
        let number = |name: &str| row[column(name)].parse::<f64>().expect(name);
        assert_eq!((&row[column("scene")], number("cells"), number("poses")), ("base", 6.0, 2.0));
        let us = number("median_cycles") * 1e6 / TICKS_PER_SECOND as f64;
        assert!((number("median_us_at_170mhz") - us).abs() < 0.06 && number("rms_error_urad") > 0.0);
        cases.push(format!("{} {}", &row[column("tier")], &row[column("start")]));
    }
    let tiers = ["paper", "exact:1e-4", "exact:1e-6"];
    assert_eq!(cases, tiers.map(|tier| [format!("{tier} cold"), format!("{tier} warm")]).concat());
    assert!(err.contains("slitpose_model::") && err.contains("CCM SRAM"), "{err}");
}

#[test]
fn a_scene_with_effects_is_refused() {
    let mut scene = WIDE.read().expect("shipped").scene;
    scene.cells[3].effects.source_diameter_m = 0.3e-3;
    let refused = Stopwatch::boot(&open_stopwatch_image(None).expect("an image"), &scene, Tier::Paper);
    assert!(matches!(refused, Err(StopwatchError::Effects { cell: 3 })), "{refused:?}");
}

#[test]
fn what_is_missing_is_named_with_the_next_step() {
    let (code, out, err) = slitpose_cycles(&["--elf", "/nowhere/image"]);
    assert_eq!((code, out.as_str()), (Some(1), ""));
    assert!(err.contains("/nowhere/image") && err.contains("firmware/build --stopwatch"), "{err}");

    let board = slitpose_emulator::rig::default_image_path();
    let (code, _, err) = slitpose_cycles(&["--elf", board.to_str().expect("text")]);
    assert!(code == Some(1) && err.contains(MAILBOX_SYMBOL) && err.contains("firmware/build --stopwatch"), "{err}");

    let (code, _, err) = slitpose_cycles(&["bench", "--poses", "1"]);
    assert!(code == Some(1) && err.contains("bench"), "{err}");
    assert_eq!(slitpose_cycles(&["--poses", "0"]).0, Some(2));
}
