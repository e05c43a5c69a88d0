//! The asking side: requests in, answers out, clients that follow handed on to the publishers.

use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, Weak};
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::Sender;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use schemars::JsonSchema;
use serde::Serialize;

use super::cookie::{Cookies, Worth};
use super::error::DatagramError;
use super::leases::{Admission, Lease, Leases};
use super::publisher::Publisher;
use super::shared::{Counters, Shared};
use super::slot::Slot;
use super::socket::{Delivery, Peer, Socket, SocketFile};
use super::subscription::{MAX_FOLLOWERS, MAX_NEWS, Subscription};
use super::{Address, Answer, Mode, Request};
use crate::clock::HostInstant;
use crate::link::DeviceId;
use slitpose_head::threads::lock;

/// How long a client is followed after it asked. Clients ask each second.
pub(super) const LEASE: Duration = Duration::from_secs(3);

/// Counts of datagrams sent and refused since the server started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct DatagramCounts {
    /// Places that clients have taken, now.
    pub places_taken: u64,
    /// Places of each board; users share them evenly, and all clients on UDP count as one user.
    pub places: u64,
    /// Clients that were told that they get no place, or lose theirs to another user's.
    pub places_refused: u64,
    /// Requests understood, and answered as far as there was an answer.
    pub requests: u64,
    /// Requests that were not: of unreadable bytes, from clients without a name that is theirs, or too many at a
    /// time.
    pub refused: u64,
    /// Requests on UDP that were answered with a cookie, as they came without one that proves their address.
    pub unproven: u64,
    /// Datagrams sent.
    pub sent: u64,
    /// Datagrams for which a client's queue had no room, as far as the system tells: of UDP it does
    /// not.
    pub missed: u64,
}

/// A board, as the server knows it; its publisher holds the other ends.
#[derive(Debug)]
struct Board {
    device: DeviceId,
    slot: Weak<Slot>,
    subscriptions: Sender<Subscription>,
}

/// Who sends, and who wants to be sent to.
#[derive(Debug, Default)]
struct Directory {
    boards: Vec<Board>,
    leases: Leases,
    cookies: Cookies,
}

/// Answers requests, from a thread of its own, until dropped.
#[derive(Debug)]
pub struct DatagramServer {
    shared: Arc<Shared>,
    directory: Arc<Mutex<Directory>>,
    addresses: Vec<Address>,
    /// Closed, it ends the thread.
    end: Option<UnixStream>,
    thread: Option<JoinHandle<()>>,
    _files: Vec<SocketFile>,
}

impl DatagramServer {
    /// Listens on all of `addresses`.
    ///
    /// # Errors
    /// If one of them cannot be had.
    pub fn bind(addresses: &[Address]) -> Result<Self, DatagramError> {
        let (mut sockets, mut bound, mut files) = (Vec::new(), Vec::new(), Vec::new());
        for address in addresses {
            let (socket, file) = Socket::bind(address)?;
            bound.push(socket.address(address));
            sockets.push(socket);
            files.extend(file);
        }
        let shared = Arc::new(Shared { sockets, counters: Counters::default() });
        let directory = Arc::new(Mutex::new(Directory::default()));
        let (end, ended) = UnixStream::pair().map_err(DatagramError::Thread)?;
        let thread = std::thread::Builder::new()
            .name("datagrams".to_owned())
            .spawn({
                let (shared, directory) = (Arc::clone(&shared), Arc::clone(&directory));
                move || serve(&shared, &directory, &ended)
            })
            .map_err(DatagramError::Thread)?;
        Ok(Self { shared, directory, addresses: bound, end: Some(end), thread: Some(thread), _files: files })
    }

    /// Where it listens; a port of 0 has become one that was free.
    pub fn addresses(&self) -> &[Address] {
        &self.addresses
    }

    /// What sends the poses of a board, until it is dropped, also to clients that asked before it was
    /// there. Those of one made earlier are no longer given to new clients.
    pub fn publisher(&self, device: DeviceId) -> Publisher {
        let (sender, receiver) = crossbeam_channel::bounded(MAX_NEWS);
        let slot = Arc::new(Slot::new());
        let mut directory = lock(&self.directory);
        for subscription in directory.leases.of(device, HostInstant::now().monotonic_ns) {
            if sender.try_send(subscription.clone()).is_err() {
                Counters::count(&self.shared.counters.refused);
            }
        }
        directory.boards.retain(|board| board.device != device);
        directory.boards.push(Board { device, slot: Arc::downgrade(&slot), subscriptions: sender });
        Publisher::new(Arc::clone(&self.shared), slot, receiver)
    }

    /// The counts so far.
    pub fn counts(&self) -> DatagramCounts {
        let Counters { requests, places_refused, unproven, refused, sent, missed } = &self.shared.counters;
        let [requests, places_refused, unproven, refused, sent, missed] =
            [requests, places_refused, unproven, refused, sent, missed].map(|counter| counter.load(Ordering::Relaxed));
        let places_taken = lock(&self.directory).leases.count(HostInstant::now().monotonic_ns) as u64;
        let places = MAX_FOLLOWERS as u64;
        DatagramCounts { places_taken, places, places_refused, requests, refused, unproven, sent, missed }
    }
}

impl Drop for DatagramServer {
    fn drop(&mut self) {
        drop(self.end.take());
        if let Some(thread) = self.thread.take() {
            // It does not panic.
            let _ = thread.join();
        }
    }
}

fn serve(shared: &Shared, directory: &Mutex<Directory>, ended: &UnixStream) {
    // One byte more than a request has shows what is too long.
    let mut buffer = [0; Request::BYTES + 1];
    loop {
        let mut watched: Vec<PollFd<'_>> = shared
            .sockets
            .iter()
            .map(AsFd::as_fd)
            .chain([ended.as_fd()])
            .map(|descriptor| PollFd::new(descriptor, PollFlags::POLLIN))
            .collect();
        // An error of `recv`, interrupted or not, ends this round.
        let _ = poll(&mut watched, PollTimeout::NONE);
        if watched.last().is_none_or(|end| end.any() != Some(false)) {
            return;
        }
        drop(watched);
        for (socket, receiver) in shared.sockets.iter().enumerate() {
            while let Ok((count, peer)) = receiver.receive(&mut buffer) {
                match (Request::from_bytes(&buffer[..count]), peer) {
                    (Some(request), Some(peer)) => {
                        answer(shared, &mut lock(directory), request, socket, &peer);
                        Counters::count(&shared.counters.requests);
                    }
                    _ => Counters::count(&shared.counters.refused),
                }
            }
        }
    }
}

fn answer(shared: &Shared, directory: &mut Directory, request: Request, socket: usize, peer: &Peer) {
    let now_ns = HostInstant::now().monotonic_ns;
    if let Peer::Udp(address) = peer {
        match directory.cookies.judge(*address, request.cookie, now_ns) {
            Worth::Good => {}
            Worth::Old(next) => tell(shared, Answer::Renew(next), socket, peer),
            Worth::Nothing(cookie) => {
                Counters::count(&shared.counters.unproven);
                return tell(shared, Answer::Prove(cookie), socket, peer);
            }
        }
    }
    directory.boards.retain(|board| board.slot.strong_count() > 0);
    match request.mode {
        Mode::Newest => {
            for datagram in directory.wanted(request.device).filter_map(|board| board.slot.upgrade()?.load()) {
                match shared.sockets[socket].send(datagram.as_bytes(), peer) {
                    Delivery::Sent => Counters::count(&shared.counters.sent),
                    Delivery::Full => Counters::count(&shared.counters.missed),
                    Delivery::Gone => {}
                }
            }
        }
        Mode::Follow => {
            let until_ns = now_ns.saturating_add(LEASE.as_nanos() as u64);
            let subscription = Subscription { socket, peer: peer.clone(), until_ns };
            let (subscription, lost) = match directory.leases.renew(request.device, &subscription, now_ns) {
                Admission::Kept(subscription) => (subscription, Vec::new()),
                Admission::Instead(subscription, lost) => (subscription, lost),
                Admission::Refused => {
                    Counters::count(&shared.counters.places_refused);
                    return tell(shared, Answer::Refused, socket, peer);
                }
            };
            // First out, then in: a board has no place more.
            for Lease { device, subscription } in lost {
                Counters::count(&shared.counters.places_refused);
                tell(shared, Answer::Refused, subscription.socket, &subscription.peer);
                directory.hand_on(shared, device, &Subscription { until_ns: 0, ..subscription });
            }
            directory.hand_on(shared, request.device, &subscription);
        }
    }
}

/// Sends an answer that is no pose. It is lost if the client's queue is full: clients ask again.
fn tell(shared: &Shared, answer: Answer, socket: usize, peer: &Peer) {
    let _ = shared.sockets[socket].send(&answer.to_bytes(), peer);
}

impl Directory {
    fn wanted(&self, device: Option<DeviceId>) -> impl Iterator<Item = &Board> {
        self.boards.iter().filter(move |board| device.is_none_or(|device| device == board.device))
    }

    /// Hands news of a follower to the boards it concerns.
    fn hand_on(&self, shared: &Shared, device: Option<DeviceId>, news: &Subscription) {
        for board in self.wanted(device) {
            // Full until the next scan: clients ask again.
            if board.subscriptions.try_send(news.clone()).is_err() {
                Counters::count(&shared.counters.refused);
            }
        }
    }
}
