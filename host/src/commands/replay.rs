//! `slitpose replay`: a capture through the live path.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use slitpose_protocol::{Decoder, MAX_MESSAGE_BYTES, Message};

use super::stream::{PoseOptions, Stream, StreamError, open_scene, shipped_with_hash, talk};
use super::{CommandError, Outcome};
use crate::pace::{Pace, Speed};
use crate::pipeline::{Pipeline, SceneMatch};
use crate::scene_file::SceneFile;

/// Bytes read at once: some 4 ms of a board at 4 kHz, so that a replay in real time flows.
const CHUNK_BYTES: usize = 1024;

/// Solves a recorded capture again, through the same pipeline as a live board.
///
/// The same bytes give the same poses, bit for bit. Without --scene the shipped scene that the
/// capture was made with is used. Ends with exit code 3 if the capture is damaged or incomplete.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose replay contact.capture --format csv > poses.csv\n  \
                        slitpose replay contact.capture --speed 0.1")]
pub(super) struct Args {
    /// Capture file
    file: PathBuf,
    /// Scene file, or the name of a shipped scene, also if it is not the one of the capture
    #[arg(long, value_name = "SCENE")]
    scene: Option<String>,
    #[command(flatten)]
    poses: PoseOptions,
    /// Device seconds a second, or max
    #[arg(long, value_name = "N", default_value_t = Speed::Max, allow_negative_numbers = true)]
    speed: Speed,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let path = &args.file;
    let open_error = |source| StreamError::Open { path: path.clone(), source };
    let mut capture = File::open(path).map_err(open_error)?;
    // It is looked at for its scene first, and a pipe gives its bytes only once.
    if capture.metadata().is_ok_and(|metadata| !metadata.is_file() && !metadata.is_dir()) {
        let source = io::Error::new(io::ErrorKind::InvalidInput, "it is no regular file; save it to one first");
        return Err(open_error(source).into());
    }
    let recorded_with = scene_hash(path).map_err(open_error)?;
    let (file, scene_match) = choose_scene(args.scene.as_deref(), recorded_with)?;
    let pipeline = Pipeline::new(file, args.poses.tier(), scene_match)
        .until(args.poses.duration)
        .following(args.poses.following());
    let mut stream = Stream::new(pipeline, &args.poses)?;
    let pace = Pace::new(args.speed);
    let mut chunk = [0; CHUNK_BYTES];
    while !stream.is_over() {
        match capture.read(&mut chunk) {
            Ok(0) => break,
            Ok(count) => {
                stream.push(&chunk[..count])?;
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(source) => return Err(open_error(source).into()),
        }
        stream.tick()?;
        while !stream.is_over() && !pace.nap(stream.elapsed_s()) {}
    }
    let (outcome, counts) = stream.finish()?;
    if counts.scans == 0 {
        let (bytes, packets) = (counts.decoder.bytes, counts.decoder.packets);
        return Err(StreamError::NoScan { path: path.clone(), bytes, packets }.into());
    }
    Ok(outcome)
}

/// The scene hash of the first hello in a capture.
fn scene_hash(path: &Path) -> io::Result<Option<u64>> {
    let mut capture = io::BufReader::new(File::open(path)?);
    let mut decoder = Decoder::<MAX_MESSAGE_BYTES>::new();
    let mut chunk = [0; CHUNK_BYTES];
    loop {
        let count = capture.read(&mut chunk)?;
        if count == 0 {
            return Ok(None);
        }
        let mut bytes = &chunk[..count];
        while let Some(message) = decoder.next::<Message<'_>>(&mut bytes) {
            if let Ok(Message::Hello(hello)) = message {
                return Ok(hello.hashes.scene);
            }
        }
    }
}

fn choose_scene(argument: Option<&str>, recorded_with: Option<u64>) -> Result<(SceneFile, SceneMatch), CommandError> {
    let file = match (argument, recorded_with.and_then(shipped_with_hash)) {
        (None, Some(file)) => return Ok((file, SceneMatch::Required)),
        (argument, _) => open_scene(argument)?,
    };
    match recorded_with {
        Some(hash) if hash != file.hash && argument.is_some() => talk(format_args!(
            "the capture was made with the scene of hash {hash:016x}; solving it with `{}` ({:016x}) as asked",
            file.name, file.hash
        )),
        _ => {}
    }
    Ok((file, if argument.is_some() { SceneMatch::Waived } else { SceneMatch::Required }))
}
