//! What a host reads of strangers: captures, calibrations and configurations, requests of programs and pages, and the bytes
//! of a device on the port.

use std::io::Cursor;
use std::path::Path;
use std::sync::LazyLock;

use slitpose::commands::configured_options;
use slitpose::datagram::{Answer, Request};
use slitpose::http::is_own_request;
use slitpose_calibration::Calibration;
use slitpose_head::scene_file::{SceneFile, WIDE, fnv1a_64};
use slitpose_head::table::CAPTURE_MAGIC;
use slitpose_model::{CompiledScene, Pose, Tier};
use slitpose_tracking::capture::{CaptureReader, Entry};
use slitpose_tracking::link::Segment;
use slitpose_tracking::page;
use slitpose_tracking::pipeline::{Item, Pipeline, PipelineError, SceneMatch};

use crate::wire::repaired;

/// Damage is counted, never an error; what is whole and what is lost are parts of the file. From a later instant on, and of
/// a whole file that is cut off, no more is read than of the whole, and a second time the same.
pub(crate) fn capture(bytes: &[u8]) {
    let (&cut, bytes) = bytes.split_first().unwrap_or((&0, &[]));
    let whole = captured(bytes, 0);
    assert_eq!(captured(bytes, 0), whole);
    let later = captured(bytes, u64::from(cut) << 56);
    assert!(later.link_bytes <= whole.link_bytes, "{later:?} after {whole:?}");
    // Of a damaged file a part may show more: a wrong length that swallows what follows is noticed only where that is
    // missing.
    if bytes.starts_with(CAPTURE_MAGIC) && !whole.has_loss {
        let part = captured(&bytes[..bytes.len() * usize::from(cut) / 256], 0);
        assert!(part.link_bytes <= whole.link_bytes, "{part:?} of {whole:?}");
    }
}

/// What a capture holds: bytes of links, entries of other kinds, and bytes of the file that are whole or could not be read.
#[derive(Debug, PartialEq)]
struct Captured {
    link_bytes: u64,
    others: u64,
    whole_bytes: u64,
    lost_bytes: u64,
    has_loss: bool,
}

fn captured(bytes: &[u8], from_ns: u64) -> Captured {
    const READABLE: &str = "bytes in memory can be read";
    let mut reader = CaptureReader::new(Path::new("bytes"), Cursor::new(bytes)).expect(READABLE).starting_at(from_ns);
    let (mut link_bytes, mut others, mut segment) = (0, 0, Segment::default());
    while let Some(entry) = reader.next(&mut segment).expect(READABLE) {
        match entry {
            Entry::Link { .. } => link_bytes += segment.bytes.len() as u64,
            Entry::Setup(_) | Entry::Hello { .. } | Entry::Note { .. } => others += 1,
        }
    }
    let end = reader.end();
    let (whole_bytes, lost_bytes, has_loss) = (end.whole_bytes, end.lost_bytes, end.has_loss());
    assert!(whole_bytes.max(lost_bytes) <= bytes.len() as u64, "{whole_bytes} whole, {lost_bytes} lost");
    Captured { link_bytes, others, whole_bytes, lost_bytes, has_loss }
}

/// A calibration is refused with a message that names the file, or gives a head whose covariance is a number. The hash in
/// its first line is put right, else no mutation would be read.
pub(crate) fn calibration(bytes: &[u8]) {
    let rest = after_the_first_line(bytes);
    let repaired = [format!("hash = \"{:016x}\"\n", fnv1a_64(rest)).as_bytes(), rest].concat();
    for bytes in [bytes, &repaired] {
        let calibration = match Calibration::from_bytes("stranger.toml", bytes) {
            Ok(calibration) => calibration,
            Err(error) => {
                assert!(error.to_string().contains("stranger.toml"), "no place: {error}");
                continue;
            }
        };
        let covariance = calibration.pose_covariance(&Pose::HOME);
        assert!(covariance.iter().flatten().all(|value| !value.is_nan()), "a covariance is no number");
        let own = calibration.scene_file().ok();
        for file in own.into_iter().chain(WIDE.read()) {
            if let Ok(scene) = calibration.apply(&file) {
                assert!(CompiledScene::<f64>::compile(&scene, Tier::Paper).is_ok());
            }
        }
    }
}

fn after_the_first_line(bytes: &[u8]) -> &[u8] {
    bytes.iter().position(|&byte| byte == b'\n').map_or(&[], |end| &bytes[end + 1..])
}

/// A configuration sets each option once, or is refused with a message that names the place.
pub(crate) fn configuration(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    match configured_options(Path::new("config.toml"), text) {
        Ok(mut options) => {
            let count = options.len();
            options.sort_unstable();
            options.dedup();
            assert_eq!(options.len(), count, "an option is set twice");
        }
        Err(message) => assert!(message.contains("config.toml"), "no place: {message}"),
    }
}

/// What is read as a request or an answer is written as the same bytes, but for requests without a cookie, which are
/// shorter.
pub(crate) fn datagram(bytes: &[u8]) {
    if let Some(request) = Request::from_bytes(bytes) {
        let written = request.to_bytes();
        assert_eq!(Request::from_bytes(&written), Some(request));
        assert!(written == *bytes || (bytes.len() < Request::BYTES && request.cookie == 0));
    }
    if let Some(answer) = Answer::from_bytes(bytes) {
        assert_eq!(answer.to_bytes(), bytes);
    }
}

/// A message of a page is refused, or it is an object with a kind.
pub(crate) fn page(bytes: &[u8]) {
    if let Ok(text) = std::str::from_utf8(bytes)
        && page::Request::read(text).is_ok()
    {
        let object: serde_json::Map<String, serde_json::Value> = serde_json::from_str(text).expect("an object");
        assert!(object.get("kind").is_some_and(serde_json::Value::is_string), "{text}");
    }
}

/// One header a line, the name before the first colon. Served are requests without `Origin` and with no `Host` but one of
/// this host, or with the origin that `Host` names.
pub(crate) fn http(bytes: &[u8]) {
    let lines = bytes.split(|&byte| byte == b'\n');
    let headers: Vec<_> = lines
        .filter_map(|line| {
            let colon = line.iter().position(|&byte| byte == b':')?;
            Some((&line[..colon], &line[colon + 1..]))
        })
        .collect();
    if !is_own_request(headers.iter().copied()) {
        return;
    }
    let valued = |asked: &str| {
        let is_asked = move |(name, _): &&(&[u8], &[u8])| name.eq_ignore_ascii_case(asked.as_bytes());
        headers.iter().filter(is_asked).map(|(_, value)| String::from_utf8_lossy(value)).collect::<Vec<_>>()
    };
    for host in valued("host") {
        let host = host.to_ascii_lowercase();
        assert!(host.contains("localhost") || host.contains("127.") || host.contains("::"), "served {host}");
    }
    for origin in valued("origin") {
        assert!(origin.starts_with("http://"), "served {origin}");
    }
}

/// That of a main thread, where `replay` runs: without optimisation a pipeline is moved about by value.
const STACK_BYTES: usize = 8 << 20;

/// Every scan is solved once, in the order of the board's numbers; each pose has a covariance of numbers; the same bytes in
/// two pieces give the same. Boards that do not suit the scene are refused.
pub(crate) fn hostile_board(bytes: &[u8]) {
    let (&cut, bytes) = bytes.split_first().unwrap_or((&0, &[]));
    let stream = repaired(bytes);
    let at = stream.len() * usize::from(cut) / 256;
    let judge = || assert_eq!(solve(&[&stream]), solve(&[&stream[..at], &stream[at..]]), "cut at {at}");
    std::thread::scope(|scope| {
        let judged = std::thread::Builder::new().stack_size(STACK_BYTES).spawn_scoped(scope, judge);
        judged.expect("a thread").join().unwrap_or_else(|reason| std::panic::resume_unwind(reason));
    });
}

/// The number of a scan, and the bits of its pose.
type Solved = (u64, Option<[u64; 3]>);

/// What came of the scans, and whether the board was refused.
fn solve(pieces: &[&[u8]]) -> (Vec<Solved>, bool) {
    static HEAD: LazyLock<SceneFile> = LazyLock::new(|| WIDE.read().expect("shipped"));
    let mut pipeline = Pipeline::new(HEAD.clone(), Tier::Paper, SceneMatch::Waived).watched();
    let (mut solved, mut scans) = (Vec::new(), 0_usize);
    let mut is_refused = false;
    for piece in pieces {
        let pushed = pipeline.push(piece, |item| {
            match item {
                Item::Scan(_) => scans += 1,
                Item::Pose(record) => {
                    let bits = record.solution.estimate.as_ref().map(|estimate| {
                        assert!(estimate.covariance.iter().flatten().all(|value| value.is_finite()), "{record:?}");
                        estimate.pose.translation_m.to_array().map(f64::to_bits)
                    });
                    solved.push((record.sequence, bits));
                }
                _ => {}
            }
            Ok::<_, PipelineError>(())
        });
        if pushed.is_err() {
            is_refused = true;
            break;
        }
    }
    assert!(solved.len() <= scans, "{} poses of {scans} scans", solved.len());
    (solved, is_refused)
}
