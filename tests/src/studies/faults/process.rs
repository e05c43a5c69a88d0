//! One fault on a daemon that loses its board by it.

use std::collections::BTreeSet;

use slitpose_head::faults::Kind;

use super::{Scan, Spans, Trace};
use crate::consistency::worst_axis;
use crate::ndjson;
use crate::process::Slitpose;

/// Longest silence in which nothing happened, seconds: three frames of the default scene.
const SILENCE_S: f64 = 0.75e-3;

/// What `slitpose run` makes of a fault of `kind`, and its exit code.
pub(super) fn run(slitpose: Slitpose, kind: &Kind, spans: &Spans, seed: u64) -> (Trace, i32) {
    let spec = format!("{},seed={seed}", spans.spec(kind));
    let duration = format!("{}s", spans.duration_s());
    // A busy machine may find the board late: the patience is not what is judged.
    let words =
        ["run", "--device", "sim", "--speed", "max", "--tier", "paper", "--format", "ndjson", "--patience", "60s"];
    let words = words.into_iter().chain(["--duration", &duration, "--fault", &spec]);
    let finished = slitpose.run(words);
    let text = String::from_utf8(finished.stdout).expect("UTF-8");
    let poses: String =
        text.lines().filter(|line| !line.contains("\"kind\":")).map(|line| format!("{line}\n")).collect();
    let mut trace = Trace { counted_lost: told(&finished.stderr, " scans missing"), ..Trace::default() };
    let reconnects = told(&finished.stderr, " times;");
    let (mut earlier_s, mut before) = (0.0, None::<(u64, f64)>);
    let mut missing = 0;
    for line in ndjson::parse(&poses) {
        if let Some((sequence, time_s)) = before {
            let last_s = earlier_s + time_s;
            if line.sequence < sequence {
                // Its clock has begun anew, too.
                earlier_s = last_s;
                trace.signs.push((last_s, "restart".to_owned()));
            } else {
                missing += line.sequence - sequence - 1;
            }
            if earlier_s + line.device_time_s - last_s > SILENCE_S {
                let sign = if reconnects >= spans.count as u64 { "reconnect" } else { "gap" };
                trace.signs.push((last_s, sign.to_owned()));
                trace.silences_s.push(earlier_s + line.device_time_s - last_s);
            }
        }
        before = Some((line.sequence, line.device_time_s));
        let is_flagged = line.status != "converged";
        let sigmas = line.error().map(|(error, covariance)| worst_axis(&error, &covariance));
        let time_s = earlier_s + line.device_time_s;
        trace.scans.push(Scan { sequence: line.sequence, time_s, sigmas, unnoticed_sigmas: 0.0, is_flagged });
    }
    // What is missing within a numbering must have been counted.
    trace.taken = trace.scans.iter().map(|scan| scan.sequence).collect::<BTreeSet<_>>().len() as u64 + missing;
    trace.is_renumbered = trace.signs.iter().any(|(_, sign)| sign == "restart");
    trace.missing = Some(missing);
    (trace, finished.code)
}

/// The number ahead of `words` in what the program says.
fn told(stderr: &str, words: &str) -> u64 {
    let before = stderr.lines().find_map(|line| line.split_once(words)).map_or("", |(before, _)| before);
    before.rsplit([' ', ':']).next().and_then(|number| number.parse().ok()).unwrap_or(0)
}
