//! What only a browser has: its clocks, and files that the user has given to the page.

use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::rc::Rc;

use slitpose_tracking::capture::{CaptureError, CaptureReader};
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::playback::Shelf;
use wasm_bindgen::JsCast;
use wasm_bindgen::prelude::wasm_bindgen;
use web_sys::{Blob, File, FileReaderSync};

use crate::station::Station;

#[wasm_bindgen]
extern "C" {
    #[wasm_bindgen(js_namespace = performance, js_name = timeOrigin, thread_local_v2)]
    static TIME_ORIGIN_MS: f64;
    #[wasm_bindgen(js_namespace = performance, js_name = now)]
    fn now_ms() -> f64;
}

#[wasm_bindgen]
impl Station {
    /// Shows nothing yet.
    #[wasm_bindgen(constructor)]
    #[expect(clippy::new_without_default, reason = "JavaScript has no defaults")]
    pub fn new() -> Self {
        Self::by(Box::new(|| {
            let ms = TIME_ORIGIN_MS.with(|origin_ms| *origin_ms) + now_ms();
            HostInstant { monotonic_ns: (ms * 1e6) as u64, utc_ns: (js_sys::Date::now() * 1e6) as u64 }
        }))
    }

    /// Plays captures.
    pub fn play(&mut self, files: Vec<File>) -> Result<(), String> {
        let (files, names) = Files::new(files);
        self.play_on(files, names)
    }

    /// Begins to write every pose of captures as CSV to what is recorded.
    pub fn export(&mut self, files: Vec<File>) -> Result<(), String> {
        let (files, names) = Files::new(files);
        self.export_of(files, names)
    }
}

/// Bytes read at once.
const READ_BYTES: u64 = 1 << 18;

/// The files by their names.
#[derive(Clone)]
pub(crate) struct Files(Rc<[File]>);

impl Files {
    /// These files, and their names.
    pub(crate) fn new(files: Vec<File>) -> (Self, Vec<PathBuf>) {
        let names = files.iter().map(|file| PathBuf::from(file.name())).collect();
        (Self(files.into()), names)
    }

    fn named(&self, path: &Path) -> Option<&File> {
        self.0.iter().find(|file| Path::new(&file.name()) == path)
    }
}

impl Shelf for Files {
    type Input = Pieces;

    fn open(&self, path: &Path) -> Result<CaptureReader<Pieces>, CaptureError> {
        let gone = || CaptureError::Open { path: path.to_owned(), source: io::ErrorKind::NotFound.into() };
        let file = self.named(path).ok_or_else(gone)?;
        let reader = FileReaderSync::new().map_err(|_| gone())?;
        let length = file.size() as u64;
        CaptureReader::new(
            path,
            Pieces { blob: file.clone().into(), reader, length, at: 0, piece: Vec::new(), from: 0 },
        )
    }

    fn length(&self, path: &Path) -> u64 {
        self.named(path).map_or(0, |file| file.size() as u64)
    }
}

/// A file that is read a piece at a time.
pub(crate) struct Pieces {
    blob: Blob,
    reader: FileReaderSync,
    length: u64,
    at: u64,
    /// Bytes of the file from `from` on.
    piece: Vec<u8>,
    from: u64,
}

impl Read for Pieces {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let is_held = (self.from..self.from + self.piece.len() as u64).contains(&self.at);
        if !is_held && self.at < self.length {
            let end = (self.at + READ_BYTES).min(self.length);
            let failed = |_| io::Error::other("the browser cannot read the file; it may have been changed or moved");
            let slice = self.blob.slice_with_f64_and_f64(self.at as f64, end as f64).map_err(failed)?;
            let buffer = self.reader.read_as_array_buffer(&slice).map_err(failed)?;
            self.piece = js_sys::Uint8Array::new(buffer.unchecked_ref()).to_vec();
            self.from = self.at;
        }
        let rest = self.piece.get((self.at - self.from) as usize..).unwrap_or_default();
        let count = rest.len().min(bytes.len());
        bytes[..count].copy_from_slice(&rest[..count]);
        self.at += count as u64;
        Ok(count)
    }
}

impl Seek for Pieces {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
            SeekFrom::End(by) => self.length.checked_add_signed(by),
        };
        self.at = at.ok_or(io::ErrorKind::InvalidInput)?;
        Ok(self.at)
    }
}
