//! A capture that is played as the live page asks.

use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crate::live::{Control, Input, LiveBoard, LiveInput};
use slitpose_head::pace::Speed;
use slitpose_head::threads::lock;
use slitpose_tracking::page::{Order, PlayerOrder, PlayerState, Refusal, Sampler};
use slitpose_tracking::playback::{self, Board, PlaybackError};
use slitpose_tracking::telemetry::DaemonReport;

/// Time between messages on the state of the player.
const TELL_EVERY: Duration = Duration::from_millis(250);

/// Orders that are not carried out yet; a later one overrides an earlier one.
#[derive(Clone, Debug, Default)]
pub(super) struct Orders(Arc<Mutex<PlayerOrder>>);

impl Orders {
    pub(super) fn control(&self) -> Control {
        let orders = self.clone();
        Box::new(move |order| orders.order(&order))
    }

    fn order(&self, order: &Order) -> Result<(), Refusal> {
        let order = match order {
            Order::Player(order) => *order,
            Order::Record(_) | Order::Note(..) => return Err(Refusal::NO_RECORDER),
            Order::Frame(..) => return Err(Refusal::NO_FRAME),
        };
        order.check()?;
        let mut waiting = lock(&self.0);
        *waiting = PlayerOrder {
            playing: order.playing.or(waiting.playing),
            speed: order.speed.or(waiting.speed),
            seek_s: order.seek_s.or(waiting.seek_s),
        };
        Ok(())
    }
}

pub(super) struct Player {
    orders: Orders,
    pub(super) live: LiveInput,
    state: PlayerState,
    told: Option<Instant>,
}

impl Player {
    /// A player of the captures `files`, called `name`, up to `to_s`, if that is before their end; `None` if nobody looks
    /// any more when they have been read.
    pub(super) fn new(
        orders: Orders,
        live: LiveInput,
        name: String,
        files: &[PathBuf],
        to_s: Option<f64>,
    ) -> Result<Option<Self>, PlaybackError> {
        let state = PlayerState { playing: true, file: name, ..PlayerState::default() };
        let mut player = Self { orders, live, state, told: None };
        let outline = playback::Playback::outline(files, &mut |length_s| {
            // A page that hears nothing takes the program for dead.
            player.state.duration_s = length_s;
            player.tell_state();
            !player.is_left()
        })?;
        player.state.duration_s = outline.length_s.min(to_s.unwrap_or(f64::INFINITY));
        player.state.notes = outline.notes;
        player.told = None;
        Ok(Some(player).filter(|player| !player.is_left()))
    }

    /// Sends the state to the page, four times a second; returns whether it was sent.
    fn tell_state(&mut self) -> bool {
        let is_due = self.told.is_none_or(|told| told.elapsed() >= TELL_EVERY);
        if is_due {
            self.told = Some(Instant::now());
            self.live.show(Input::Player(self.state.clone()));
        }
        is_due
    }

    /// Shows these boards from now on, by the samplers that are returned.
    pub(super) fn show(&self, boards: &[Board]) -> Vec<Sampler> {
        let shown = |board: &Board| LiveBoard { name: board.name(), head: board.head.clone() };
        self.live.show(Input::Boards(boards.iter().map(shown).collect()));
        boards.iter().map(|_| Sampler::default()).collect()
    }

    pub(super) fn is_left(&self) -> bool {
        self.live.is_closed()
    }

    pub(super) fn is_playing(&self) -> bool {
        self.state.is_playing()
    }

    /// Carries out waiting orders: changes `speed`, and returns the place of a leap, seconds after the beginning.
    pub(super) fn obey(&mut self, speed: &mut Speed) -> Option<f64> {
        let order = std::mem::take(&mut *lock(&self.orders.0));
        if order != PlayerOrder::default() {
            self.told = None;
        }
        if let Some(new) = order.speed {
            *speed = new.map_or(Speed::Max, Speed::Times);
        }
        self.state.obey(&order)
    }

    /// Sends the state of the player and a report on the boards to the page, four times a second and after each change.
    pub(super) fn tell(&mut self, position_s: f64, speed: Speed, ended: bool, report: impl FnOnce() -> DaemonReport) {
        if ended != self.state.ended {
            self.told = None;
        }
        (self.state.position_s, self.state.ended) = (position_s, ended);
        self.state.speed = match speed {
            Speed::Max => None,
            Speed::Times(times) => Some(times),
        };
        // It may still be recorded.
        self.state.duration_s = self.state.duration_s.max(position_s);
        if self.tell_state() {
            self.live.show(Input::Report(Box::new(report())));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_that_wait_are_joined_and_bad_ones_refused() {
        let orders = Orders::default();
        let give = |order| orders.order(&Order::Player(order));
        let none = PlayerOrder::default();
        give(PlayerOrder { playing: Some(false), seek_s: Some(3.0), ..none }).unwrap();
        give(PlayerOrder { playing: Some(true), speed: Some(None), ..none }).unwrap();
        let joined = PlayerOrder { playing: Some(true), speed: Some(None), seek_s: Some(3.0) };
        assert_eq!(*lock(&orders.0), joined);
        for seek_s in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(give(PlayerOrder { seek_s: Some(seek_s), ..none }).is_err(), "{seek_s}");
        }
        for speed in [0.0, -1.0, 1e9, f64::NAN] {
            assert!(give(PlayerOrder { speed: Some(Some(speed)), ..none }).is_err(), "{speed}");
        }
        assert!(orders.order(&Order::Record(true)).is_err());
        assert_eq!(*lock(&orders.0), joined, "refused orders change nothing");
    }
}
