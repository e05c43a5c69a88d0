//! The server receives requests, sends answers, and passes followers to the publishers, which send poses on the thread that
//! solves.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, Weak};
use std::time::Duration;

use anyhow::{Context, Result};
use crossbeam_channel::{Receiver, Sender};
use tokio::sync::oneshot;

use super::layout::{Answer, Mode, PoseDatagram, Request};
use super::ring::{Memory, Ring};
use super::slot::Slot;
use super::socket::{Delivery, Peer, Socket};
use super::subscription::{Cookies, Lease, Leases, MAX_FOLLOWERS, MAX_NEWS, Subscription, Worth};
use crate::address::Address;
use crate::background::{Background, NO_THREAD, drive};
use crate::platform::SocketFile;
use slitpose_head::threads::lock;
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::pipeline::Record;
use slitpose_tracking::telemetry::DatagramCounts;

/// Duration of a lease after each request. Clients send one each second.
pub(super) const LEASE: Duration = Duration::from_secs(3);

/// The server's side of a board; its publisher holds the other ends.
#[derive(Debug)]
struct Board {
    device: DeviceId,
    slot: Weak<Slot>,
    subscriptions: Sender<Subscription>,
}

#[derive(Debug, Default)]
struct Directory {
    boards: Vec<Board>,
    leases: Leases,
    cookies: Cookies,
}

/// Answers requests on its own thread until dropped.
#[derive(Debug)]
pub struct DatagramServer {
    shared: Arc<Shared>,
    directory: Arc<Mutex<Directory>>,
    memories: Vec<Arc<Memory>>,
    addresses: Vec<Address>,
    _thread: Background<oneshot::Sender<()>>,
    _files: Vec<SocketFile>,
}

impl DatagramServer {
    /// Listens on all of `addresses` that are sockets, and maps those that are memory.
    pub fn bind(addresses: &[Address]) -> Result<Self> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build().context(NO_THREAD)?;
        let entered = runtime.enter();
        let (mut sockets, mut bound, mut files, mut memories) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for address in addresses {
            if let Address::Memory(path) = address {
                memories.push(Arc::new(Memory::open(path)?));
                bound.push(address.clone());
                continue;
            }
            let (socket, file) = Socket::bind(address)?;
            bound.push(socket.address(address));
            sockets.push(socket);
            files.extend(file);
        }
        drop(entered);
        let shared = Arc::new(Shared { sockets, counters: Counters::default() });
        let directory = Arc::new(Mutex::new(Directory::default()));
        for index in 0..shared.sockets.len() {
            runtime.spawn(serve(Arc::clone(&shared), Arc::clone(&directory), index));
        }
        let thread = drive("datagrams", runtime)?;
        Ok(Self { shared, directory, memories, addresses: bound, _thread: thread, _files: files })
    }

    /// The addresses it listens on, with the ports that the system chose for port 0.
    pub fn addresses(&self) -> &[Address] {
        &self.addresses
    }

    /// A publisher that sends the poses of a board until dropped, also to clients that asked before. It replaces an
    /// earlier publisher of the board for new clients. Memory has the poses of the first [`MAX_BOARDS`](super::MAX_BOARDS)
    /// publishers only.
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
        Publisher {
            shared: Arc::clone(&self.shared),
            slot,
            rings: self.memories.iter().filter_map(Memory::ring).collect(),
            subscriptions: receiver,
            followers: Vec::with_capacity(MAX_FOLLOWERS),
            number: 0,
            missed: 0,
            is_behind: false,
        }
    }

    pub fn counts(&self) -> DatagramCounts {
        let Counters { requests, places_refused, unproven, refused, sent, missed } = &self.shared.counters;
        let [requests, places_refused, unproven, refused, sent, missed] =
            [requests, places_refused, unproven, refused, sent, missed].map(|counter| counter.load(Ordering::Relaxed));
        let (directory, now_ns) = (lock(&self.directory), HostInstant::now().monotonic_ns);
        let places_taken = directory.leases.valid(now_ns).count() as u64;
        let slow_clients = directory.leases.valid(now_ns).filter_map(|lease| lease.subscription.slow(now_ns)).collect();
        let places = MAX_FOLLOWERS as u64;
        DatagramCounts { places_taken, places, places_refused, requests, refused, unproven, sent, missed, slow_clients }
    }
}

/// Serves the requests that come to one of the sockets.
async fn serve(shared: Arc<Shared>, directory: Arc<Mutex<Directory>>, index: usize) {
    // One byte more than a request, to detect longer datagrams.
    let mut buffer = [0; Request::BYTES + 1];
    loop {
        match shared.sockets[index].receive(&mut buffer).await {
            Ok((count, peer)) => match (Request::from_bytes(&buffer[..count]), peer) {
                (Some(request), Some(peer)) => {
                    answer(&shared, &mut lock(&directory), request, index, &peer);
                    Counters::count(&shared.counters.requests);
                }
                _ => Counters::count(&shared.counters.refused),
            },
            // Such as the notice of a client by UDP that has gone.
            Err(_) => tokio::task::yield_now().await,
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
            let subscription = Subscription { socket, peer: peer.clone(), until_ns, misses: Arc::default() };
            let Some((subscription, lost)) = directory.leases.renew(request.device, &subscription, now_ns) else {
                Counters::count(&shared.counters.places_refused);
                return tell(shared, Answer::Refused, socket, peer);
            };
            // Removed before the new one is added: a board never has more followers than places.
            for Lease { device, subscription } in lost {
                Counters::count(&shared.counters.places_refused);
                tell(shared, Answer::Refused, subscription.socket, &subscription.peer);
                directory.hand_on(shared, device, &Subscription { until_ns: 0, ..subscription });
            }
            directory.hand_on(shared, request.device, &subscription);
        }
    }
}

/// Sends an answer other than a pose. It is lost if the client's queue is full: clients ask again.
fn tell(shared: &Shared, answer: Answer, socket: usize, peer: &Peer) {
    let _ = shared.sockets[socket].send(&answer.to_bytes(), peer);
}

impl Directory {
    fn wanted(&self, device: Option<DeviceId>) -> impl Iterator<Item = &Board> {
        self.boards.iter().filter(move |board| device.is_none_or(|device| device == board.device))
    }

    /// Passes the change of a follower to the boards it concerns.
    fn hand_on(&self, shared: &Shared, device: Option<DeviceId>, news: &Subscription) {
        for board in self.wanted(device) {
            // The queue is full until the next scan: clients ask again.
            if board.subscriptions.try_send(news.clone()).is_err() {
                Counters::count(&shared.counters.refused);
            }
        }
    }
}

// The sending side, on the thread that solves.

/// Sends the poses of one board. Never waits, takes no lock, allocates nothing.
#[derive(Debug)]
pub struct Publisher {
    shared: Arc<Shared>,
    slot: Arc<Slot>,
    rings: Vec<Ring>,
    subscriptions: Receiver<Subscription>,
    followers: Vec<Subscription>,
    number: u64,
    /// Datagrams that followers have missed because they did not read in time.
    pub(crate) missed: u64,
    /// Whether the next poses are marked as those of a solver that is behind.
    pub(crate) is_behind: bool,
}

impl Publisher {
    /// Sends a pose to all followers, and stores it in shared memory and for clients that request the newest.
    pub fn publish(&mut self, record: &Record, now: HostInstant) {
        self.number += 1;
        let mut datagram = PoseDatagram::new(record, self.number, now);
        if self.is_behind {
            datagram.mark_behind();
        }
        self.slot.store(&datagram);
        self.rings.iter_mut().for_each(|ring| ring.store(&datagram));
        for subscription in self.subscriptions.try_iter().take(MAX_NEWS) {
            admit(&mut self.followers, subscription, &self.shared.counters);
        }
        self.followers.retain(|follower| now.monotonic_ns <= follower.until_ns);
        let Shared { sockets, counters } = &*self.shared;
        let missed_by_all = &mut self.missed;
        self.followers.retain(|Subscription { socket, peer, misses, .. }| {
            datagram.set_missed(misses.count());
            match sockets[*socket].send(datagram.as_bytes(), peer) {
                Delivery::Sent => Counters::count(&counters.sent),
                Delivery::Full => {
                    misses.add(now.monotonic_ns);
                    *missed_by_all += 1;
                    Counters::count(&counters.missed);
                }
                Delivery::Gone => return false,
            }
            true
        });
    }
}

/// Adds a client, or renews the lease of a known one.
fn admit(followers: &mut Vec<Subscription>, new: Subscription, counters: &Counters) {
    if new.until_ns == 0 {
        followers.retain(|known| !known.is_of(&new));
    } else if let Some(known) = followers.iter_mut().find(|known| known.is_of(&new)) {
        known.until_ns = new.until_ns;
    } else if followers.len() < MAX_FOLLOWERS {
        followers.push(new);
    } else {
        Counters::count(&counters.refused);
    }
}

#[derive(Debug, Default)]
pub(super) struct Counters {
    pub(super) requests: AtomicU64,
    pub(super) places_refused: AtomicU64,
    pub(super) unproven: AtomicU64,
    pub(super) refused: AtomicU64,
    pub(super) sent: AtomicU64,
    pub(super) missed: AtomicU64,
}

impl Counters {
    pub(super) fn count(counter: &AtomicU64) {
        counter.fetch_add(1, Ordering::Relaxed);
    }
}

#[derive(Debug)]
pub(super) struct Shared {
    pub(super) sockets: Vec<Socket>,
    pub(super) counters: Counters,
}
