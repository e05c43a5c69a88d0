//! What a fault came to, and the table of all of them.

use std::collections::BTreeMap;

use super::{Spans, WRONG_SIGMAS};
use crate::consistency::Sorted;
use crate::studies::Table;

/// Sound poses in a row after which a head has recovered.
const SOUND: usize = 20;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scan {
    pub sequence: u64,
    /// Device time at which its pose came, seconds.
    pub time_s: f64,
    /// Error of the pose in σ of its worst axis; `None` without a pose.
    pub sigmas: Option<f64>,
    /// How far, in σ, the pose says that an error in one cell may have moved it and be as likely as not to pass.
    pub unnoticed_sigmas: f64,
    /// Whether its status says that something is not as usual.
    pub is_flagged: bool,
}

#[derive(Clone, Debug, Default)]
pub struct Trace {
    /// Solved scans in the order in which their poses came.
    pub scans: Vec<Scan>,
    /// When somebody noticed something, seconds of device time, and who: a word for the table.
    pub signs: Vec<(f64, String)>,
    /// Scans that the board took, by the number of the last one: no fault acts at the end.
    pub taken: u64,
    /// Scans that the program counted as missing.
    pub counted_lost: u64,
}

#[derive(Clone, Debug)]
pub struct Report {
    pub fault: String,
    pub injected: usize,
    pub detected: usize,
    /// Who noticed, and how often.
    pub by: BTreeMap<String, usize>,
    /// Scans that neither came nor were counted as missing; below zero: more were counted than are missing.
    pub silently_lost: i64,
    /// Poses that did not come in the order of their numbers.
    pub out_of_order: usize,
    /// Wrong poses whose status says nothing.
    pub unflagged: usize,
    /// Of these, those farther off than twice what the pose says of itself that an error in one cell may do unnoticed.
    pub beyond: usize,
    /// Wrong poses whose status says so.
    pub flagged: usize,
    /// Times from the end of the fault to sound poses, seconds; infinite where there were none.
    pub recovery_s: Sorted,
}

impl Report {
    pub fn of(fault: &str, spans: &Spans, is_instant: bool, trace: &Trace) -> Self {
        let mut by = BTreeMap::new();
        let mut detected = 0;
        let mut recovery_s = Vec::new();
        let is_wrong = |scan: &&Scan| scan.sigmas.is_some_and(|sigmas| sigmas > WRONG_SIGMAS);
        for span in 0..spans.count {
            let (begin_s, end_s) = (spans.begin_s(span), spans.begin_s(span + 1));
            let is_in = |time_s: f64| (begin_s - 1e-6..end_s).contains(&time_s);
            let mut words: Vec<_> =
                trace.signs.iter().filter(|(at, _)| is_in(*at)).map(|(_, sign)| sign.clone()).collect();
            words.sort_unstable();
            words.dedup();
            detected += usize::from(!words.is_empty());
            words.into_iter().for_each(|word| *by.entry(word).or_default() += 1);
            let over_s = if is_instant { begin_s } else { begin_s + spans.for_s };
            recovery_s.push(recovery(&trace.scans, over_s, end_s));
        }
        let missing = trace.taken.saturating_sub(trace.scans.len() as u64);
        let is_back = |pair: &&[Scan]| pair[1].sequence <= pair[0].sequence;
        Self {
            fault: fault.to_owned(),
            injected: spans.count,
            detected,
            by,
            silently_lost: missing as i64 - trace.counted_lost as i64,
            out_of_order: trace.scans.windows(2).filter(is_back).count(),
            unflagged: trace.scans.iter().filter(is_wrong).filter(|scan| !scan.is_flagged).count(),
            beyond: trace.scans.iter().filter(|scan| !scan.is_flagged && is_beyond(scan)).count(),
            flagged: trace.scans.iter().filter(is_wrong).filter(|scan| scan.is_flagged).count(),
            recovery_s: Sorted::of(recovery_s),
        }
    }
}

/// Whether a pose is wrong, and by more than twice the error of one cell that is as likely as not to pass the gate of χ²:
/// at twice its size an error passes once in a million.
fn is_beyond(scan: &Scan) -> bool {
    scan.sigmas.is_some_and(|sigmas| sigmas > WRONG_SIGMAS.max(2.0 * scan.unnoticed_sigmas))
}

/// Time from `over_s` to the first of [`SOUND`] sound poses without a gap; infinite if none come before `until_s`.
fn recovery(scans: &[Scan], over_s: f64, until_s: f64) -> f64 {
    let after: Vec<&Scan> = scans.iter().filter(|scan| (over_s..until_s).contains(&scan.time_s)).collect();
    let is_sound = |scan: &Scan| !scan.is_flagged && scan.sigmas.is_some_and(|sigmas| sigmas <= WRONG_SIGMAS);
    let is_run = |run: &&[&Scan]| {
        run.iter().all(|scan| is_sound(scan)) && run[run.len() - 1].sequence - run[0].sequence == run.len() as u64 - 1
    };
    after.windows(SOUND).find(is_run).map_or(f64::INFINITY, |run| run[0].time_s - over_s)
}

pub fn table(reports: &[Report]) -> Table {
    let header = [
        "fault",
        "injected",
        "detected",
        "silently lost",
        "wrong unflagged",
        "beyond said",
        "wrong flagged",
        "recovery ms",
        "max ms",
        "noticed by",
    ];
    let mut table = Table::new(&header);
    for report in reports {
        let by: Vec<_> = report.by.iter().map(|(word, times)| format!("{word} {times}")).collect();
        let numbers = [
            report.injected.to_string(),
            report.detected.to_string(),
            report.silently_lost.to_string(),
            report.unflagged.to_string(),
            report.beyond.to_string(),
            report.flagged.to_string(),
        ];
        let times = [report.recovery_s.at(0.5), report.recovery_s.most()];
        let times = times.map(|time_s| format!("{:.1}", time_s * 1e3));
        table.row([report.fault.clone()].into_iter().chain(numbers).chain(times).chain([by.join(", ")]));
    }
    table
}
