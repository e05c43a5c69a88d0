//! `slitpose doctor`: a good board is found good, a bad one is found bad in the right place, and the bundle holds
//! what it says. In `--bring-up` a good board passes every step, simulated and emulated, and each flaw that the emulator
//! plants is named by the step that looks for it.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::process::Command;
use std::time::Duration;

use nix::pty::openpty;
use slitpose::device::SerialDevice;
use slitpose_emulator::facts::number;
use slitpose_emulator::faults::{Fault, Kind};
use slitpose_head::scene_file::WIDE;
use slitpose_tests::process::{Finished, name_in};
use slitpose_tests::slitpose;
use slitpose_tests::terminal::{Board, Device, Terminal};

use super::run_emulated::Emulator;

/// Runs the doctor and gives each check's verdict, too.
fn doctor(device: &str, arguments: &[&str]) -> (Finished, BTreeMap<String, String>) {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path().to_str().expect("UTF-8");
    let finished = slitpose!().run([&["doctor", "--device", device, "--folder", folder], arguments].concat());
    let text = String::from_utf8(finished.stdout.clone()).expect("UTF-8");
    // Verdict in 8 columns, name in 14.
    let checks = text.lines().filter(|line| !line.starts_with(' ')).map(|line| {
        let (verdict, name) = (&line[..8], &line[9..23]);
        (name.trim().to_owned(), verdict.trim().to_owned())
    });
    (finished, checks.collect())
}

fn at(served: impl Device) -> (Finished, BTreeMap<String, String>, String) {
    let terminal = Terminal::serve(served);
    let path = terminal.path.clone();
    let (finished, checks) = doctor(&path, &["--duration", "300ms"]);
    terminal.closed();
    (finished, checks, path)
}

#[test]
fn a_simulated_board_is_well_and_its_bundle_is_whole() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let bundle = &*name_in(folder.path(), "report.tar.gz");
    let (finished, checks) = doctor("sim", &["--duration", "200ms", "--bundle", bundle]);
    let good = ["hello", "version", "last start", "scene", "full scale", "board", "link", "poses", "health"];
    for name in good.into_iter().chain(["oscillator", "settings"]) {
        assert_eq!(checks.get(name).map(String::as_str), Some("ok"), "{name}: {checks:?}");
    }
    for name in ["rate", "date", "clock", "priority", "disk space", "disk rate"] {
        assert!(checks.contains_key(name), "{name}: {checks:?}");
    }
    assert_eq!(checks["port"], "skipped");
    assert_eq!(finished.code, 0, "{}", finished.stderr);

    let unpacked = Command::new("tar").args(["-xzf", bundle, "-C"]).arg(folder.path()).status().expect("tar");
    assert!(unpacked.success());
    let file = |name: &str| std::fs::read(folder.path().join("slitpose-doctor").join(name)).expect("in the bundle");
    assert_eq!(file("report.txt"), finished.stdout);
    assert_eq!(file("scene.toml"), WIDE.text.as_bytes());
    let stream = slitpose_tests::capture::decode(&file("stream.bin"));
    assert_eq!(stream.scans.len(), 800);
    for name in ["report.txt", "report.json", "hello.json", "scene.toml", "stream.bin", "system.txt"] {
        assert!(finished.stderr.contains(name) && !file(name).is_empty(), "{name}: {}", finished.stderr);
    }
    let folder = folder.path().to_str().expect("UTF-8");
    for name in ["report.txt", "report.json", "system.txt"] {
        assert!(!String::from_utf8_lossy(&file(name)).contains(folder), "where things are is private");
    }
}

#[test]
fn a_board_on_a_port_is_well() {
    let (finished, checks, path) = at(Board::wide(91));
    for name in ["ports", "permission", "exclusive", "hello", "scene", "board", "link", "poses"] {
        assert_eq!(checks.get(name).map(String::as_str), Some("ok"), "{name}: {checks:?}");
    }
    assert!(String::from_utf8_lossy(&finished.stdout).contains(&path));
}

#[test]
fn what_is_no_board_gets_no_further() {
    let (finished, checks, _) = at(|_: &[u8], _: f64, _: &mut Vec<u8>| true);
    let verdicts = ["exclusive", "hello", "measurement"].map(|name| checks[name].as_str());
    assert_eq!((verdicts, finished.code), (["ok", "failed", "skipped"], 1));
    assert!(checks.contains_key("disk rate"), "the host is looked at all the same");

    let terminal = Terminal::serve(Board::wide(93));
    let held = SerialDevice::open(&terminal.path).expect("free");
    let (finished, checks) = doctor(&terminal.path, &[]);
    assert_eq!((checks["exclusive"].as_str(), finished.code), ("failed", 1));
    let text = String::from_utf8_lossy(&finished.stdout).into_owned();
    assert!(text.contains("in use"), "{text}");
    assert!(!cfg!(target_os = "linux") || text.contains(&format!("process {}", std::process::id())), "{text}");
    drop(held);
    terminal.closed();
}

const STEPS: &str = "continuity link supply dark noise emitters levels settling crosstalk trigger safety storage";

/// Arguments of an emulator as fast as it can, its tool at rest at home.
const AT_HOME: [&str; 7] = ["wide", "--seed", "5", "--trajectory", "still", "--speed", "max"];

/// Faults with which light settles in time, and when 0.3 codes of full scale are left by an integration of their
/// resistors, capacitors and poles, microseconds.
const SETTLE: [(Fault, f64); 2] = [(Fault::LineDetector, 11.9), (Fault::SlowDetector, 13.5)];

/// Each other flaw, the step that must find it, and the words of its finding.
const FOUND: [(Fault, &str, &[&str]); 15] = [
    (Fault::OpenElectrode, "emitters", &["I_X1 of cell 2 (PC0, CN7-38) sees no light"]),
    (Fault::StuckElectrode, "dark", &["I_X2 of cell 4 (PB11, CN10-18)", "stuck at ground"]),
    (Fault::NoisyChannel, "noise", &["I_X1 of cell 1 (PA1, CN7-30)", "too noisy"]),
    (Fault::DeadEmitter, "emitters", &["emitter 3 gives no light", "PC9"]),
    (Fault::SwappedGates, "emitters", &["gates exchanged: gate of emitter 1 (PC7", "gate of emitter 4 (PC10"]),
    (Fault::SwappedCells, "emitters", &["inputs exchanged: I_X1 of cell 0 (PA0", "I_X2 of cell 5 (PB15"]),
    (Fault::StuckLevel, "levels", &["level line of emitters 0 to 2 (PA4, CN7-32) stays at nominal"]),
    (Fault::LiftedLevel, "levels", &["level line of emitters 0 to 2 (PA4, CN7-32) is off by 5.0 % of nominal"]),
    (Fault::StuckGate, "dark", &["shine while their gates are off: 2 (26"]),
    (Fault::WeakEmitter, "emitters", &["0.50 of that", "emitter 5 is weak"]),
    (
        Fault::SlowFrontEnd,
        "settling",
        &["full scale are left after 32.", "one time constant of 3.", "the front end is slow"],
    ),
    (Fault::MissingBaffle, "crosstalk", &["too much by emitter 2", "too much by emitter 1"]),
    (Fault::LowSupply, "supply", &["V_DDA 3.000 V, expected 3.135 to 3.465 V"]),
    (Fault::LostSettings, "storage", &["after a reboot none", "settings are lost"]),
    (
        Fault::MissingWire,
        "trigger",
        &["pulses of the frame output (PA10, CN10-33) came back at the trigger input (PC12, CN7-3), as 0 edges"],
    ),
];

fn bring_up(device: &str, arguments: &[&str]) -> Finished {
    slitpose!().run([&["doctor", "--bring-up", "--device", device], arguments].concat())
}

/// Asserts that all steps were taken in their order, and that nothing failed.
fn assert_well(finished: &Finished) {
    let text = finished.text();
    println!("{text}{}", finished.stderr);
    assert_eq!(finished.code, 0, "{}", finished.stderr);
    let taken = text.lines().filter(|line| line.starts_with("step "));
    let expected = (1..).zip(STEPS.split(' ')).map(|(number, name)| format!("step {number} of 12, {name}"));
    assert!(taken.zip(expected).filter(|(line, start)| line.starts_with(start)).count() == 12);
    assert!(!text.lines().any(|line| line.starts_with("failed")));
}

#[test]
fn a_simulated_board_passes_every_step() {
    // Standard input is no terminal: nobody is asked.
    assert_well(&bring_up("sim", &[]));
}

/// Its DACs do not reach 0 V: buffered ones are promised from 0.2 V on, and relatives of the MCU end at 25 to 69 mV.
#[test]
fn an_emulated_board_passes_every_step_and_is_left_as_it_was() {
    let emulator = Emulator::start(&[&AT_HOME[..], &["--silicon", "dac-rest"]].concat());
    let info = || slitpose!().run(["device", "info", "--device", &emulator.path]).text().to_owned();
    let before = info();
    let finished = bring_up(&emulator.path, &["--yes", "--scene", "wide"]);
    assert_well(&finished);
    let text = finished.text();
    let lowest = text.split("at levels ").nth(1).and_then(|levels| levels.split(' ').next()?.parse::<f64>().ok());
    // Nominal is half of V_DDA.
    assert!(lowest.expect("levels") * 0.5 * 3.3 >= number("V_DAC_headroom"), "{lowest:?}");
    for place in
        ["board", "link", "zero", "gates off", "noise", "codes", "trigger", "stop", "port closed", "storage", "forget"]
    {
        assert!(text.lines().any(|line| line.starts_with(&format!("ok       {place:14} "))), "{place}");
    }
    for [place, count] in [["emitters", "6"], ["levels", "6"], ["settling", "6"], ["crosstalk", "6"]] {
        let rows = text.lines().filter(|line| line.starts_with(&format!("ok       {place:14} ")));
        assert_eq!(rows.count().to_string(), count, "{place}");
    }
    let kept = |info: &str| -> Vec<String> {
        let names = ["serial", "board", "scene", "calibration", "scaling", "schedule"];
        let is_kept = |line: &&str| names.contains(&line.split(' ').next().unwrap_or_default());
        info.lines().filter(is_kept).map(str::to_owned).collect()
    };
    let (before, after) = (kept(&before), kept(&info()));
    assert!(before.len() == 6 && before == after, "{before:?} {after:?}");
    // Settings that were there before are kept.
    let set = slitpose!().run(["device", "set", "--device", &emulator.path, "--scene", "wide"]);
    assert_eq!(set.code, 0, "{}", set.stderr);
    let stored = bring_up(&emulator.path, &["--step", "storage"]);
    assert_eq!(stored.code, 0, "{}", stored.stderr);
    assert!(!stored.text().contains("forget"), "{}", stored.text());
    assert!(info().lines().any(|line| line.starts_with("settings") && line.contains("stored")), "{}", info());
    // Steps are taken alone, too, by number.
    let alone = bring_up(&emulator.path, &["--step", "3"]);
    assert_eq!(alone.code, 0, "{}", alone.stderr);
    let stdout = String::from_utf8(alone.stdout).expect("UTF-8");
    assert_eq!(stdout.lines().filter(|line| line.starts_with("step ")).count(), 1, "{stdout}");
    emulator.close();
}

#[test]
fn each_flaw_is_named_by_the_step_that_looks_for_it() {
    let tested = || FOUND.map(|(flaw, ..)| flaw).into_iter().chain(SETTLE.map(|(flaw, _)| flaw));
    assert!(Fault::of(Kind::Board).iter().all(|flaw| tested().any(|tested| tested == *flaw)));
    for (flaw, step, words) in FOUND {
        let emulator = Emulator::start(&[&AT_HOME[..], &["--silicon", "dac-rest", "--flaw", &flaw.name()]].concat());
        let finished = bring_up(&emulator.path, &["--step", step, "--scene", "wide"]);
        let text = finished.text();
        println!("{}: {}\n{text}{}", flaw.name(), flaw.what(), finished.stderr);
        assert_eq!(finished.code, 1, "{}", flaw.name());
        let failed: Vec<&str> = text.lines().filter(|line| line.starts_with("failed")).collect();
        for word in words {
            assert!(failed.iter().any(|line| line.contains(word)), "{}: no `{word}`", flaw.name());
        }
        assert!(finished.stderr.contains(&format!("take these steps again: {step}")), "{}", finished.stderr);
        // Nothing but the flaw is complained of.
        let most = match flaw {
            Fault::SlowFrontEnd => 6,
            Fault::StuckLevel | Fault::LiftedLevel => 3,
            Fault::MissingBaffle => 2,
            _ => 1,
        };
        assert_eq!(failed.len(), most, "{}", flaw.name());
        emulator.close();
    }
}

#[test]
fn detectors_with_more_than_one_pole_have_the_instant_at_which_their_light_has_settled() {
    for (flaw, settled_us) in SETTLE {
        let emulator = Emulator::start(&[&AT_HOME[..], &["--flaw", &flaw.name()]].concat());
        let finished = bring_up(&emulator.path, &["--step", "settling", "--scene", "wide"]);
        let text = finished.text();
        println!("{}\n{text}", flaw.name());
        let rows: Vec<&str> = text.lines().filter(|line| line.starts_with("ok       settling")).collect();
        assert!(finished.code == 0 && rows.len() == 6, "{}", flaw.name());
        for row in rows {
            let found_us =
                row.split("left after ").nth(1).and_then(|found| found.split(' ').next()?.parse::<f64>().ok());
            assert!((found_us.expect("an instant") - settled_us).abs() < 0.4, "{}: {row}", flaw.name());
        }
        emulator.close();
    }
}

/// Of an unpowered board only a user with a multimeter knows: it is not looked for, and not powered with a fault.
#[test]
fn the_continuity_check_asks_for_each_measurement_and_ends_before_power() {
    let rows = || slitpose_firmware::pcb::pins::rows("check");
    let listed = bring_up("/dev/no-such-board", &["--step", "continuity"]);
    assert!(listed.code == 0 && rows().all(|row| listed.text().contains(&format!("{}: {}", row.name, row.function))));
    let pair = openpty(None, None).expect("pseudo-terminal");
    let arguments = ["doctor", "--bring-up", "--device", "/dev/no-such-board"];
    let child = slitpose!().command(arguments).stdin(pair.slave).spawn().expect("slitpose starts");
    let answers = rows().map(|row| if row.name == "CN7-28 to CN7-23" { "n\n" } else { "\n" }).collect::<String>();
    nix::unistd::write(&pair.master, answers.as_bytes()).expect("written");
    let finished = Finished::of(child);
    let failed: Vec<&str> = finished.text().lines().filter(|line| line.starts_with("failed")).collect();
    assert!(finished.code == 1 && failed.len() == 1 && failed[0].contains("CN7-28 to CN7-23: open, but"), "{failed:?}");
    assert!(finished.text().contains("open SB21") && finished.stderr.contains("before you apply power"));
}

#[test]
fn at_a_terminal_a_step_waits_for_enter() {
    let pair = openpty(None, None).expect("pseudo-terminal");
    let arguments = ["doctor", "--bring-up", "--device", "sim", "--step", "supply"];
    let mut child = slitpose!().command(arguments).stdin(pair.slave).spawn().expect("slitpose starts");
    let mut stderr = BufReader::new(child.stderr.take().expect("piped"));
    let mut asked = String::new();
    stderr.read_line(&mut asked).expect("UTF-8");
    assert!(asked.contains("press Enter"), "{asked}");
    std::thread::sleep(Duration::from_millis(500));
    assert!(child.try_wait().expect("a child").is_none(), "it has not waited");
    nix::unistd::write(&pair.master, b"\n").expect("written");
    let finished = Finished::of(child);
    assert_eq!(finished.code, 0);
    assert!(finished.text().contains("V_DDA 3.300 V"), "{}", finished.text());
}

#[test]
fn what_the_bring_up_cannot_do_is_refused() {
    let missing = bring_up("/dev/no-such-board", &[]);
    assert_eq!(missing.code, 1, "{}", missing.stderr);
    assert!(missing.text().contains("/dev/no-such-board") && missing.text().contains("slitpose doctor"));
}
