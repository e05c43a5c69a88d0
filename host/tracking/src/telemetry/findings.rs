//! The findings that explain missing or bad poses.

use super::report::{
    BoardEvent, BoardReport, DaemonReport, LagReport, LinkLosses, LinkState, RecorderState, SlowClient,
};
use crate::clock::HostInstant;
use crate::pipeline::Agreement;
use slitpose_head::finding::{Finding, Grade};

/// A report this old shows that the daemon hangs: reports are made several times per second.
const STALE_S: f64 = 3.0;

/// A running board without a scan for this long is stuck, even if it sends other messages.
const NO_SCAN_S: f64 = 3.0;

/// A solver that is behind for this long does not keep up: pauses caused by the system are shorter.
const BEHIND_S: f64 = 1.0;

/// Poses that are older than this when sent are useless to a control loop.
const OLD_S: f64 = 0.25;

/// Poses that a board finds differ by a few hundredths of σ from those found here, as its numbers are shorter.
const APART_SIGMAS: f64 = 0.3;

/// Damaged packets per second from which on the link is faulty: a good link damages none in a day.
const DAMAGED_FROM: u64 = 3;

impl LagReport {
    /// The reason why poses are late or left out, if any.
    pub fn finding(&self) -> Option<Finding> {
        let Self { behind_s, is_output_blocked, waiting_scans, waiting_s, skipped_scans, .. } = self;
        if *is_output_blocked && *waiting_s > BEHIND_S {
            let text =
                format!("read too slowly: {waiting_scans} scans wait to be printed, the oldest for {waiting_s:.1} s");
            return Some(Finding::failed("standard output", text, "read it faster, or use --format none"));
        }
        (*behind_s >= BEHIND_S).then(|| {
            let text = format!(
                "behind: scans come faster than they are solved, and control loops get the newest only; \
                 {waiting_scans} wait, {skipped_scans} were skipped so far"
            );
            let next_step = "look at the cells with `slitpose doctor`, or use --tier paper, or lower the frame rate";
            Finding::failed("solver", text, next_step)
        })
    }
}

impl BoardEvent {
    /// The finding that the board reported.
    pub fn finding(&self) -> Finding {
        let grade = if self.is_error { Grade::Failed } else { Grade::Warning };
        let place = self.device_time_s.map_or("board".into(), |time_s| format!("board at {time_s:.3} s").into());
        Finding { place, ..Finding::new(grade, "", &*self.text) }
    }
}

impl DaemonReport {
    /// All reasons for missing or bad poses; empty if there are none.
    pub fn findings(&self, now: HostInstant) -> Vec<Finding> {
        self.gather(|board| {
            let (stream, is_running) = board.findings(now);
            let heads = board.head.iter().filter(|_| is_running).flat_map(|head| &head.findings);
            stream.into_iter().chain(heads.map(|diagnosis| diagnosis.finding.clone())).collect()
        })
    }

    /// As [`findings`](Self::findings), without the findings on heads.
    pub fn findings_beside_heads(&self, now: HostInstant) -> Vec<Finding> {
        self.gather(|board| board.findings(now).0)
    }

    fn gather(&self, of_board: impl Fn(&BoardReport) -> Vec<Finding>) -> Vec<Finding> {
        let mut findings = Vec::new();
        if self.boards.is_empty() {
            findings.push(Finding::failed("link", "there is no board", "plug one in"));
        }
        for board in &self.boards {
            findings.extend(of_board(board).into_iter().map(|finding| finding.within(&board.name)));
        }
        for client in self.datagrams.iter().flat_map(|datagrams| &datagrams.slow_clients) {
            findings.push(of_client(client));
        }
        if self.recorder.state == RecorderState::Failed {
            let reason = self.recorder.reason.as_deref().unwrap_or("it gives no reason");
            findings.push(Finding::new(Grade::Failed, "recorder", format!("failed: {reason}")));
        }
        findings
    }
}

fn of_client(client: &SlowClient) -> Finding {
    let SlowClient { process, user, missed, missing_s } = client;
    let process = process.map_or("a client".to_owned(), |process| format!("process {process}"));
    let user = user.map_or(String::new(), |user| format!(" of user {user}"));
    let text = format!("{process}{user} has missed poses for {missing_s:.1} s, {missed} so far");
    Finding::failed("control loops", text, "let it read faster, or end it")
}

impl BoardReport {
    /// The faults of the board's stream, and whether the board runs.
    fn findings(&self, now: HostInstant) -> (Vec<Finding>, bool) {
        let age_s = self.age_s(now);
        if self.link.state == LinkState::Ended && self.link.reason.is_none() {
            return (Vec::new(), false);
        }
        if self.link.state != LinkState::Ended && age_s > STALE_S {
            let text = format!("nothing is known for {age_s:.0} s: the program is stuck");
            return (vec![Finding::failed("daemon", text, "start it again")], false);
        }
        if self.link.state != LinkState::Running {
            let state = self.link.state;
            let tried = match self.link.attempts {
                0 | 1 => String::new(),
                attempts => format!(" (tried {attempts} times)"),
            };
            let finding = match &self.link.reason {
                Some(reason) => Finding::new(Grade::Failed, "link", format!("{state}: {reason}{tried}")),
                None => Finding::failed("link", format!("{state}: no scan has come yet{tried}"), "wait some seconds"),
            };
            return (vec![finding], false);
        }
        let mut findings = Vec::new();
        if let Some(scan_age_s) = self.last_scan_age_s.map(|before_s| before_s + age_s)
            && scan_age_s > NO_SCAN_S
        {
            findings.push(Finding::failed("link", format!("no scan for {scan_age_s:.0} s"), "reset the board"));
        }
        findings.extend(self.lag.finding());
        // Of poses whose instant is unknown only the time on the host is known.
        let age_s = self.latencies.total.recent.p50_s.max(self.latencies.host.recent.p50_s);
        if age_s > OLD_S {
            let text = format!("{age_s:.1} s old when they are sent");
            let next_step = "see from the latencies in `slitpose status` whether the link or this machine is too slow";
            findings.push(Finding::failed("poses", text, next_step));
        }
        let (poses, scans) = (self.recent_outcomes.poses(), self.recent_outcomes.all());
        if 2 * poses < scans {
            let text = format!("only {poses} of the last {scans} scans gave a pose");
            let next_step = "bring the tool home, and check that the scene is this head's";
            findings.push(Finding::failed("poses", text, next_step));
        }
        if self.board_poses.is_some_and(|poses| poses.is_unchecked) {
            let text = "the board sends no scans by which its own poses can be checked";
            findings.push(Finding::failed("poses", text, "reset the board, or use --stream raw"));
        }
        if let Some(Agreement { recent_rms_sigmas, .. }) = self.board_poses
            && recent_rms_sigmas > APART_SIGMAS
        {
            let text =
                format!("the board's own differ from those found here by {recent_rms_sigmas:.2} standard deviations");
            let next_step = "build firmware and program from the same source, and use --stream raw until then; in frames of a millisecond fast motions do that, too";
            findings.push(Finding::failed("poses", text, next_step));
        }
        let LinkLosses { unreadable, poses_refused, .. } = self.recent_link_losses;
        if poses_refused > 0 {
            let text =
                format!("{poses_refused} of the board's own in the last second cannot be right, and are left out");
            let next_step = "build firmware and program from the same source, and use --stream raw until then";
            findings.push(Finding::failed("poses", text, next_step));
        }
        if unreadable > 0 {
            let text = format!("{unreadable} packets of the last second cannot be read");
            let next_step = "build firmware and program from the same source, and let nothing else speak to the board";
            findings.push(Finding::failed("link", text, next_step));
        }
        let damaged = self.recent_link_losses.damaged();
        if damaged >= DAMAGED_FROM {
            let text = format!("{damaged} packets of the last second came damaged");
            findings.push(Finding::failed("link", text, "check cable, hub and port of the board"));
        }
        (findings, true)
    }
}

#[cfg(test)]
mod tests {
    use super::super::report::{DatagramCounts, LinkReport, RecorderReport};
    use super::*;
    use crate::pipeline::Outcomes;

    const NOW: HostInstant = HostInstant { monotonic_ns: 100_000_000_000, utc_ns: 0 };

    fn findings(board: BoardReport) -> Vec<String> {
        let report = DaemonReport::of(NOW, NOW, vec![board], RecorderReport::default());
        report.findings(NOW).iter().map(Finding::to_string).collect()
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

    /// Asserts that a board that runs well, but for what `change` does, has one finding with these words, or none.
    fn assert_found(words: &str, change: impl FnOnce(&mut BoardReport)) {
        let mut board = running();
        change(&mut board);
        let found = findings(board);
        let is_it = if words.is_empty() { found.is_empty() } else { found.len() == 1 && found[0].contains(words) };
        assert!(is_it, "{words}: {found:?}");
    }

    #[test]
    fn a_stuck_stream_is_reported() {
        assert_found("", |_| ());
        // The program no longer makes reports; the board sends no scans; there is no board.
        assert_found("stuck", |it| it.made_monotonic_ns = NOW.monotonic_ns - 4_000_000_000);
        assert_found("no scan", |it| it.last_scan_age_s = Some(2.9));
        assert_found("searching", |it| it.link = LinkReport::default());
        // A board that answers but sends no scan, after several attempts.
        let link = LinkReport { state: LinkState::Connecting, attempts: 7, ..LinkReport::default() };
        assert_found("connecting: no scan has come yet (tried 7 times); wait some seconds", |it| it.link = link);
        // Scans come, but the solver does not keep up, or the printed poses are not read.
        let lag = LagReport { is_behind: true, behind_s: 1.2, waiting_scans: 77, ..LagReport::default() };
        assert_found("behind: scans come faster than they are solved", |it| it.lag = lag);
        assert_found("", |it| it.lag = LagReport { behind_s: 0.8, ..lag });
        let blocked = LagReport { is_output_blocked: true, waiting_s: 1.5, ..lag };
        assert_found("standard output: read too slowly: 77 scans wait", |it| it.lag = blocked);
        assert_found("poses: 0.3 s old", |it| it.latencies.total.recent.p50_s = 0.3);
        // Of poses without a known instant, the time on the host is known.
        assert_found("poses: 0.5 s old", |it| it.latencies.host.recent.p50_s = 0.5);
        let dark = Outcomes { converged: 1, too_dark: 2, ..Outcomes::default() };
        assert_found("only 1 of the last 3", |it| it.recent_outcomes = dark);
        // Unreadable packets, and damaged ones, of which one may be chance.
        assert_found("1 packets of the last second cannot be read", |it| it.recent_link_losses.unreadable = 1);
        let damaged = LinkLosses { bad_checksum: 2, misframed: 1, ..LinkLosses::default() };
        assert_found("3 packets of the last second came damaged", |it| it.recent_link_losses = damaged);
        assert_found("", |it| it.recent_link_losses.overlong = 2);
        assert_found("5 of the board's own in the last second", |it| it.recent_link_losses.poses_refused = 5);
        let unchecked = Agreement { is_unchecked: true, ..Agreement::default() };
        assert_found("no scans by which its own poses can be checked", |it| it.board_poses = Some(unchecked));
        let apart = Agreement { recent_rms_sigmas: 0.4, ..Agreement::default() };
        assert_found("differ from those found here by 0.40", |it| it.board_poses = Some(apart));
    }

    #[test]
    fn a_client_that_misses_poses_is_reported() {
        let slow = SlowClient { process: Some(42), user: Some(7), missed: 900, missing_s: 1.5 };
        let nameless = SlowClient { process: None, user: None, ..slow };
        let datagrams = DatagramCounts { slow_clients: vec![slow, nameless], ..DatagramCounts::default() };
        let report = DaemonReport::of(NOW, NOW, vec![running()], RecorderReport::default());
        let report = DaemonReport { datagrams: Some(datagrams), ..report };
        let findings: Vec<String> = report.findings(NOW).iter().map(Finding::to_string).collect();
        assert_eq!(findings.len(), 2, "{findings:?}");
        assert!(
            findings[0].contains("process 42 of user 7 has missed poses for 1.5 s, 900 so far; let it read faster")
        );
        assert!(findings[1].contains("a client has missed"), "{findings:?}");
    }
}
