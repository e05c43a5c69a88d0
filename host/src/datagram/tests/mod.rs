//! What the tests of this folder share.

mod c;
mod memory;
mod server;
mod wall;

use std::io;
use std::net::{Ipv4Addr, UdpSocket};
use std::path::Path;
use std::time::{Duration, Instant};

use tempfile::TempDir;

use super::*;
use crate::platform::UnixClient;
use crate::samples;
use slitpose_tracking::clock::{HostInstant, HostTime};
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::pipeline::Record;

const DEVICE: DeviceId = DeviceId(*b"simulated\0\0\0");
const OTHER: DeviceId = DeviceId(*b"another one\0");

/// A busy machine may take long for what takes a moment.
const PATIENCE: Duration = Duration::from_secs(60);

fn record() -> Record {
    let (record, _) = samples::poses(40).pop().unwrap();
    assert!(record.solution.estimate.is_some() && record.twist.is_ok());
    let host_time = HostTime { monotonic_ns: 123_456_789_000, utc_ns: 1_700_000_000_987_654_321, uncertainty_ns: 345 };
    let arrival = HostInstant { monotonic_ns: 123_456_999_000, utc_ns: 0 };
    Record { host_time: Some(host_time), arrival: Some(arrival), ..record }
}

/// A server on both kinds of socket, and in shared memory.
struct Bench {
    folder: TempDir,
    server: DatagramServer,
}

impl Bench {
    fn new() -> Self {
        let folder = TempDir::new().unwrap();
        let unix = Address::Unix(folder.path().join("pose"));
        let udp = Address::Udp((Ipv4Addr::LOCALHOST, 0).into());
        let memory = Address::Memory(folder.path().join("memory"));
        let server = DatagramServer::bind(&[unix, udp, memory]).unwrap();
        Self { folder, server }
    }

    /// The path of the server's Unix socket.
    fn path(&self) -> &Path {
        let Address::Unix(path) = &self.server.addresses()[0] else { panic!("unix first") };
        path
    }

    fn unix_client(&self) -> UnixClient {
        let client = UnixClient::new().unwrap();
        client.socket.set_read_timeout(Some(PATIENCE)).unwrap();
        client
    }

    fn udp_client(&self) -> UdpSocket {
        let client = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let Address::Udp(address) = self.server.addresses()[1] else { panic!("udp second") };
        client.connect(address).unwrap();
        client.set_read_timeout(Some(PATIENCE)).unwrap();
        client
    }

    /// The cookie of a client on UDP.
    fn prove(&self, client: &UdpSocket) -> u64 {
        self.tell(|| client.send(&Request::new(Mode::Newest, None).to_bytes()));
        let mut bytes = [0; PoseDatagram::BYTES];
        let count = client.recv(&mut bytes).unwrap();
        let Some(Answer::Prove(cookie)) = Answer::from_bytes(&bytes[..count]) else { panic!("{count} bytes") };
        cookie
    }

    /// Sends bytes and waits until the server has seen them.
    fn tell(&self, send: impl FnOnce() -> io::Result<usize>) {
        let seen = || {
            let counts = self.server.counts();
            counts.requests + counts.refused
        };
        let (before, since) = (seen(), Instant::now());
        send().unwrap();
        while seen() == before {
            assert!(since.elapsed() < PATIENCE, "no request has come");
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    fn ask(&self, client: &UnixClient, mode: Mode, device: Option<DeviceId>) {
        self.tell(|| client.ask(self.path(), Request::new(mode, device)));
    }
}

#[test]
fn addresses_are_read_as_they_are_written() {
    let sockets = ["unix:/run/slitpose/pose", "unix:pose", "udp:127.0.0.1:7440", "udp:[::1]:7440", "udp:127.9.9.9:0"];
    for text in sockets.into_iter().chain(["shm:slitpose", "shm:/run/slitpose/ring", "shm:./ring"]) {
        assert_eq!(address(text).unwrap().to_string(), text);
    }
    for text in ["", "pose", "unix", "unix:", "shm:", "tcp:127.0.0.1:1", "udp:", "udp:localhost:1", "udp:127.0.0.1"] {
        assert!(address(text).is_err(), "{text}");
    }
}

#[test]
fn other_hosts_are_not_served() {
    for text in ["udp:0.0.0.0:7440", "udp:192.168.1.2:7440", "udp:[::]:7440"] {
        let error = address(text).unwrap_err();
        assert!(error.contains("can be reached from other hosts"), "{text}: {error}");
    }
}
