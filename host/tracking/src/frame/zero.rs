//! The frame of a board's poses, whose zero a person may set while the board is followed.

use glam::DVec3;
use schemars::JsonSchema;
use serde::Serialize;
use slitpose_calibration::{inverse, values_of};
use slitpose_model::Pose;

use super::View;
use crate::pipeline::Record;

/// The name of a frame that was set to the pose of a moment.
const ZERO: &str = "zero";

/// The frame of a board's poses, and what became of setting its zero.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct FrameReport {
    /// Its name; `base` is that of the head.
    pub name: String,
    /// The transform from the base frame: translation, m, and rotation vector, rad.
    pub user_from_base: [f64; 6],
    /// The tip in the tool frame, m.
    pub tip_m: [f64; 3],
    /// How many zeros were set or refused.
    pub zeros: u64,
    /// The last of them, in words.
    pub zero: Option<String>,
    /// Whether it was refused.
    pub is_refused: bool,
    /// The file of the frame, as text; empty without a zero.
    pub text: String,
}

/// The mean of the poses of some time, of which a frame is made.
#[derive(Debug, Default)]
struct Mean {
    over_s: f64,
    /// Device time of the first scan, and the tip's pose in the first one with a pose.
    begun_s: Option<f64>,
    first: Option<Pose>,
    count: u64,
    sums: [f64; 6],
    squares: [f64; 6],
}

impl Mean {
    /// Adds the pose of a tip in the base; returns whether that was the last.
    fn add(&mut self, time_s: f64, base_from_tip: Option<Pose>) -> bool {
        let begun_s = *self.begun_s.get_or_insert(time_s);
        if let Some(pose) = base_from_tip {
            let (t, r) = pose.displacement_from(self.first.get_or_insert(pose));
            self.count += 1;
            for (k, value) in t.to_array().into_iter().chain(r.to_array()).enumerate() {
                self.sums[k] += value;
                self.squares[k] += value * value;
            }
        }
        // A board that has restarted begins at zero.
        !(0.0..self.over_s).contains(&(time_s - begun_s))
    }

    /// The mean pose, its standard deviations, and those of a single pose.
    fn pose(&self) -> Option<(Pose, [f64; 6], [f64; 6])> {
        let (first, count) = (self.first?, self.count as f64);
        let mean = self.sums.map(|sum| sum / count);
        let spread: [f64; 6] = std::array::from_fn(|k| {
            ((self.squares[k] / count - mean[k] * mean[k]).max(0.0) * count / (count - 1.0).max(1.0)).sqrt()
        });
        let [t, r] = [0, 3].map(|k| DVec3::from_slice(&mean[k..k + 3]));
        Some((first.perturbed(t, r), spread.map(|spread| spread / count.sqrt()), spread))
    }
}

/// The frame of one board's poses, which a person may change while it is followed.
#[derive(Debug, Default)]
pub(crate) struct Viewer {
    /// That of the start.
    given: Option<&'static View>,
    view: Option<&'static View>,
    mean: Option<Mean>,
    /// What became of its zeros.
    report: FrameReport,
}

impl Viewer {
    pub(crate) fn of(view: Option<&'static View>) -> Self {
        Self { given: view, view, ..Self::default() }
    }

    /// Puts `record` into the present frame.
    pub(crate) fn see(&mut self, record: &mut Record) {
        if self.mean.is_some() {
            self.add(record);
        }
        if let Some(view) = self.view {
            view.see(record);
        }
    }

    /// Makes the mean of the next `over_s` seconds of device time the zero; `None`: the frame is that of the start.
    pub(crate) fn zero(&mut self, over_s: Option<f64>) {
        self.mean = over_s.map(|over_s| Mean { over_s, ..Mean::default() });
        if over_s.is_none() {
            self.view = self.given;
            let (zeros, zero) = (self.report.zeros + 1, Some("the frame is that of the start".to_owned()));
            self.report = FrameReport { zeros, zero, ..FrameReport::default() };
        }
    }

    fn add(&mut self, record: &Record) {
        let tip = |pose: &Pose| self.view.map_or(*pose, |view| view.base_from_tip(pose));
        let base_from_tip = record.solution.estimate.as_ref().map(|estimate| tip(&estimate.pose));
        let Some(mean) = self.mean.take_if(|mean| mean.add(record.device_time_s, base_from_tip)) else { return };
        self.report.zeros += 1;
        self.report.is_refused = mean.count == 0;
        let Some((pose, sigma, spread)) = mean.pose() else {
            let reason = "no zero was set: no scan of that time had a pose; bring the tool into view, and try again";
            self.report.zero = Some(reason.to_owned());
            return;
        };
        let view =
            View { name: ZERO.to_owned(), user_from_base: inverse(&pose), ..self.view.cloned().unwrap_or_default() }
                .kept();
        let six = |values: [f64; 6]| {
            let [x, y, z, rx, ry, rz] = values.map(|value| value * 1e6);
            format!("{x:.3} {y:.3} {z:.3} um, {rx:.2} {ry:.2} {rz:.2} urad")
        };
        let text = format!(
            "zero set to the mean of {} poses within {} s; sigma {}; a single pose {}",
            mean.count,
            mean.over_s,
            six(sigma),
            six(spread)
        );
        self.view = Some(view);
        self.report.text = view.to_text(&text);
        self.report.zero = Some(text);
    }

    pub(crate) fn report(&self) -> FrameReport {
        let view = self.view.cloned().unwrap_or_default();
        FrameReport {
            user_from_base: values_of(&view.user_from_base),
            tip_m: view.tip_m.to_array(),
            name: view.name,
            ..self.report.clone()
        }
    }
}
