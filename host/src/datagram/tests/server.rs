//! Requests and what becomes of them.

use std::net::{Ipv4Addr, SocketAddr};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixDatagram;

use tempfile::TempDir;

use super::{Bench, DEVICE, OTHER, record};
use crate::address::in_use;
use crate::datagram::server::LEASE;
use crate::datagram::{Address, Answer, DatagramServer, Mode, PoseDatagram, Request};
use crate::platform::{UnixClient, pass};
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::pipeline::Record;

#[test]
fn on_udp_nothing_longer_than_a_request_is_sent_to_who_has_not_proved_its_address() {
    let bench = Bench::new();
    let [client, other] = [bench.udp_client(), bench.udp_client()];
    let mut publisher = bench.server.publisher(DEVICE);
    let record = record();
    publisher.publish(&record, HostInstant::now());
    let cookie = bench.prove(&other);
    let mut bytes = [0; 2 * PoseDatagram::BYTES];
    // Without a cookie, with a guess, with that of somebody else; of the length it had before there were cookies, too.
    for cookie in [0, 1, cookie] {
        for mode in [Mode::Newest, Mode::Follow] {
            let mut request = Request { mode, device: None, cookie }.to_bytes().to_vec();
            if cookie == 0 {
                request.truncate(24);
                request[6] = 24;
            }
            bench.tell(|| client.send(&request));
            for _ in 0..3 {
                publisher.publish(&record, HostInstant::now());
            }
            let count = client.recv(&mut bytes).unwrap();
            assert!(count <= request.len(), "{count} bytes for {}", request.len());
            assert!(matches!(Answer::from_bytes(&bytes[..count]), Some(Answer::Prove(_))), "{mode:?}");
        }
    }
    client.set_nonblocking(true).unwrap();
    assert!(client.recv(&mut bytes).is_err(), "more than an answer each");
    let counts = bench.server.counts();
    assert_eq!((counts.unproven, counts.sent, counts.places_taken), (7, 0, 0));
    // With the one that it was sent it is served.
    let Some(Answer::Prove(cookie)) = Answer::from_bytes(&bytes[..24]) else { panic!("kept from above") };
    bench.tell(|| client.send(&Request { mode: Mode::Follow, device: None, cookie }.to_bytes()));
    publisher.publish(&record, HostInstant::now());
    assert_eq!(client.recv(&mut bytes).unwrap(), PoseDatagram::BYTES);
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap())
}

fn receive(client: &UnixClient) -> [u8; PoseDatagram::BYTES] {
    let mut bytes = [0; PoseDatagram::BYTES];
    assert_eq!(client.socket.recv(&mut bytes).unwrap(), PoseDatagram::BYTES);
    bytes
}

/// Numbers of all datagrams that wait, and what the last says was missed.
fn drain(client: &UnixClient) -> (Vec<u64>, u64) {
    client.socket.set_nonblocking(true).unwrap();
    let (mut numbers, mut missed, mut bytes) = (Vec::new(), 0, [0; PoseDatagram::BYTES]);
    while client.socket.recv(&mut bytes).is_ok() {
        numbers.push(u64_at(&bytes, 32));
        missed = u64_at(&bytes, 40);
    }
    client.socket.set_nonblocking(false).unwrap();
    (numbers, missed)
}

#[test]
fn the_newest_is_given_to_who_asks() {
    let bench = Bench::new();
    let (client, udp) = (bench.unix_client(), bench.udp_client());
    let (mut first, mut second) = (bench.server.publisher(DEVICE), bench.server.publisher(OTHER));
    // Nothing to give yet.
    bench.ask(&client, Mode::Newest, None);
    let record = record();
    let other = Record { device: OTHER, ..record };
    for _ in 0..3 {
        first.publish(&record, HostInstant::now());
    }
    second.publish(&other, HostInstant::now());
    bench.ask(&client, Mode::Newest, None);
    let both = [receive(&client), receive(&client)];
    assert_eq!(
        both.map(|bytes| (bytes[16..28].to_vec(), u64_at(&bytes, 32))),
        [(DEVICE.0.to_vec(), 3), (OTHER.0.to_vec(), 1)]
    );
    let cookie = bench.prove(&udp);
    bench.tell(|| udp.send(&Request { mode: Mode::Newest, device: Some(OTHER), cookie }.to_bytes()));
    let mut bytes = [0; PoseDatagram::BYTES];
    assert_eq!(udp.recv(&mut bytes).unwrap(), bytes.len());
    assert_eq!(bytes, both[1]);
    // A board that has gone says nothing any more.
    drop(second);
    bench.ask(&client, Mode::Newest, None);
    assert_eq!(receive(&client)[16..28], DEVICE.0);
    bench.ask(&client, Mode::Newest, Some(OTHER));
    bench.ask(&client, Mode::Newest, None);
    assert_eq!(drain(&client).0, [3]);
}

#[test]
fn who_follows_gets_the_board_it_asked_for_until_its_lease_ends() {
    let bench = Bench::new();
    let (one, all) = (bench.unix_client(), bench.unix_client());
    let (mut first, mut second) = (bench.server.publisher(DEVICE), bench.server.publisher(OTHER));
    let record = record();
    let mut publish = |now| {
        first.publish(&record, now);
        second.publish(&Record { device: OTHER, ..record }, now);
    };
    // Read before the requests, it lies before the end of their leases however long the test takes.
    let now = HostInstant::now();
    bench.ask(&one, Mode::Follow, Some(OTHER));
    bench.ask(&all, Mode::Follow, None);
    publish(now);
    publish(now);
    assert_eq!(drain(&one).0, [1, 2]);
    assert_eq!(drain(&all).0, [1, 1, 2, 2]);
    let mut later = HostInstant::now();
    later.monotonic_ns += LEASE.as_nanos() as u64 + 1;
    publish(later);
    assert_eq!((drain(&one).0, drain(&all).0), (vec![], vec![]));
    bench.ask(&one, Mode::Follow, Some(OTHER));
    publish(now);
    assert_eq!((drain(&one).0, drain(&all).0), (vec![4], vec![]));
    // Asked twice, it is still sent once.
    bench.ask(&one, Mode::Follow, Some(OTHER));
    publish(now);
    assert_eq!(drain(&one).0, [5]);
}

type Receive = Box<dyn Fn(&mut [u8]) -> std::io::Result<usize>>;

/// A client that follows with a queue of its own, on a Unix socket or on UDP: what it receives, without waiting.
fn follower(bench: &Bench, is_udp: bool) -> Receive {
    if is_udp {
        let client = bench.udp_client();
        let cookie = bench.prove(&client);
        bench.tell(|| client.send(&Request { mode: Mode::Follow, device: None, cookie }.to_bytes()));
        client.set_nonblocking(true).unwrap();
        Box::new(move |bytes| client.recv(bytes))
    } else {
        let client = bench.unix_client();
        bench.ask(&client, Mode::Follow, None);
        client.socket.set_nonblocking(true).unwrap();
        Box::new(move |bytes| client.socket.recv(bytes))
    }
}

#[test]
fn no_client_misses_a_datagram_because_of_another() {
    // More than a queue holds.
    const PUBLISHED: u64 = 2_000;
    for is_udp in [false, true] {
        // Stopped, slow and dead ones beside healthy ones, in all places.
        for [stopped, slow, dead] in [[15, 0, 0], [0, 15, 0], [0, 0, 15], [5, 5, 5], [0, 0, 0], [1, 0, 0]] {
            let bench = Bench::new();
            let case = format!("udp {is_udp}: {stopped} stopped, {slow} slow, {dead} dead");
            let follow = |count: usize| (0..count).map(|_| follower(&bench, is_udp)).collect::<Vec<_>>();
            let [stopped_clients, slow_clients] = [stopped, slow].map(follow);
            drop(follow(dead));
            let healthy = follow(16 - stopped - slow - dead);
            assert_eq!(bench.server.counts().places_taken, 16, "{case}");
            let mut publisher = bench.server.publisher(DEVICE);
            let (record, now, mut bytes) = (record(), HostInstant::now(), [0; PoseDatagram::BYTES]);
            for number in 1..=PUBLISHED {
                publisher.publish(&record, now);
                for client in &healthy {
                    assert_eq!(client(&mut bytes).unwrap(), bytes.len(), "{case}");
                    assert_eq!((u64_at(&bytes, 32), u64_at(&bytes, 40)), (number, 0), "{case}");
                }
                if number % 50 == 0 {
                    slow_clients.iter().for_each(|client| assert!(client(&mut bytes).is_ok(), "{case}"));
                }
            }
            let is_missing = stopped + slow > 0 && !is_udp;
            assert_eq!(bench.server.counts().missed > 0, is_missing, "{case}");
            assert!(
                stopped_clients.iter().all(|client| client(&mut bytes).is_ok() && u64_at(&bytes, 32) == 1),
                "{case}"
            );
        }
    }
}

#[test]
fn a_client_that_misses_poses_for_a_second_is_slow_until_it_reads() {
    let bench = Bench::new();
    let stopped = bench.unix_client();
    bench.ask(&stopped, Mode::Follow, None);
    let mut publisher = bench.server.publisher(DEVICE);
    let (record, mut now) = (record(), HostInstant::now());
    let mut publish = |millis: u64| {
        now.monotonic_ns += millis * 1_000_000;
        (0..500).for_each(|_| publisher.publish(&record, now));
        bench.server.counts().slow_clients
    };
    assert_eq!((publish(0), publish(900)), (vec![], vec![]), "a pause of the client is no fault");
    let slow = publish(200);
    assert!(slow.len() == 1 && slow[0].process == Some(std::process::id() as i32), "{slow:?}");
    assert!(slow[0].missed > 1000 && slow[0].user.is_some(), "{slow:?}");
    // It reads again, and has missed nothing for a second.
    drain(&stopped);
    now.monotonic_ns += 1_100_000_000;
    publisher.publish(&record, now);
    assert_eq!(u64_at(&receive(&stopped), 40), slow[0].missed, "it is told what it missed");
}

#[test]
fn what_is_no_end_of_a_pair_gets_no_datagrams() {
    let bench = Bench::new();
    let (mut publisher, record) = (bench.server.publisher(DEVICE), record());
    publisher.publish(&record, HostInstant::now());
    let victim = UnixDatagram::bind(bench.folder.path().join("victim")).unwrap();
    victim.set_nonblocking(true).unwrap();
    let towards = UnixDatagram::unbound().unwrap();
    towards.connect(bench.folder.path().join("victim")).unwrap();
    let (stream, _other) = std::os::unix::net::UnixStream::pair().unwrap();
    let passed: [OwnedFd; 5] = [
        towards.into(),
        stream.into(),
        UnixDatagram::unbound().unwrap().into(),
        bench.udp_client().into(),
        std::fs::File::open("/dev/null").unwrap().into(),
    ];
    let asks = UnixDatagram::unbound().unwrap();
    for (number, passed) in (1..).zip(passed) {
        bench.tell(|| pass(&asks, bench.path(), Request::new(Mode::Newest, None), &passed));
        let counts = bench.server.counts();
        assert_eq!((counts.refused, counts.sent, counts.requests), (number, 0, 0));
    }
    assert!(victim.recv(&mut [0; 1]).is_err());
    // An end that blocks delays nobody, and with its other end the client is gone.
    let (near, far) = UnixDatagram::pair().unwrap();
    bench.tell(|| pass(&asks, bench.path(), Request::new(Mode::Follow, None), &far));
    far.set_nonblocking(false).unwrap();
    (0..1000).for_each(|_| publisher.publish(&record, HostInstant::now()));
    let counts = bench.server.counts();
    assert_eq!(counts.sent + counts.missed, 1000);
    drop((near, far));
    publisher.publish(&record, HostInstant::now());
    assert_eq!((bench.server.counts().sent, bench.server.counts().missed), (counts.sent, counts.missed));
}

#[test]
fn what_is_no_request_is_counted_and_nothing_else() {
    let bench = Bench::new();
    let (client, udp) = (bench.unix_client(), bench.udp_client());
    let mut publisher = bench.server.publisher(DEVICE);
    publisher.publish(&record(), HostInstant::now());
    let nameless = UnixDatagram::unbound().unwrap();
    bench.tell(|| nameless.send_to(b"pose, please", bench.path()));
    bench.tell(|| udp.send(&[]));
    bench.tell(|| udp.send(&[0; 2000]));
    // Who passes no socket cannot be answered.
    bench.tell(|| nameless.send_to(&Request::new(Mode::Newest, None).to_bytes(), bench.path()));
    let counts = bench.server.counts();
    assert_eq!((counts.requests, counts.refused, counts.sent), (0, 4, 0));
    bench.ask(&client, Mode::Newest, None);
    assert_eq!(u64_at(&receive(&client), 32), 1);
}

#[test]
fn addresses_are_had_alone_and_given_back() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("pose");
    let address = [Address::Unix(path.clone())];
    // A daemon that was killed leaves its file.
    drop(UnixDatagram::bind(&path).unwrap());
    assert!(path.exists());
    let living = DatagramServer::bind(&address).unwrap();
    let error = DatagramServer::bind(&address).unwrap_err();
    assert_eq!(error.to_string(), in_use(&address[0]).to_string());
    drop(living);
    assert!(!path.exists());
    let anywhere: SocketAddr = (Ipv4Addr::UNSPECIFIED, 0).into();
    let error = DatagramServer::bind(&[Address::Udp(anywhere)]).unwrap_err();
    assert!(error.to_string().contains("can be reached from other hosts"), "{error}");
}

#[test]
fn who_asks_before_the_board_is_there_follows_it() {
    let bench = Bench::new();
    let [every, first, second] = [None, Some(DEVICE), Some(OTHER)].map(|device| {
        let client = bench.unix_client();
        // Twice, as clients do: each is followed once.
        bench.ask(&client, Mode::Follow, device);
        bench.ask(&client, Mode::Follow, device);
        client
    });
    let record = record();
    let mut publisher = bench.server.publisher(DEVICE);
    publisher.publish(&record, HostInstant::now());
    // The same board comes back under its name.
    drop(publisher);
    bench.server.publisher(DEVICE).publish(&record, HostInstant::now());
    for (client, expected) in [(&every, &[1, 1][..]), (&first, &[1, 1]), (&second, &[])] {
        assert_eq!(drain(client).0, expected);
    }
}

#[test]
fn one_kind_of_client_does_not_take_the_places_of_another() {
    let bench = Bench::new();
    let mut publisher = bench.server.publisher(DEVICE);
    let record = record();
    let mut publish = || publisher.publish(&record, HostInstant::now());
    // All places, and one more, by UDP.
    let mut udp: Vec<_> = (0..17).map(|_| bench.udp_client()).collect();
    for client in &udp {
        let cookie = bench.prove(client);
        bench.tell(|| client.send(&Request { mode: Mode::Follow, device: None, cookie }.to_bytes()));
    }
    let counts = bench.server.counts();
    assert_eq!((counts.places, counts.places_taken, counts.places_refused), (16, 16, 1));
    let answer_of = |client: &std::net::UdpSocket| {
        let mut bytes = [0; PoseDatagram::BYTES];
        let count = client.recv(&mut bytes).unwrap();
        Answer::from_bytes(&bytes[..count])
    };
    assert_eq!(answer_of(&udp.pop().unwrap()), Some(Answer::Refused), "the one that came last is told");
    publish();
    assert!(udp.iter().all(|client| answer_of(client).is_none()), "all others have the pose");
    // Clients of a user have half of them, and no more, as long as others want the rest.
    let unix: Vec<_> = (0..9).map(|_| bench.unix_client()).collect();
    for client in &unix {
        bench.ask(client, Mode::Follow, Some(DEVICE));
    }
    publish();
    for (number, client) in unix.iter().enumerate() {
        let mut bytes = [0; PoseDatagram::BYTES];
        let count = client.socket.recv(&mut bytes).unwrap();
        assert_eq!(Answer::from_bytes(&bytes[..count]), (number == 8).then_some(Answer::Refused), "{number}");
    }
    for (number, client) in udp.iter().enumerate() {
        assert_eq!(answer_of(client), (number >= 8).then_some(Answer::Refused), "{number}");
    }
    assert_eq!(bench.server.counts().places_taken, 16);
    // Who was pushed out gets nothing more.
    publish();
    udp[15].set_nonblocking(true).unwrap();
    assert!(udp[15].recv(&mut [0; 1]).is_err());
}
