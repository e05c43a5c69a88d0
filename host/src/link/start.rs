//! Findings on a board's start, and on the clock that it says it started with.

use slitpose_head::finding::Finding;
use slitpose_protocol::{ClockSource, SettingsSource};

/// What a board's status says of its start: one finding on its clock, one on its settings.
pub(crate) fn start_findings(clock: ClockSource, settings: SettingsSource) -> [Finding; 2] {
    let (oscillator, stored) = ("oscillator", "settings");
    [
        match clock {
            ClockSource::Internal | ClockSource::Crystal => Finding::ok(oscillator, clock.to_string()),
            ClockSource::CrystalFailed => Finding::warning(
                oscillator,
                format!("{clock}: rates and times of the board are right to some per cent only"),
                "reset the board; if it comes again, check the crystal and its solder joints",
            ),
        },
        match settings {
            SettingsSource::Defaults | SettingsSource::Stored => Finding::ok(stored, settings.to_string()),
            SettingsSource::PassedOver => Finding::warning(
                stored,
                settings.to_string(),
                "store them again with `slitpose device set --scene SCENE`, or forget them with `--clear`",
            ),
        },
    ]
}

/// The finding on a board that says crystal and has drifted from the host's clock as none does.
pub(crate) fn contradicted_crystal() -> Finding {
    Finding::warning(
        "board clock",
        "the board says that it runs from a crystal and does not keep time as a crystal does, by this host's clock",
        "unless this host was suspended or NTP corrected its clock meanwhile, check the board's crystal",
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use slitpose_head::finding::Grade;

    #[test]
    fn what_failed_at_the_start_is_a_warning_with_a_next_step() {
        for clock in ClockSource::ALL {
            for settings in SettingsSource::ALL {
                let found = start_findings(clock, settings);
                let failed = [clock == ClockSource::CrystalFailed, settings == SettingsSource::PassedOver];
                for (finding, failed) in found.iter().zip(failed) {
                    let grade = if failed { Grade::Warning } else { Grade::Ok };
                    assert_eq!((finding.grade, finding.next_step.is_some()), (grade, failed), "{finding}");
                }
            }
        }
        let [oscillator, settings] = start_findings(ClockSource::CrystalFailed, SettingsSource::PassedOver);
        assert!(oscillator.text.contains("crystal did not start"), "{oscillator}");
        assert!(settings.to_string().contains("three starts in a row") && settings.to_string().contains("--clear"));
    }
}
