//! The socket that spacenavd's clients connect to.

use std::io::{ErrorKind, Read, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TryRecvError, bounded};
use slitpose_head::scene_file::Workspace;
use slitpose_model::Pose;

use super::Feel;
use crate::address::ServeError;
use crate::background::Background;
use crate::platform::{LocalListener, LocalStream, SocketFile, listen_local};
use slitpose_tracking::page::{Sample, SampleSink};

/// Most clients; more are not let in.
pub(super) const MAX_CLIENTS: usize = 16;

/// Longest wait for a pose: then new clients are let in, and the tool counts as at rest.
const MOMENT: Duration = Duration::from_millis(100);

/// Most reads of one client in a row, of 64 bytes each.
const MAX_READS: usize = 16;

/// The request for another version of the protocol, and the mask of its version.
const CHANGE_VERSION: u32 = 0x7faa_5500;
const VERSION: u32 = 0xff;

/// Poses on their way to the clients.
const SIGHTINGS: usize = 4;

/// Serves the socket until dropped.
#[derive(Debug)]
pub(crate) struct SpacenavServer {
    pub(crate) input: SpacenavInput,
    _thread: Background<Sender<()>>,
    _file: SocketFile,
}

#[derive(Clone, Debug)]
pub(crate) struct SpacenavInput {
    sightings: Sender<Option<Pose>>,
    is_zeroed: Arc<AtomicBool>,
}

impl SpacenavInput {
    /// Makes the next pose the one at which nothing moves.
    pub(crate) fn zero(&self) {
        self.is_zeroed.store(true, Ordering::Relaxed);
    }

    /// Shows the newest pose; `false` if the server has no time.
    pub(super) fn see(&self, pose: Option<Pose>) -> bool {
        self.sightings.try_send(pose).is_ok()
    }
}

impl SampleSink for SpacenavInput {
    /// As a 3-D mouse sends.
    fn rate_hz(&self) -> u64 {
        60
    }

    fn sample(&self, board: usize, sample: &Sample) -> bool {
        // The first board is the mouse.
        board > 0 || self.see(sample.pose())
    }
}

impl SpacenavServer {
    /// Serves `path`, for a tool in `workspace`.
    pub(crate) fn start(path: &Path, feel: Feel, workspace: Workspace) -> Result<Self, ServeError> {
        let (listener, file) = listen_local(path)?;
        let failed = |source| ServeError::Thread { source };
        listener.set_nonblocking(true).map_err(failed)?;
        let (sender, sightings) = bounded(SIGHTINGS);
        let (end, ended) = bounded(0);
        let is_zeroed = Arc::<AtomicBool>::default();
        let mouse = Mouse {
            feel,
            workspace,
            zero: Pose::HOME,
            is_zeroed: Arc::clone(&is_zeroed),
            clients: Vec::new(),
            last_event: Instant::now(),
        };
        let thread = Background::spawn("spacenav", end, move || mouse.serve(&listener, &sightings, &ended));
        let input = SpacenavInput { sightings: sender, is_zeroed };
        Ok(Self { input, _thread: thread.map_err(failed)?, _file: file })
    }
}

struct Mouse {
    feel: Feel,
    workspace: Workspace,
    zero: Pose,
    is_zeroed: Arc<AtomicBool>,
    clients: Vec<Client>,
    last_event: Instant,
}

impl Mouse {
    fn serve(mut self, listener: &LocalListener, sightings: &Receiver<Option<Pose>>, ended: &Receiver<()>) {
        while ended.try_recv() == Err(TryRecvError::Empty) {
            // Without scans the tool is where nobody knows.
            let pose = match sightings.recv_timeout(MOMENT) {
                Ok(pose) => pose,
                Err(RecvTimeoutError::Timeout) => None,
                Err(RecvTimeoutError::Disconnected) => return,
            };
            while let Ok((stream, _)) = listener.accept() {
                if self.clients.len() < MAX_CLIENTS && stream.set_nonblocking(true).is_ok() {
                    self.clients.push(Client { stream, sensitivity: 1.0, at_rest: true, part: Vec::new() });
                }
            }
            self.clients.retain_mut(Client::listen);
            self.pass_on(pose);
        }
    }

    /// Tells all clients of the motion; of a tool at rest once.
    fn pass_on(&mut self, pose: Option<Pose>) {
        if let Some(pose) = &pose
            && self.is_zeroed.swap(false, Ordering::Relaxed)
        {
            self.zero = *pose;
        }
        let motion = pose.map_or([0; 6], |pose| self.feel.motion(&self.workspace, &self.zero, &pose));
        if motion == [0; 6] && self.clients.iter().all(|client| client.at_rest) {
            return;
        }
        let period_ms = self.last_event.elapsed().as_millis().min(1000) as i32;
        self.last_event = Instant::now();
        self.clients.retain_mut(|client| client.tell(motion, period_ms));
    }
}

struct Client {
    stream: LocalStream,
    sensitivity: f64,
    /// Whether the last event that it was sent is of a tool at rest.
    at_rest: bool,
    /// Bytes of a message that is not whole.
    part: Vec<u8>,
}

impl Client {
    /// Takes what the client has said; whether it is still there.
    fn listen(&mut self) -> bool {
        let mut buffer = [0; 64];
        // One that does not stop talking keeps the others waiting no longer than this.
        for _ in 0..MAX_READS {
            match self.stream.read(&mut buffer) {
                Ok(0) => return false,
                Ok(count) => self.part.extend_from_slice(&buffer[..count]),
                Err(error) if error.kind() == ErrorKind::WouldBlock => return true,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return false,
            }
            let whole = self.part.len() / 4 * 4;
            for word in self.part.drain(..whole).collect::<Vec<_>>().as_chunks().0 {
                let bits = u32::from_ne_bytes(*word);
                if bits & !VERSION == CHANGE_VERSION {
                    // Version 0 it stays.
                    if self.stream.write_all(&CHANGE_VERSION.to_ne_bytes()).is_err() {
                        return false;
                    }
                } else if f32::from_bits(bits).is_finite() {
                    self.sensitivity = f64::from(f32::from_bits(bits));
                }
            }
        }
        true
    }

    /// Sends an event; whether the client is still there. One that does not read misses events, but not that the tool has
    /// come to rest.
    fn tell(&mut self, motion: [i32; 6], period_ms: i32) -> bool {
        let is_at_rest = motion == [0; 6];
        if is_at_rest && self.at_rest {
            return true;
        }
        let [x, y, z, rx, ry, rz] = motion.map(|value| (f64::from(value) * self.sensitivity) as i32);
        let event = [0, x, y, z, rx, ry, rz, period_ms].map(i32::to_ne_bytes);
        match self.stream.write(event.as_flattened()) {
            Ok(count) => {
                self.at_rest = is_at_rest;
                count == event.as_flattened().len()
            }
            Err(error) => matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_client_that_says_much_is_heard_in_parts() {
        let (stream, mut other) = LocalStream::pair().unwrap();
        stream.set_nonblocking(true).unwrap();
        other.write_all(&[0x3f; 4096]).unwrap();
        let mut client = Client { stream, sensitivity: 1.0, at_rest: true, part: Vec::new() };
        assert!(client.listen());
        assert_eq!(client.stream.read(&mut [0; 4096]).unwrap(), 4096 - 64 * MAX_READS);
    }
}
