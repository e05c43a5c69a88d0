//! What a board says of its start: its clock, its settings, and warnings where either failed.

use slitpose_firmware::{Board, Identity, Link};
use slitpose_protocol::{ClockSource, Command, Hashes, SettingsSource, Severity};

use crate::common::{Bench, Fake, Heard, configuration, identity};

/// A board that has just started, its link closed.
fn started(clock: ClockSource, settings: SettingsSource) -> Bench {
    let identity = Identity { clock, settings, ..identity() };
    Bench::of(Board::new(Fake::default(), identity, configuration(), [0; 2_048]).expect("the configuration is valid"))
}

/// What a status says of the start.
fn said(bench: &mut Bench) -> (ClockSource, SettingsSource) {
    let status = bench.status();
    (status.clock, status.settings)
}

/// The warnings that a host hears when it opens the link; the hello comes first.
fn warnings_on_opening(bench: &mut Bench) -> Vec<String> {
    bench.board.poll(Link::Closed);
    let heard = bench.turn();
    assert!(matches!(heard[0], Heard::Hello { .. }), "{heard:?}");
    let text = |heard: &Heard| match heard {
        Heard::Event { severity: Severity::Warning, text } => text.clone(),
        other => panic!("no warning: {other:?}"),
    };
    heard[1..].iter().map(text).collect()
}

#[test]
fn every_status_names_clock_and_settings_and_every_host_is_warned_once_of_each_failure() {
    const CRYSTAL: &str = "the crystal did not start: running from the internal oscillator";
    const SETTINGS: &str =
        "three starts in a row failed: stored settings were passed over; store them again, or forget them";
    for clock in ClockSource::ALL {
        for settings in SettingsSource::ALL {
            let mut bench = started(clock, settings);
            let crystal = (clock == ClockSource::CrystalFailed).then_some(CRYSTAL);
            let passed_over = (settings == SettingsSource::PassedOver).then_some(SETTINGS);
            let expected = crystal.into_iter().chain(passed_over).collect::<Vec<_>>();
            for _ in 0..2 {
                assert_eq!(warnings_on_opening(&mut bench), expected);
                assert_eq!(bench.turn(), [], "once");
            }
            assert_eq!(said(&mut bench), (clock, settings));
        }
    }
}

#[test]
fn settings_follow_a_store_and_a_forget_and_the_warning_ends() {
    for (command, after) in
        [(Command::Store(Hashes::default()), SettingsSource::Stored), (Command::Forget, SettingsSource::Defaults)]
    {
        let mut bench = started(ClockSource::Crystal, SettingsSource::PassedOver);
        assert_eq!(warnings_on_opening(&mut bench).len(), 1);
        // Flash memory that does not take it leaves the next start as it is.
        bench.hardware().refuse_store = true;
        bench.ask(1, command.clone());
        assert_eq!(said(&mut bench), (ClockSource::Crystal, SettingsSource::PassedOver));

        bench.hardware().storing_polls = 2;
        bench.ask(2, command);
        assert_eq!(said(&mut bench).1, SettingsSource::PassedOver, "not yet");
        bench.turn();
        assert_eq!(said(&mut bench), (ClockSource::Crystal, after));
        assert_eq!(warnings_on_opening(&mut bench), Vec::<String>::new());
    }
}
