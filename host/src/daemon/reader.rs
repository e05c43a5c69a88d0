//! The thread that reads a board: it opens the board, starts it, and passes on the bytes. After a loss it searches for
//! the board again.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use anyhow::{Context, Error};
use crossbeam_channel::Receiver;
use slitpose_protocol::Hello;

use super::board::{BoardPlan, BoardSlot, Claims};
use super::handoff::ReaderEnd;
use super::link::StreamEvent;
use super::solver::Solver;
use crate::device::{Contact, Conversation, DeviceError, HELLO_WITHIN, Selector, SimulatedPort};
use crate::terminal::say;
use slitpose_head::threads::lock;
use slitpose_tracking::link::DeviceId;
use slitpose_tracking::pipeline::{PipelineError, head_of};
use slitpose_tracking::solving;

/// Pause between searches for a board lost recently: a re-plugged one is back at once.
const SOON: Duration = Duration::from_millis(100);

/// Time after its loss during which a board counts as lost recently. A search for ports costs 0.1 ms and more.
const RECENTLY: Duration = Duration::from_secs(10);

/// Pause between searches for a board lost earlier, and between the first two attempts at one that cannot be used.
const LATER: Duration = Duration::from_millis(500);

/// Number of times that the pause between attempts at an unusable board doubles, to half a minute.
const DOUBLINGS: u32 = 6;

const MOMENT: Duration = Duration::from_millis(20);

const NO_HEAD: &str = "the board cannot solve poses of this head, and this program can: give --stream raw";

// Opening.

/// Decides from a board's hello whether it can be followed.
pub(crate) type Admit = Box<dyn Fn(&Hello<'_>) -> Result<(), PipelineError> + Send>;

/// Held while ports are searched for boards, until the board found has answered: two simultaneous searches would find
/// each other's ports in use.
static LOOKING: Mutex<()> = Mutex::new(());

pub(crate) trait Opener: Send {
    fn name(&self) -> String;

    /// Waits until no other reader searches for boards, if that would disturb the search.
    fn turn(&self) -> Option<MutexGuard<'static, ()>> {
        None
    }

    fn open(&mut self) -> Result<Conversation, DeviceError>;

    /// The board that was opened last has introduced itself.
    fn greeted(&mut self, _: DeviceId) {}
}

impl Opener for Contact {
    fn name(&self) -> String {
        self.selector.to_string()
    }

    fn turn(&self) -> Option<MutexGuard<'static, ()>> {
        let looks = !matches!(self.selector, Selector::Path(_));
        looks.then(|| lock(&LOOKING))
    }

    fn open(&mut self) -> Result<Conversation, DeviceError> {
        Conversation::open(Box::new(self.open()?))
    }

    fn greeted(&mut self, device: DeviceId) {
        self.greeted(device);
    }
}

/// A simulated board opens once, and again after faults on its link.
impl Opener for SimulatedPort {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn open(&mut self) -> Result<Conversation, DeviceError> {
        // Unlocked again: the conversation begins with bytes to the device.
        let is_there = lock(&self.device).open();
        match is_there {
            true => Conversation::open(Box::new(self.clone())),
            false => Err(DeviceError::Missing { name: self.name.clone() }),
        }
    }
}

// Reading.

pub(super) struct Reader {
    pub(super) plan: BoardPlan,
    pub(super) handoff: ReaderEnd<Solver>,
    pub(super) events: Receiver<(u64, StreamEvent)>,
    /// Number of the connection, from 1; each event carries the number of its connection.
    pub(super) connection: u64,
    pub(super) claims: Claims,
    /// The name under which the reader claims its board.
    pub(super) claimant: String,
    /// Whether scans have come over this connection.
    pub(super) has_scans: bool,
    pub(super) slot: Arc<BoardSlot>,
    pub(super) stop: Arc<AtomicBool>,
}

impl Reader {
    /// Reads until it is stopped, the stream is complete, or the board is given up.
    pub(super) fn run(mut self) -> anyhow::Result<()> {
        let ended = self.follow();
        self.slot.link.ended(ended.as_ref().err());
        ended
    }

    fn follow(&mut self) -> anyhow::Result<()> {
        // Since the last usable scan: a board that answers but sends no scan counts as missing.
        let mut missing_since = Instant::now();
        let mut is_first = true;
        let mut attempts = 0;
        loop {
            self.has_scans = false;
            self.claims.release(&self.claimant);
            // A board that is lost is dropped, which stops it, if it can still be reached.
            let error = match self.connect().and_then(|mut board| self.listen(&mut board).map(|()| board)) {
                Ok(mut board) => return self.end(&mut board),
                Err(error) => error,
            };
            let of_device = error.downcast_ref::<DeviceError>();
            if self.has_scans {
                let missed_s = of_device.map_or(0.0, DeviceError::missed_s);
                let missed = Duration::try_from_secs_f64(missed_s).unwrap_or_default();
                missing_since = Instant::now().checked_sub(missed).unwrap_or_else(Instant::now);
                (is_first, attempts) = (false, 0);
            }
            // At the start a user is there to correct errors that do not pass. Later, access to a port may be denied
            // only because it has just appeared.
            let is_hopeless = is_first && !of_device.is_some_and(DeviceError::is_passing);
            is_first = false;
            if is_hopeless || self.plan.patience.is_some_and(|patience| missing_since.elapsed() >= patience) {
                return Err(error);
            }
            if let Some(told) = self.slot.link.lost(&error) {
                say(format_args!("{told}"));
            }
            // A board that has just run will most likely run again at once. A board that stays away, or needs the
            // user, is tried less often.
            let is_away = of_device.is_some_and(DeviceError::is_away);
            let is_soon = self.has_scans || (is_away && missing_since.elapsed() < RECENTLY);
            self.rest(if is_soon { SOON } else { pause_behind(of_device, attempts) });
            attempts = attempts.saturating_add(1);
            if self.stops() {
                return Ok(());
            }
        }
    }

    fn stops(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    fn rest(&self, pause: Duration) {
        let until = Instant::now() + pause;
        while !self.stops() && Instant::now() < until {
            std::thread::sleep(MOMENT);
        }
    }

    /// Opens, greets, configures and starts the board. It counts as running once scans come.
    fn connect(&mut self) -> anyhow::Result<Conversation> {
        let Self {
            plan: BoardPlan { opener, admit, stream, sends_soon, pulse, head, configuration, .. },
            slot,
            claims,
            claimant,
            ..
        } = self;
        let _turn = opener.turn();
        let mut board = opener.open()?;
        slot.link.connecting();
        let name = board.name();
        let mut compiled = None;
        board.greet(HELLO_WITHIN, |hello| {
            admit(hello)?;
            let device = DeviceId(hello.device_id);
            claims.claim(device, claimant)?;
            opener.greeted(device);
            slot.link.greeted(device, &name);
            if stream.poses > 0 {
                let head = solving::compile(&head_of(head, hello), &configuration.schedule, &hello.scaling);
                compiled = Some(head.context(NO_HEAD)?);
            }
            Ok::<_, Error>(())
        })?;
        board.configure(configuration.clone())?;
        if let Some(head) = &compiled {
            board.send_head(head)?;
        }
        board.stream(*stream)?;
        if *sends_soon {
            board.send_soon(&configuration.schedule)?;
        }
        if let Some(pulse) = pulse {
            board.pulse(*pulse)?;
        }
        board.start()?;
        self.connection += 1;
        Ok(board)
    }

    /// Passes on what the board sends, until it shall end or the stream is complete; the error says why it is lost.
    fn listen(&mut self, board: &mut Conversation) -> anyhow::Result<()> {
        self.pass_on(board, true);
        loop {
            match self.next_event() {
                Some(StreamEvent::Complete) => return Ok(()),
                Some(StreamEvent::Scans) => {
                    self.has_scans = true;
                    if let Some(told) = self.slot.link.running(&board.name()) {
                        say(format_args!("{told}"));
                    }
                }
                Some(StreamEvent::Scanless(seconds, cause)) => {
                    return Err(DeviceError::NoScans { name: board.name(), seconds, cause }.into());
                }
                Some(StreamEvent::Unusable(error)) => return Err(error),
                Some(StreamEvent::Stopped(reason)) => {
                    let reason = reason.unwrap_or_else(|| "it gives no reason; reset the board".to_owned());
                    return Err(DeviceError::Stopped { name: board.name(), reason }.into());
                }
                None if self.stops() => return Ok(()),
                None => {}
            }
            let more = board.listen()?;
            let is_taken = self.pass_on(board, false);
            if !more || !is_taken {
                return Ok(());
            }
        }
    }

    /// The next event. Events of earlier connections are ignored, except the end of the stream.
    fn next_event(&self) -> Option<StreamEvent> {
        self.events.try_iter().find_map(|(connection, event)| {
            (connection == self.connection || matches!(event, StreamEvent::Complete)).then_some(event)
        })
    }

    /// Stops the board and passes on the bytes that were still under way.
    fn end(&mut self, board: &mut Conversation) -> anyhow::Result<()> {
        let stopped = board.stop();
        self.pass_on(board, false);
        if let Err(DeviceError::NoReply { .. }) = stopped {
            say(format_args!("the emitters of the board may still be lit; it goes dark when its port is closed"));
        }
        Ok(stopped?)
    }

    /// Solves the bytes received last, or passes them on. Waits if the solver is far behind: bytes then wait in the
    /// operating system and on the board. `false` if the solver has ended.
    fn pass_on(&mut self, board: &mut Conversation, opened: bool) -> bool {
        let Some(segment) = self.handoff.chunk() else {
            return false;
        };
        segment.clear();
        segment.opened = opened;
        board.fill(segment);
        self.handoff.pass_on();
        true
    }
}

/// Pause after a failed attempt, the last of `attempts` since the board ran; `error`: that of its device.
fn pause_behind(error: Option<&DeviceError>, attempts: u32) -> Duration {
    if error.is_none_or(DeviceError::needs_user) { LATER * (1 << attempts.min(DOUBLINGS)) } else { LATER }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::Scanless;

    #[test]
    fn attempts_become_rarer_where_the_user_must_act_and_stay_frequent_where_not() {
        let name = || "port".to_owned();
        let seconds = |error: DeviceError| {
            [0, 1, 2, 6, 7, u32::MAX].map(|attempts| pause_behind(Some(&error), attempts).as_secs_f64())
        };
        let growing = [0.5, 1.0, 2.0, 32.0, 32.0, 32.0];
        assert_eq!(seconds(DeviceError::Forbidden { name: name() }), growing);
        let cause = Scanless::Nothing;
        assert_eq!(seconds(DeviceError::NoScans { name: name(), seconds: 3.0, cause }), growing);
        assert_eq!(seconds(DeviceError::Missing { name: name() }), [0.5; 6]);
        assert_eq!(seconds(DeviceError::Busy { name: name() }), [0.5; 6]);
    }
}
