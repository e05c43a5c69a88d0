//! `slitpose calibrate --tip`: where the tip of a tool is.

use std::path::Path;

use slitpose_calibration::{Calibration, Head};
use slitpose_head::table::Output;
use slitpose_tracking::frame::View;
use slitpose_tracking::measurements::Measurements;
use slitpose_tracking::tip;

use super::{CommandError, Outcome, talk};

/// Finds the tip in `readings`, by the calibration at `path`, and writes a file for --tip to `output`.
pub(super) fn run(readings: &str, path: &Path, output: &Path) -> Result<Outcome, CommandError> {
    let calibration = Calibration::open(path)?;
    let file = calibration.scene_file()?;
    let measured = Measurements { pivot: vec![readings.to_owned()], ..Measurements::default() };
    let data = measured.read(&file, &mut |remark| talk(format_args!("{remark}")))?;
    let output = Output::file(output)?;
    let found = tip::find(&Head::calibrated(file, calibration)?, &data)?;
    let [x, y, z] = (found.tip_m * 1e3).to_array();
    let [sx, sy, sz] = std::array::from_fn(|k| found.covariance.col(k)[k].sqrt() * 1e6);
    let text = format!(
        "tip at {x:.4} {y:.4} {z:.4} mm in the tool frame; sigma {sx:.1} {sy:.1} {sz:.1} um; from {} rows, {} left out; {:.1} um \
         rms from the cone",
        found.rows,
        found.left_out,
        found.rms_m * 1e6
    );
    let target = output.target().to_owned();
    output.write_text(&View::with_tip(found.tip_m, found.covariance).to_text(&text))?;
    talk(format_args!("{text}"));
    talk(format_args!("wrote {target}"));
    Ok(Outcome::Done)
}
