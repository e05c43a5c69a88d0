//! What a board says of its start: its clock, its settings, and warnings where either failed.

use slitpose_firmware::{Board, Identity, Link, STATUS_MS};
use slitpose_protocol::{ClockSource, Command, Hashes, SettingsSource, Severity};

use crate::common::{Fake, Heard, Listener, TICK_HZ, configuration, identity, request, turn};

type Started = Board<Fake, [u8; 2_048]>;

/// A board that has just started, its link closed.
fn started(clock: ClockSource, settings: SettingsSource) -> Started {
    let identity = Identity { clock, settings, ..identity() };
    Board::new(Fake::default(), identity, configuration(), [0; 2_048]).expect("the configuration is valid")
}

fn said(board: &mut Started, listener: &mut Listener) -> (ClockSource, SettingsSource) {
    board.hardware_mut().now += STATUS_MS * u64::from(TICK_HZ) / 1_000;
    match turn(board, listener).pop() {
        Some(Heard::Status(status)) => (status.clock, status.settings),
        other => panic!("no status but {other:?}"),
    }
}

/// The warnings that a host hears when it opens the link; the hello comes first.
fn warnings_on_opening(board: &mut Started, listener: &mut Listener) -> Vec<String> {
    board.poll(Link::Closed);
    let heard = turn(board, listener);
    assert!(matches!(heard[0], Heard::Hello { .. }), "{heard:?}");
    let text = |heard: &Heard| match heard {
        Heard::Event { severity: Severity::Warning, text } => text.clone(),
        other => panic!("no warning: {other:?}"),
    };
    heard[1..].iter().map(text).collect()
}

#[test]
fn every_status_names_clock_and_settings_of_the_start() {
    for clock in ClockSource::ALL {
        for settings in SettingsSource::ALL {
            let (mut board, mut listener) = (started(clock, settings), Listener::default());
            turn(&mut board, &mut listener);
            assert_eq!(said(&mut board, &mut listener), (clock, settings));
        }
    }
}

#[test]
fn every_host_that_opens_the_link_is_warned_once_of_each_failure() {
    const CRYSTAL: &str = "the crystal did not start: running from the internal oscillator";
    const SETTINGS: &str =
        "three starts in a row failed: stored settings were passed over; store them again, or forget them";
    for clock in ClockSource::ALL {
        for settings in SettingsSource::ALL {
            let (mut board, mut listener) = (started(clock, settings), Listener::default());
            let crystal = (clock == ClockSource::CrystalFailed).then_some(CRYSTAL);
            let passed_over = (settings == SettingsSource::PassedOver).then_some(SETTINGS);
            let expected = crystal.into_iter().chain(passed_over).collect::<Vec<_>>();
            for _ in 0..2 {
                assert_eq!(warnings_on_opening(&mut board, &mut listener), expected);
                assert_eq!(turn(&mut board, &mut listener), [], "once");
            }
        }
    }
}

#[test]
fn settings_follow_a_store_and_a_forget_and_the_warning_ends() {
    for (command, after) in
        [(Command::Store(Hashes::default()), SettingsSource::Stored), (Command::Forget, SettingsSource::Defaults)]
    {
        let (mut board, mut listener) =
            (started(ClockSource::Crystal, SettingsSource::PassedOver), Listener::default());
        assert_eq!(warnings_on_opening(&mut board, &mut listener).len(), 1);
        // Flash memory that does not take it leaves the next start as it is.
        board.hardware_mut().refuse_store = true;
        board.receive(&request(1, command.clone()));
        turn(&mut board, &mut listener);
        assert_eq!(said(&mut board, &mut listener), (ClockSource::Crystal, SettingsSource::PassedOver));

        board.hardware_mut().storing_polls = 2;
        board.receive(&request(2, command));
        turn(&mut board, &mut listener);
        assert_eq!(said(&mut board, &mut listener).1, SettingsSource::PassedOver, "not yet");
        turn(&mut board, &mut listener);
        assert_eq!(said(&mut board, &mut listener), (ClockSource::Crystal, after));
        assert_eq!(warnings_on_opening(&mut board, &mut listener), Vec::<String>::new());
    }
}
