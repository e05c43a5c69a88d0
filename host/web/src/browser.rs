//! What only a browser has: its clocks, and files that the user has given to the page, by functions of `worker.js`. Files are
//! read a piece at a time, so memory does not grow with them.

use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use slitpose_tracking::capture::{CaptureError, CaptureReader};
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::playback::Shelf;
use wasm_bindgen::JsValue;
use wasm_bindgen::prelude::wasm_bindgen;

const READ_BYTES: usize = 1 << 18;

#[wasm_bindgen]
extern "C" {
    /// Bytes of a file from `at` on, at most `count`.
    #[wasm_bindgen(catch, js_name = readFile)]
    fn read_file(name: &str, at: f64, count: f64) -> Result<Vec<u8>, JsValue>;
    #[wasm_bindgen(js_name = lengthOfFile)]
    fn length_of_file(name: &str) -> f64;
    /// Milliseconds since 1970 by a clock that is never set, and by UTC.
    #[wasm_bindgen(js_name = clocks)]
    fn clocks() -> Vec<f64>;
}

pub(crate) fn now() -> HostInstant {
    let ns = |ms: &f64| (ms * 1e6) as u64;
    match &clocks()[..] {
        [monotonic_ms, utc_ms] => HostInstant { monotonic_ns: ns(monotonic_ms), utc_ns: ns(utc_ms) },
        _ => HostInstant::default(),
    }
}

/// The files that the page was given last, by their names.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Files;

impl Shelf for Files {
    type Input = BufReader<UserFile>;

    fn open(&self, path: &Path) -> Result<CaptureReader<Self::Input>, CaptureError> {
        let name = path.to_string_lossy().into_owned();
        CaptureReader::new(path, BufReader::with_capacity(READ_BYTES, UserFile { name, at: 0 }))
    }

    fn length(&self, path: &Path) -> u64 {
        length_of_file(&path.to_string_lossy()) as u64
    }
}

pub(crate) struct UserFile {
    name: String,
    at: u64,
}

impl Read for UserFile {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let failed =
            |_| io::Error::other("the browser cannot read the file; if it was changed or moved, open it again");
        let read = read_file(&self.name, self.at as f64, bytes.len() as f64).map_err(failed)?;
        bytes[..read.len()].copy_from_slice(&read);
        self.at += read.len() as u64;
        Ok(read.len())
    }
}

impl Seek for UserFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
            SeekFrom::End(by) => (length_of_file(&self.name) as u64).checked_add_signed(by),
        };
        self.at = at.ok_or(io::ErrorKind::InvalidInput)?;
        Ok(self.at)
    }
}
