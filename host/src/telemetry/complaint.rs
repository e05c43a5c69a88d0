//! Whether all is well, and if not, what is not.

use super::report::{BoardReport, DaemonReport, LagReport, LinkLosses, LinkState, RecorderState};
use crate::clock::HostInstant;

/// Reports are made several times a second: one so old comes from a daemon that is stuck.
const STALE_S: f64 = 3.0;

/// A board that runs and sends no scan for so long is stuck, whatever else it sends.
const NO_SCAN_S: f64 = 3.0;

/// What a system that runs something else for a while can do to a solver that keeps up is over sooner.
const BEHIND_S: f64 = 1.0;

/// Poses that are older when they are sent are of no use to a control loop.
const OLD_S: f64 = 0.25;

impl LagReport {
    /// Why poses are late or left out, if they are.
    pub fn complaint(&self) -> Option<String> {
        let Self { behind_s, is_output_blocked, waiting_scans, waiting_s, skipped_scans, .. } = self;
        if *is_output_blocked && *waiting_s > BEHIND_S {
            return Some(format!(
                "standard output is read too slowly: {waiting_scans} scans wait to be printed, the oldest for \
                 {waiting_s:.1} s; read it faster, or use --format none"
            ));
        }
        (*behind_s >= BEHIND_S).then(|| {
            format!(
                "behind: scans come faster than they are solved, and control loops get the newest only; \
                 {waiting_scans} wait, {skipped_scans} were skipped so far: look at the cells with `slitpose doctor`, \
                 or use --tier paper, or lower the frame rate"
            )
        })
    }
}

/// Packets that arrive damaged within a second, from which on it is no chance: a good link damages none in a day.
const DAMAGED_FROM: u64 = 3;

impl DaemonReport {
    /// Everything that keeps good poses from coming, a sentence each. None: all is well.
    pub fn complaints(&self, now: HostInstant) -> Vec<String> {
        let mut complaints = Vec::new();
        if self.boards.is_empty() {
            complaints.push("there is no board: plug one in".to_owned());
        }
        for board in &self.boards {
            let name = &board.name;
            complaints.extend(board.complaints(now).into_iter().map(|complaint| format!("{name}: {complaint}")));
        }
        if self.recorder.state == RecorderState::Failed {
            let reason = self.recorder.reason.as_deref().unwrap_or("it gives no reason");
            complaints.push(format!("the recorder has failed: {reason}"));
        }
        complaints
    }
}

impl BoardReport {
    fn complaints(&self, now: HostInstant) -> Vec<String> {
        let age_s = self.age_s(now);
        if self.link.state == LinkState::Ended && self.link.reason.is_none() {
            return Vec::new();
        }
        if self.link.state != LinkState::Ended && age_s > STALE_S {
            return vec![format!("nothing is known for {age_s:.0} s: the program is stuck, start it again")];
        }
        if self.link.state != LinkState::Running {
            let state = self.link.state.as_str();
            let reason = self.link.reason.as_deref().unwrap_or("no scan has come yet; wait some seconds");
            let tried = match self.link.attempts {
                0 | 1 => String::new(),
                attempts => format!(" (tried {attempts} times)"),
            };
            return vec![format!("{state}: {reason}{tried}")];
        }
        let mut complaints = Vec::new();
        if let Some(scan_age_s) = self.last_scan_age_s.map(|before_s| before_s + age_s)
            && scan_age_s > NO_SCAN_S
        {
            complaints.push(format!("no scan for {scan_age_s:.0} s: reset the board"));
        }
        complaints.extend(self.lag.complaint());
        let age_s = self.latencies.total.recent.p50_s;
        if age_s > OLD_S {
            complaints.push(format!(
                "poses are {age_s:.1} s old when they are sent: the link to the board, or this machine, is too slow"
            ));
        }
        let (poses, scans) = (self.recent_outcomes.poses(), self.recent_outcomes.all());
        if 2 * poses < scans {
            complaints.push(format!(
                "only {poses} of the last {scans} scans gave a pose: bring the tool home, and check that the scene is \
                 this head's"
            ));
        }
        let LinkLosses { unreadable, .. } = self.recent_link_losses;
        if unreadable > 0 {
            complaints.push(format!(
                "{unreadable} packets of late cannot be read: build firmware and program from the same source, and let \
                 nothing else speak to the board"
            ));
        }
        let damaged = self.recent_link_losses.damaged();
        if damaged >= DAMAGED_FROM {
            complaints.push(format!("{damaged} packets of late came damaged: check cable, hub and port of the board"));
        }
        complaints.extend(self.head.iter().flat_map(|head| &head.findings).map(|finding| finding.text.clone()));
        complaints
    }
}

#[cfg(test)]
mod tests {
    use super::super::report::{LinkReport, RecorderReport};
    use super::*;
    use crate::pipeline::Outcomes;

    const NOW: HostInstant = HostInstant { monotonic_ns: 100_000_000_000, utc_ns: 0 };

    fn complaints(board: BoardReport) -> Vec<String> {
        DaemonReport::of_now(NOW, vec![board], RecorderReport::default()).complaints(NOW)
    }

    fn running() -> BoardReport {
        BoardReport {
            name: "port".to_owned(),
            made_monotonic_ns: NOW.monotonic_ns - 200_000_000,
            link: LinkReport { state: LinkState::Running, ..LinkReport::default() },
            last_scan_age_s: Some(0.1),
            recent_outcomes: Outcomes { converged: 4000, ..Outcomes::default() },
            ..BoardReport::default()
        }
    }

    #[test]
    fn a_stream_that_is_stuck_does_not_look_well() {
        assert_eq!(complaints(running()), Vec::<String>::new());
        let told = |board: BoardReport, word: &str| {
            let complaints = complaints(board);
            assert!(complaints.len() == 1 && complaints[0].contains(word), "{complaints:?}");
        };
        // The program no longer makes reports; the board sends no scans; there is no board.
        told(BoardReport { made_monotonic_ns: NOW.monotonic_ns - 4_000_000_000, ..running() }, "stuck");
        told(BoardReport { last_scan_age_s: Some(2.9), ..running() }, "no scan");
        told(BoardReport { link: LinkReport::default(), ..running() }, "searching");
        // The solver does not keep up, or nobody reads what is printed; scans come.
        let lag = LagReport { is_behind: true, behind_s: 1.2, waiting_scans: 77, ..LagReport::default() };
        told(BoardReport { lag, ..running() }, "behind: scans come faster than they are solved");
        assert_eq!(complaints(BoardReport { lag: LagReport { behind_s: 0.8, ..lag }, ..running() }).len(), 0);
        let lag = LagReport { is_output_blocked: true, waiting_s: 1.5, ..lag };
        told(BoardReport { lag, ..running() }, "standard output is read too slowly: 77 scans wait");
        let mut late = running();
        late.latencies.total.recent.p50_s = 0.3;
        told(late, "poses are 0.3 s old");
        // Scans, and no poses.
        let recent_outcomes = Outcomes { converged: 1, too_dark: 2, ..Outcomes::default() };
        told(BoardReport { recent_outcomes, ..running() }, "only 1 of the last 3");
        // Packets that mean nothing, and packets that arrive damaged; one of those may be chance.
        let lossy = |recent_link_losses| BoardReport { recent_link_losses, ..running() };
        told(lossy(LinkLosses { unreadable: 1, ..LinkLosses::default() }), "1 packets of late cannot be read");
        told(lossy(LinkLosses { bad_checksum: 2, misframed: 1, ..LinkLosses::default() }), "3 packets of late");
        assert_eq!(complaints(lossy(LinkLosses { overlong: 2, ..LinkLosses::default() })), Vec::<String>::new());
        // A board that answers and sends no scan, tried again and again.
        let link = LinkReport { state: LinkState::Connecting, attempts: 7, ..LinkReport::default() };
        told(BoardReport { link, ..running() }, "connecting: no scan has come yet; wait some seconds (tried 7 times)");
    }
}
