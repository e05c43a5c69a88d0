//! A client of the daemon's datagrams, beside a study.

use std::os::unix::net::UnixDatagram;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use slitpose::datagram::{Mode, Request};

/// A control loop that is sent every pose, and counts them.
pub struct Subscriber {
    over: Arc<AtomicBool>,
    thread: JoinHandle<u64>,
}

impl Subscriber {
    /// Follows the daemon whose socket is `server`, which may not be there yet, from a socket beside that.
    pub fn start(server: PathBuf) -> Self {
        let over = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&over);
        let thread = std::thread::spawn(move || {
            let socket = UnixDatagram::bind(server.with_file_name("client")).expect("socket");
            socket.set_read_timeout(Some(Duration::from_millis(100))).expect("settable");
            let (mut count, mut asked) = (0, None::<Instant>);
            while !ends.load(Ordering::Relaxed) {
                if asked.is_none_or(|asked| asked.elapsed() > Duration::from_secs(1)) {
                    // There is no socket before the daemon has made it, and none when it has gone.
                    let request = Request::new(Mode::Follow, None);
                    asked = socket.send_to(&request.to_bytes(), &server).is_ok().then(Instant::now);
                }
                count += u64::from(socket.recv(&mut [0; 1024]).is_ok());
            }
            count
        });
        Self { over, thread }
    }

    /// How many datagrams it was sent.
    ///
    /// # Panics
    /// If its socket could not be made.
    pub fn end(self) -> u64 {
        self.over.store(true, Ordering::Relaxed);
        self.thread.join().expect("subscriber")
    }
}
