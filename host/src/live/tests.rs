//! The server as clients see it.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use slitpose_head::scene_file::WIDE;
use slitpose_model::Photocurrents;
use tungstenite::client::IntoClientRequest;
use tungstenite::stream::MaybeTlsStream;
use tungstenite::{Message, WebSocket};

use super::hub::LiveBoard;
use super::server::{Clients, MAX_CLIENTS, MAX_REQUEST};
use super::session::WINDOW;
use super::*;
use crate::http::{LIFETIME, MOST};
use crate::samples::poses;
use slitpose_tracking::clock::HostInstant;
use slitpose_tracking::page::{Bins, FINE_HZ, MAP_POINTS, Order, PlayerOrder, Sample, Sampler, SceneView};
use slitpose_tracking::pipeline::Record;

const TOKEN: &str = "correct-horse-battery";

/// Longer than any answer takes on a busy machine.
const PATIENCE: Duration = Duration::from_secs(60);

type Orders = Arc<Mutex<Vec<Order>>>;

fn kept_in(orders: &Orders) -> Control {
    let orders = Arc::clone(orders);
    Box::new(move |order| {
        orders.lock().unwrap().push(order);
        Ok(())
    })
}

fn start(address: &str, token: Option<&str>) -> (LiveServer, Orders) {
    serve(address, token, None)
}

/// The same, with a tool to be dragged in a scene if there is one.
fn serve(address: &str, token: Option<&str>, scene: Option<SceneView>) -> (LiveServer, Orders) {
    let orders = Orders::default();
    let access = Access::new(address.parse().unwrap(), token.map(str::to_owned), false).unwrap();
    let server = LiveServer::start(LivePlan {
        access,
        source: "run",
        boards: vec![LiveBoard { name: "sim".to_owned(), head: WIDE.read().unwrap().into() }],
        scene,
        control: kept_in(&orders),
        report: None,
        recordings: None,
    });
    (server.unwrap(), orders)
}

/// Host and port that its URL names.
fn authority(server: &LiveServer) -> &str {
    server.url.split('/').nth(2).unwrap()
}

fn port(server: &LiveServer) -> &str {
    authority(server).rsplit(':').next().unwrap()
}

struct Client(WebSocket<MaybeTlsStream<TcpStream>>);

impl Client {
    /// Connects to the server's port on this host.
    fn connect(server: &LiveServer) -> Result<Self, tungstenite::Error> {
        let url = format!("ws://127.0.0.1:{}/live", port(server));
        let (socket, _) = tungstenite::connect(url)?;
        if let MaybeTlsStream::Plain(stream) = socket.get_ref() {
            stream.set_read_timeout(Some(PATIENCE)).unwrap();
        }
        Ok(Self(socket))
    }

    fn greeted(server: &LiveServer) -> Self {
        let mut client = Self::connect(server).unwrap();
        client.say(&json!({"kind": "hello"}));
        client
    }

    fn say(&mut self, request: &Value) {
        self.0.send(Message::text(request.to_string())).unwrap();
    }

    /// The next message; `None` if the server has closed the connection.
    fn hear(&mut self) -> Option<Value> {
        let since = Instant::now();
        loop {
            match self.0.read() {
                Ok(Message::Text(text)) => return Some(serde_json::from_str(&text).unwrap()),
                Ok(Message::Ping(_) | Message::Pong(_)) if since.elapsed() < PATIENCE => {}
                Ok(Message::Ping(_) | Message::Pong(_)) => panic!("nothing came"),
                Ok(_) => return None,
                Err(tungstenite::Error::Io(error)) if error.kind() == std::io::ErrorKind::WouldBlock => {
                    panic!("nothing came")
                }
                Err(_) => return None,
            }
        }
    }

    /// The next message of this kind, and all before it.
    fn hear_of(&mut self, kind: &str) -> Vec<Value> {
        let mut heard = Vec::new();
        loop {
            let message = self.hear().unwrap_or_else(|| panic!("closed before any {kind}"));
            let is_found = message["kind"] == kind;
            heard.push(message);
            if is_found {
                return heard;
            }
        }
    }
}

/// Sends each of `poses` as a sample, as soon as the server takes it.
fn play(server: &LiveServer, poses: &[(Record, Photocurrents)]) {
    for (record, photocurrents) in poses {
        let (record, photocurrents) = (*record, photocurrents.clone());
        let sample = Sample { record, photocurrents, scans: 1, poses: 1, bins: Bins::default() };
        while !server.input.sample(0, &sample) {
            std::thread::yield_now();
        }
    }
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

#[test]
fn a_client_gets_head_and_frames_with_the_numbers_of_the_poses() {
    let (server, _) = start("127.0.0.1:0", None);
    let mut client = Client::greeted(&server);
    let begun = client.hear_of("head");
    assert_eq!((&begun[0]["kind"], &begun[0]["may_write"]), (&json!("hello"), &json!(true)));
    assert_eq!(begun[0]["boards"], json!(["sim"]));
    let head = &begun[1];
    let scene = WIDE.read().unwrap().scene;
    assert_eq!(head["cells"].as_array().unwrap().len(), scene.cells.len());
    assert_eq!(numbers(&head["cells"][2]["emitter"]["position_m"]), scene.cells[2].emitter.position_tool_m.to_array());
    let poses = poses(5);
    play(&server, &poses);
    for (n, (record, photocurrents)) in poses.iter().enumerate() {
        let frame = client.hear_of("frame").pop().unwrap();
        assert_eq!((&frame["n"], &frame["seq"]), (&json!(n), &json!(record.sequence)));
        let estimate = record.solution.estimate.unwrap();
        for (found, expected) in numbers(&frame["t_m"]).iter().zip(estimate.pose.translation_m.to_array()) {
            assert!((found - expected).abs() < 1e-9, "{found} {expected}");
        }
        for (found, expected) in numbers(&frame["sigma"]).iter().zip(estimate.sigma()) {
            assert!((found / expected - 1.0).abs() < 1e-3, "{found} {expected}");
        }
        for (cell, reading) in frame["cells"].as_array().unwrap().iter().zip(&photocurrents.cells) {
            let slitpose_model::Reading::Light(pair) = reading else { panic!("a dark cell") };
            let found = numbers(&cell["i_a"]);
            assert!((found[1] / pair.i_x2_a - 1.0).abs() < 1e-3, "{found:?} {pair:?}");
            // The position follows from the currents as the model's does from the pose, within noise.
            let [measured, expected] = ["x_m", "expected_x_m"].map(|key| cell[key].as_f64().unwrap());
            assert!((measured - expected).abs() < 50e-6, "{measured} {expected}");
            let spot = numbers(&cell["spot_m"]);
            assert!(spot[0] < expected && expected < spot[1], "{spot:?} {expected}");
            assert_eq!(cell["state"], json!(["used"]));
        }
    }
}

#[test]
fn a_frame_covers_all_scans_since_the_one_before() {
    let (server, _) = start("127.0.0.1:0", None);
    let mut client = Client::greeted(&server);
    let poses = poses(90);
    let mut sampler = Sampler::default();
    for (number, (record, photocurrents)) in poses.iter().enumerate() {
        sampler.add(record);
        // One in thirty is due.
        let now = HostInstant { monotonic_ns: number as u64 * 1_200_000, utc_ns: 0 };
        sampler.send(Some(photocurrents), now, |sample| server.input.sample(0, sample));
    }
    let frames: Vec<Value> = (0..3).map(|_| client.hear_of("frame").pop().unwrap()).collect();
    let (mut covered, mut fine) = (0, Vec::new());
    for frame in &frames {
        let scans = frame["scans"].as_u64().unwrap() as usize;
        let part = &poses[covered..covered + scans];
        covered += scans;
        assert_eq!(frame["seq"], json!(part[scans - 1].0.sequence));
        fine.extend(frame["fine"].as_array().unwrap().iter().map(numbers));
    }
    assert!(covered > 50, "{covered}");
    // Mean, distances to the extremes, spread and σ of x in each bin, nanometres.
    assert!(fine.len() > 10, "{fine:?}");
    for bin in &fine {
        let is_in = |record: &&Record| (record.device_time_s * FINE_HZ as f64).floor() == bin[0];
        let estimates = poses.iter().map(|(record, _)| record).filter(is_in).map(|it| it.solution.estimate.unwrap());
        let (x, sigmas): (Vec<f64>, Vec<f64>) =
            estimates.map(|estimate| (estimate.pose.translation_m.x * 1e9, estimate.sigma()[0] * 1e9)).unzip();
        let count = x.len() as f64;
        let [mean, sigma] = [&x, &sigmas].map(|values| values.iter().sum::<f64>() / count);
        let [low, high] = [f64::min, f64::max].map(|pick| x.iter().copied().reduce(pick).unwrap());
        let rms = (x.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / count).sqrt();
        let expected = [(1, count), (2, count), (4, mean), (16, mean - low), (28, high - mean), (40, rms), (52, sigma)];
        for (place, expected) in expected {
            assert!((bin[place] - expected).abs() < 1.0, "{place}: {expected}, {bin:?}");
        }
    }
}

#[test]
fn a_client_that_acknowledges_nothing_costs_no_more_than_its_window_and_goes_on_with_the_newest() {
    let (server, _) = start("127.0.0.1:0", None);
    let mut asleep = Client::greeted(&server);
    asleep.hear_of("head");
    let mut awake = Client::greeted(&server);
    awake.hear_of("head");
    let poses = poses(400);
    // As many as it may have without a word, no faster than they can be sent.
    let (window, rest) = poses.split_at(WINDOW as usize - 2);
    let mut frames: Vec<u64> = Vec::new();
    for some in window.chunks(10) {
        play(&server, some);
        frames.extend(some.iter().map(|_| asleep.hear_of("frame").pop().unwrap()["n"].as_u64().unwrap()));
    }
    assert_eq!(frames, (0..WINDOW - 2).collect::<Vec<_>>());
    play(&server, rest);
    // The one that acknowledges gets the last frame.
    let mut heard = 2_u64;
    let mut last = 0;
    while last + 1 < poses.len() as u64 {
        let message = awake.hear().unwrap();
        heard += 1;
        awake.say(&json!({"kind": "ack", "messages": heard}));
        if message["kind"] == "frame" {
            last = message["n"].as_u64().unwrap();
        }
    }
    // The other goes on once it acknowledges.
    asleep.say(&json!({"kind": "ack", "messages": WINDOW}));
    let missed = asleep.hear_of("missed").pop().unwrap()["frames"].as_u64().unwrap();
    let next = asleep.hear_of("frame").pop().unwrap()["n"].as_u64().unwrap();
    assert_eq!(next, frames.len() as u64 + missed, "each frame has come or is counted");
    assert!(next + 2 >= poses.len() as u64, "{next}: the newest");
}

#[test]
fn a_client_that_comes_later_gets_the_last_minute_and_a_restart_begins_anew() {
    let (server, _) = start("127.0.0.1:0", None);
    let poses = poses(150);
    play(&server, &poses);
    let mut watcher = Client::greeted(&server);
    let mut past: Vec<u64> = Vec::new();
    let mut heard = 0_u64;
    while past.len() < poses.len() {
        let message = watcher.hear().unwrap();
        heard += 1;
        watcher.say(&json!({"kind": "ack", "messages": heard}));
        match message["kind"].as_str() {
            Some("history") => {
                let frames = message["frames"].as_array().unwrap();
                assert!(frames.len() <= 60);
                let numbers = frames.iter().map(|frame| frame["n"].as_u64().unwrap());
                assert!(numbers.clone().is_sorted());
                past.extend(numbers);
            }
            // Frames that were on their way come before the past.
            Some("frame") => past.push(message["n"].as_u64().unwrap()),
            _ => {}
        }
    }
    past.sort_unstable();
    assert_eq!(past, (0..poses.len() as u64).collect::<Vec<_>>());
    // The board's clock goes back.
    play(&server, &poses[..1]);
    let cleared = watcher.hear_of("history");
    let kinds: Vec<_> = cleared.iter().map(|message| message["kind"].as_str().unwrap()).collect();
    assert_eq!(kinds, ["cleared", "head", "history"]);
    assert_eq!(cleared[2]["frames"][0]["seq"], json!(poses[0].0.sequence));
}

#[test]
fn pages_of_others_and_wrong_tokens_see_nothing() {
    let (server, _) = start("127.0.0.1:0", None);
    let request = |host: &str, origin: Option<&str>| {
        let mut request = format!("ws://127.0.0.1:{}/live", port(&server)).into_client_request().unwrap();
        let own = format!("{host}:{}", port(&server));
        request.headers_mut().insert("host", own.parse().unwrap());
        if let Some(origin) = origin {
            let origin = origin.replace("PORT", port(&server));
            request.headers_mut().insert("origin", origin.parse().unwrap());
        }
        tungstenite::connect(request).map(|_| ())
    };
    assert!(request("127.0.0.1", Some("http://127.0.0.1:PORT")).is_ok());
    assert!(request("localhost", None).is_ok());
    for (host, origin) in [
        ("evil.example", None),
        ("evil.example", Some("http://evil.example:PORT")),
        ("127.0.0.1", Some("http://evil.example")),
        ("127.0.0.1", Some("https://127.0.0.1:PORT")),
        ("127.0.0.1", Some("null")),
    ] {
        let refused = request(host, origin);
        assert!(
            matches!(&refused, Err(tungstenite::Error::Http(answer)) if answer.status() == 403),
            "{host} {origin:?} {refused:?}"
        );
    }

    let (guarded, orders) = start("0.0.0.0:0", Some(TOKEN));
    for token in [
        None,
        Some("wrong"),
        Some("correct-horse-batterz"),
        Some("correct-horse-batter"),
        Some("correct-horse-batterys"),
    ] {
        let mut client = Client::connect(&guarded).unwrap();
        client.say(&json!({"kind": "hello", "token": token}));
        let refused = client.hear().unwrap();
        assert_eq!(refused["kind"], "refused");
        assert!(refused["reason"].as_str().unwrap().contains("token"));
        assert_eq!(client.hear(), None);
    }
    let mut client = Client::connect(&guarded).unwrap();
    client.say(&json!({"kind": "hello", "token": TOKEN}));
    assert_eq!(client.hear().unwrap()["may_write"], json!(false));
    client.say(&json!({"kind": "record", "on": true}));
    let refused = client.hear_of("refused").pop().unwrap();
    assert!(refused["reason"].as_str().unwrap().contains("--live-writes"), "{refused}");
    assert!(orders.lock().unwrap().is_empty());
}

#[test]
fn orders_are_passed_on_and_nonsense_is_refused() {
    let (server, orders) = start("127.0.0.1:0", None);
    let mut client = Client::greeted(&server);
    client.say(&json!({"kind": "record", "on": true}));
    client.say(&json!({"kind": "player", "playing": false, "seek_s": 2.5}));
    for (nonsense, reason) in [
        ("{", "request"),
        (r#"{"kind":"shutdown"}"#, "shutdown"),
        (r#"{"kind":"pose","t_m":[0,0,0],"r_rad":[0,0,0]}"#, "scene view"),
    ] {
        client.0.send(Message::text(nonsense)).unwrap();
        let refused = client.hear_of("refused").pop().unwrap();
        assert!(refused["reason"].as_str().unwrap().contains(reason), "{refused}");
    }
    let player = PlayerOrder { playing: Some(false), speed: None, seek_s: Some(2.5) };
    assert_eq!(*orders.lock().unwrap(), [Order::Record(true), Order::Player(player)]);
    client.0.send(Message::text("x".repeat(MAX_REQUEST + 1))).unwrap();
    while client.hear().is_some() {}
}

#[test]
fn clients_are_limited_and_those_who_say_nothing_keep_nobody_out() {
    let (server, _) = start("127.0.0.1:0", None);
    // More than there are connections: the oldest ones are closed for the rest, and none has a client's place.
    let mut silent: Vec<Client> = (0..2 * MOST).map(|_| Client::connect(&server).unwrap()).collect();
    let mut clients: Vec<Client> = (1..MAX_CLIENTS).map(|_| Client::greeted(&server)).collect();
    clients.iter_mut().for_each(|client| drop(client.hear_of("head")));
    assert_eq!((silent[0].hear(), silent[2 * MOST - 1].hear()), (None, None));
    // The last place is kept for another address.
    let refused = Client::connect(&server).err();
    assert!(matches!(&refused, Some(tungstenite::Error::Http(answer)) if answer.status() == 503), "{refused:?}");
    // They last longer than a connection that only asks for a file.
    std::thread::sleep(LIFETIME);
    play(&server, &poses(1));
    clients.iter_mut().for_each(|client| drop(client.hear_of("frame")));
    drop(clients);
    // Their places are free again.
    let again = (0..600).find_map(|_| {
        std::thread::sleep(Duration::from_millis(100));
        Client::connect(&server).ok()
    });
    assert!(again.is_some());
}

#[test]
fn the_last_place_is_kept_for_an_address_that_has_none() {
    let clients = Clients::default();
    let [here, there] = ["192.0.2.1", "192.0.2.2"].map(|text| text.parse().ok());
    let places: Vec<_> = (0..MAX_CLIENTS).map_while(|_| clients.place(here)).collect();
    assert_eq!(places.len(), MAX_CLIENTS - 1);
    let last = clients.place(there);
    assert!(last.is_some() && clients.place(there).is_none() && clients.place(None).is_none());
    drop(places);
    assert!(clients.place(here).is_some());
}

#[test]
fn files_come_with_a_policy_that_lets_them_fetch_nothing_else() {
    let (server, _) = start("127.0.0.1:0", None);
    let fetch = |path: &str| {
        let mut stream = TcpStream::connect(authority(&server)).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        write!(stream, "GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    };
    let page = fetch("/");
    assert!(page.starts_with("HTTP/1.1 200") && page.contains("content-type: text/html"), "{page}");
    assert!(page.contains("content-security-policy: default-src 'self'") && page.contains(env!("CARGO_PKG_VERSION")));
    assert!(!page.contains("SLITPOSE_VERSION"));
    for path in ["/index.html", "/../Cargo.toml", "/page/main.js"] {
        assert!(fetch(path).starts_with("HTTP/1.1 404"), "{path}");
    }
}

#[test]
fn a_tool_is_dragged_where_a_frame_sees_it_or_says_why_not() {
    let head = WIDE.read().unwrap().into();
    let (server, _) = serve("127.0.0.1:0", None, Some(SceneView::of(&head).unwrap()));
    let mut client = Client::greeted(&server);
    let mut ask = |mut request: Value, t_m: [f64; 3]| {
        (request["t_m"], request["r_rad"]) = (json!(t_m), json!([0.0, 0.1, 0.0]));
        client.say(&request);
        loop {
            let message = client.hear().unwrap();
            if ["frame", "map", "refused"].iter().any(|kind| message["kind"] == *kind) {
                return message;
            }
        }
    };
    // In the middle of a plane through the tool the accuracy is that of a frame there.
    let map = ask(json!({"kind": "map", "plane": "xz"}), [0.0, 1e-3, 0.0]);
    let at = |index: usize| map["sigma_m"][index].as_f64();
    assert_eq!(map["sigma_m"].as_array().map(Vec::len), Some(MAP_POINTS * MAP_POINTS));
    let sigma = numbers(&ask(json!({"kind": "pose"}), [0.0, 1e-3, 0.0])["sigma"]);
    let middle_m = sigma[..3].iter().map(|sigma| sigma * sigma).sum::<f64>().sqrt();
    assert!((at(MAP_POINTS * MAP_POINTS / 2).unwrap() / middle_m - 1.0).abs() < 1e-3, "{middle_m}");
    // The least z, then the least x, and the last of the first row.
    for (index, t_m) in [(0, [-3.3e-3, 1e-3, -3.3e-3]), (MAP_POINTS - 1, [3.3e-3, 1e-3, -3.3e-3])] {
        let sigma = numbers(&ask(json!({"kind": "pose"}), t_m)["sigma"]);
        let there_m = sigma[..3].iter().map(|sigma| sigma * sigma).sum::<f64>().sqrt();
        assert!((at(index).unwrap() / there_m - 1.0).abs() < 1e-3, "{index}: {there_m}");
    }
    let mut drag = |t_m: [f64; 3]| ask(json!({"kind": "pose"}), t_m);
    let seen = drag([1e-3, 0.0, -1e-3]);
    assert_eq!((&seen["status"], &seen["truth"]), (&json!("converged"), &json!(null)));
    assert!((numbers(&seen["t_m"])[0] - 1e-3).abs() < 1e-9, "{seen}");
    let sigma_m = numbers(&seen["sigma"])[0];
    assert!((0.5e-6..5e-6).contains(&sigma_m), "{sigma_m}");
    let lost = drag([0.5, 0.0, 0.0]);
    assert_eq!((&lost["t_m"], &lost["sigma"]), (&json!(null), &json!(null)), "{lost}");
    assert_eq!(drag([f64::from(f32::MAX), 0.0, 0.0])["kind"], "refused");
}
