//! `slitpose device`: boards on terminals are listed, named, told what to keep, and left alone while
//! somebody else has them.

use std::collections::BTreeMap;
use std::fs::File;
use std::num::NonZeroU32;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use nix::fcntl::OFlag;
use serde_json::Value;
use slitpose::device::SerialDevice;
use slitpose_firmware::image::{FLASH_BASE, ImageHeader, PAGE_BYTES};
use slitpose_head::scene_file::{SceneFile, WIDE};
use slitpose_protocol::{BootTarget, Command, Decoder, Hashes, MAX_REQUEST_BYTES, Request, ResetCause};
use slitpose_tests::process::{Finished, written};
use slitpose_tests::slitpose;
use slitpose_tests::terminal::{Board, Device, Log, Terminal, greeting};
use slitpose_tracking::link::DeviceId;

const FIRST: &str = "0036002900544850025a0320";
const SECOND: &str = "0036002900544850025a0321";

fn board(serial: &str) -> impl Device + use<> {
    let device: DeviceId = serial.parse().expect("24 digits");
    greeting(Board::wide(81), move |hello| {
        hello.device_id = device.0;
    })
}

fn device(arguments: &[&str]) -> Finished {
    slitpose!().run(["device"].iter().chain(arguments))
}

/// Runs a verb against `served` and gives what both say.
fn at(served: impl Device, verb: &[&str]) -> (Finished, Log, String) {
    let terminal = Terminal::serve(served);
    let path = terminal.path.clone();
    let finished = device(&[verb, &["--device", &path]].concat());
    (finished, terminal.closed(), path)
}

/// What `device list` says of each port that it was told to look at.
fn listed(paths: &[&str], options: &[&str]) -> BTreeMap<String, Value> {
    let searches = paths.iter().flat_map(|path| ["--search", path]);
    let arguments: Vec<_> = ["list", "--format", "ndjson"].into_iter().chain(searches).collect();
    let text = device(&[&arguments, options].concat()).done();
    let lines = text.lines().map(|line| serde_json::from_str::<Value>(line).expect("JSON"));
    // The machine may have ports of its own.
    lines
        .map(|line| (line["port"].as_str().expect("port").to_owned(), line))
        .filter(|(port, _)| paths.contains(&port.as_str()))
        .collect()
}

/// A scene file like `wide`, with a hash of its own.
fn other_scene(folder: &Path) -> SceneFile {
    SceneFile::open(&written(folder, "other.toml", format!("{}\n# Another head.\n", WIDE.text))).expect("scene")
}

fn only_asked(log: &Log) -> bool {
    log.commands().iter().all(|command| *command == Command::Hello)
}

#[test]
fn ports_are_listed_with_what_is_there() {
    let other = greeting(Board::wide(82), |hello| {
        hello.protocol.major = 7;
    });
    let (free, other) = (Terminal::serve(board(FIRST)), Terminal::serve(other));
    let silent = Terminal::serve(|_: &[u8], _: f64, _: &mut Vec<u8>| true);
    let used = Terminal::serve(board(SECOND));
    let held = SerialDevice::open(&used.path).expect("free");
    let paths = [&free.path, &other.path, &silent.path, &used.path].map(|path| path.as_str());
    let lines = listed(&paths, &[]);
    let states = paths.map(|path| lines[path]["state"].as_str().expect("state").to_owned());
    assert_eq!(states, ["free", "other_version", "no_answer", "in_use"]);
    let line = &lines[paths[0]];
    for (key, value) in [("serial", FIRST), ("board", "simulated"), ("kind", "simulated"), ("protocol", "2.0")] {
        assert_eq!(line[key], value, "{line}");
    }
    assert_eq!(lines[paths[1]]["protocol"], "7.0");
    drop(held);
    assert!(used.closed().commands().is_empty(), "asked although it was in use");
    assert!([free, other, silent].map(Terminal::closed).iter().all(only_asked));
}

#[test]
fn nothing_is_opened_if_nothing_shall_be() {
    let terminal = Terminal::serve(board(FIRST));
    let lines = listed(&[&terminal.path], &["--no-probe"]);
    assert_eq!(lines[&terminal.path]["state"], "not_asked");
    assert!(terminal.opened().is_none());
    let pattern =
        format!("{}[{}]", &terminal.path[..terminal.path.len() - 1], &terminal.path[terminal.path.len() - 1..]);
    let table = device(&["list", "--search", &pattern]).done();
    let row = table.lines().find(|line| line.contains(&terminal.path)).expect("found by a pattern");
    assert!(row.contains(FIRST) && row.ends_with("free"), "{row}");
    terminal.closed();
}

#[test]
fn boards_are_told_apart_by_their_numbers() {
    let (first, second) = (Terminal::serve(board(FIRST)), Terminal::serve(board(SECOND)));
    // Opened twice, to be asked and to be used; a terminal that is closed meanwhile is gone.
    let open = File::options().read(true).custom_flags(OFlag::O_NOCTTY.bits()).open(&second.path).expect("opens");
    let search = ["--search", &first.path, "--search", &second.path];
    let finished = device(&[&["info", "--format", "json", "--device", &SECOND.to_uppercase()], &search[..]].concat());
    let info: Value = serde_json::from_str(&finished.done()).expect("JSON");
    assert_eq!((info["hello"]["serial"].as_str(), info["port"].as_str()), (Some(SECOND), Some(second.path.as_str())));
    let wide = WIDE.read().expect("shipped");
    assert_eq!(info["hello"]["scene_hash"], format!("{:016x}", wide.hash));
    assert_eq!(
        (info["hello"]["frame_rate_hz"].as_f64(), info["hello"]["schedule"]["cells"].as_u64()),
        (Some(4000.0), Some(6))
    );
    assert_eq!(info["status"]["acquiring"], false);
    assert_eq!((&info["status"]["clock"], &info["status"]["settings"]), (&"crystal".into(), &"defaults".into()));
    drop(open);
    assert!(only_asked(&first.closed()) && only_asked(&second.closed()));
}

#[test]
fn a_board_says_what_it_is() {
    let (finished, log, path) = at(board(FIRST), &["info"]);
    let text = finished.done();
    for part in [FIRST, &path, "firmware", "power on", "(`wide`)", "up to 10.000 uA", "4000.000 frames/s", "3.300 V"] {
        assert!(text.contains(part), "`{part}` is not in: {text}");
    }
    for line in ["clock        crystal", "settings     defaults of the firmware"] {
        assert!(text.lines().any(|found| found == line), "`{line}` is not in: {text}");
    }
    assert!(only_asked(&log));
    assert!(device(&["info", "--device", "sim"]).done().contains("simulated"));
}

#[test]
fn a_board_of_another_version_is_not_told_anything() {
    for (major, side) in [(1, "the firmware is older"), (9, "this program is older")] {
        let other = greeting(Board::wide(83), move |hello| {
            hello.protocol.major = major;
        });
        let (finished, log, path) = at(other, &["identify"]);
        finished.assert_refused(1, &[&path, side, "update"]);
        assert!(only_asked(&log));
    }
    // The same version, but other messages.
    let keys: Vec<u8> = slitpose_protocol::schema::SchemaKeys::messages().0.iter().map(|byte| !byte).collect();
    let keys: &'static [u8] = keys.leak();
    let other = move || {
        greeting(Board::wide(84), move |hello| {
            hello.message_keys.0 = keys;
        })
    };
    let (finished, log, _) = at(other(), &["set", "--scene", "wide"]);
    finished.assert_refused(1, &["simulated", "different builds", "Hello"]);
    assert!(only_asked(&log));
    let (finished, ..) = at(other(), &["info"]);
    assert!(finished.done().contains("different builds"));
}

#[test]
fn a_board_keeps_the_scene_it_is_given() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let scene = other_scene(folder.path());
    let (finished, log, path) = at(board(FIRST), &["set", "--scene", &scene.origin]);
    let text = finished.done();
    for part in [FIRST, &path, &scene.name, &format!("{:016x}", scene.hash)] {
        assert!(text.contains(part), "{text}");
    }
    let wanted = slitpose_head::front_end::configuration(&scene).expect("schedule");
    let stored = Hashes { scene: Some(scene.hash), calibration: None };
    let expected = [Command::Hello, Command::Configure(wanted), Command::Store(stored), Command::Hello];
    let (heads, others): (Vec<_>, Vec<_>) =
        log.commands().into_iter().partition(|command| matches!(command, Command::Head(_)));
    assert_eq!(others, expected);
    // The head before goes, and that of the scene is sent whole, in order.
    assert!(text.contains("it solves poses itself"), "{text}");
    let mut end = 0;
    for head in &heads[1..] {
        let Command::Head(part) = head else { unreachable!("sorted out") };
        assert_eq!(usize::from(part.offset), end);
        end += part.bytes.len();
        assert!(end <= usize::from(part.total));
    }
    assert!(matches!(&heads[0], Command::Head(part) if part.total == 0));
    assert!(matches!(&heads[heads.len() - 1], Command::Head(part) if usize::from(part.total) == end));

    let (finished, log, _) = at(board(FIRST), &["set", "--scene", "wide", "--full-scale", "6.6"]);
    assert!(finished.clone().done().contains("up to 6.600 uA"), "{}", finished.stderr);
    let full_scale_pa = NonZeroU32::new(6_600_000).expect("not zero");
    assert!(log.commands().contains(&Command::FullScale { full_scale_pa }));
    for wrong in ["0", "-1", "nan", "inf", "4295", "1e-7", "ten"] {
        let finished = device(&["set", "--scene", "wide", &format!("--full-scale={wrong}")]);
        assert!(finished.code == 2 && finished.stderr.contains("give microamperes"), "{wrong}: {}", finished.stderr);
    }

    let (finished, log, _) = at(board(FIRST), &["set", "--clear"]);
    assert!(finished.done().contains("keeps no scene"));
    assert_eq!(log.commands(), [Command::Hello, Command::Forget, Command::Hello]);

    let forgetful = greeting(Board::wide(85), |hello| {
        hello.hashes.scene = None;
    });
    let (finished, _, path) = at(forgetful, &["set", "--scene", "wide"]);
    finished.assert_refused(1, &[&path, "another scene"]);
    assert_eq!(device(&["set"]).code, 2);
    assert_eq!(device(&["set", "--clear", "--scene", "wide"]).code, 2);
}

#[test]
fn a_calibration_outlives_only_its_own_scene() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let other = other_scene(folder.path());
    let own = WIDE.read().expect("shipped").hash;
    for (scene, kept) in [("wide", Some(7)), (&other.origin, None)] {
        let mut board = Board::wide(86);
        board.command(Command::Store(Hashes { scene: Some(own), calibration: Some(7) }));
        let (finished, log, _) = at(board, &["set", "--scene", scene]);
        assert_eq!(finished.clone().done().contains("calibration is forgotten"), kept.is_none());
        let stored = log.commands().into_iter().find_map(|command| match command {
            Command::Store(hashes) => Some(hashes.calibration),
            _ => None,
        });
        assert_eq!(stored, Some(kept), "{scene}");
    }
}

#[test]
fn a_board_shows_itself() {
    let (finished, log, path) = at(board(FIRST), &["identify", "--seconds", "7"]);
    assert!(finished.stderr.contains(FIRST) && finished.stderr.contains(&path), "{}", finished.stderr);
    assert_eq!((finished.code, log.commands().pop()), (0, Some(Command::Identify { seconds: 7 })));
    assert_eq!(device(&["identify", "--seconds", "256"]).code, 2);
}

/// A board that has been reset by command.
fn restarted() -> impl Device {
    greeting(Board::wide(88), |hello| {
        hello.reset_cause = ResetCause::Software;
    })
}

/// A board until 50 ms after a Reboot, by when its reply has gone; then `after`.
fn until_reboot(mut after: impl Device) -> impl Device {
    let mut before = Board::wide(87);
    let mut decoder = Decoder::<MAX_REQUEST_BYTES>::new();
    let mut reset_s = f64::INFINITY;
    move |received: &[u8], now_s: f64, sent: &mut Vec<u8>| {
        if now_s > reset_s {
            return after.act(received, now_s - reset_s, sent);
        }
        let mut bytes = received;
        while let Some(request) = decoder.next::<Request>(&mut bytes) {
            if matches!(request.expect("undamaged").command, Command::Reboot(_)) {
                reset_s = now_s + 0.05;
            }
        }
        before.act(received, now_s, sent)
    }
}

#[test]
fn a_board_that_restarts_is_waited_for() {
    // Its port stays, as that of a debugger; what comes in the first half second is lost.
    let mut board = restarted();
    let later = move |received: &[u8], now_s: f64, sent: &mut Vec<u8>| now_s < 0.5 || board.act(received, now_s, sent);
    let (finished, log, path) = at(until_reboot(later), &["reboot"]);
    finished.assert_said(0, &[&format!("is back on {path}")]);
    assert!(!finished.stderr.contains("last started"), "{}", finished.stderr);
    assert_eq!(log.commands()[1], Command::Reboot(BootTarget::Firmware));

    let (finished, _, _) = at(Board::wide(89), &["reboot"]);
    assert!(finished.stderr.contains("last started by `power_on`"), "did not restart: {}", finished.stderr);
}

#[test]
fn a_board_that_is_gone_while_it_restarts_is_waited_for() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let link = folder.path().join("board");
    let point = |terminal: &Terminal| std::os::unix::fs::symlink(&terminal.path, &link).expect("link");
    let removed = link.clone();
    let unplugged = move |_: &[u8], _: f64, _: &mut Vec<u8>| {
        // The name goes first: the system may give the terminal's to somebody else.
        std::fs::remove_file(&removed).expect("link");
        false
    };
    let before = Terminal::serve(until_reboot(unplugged));
    point(&before);
    let link_text = link.to_str().expect("UTF-8");
    let child = slitpose!().spawn(["device", "reboot", "--device", link_text]);
    before.closed();
    let after = Terminal::serve(restarted());
    point(&after);
    let finished = Finished::of(child);
    finished.assert_said(0, &[&format!("is back on {link_text}")]);
    assert!(only_asked(&after.closed()));
}

#[test]
fn a_board_in_its_boot_loader_is_not_waited_for() {
    let (finished, log, _) = at(Board::wide(90), &["reboot", "--boot-loader"]);
    assert!(finished.stderr.contains("slitpose device update"), "{}", finished.stderr);
    let expected = [Command::Hello, Command::Reboot(BootTarget::BootLoader)];
    assert_eq!((finished.code, &log.commands()[..]), (0, &expected[..]));
}

/// A board for which a file is none keeps its firmware, and its head, too.
#[test]
fn firmware_for_another_board_is_refused_before_the_board_is_told_anything() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut flash = vec![0xff; 3 * PAGE_BYTES];
    flash[0x9d8..0x9f4].copy_from_slice(&ImageHeader::of_this_source("NUCLEO-H743ZI").encode());
    flash[0x9f4..0x9f8].copy_from_slice(&(FLASH_BASE + 3 * PAGE_BYTES as u32).to_le_bytes());
    flash[3 * PAGE_BYTES - 8..].fill(0);
    let other = written(folder.path(), "other.bin", &flash);
    let (finished, log, _) = at(Board::wide(90), &["update", &other]);
    finished.assert_refused(1, &["for the board NUCLEO-H743ZI", "give the file for that"]);
    assert_eq!(log.commands(), [Command::Hello]);
    device(&["update", "--device", "sim"]).assert_refused(2, &["simulated board has no firmware"]);
    let torn = written(folder.path(), "torn.bin", &flash[..3 * PAGE_BYTES - 8]);
    device(&["update", &torn]).assert_refused(1, &["torn.bin", "no whole image", "of a release"]);
}

#[test]
fn a_port_in_use_is_left_alone_and_its_holder_named() {
    let terminal = Terminal::serve(board(FIRST));
    let held = SerialDevice::open(&terminal.path).expect("free");
    for verb in [&["info"][..], &["set", "--scene", "wide"], &["identify"], &["reboot"]] {
        let finished = device(&[verb, &["--device", &terminal.path]].concat());
        finished.assert_refused(1, &[&terminal.path, "in use", "slitpose run"]);
        if cfg!(target_os = "linux") {
            assert!(finished.stderr.contains(&format!("process {}", std::process::id())), "{}", finished.stderr);
        }
    }
    drop(held);
    assert!(terminal.closed().commands().is_empty());
}
