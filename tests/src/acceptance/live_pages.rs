//! Live pages that look for a daemon, beside a study.

use std::net::{SocketAddr, TcpListener};
use std::thread::{sleep, spawn};
use std::time::Duration;

use tungstenite::Message;

/// Messages that a page takes between two acknowledgements.
const ACKNOWLEDGED: usize = 8;

/// What a page does with its messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Page {
    /// It takes all, and acknowledges them.
    Takes,
    /// It takes none after its hello.
    Sleeps,
}

/// Starts `pages`, which come back whenever they lose their daemon, and returns the address at which they look for one.
///
/// # Panics
/// If no port is free.
pub fn look(pages: impl IntoIterator<Item = Page>) -> SocketAddr {
    let address = TcpListener::bind("127.0.0.1:0").and_then(|free| free.local_addr()).expect("a free port");
    for page in pages {
        spawn(move || {
            loop {
                visit(page, address);
                sleep(Duration::from_millis(100));
            }
        });
    }
    address
}

/// Stays with the daemon at `address` until it is lost; at once if there is none.
fn visit(page: Page, address: SocketAddr) {
    let Ok((mut socket, _)) = tungstenite::connect(format!("ws://{address}/live")) else { return };
    let mut sent = socket.send(Message::text(r#"{"kind":"hello"}"#));
    if page == Page::Sleeps {
        sleep(Duration::from_secs(3600));
    }
    let mut taken = 0;
    while sent.is_ok() && socket.read().is_ok() {
        taken += 1;
        if taken % ACKNOWLEDGED == 0 {
            sent = socket.send(Message::text(format!(r#"{{"kind":"ack","messages":{taken}}}"#)));
        }
    }
}
