//! What the schedule does.

use super::micro;
use crate::map::{Candidate, Schedules};
use crate::report::section::{Section, Table, Value, column};

/// Slots as a scene file has them.
fn slots(candidate: &Candidate) -> String {
    format!("{:?}", candidate.slots)
}

pub(super) fn section(schedules: &Schedules) -> Section {
    let row = |candidate: &Candidate| {
        let by = candidate.per_root_hz();
        vec![
            candidate.frame_rate_hz.into(),
            (candidate.frame_rate_hz / 2.0).into(),
            slots(candidate).into(),
            Value::from(candidate.oversampling as usize),
            (100.0 * candidate.busy).into(),
            micro(candidate.sigma_m),
            Value::from(candidate.sigma_rad * 1e3),
            micro(candidate.sigma_m * by),
            Value::from(candidate.sigma_rad * 1e3 * by),
        ]
    };
    let table = |name, caption: &str, candidates: &[Candidate]| Table {
        name,
        caption: caption.to_owned(),
        columns: vec![
            column("frame_rate_hz", "frames/s"),
            column("bandwidth_hz", "bandwidth / Hz"),
            column("slots", "slots"),
            column("oversampling", "oversampling"),
            column("busy_percent", "busy / %"),
            column("sigma_position_um", "σ / µm"),
            column("sigma_rotation_mrad", "σ / mrad"),
            column("position_um_per_root_hz", "µm/√Hz"),
            column("rotation_mrad_per_root_hz", "mrad/√Hz"),
        ],
        rows: candidates.iter().map(row).collect(),
    };
    let summary = schedules.at_rate.first().map(|best| {
        format!(
            "Best at {} frames/s: `lighting.slots = {}` and `front_end.oversampling = {}`, {:.2} µm and {:.3} mrad in the \
             median of the workspace.",
            best.frame_rate_hz,
            slots(best),
            best.oversampling,
            best.sigma_m * 1e6,
            best.sigma_rad * 1e3
        )
    });
    Section {
        name: "schedules",
        title: "What the schedule does",
        summary: summary.into_iter().collect(),
        paragraphs: vec![
            "Emitters are lit as the scene says, one by one, or as many together as do not shine on each other's detectors; \
             words are sums of as many conversions as the board adds up; settling and conversion are those of `[front_end]`. \
             Only schedules that fit the frame are listed. σ is that of a single frame, three axes together, the median of the \
             workspace; frames follow motion up to half their rate."
                .to_owned(),
        ],
        pictures: Vec::new(),
        tables: vec![
            table("schedules", "Schedules at the wanted rate, the best first", &schedules.at_rate),
            table("rates", "The best at each rate", &schedules.best_by_rate),
        ],
    }
}
