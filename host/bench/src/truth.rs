//! What a head is, and where it was, as a text for those who judge.

use std::fmt::Write;

use slitpose_calibration::Parameter;
use slitpose_model::Pose;

use crate::beyond::Beyond;
use crate::drawn::DrawnHead;
use crate::session::Session;

/// The truth as TOML: parameters in the shape of calibration files, SI units, transforms as translation and rotation
/// vector.
pub(crate) fn text(head: &DrawnHead, session: &Session) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_text(&mut out, head, session);
    out
}

fn write_text(out: &mut String, head: &DrawnHead, session: &Session) -> std::fmt::Result {
    let settings = &session.settings;
    writeln!(out, "# What a virtual bench simulated. SI units; transforms are translation and rotation vector.")?;
    writeln!(out, "seed = {}\nscene_hash = \"{:016x}\"", settings.seed, head.nominal.hash)?;
    let [sigma_m, sigma_rad] = settings.instrument;
    writeln!(out, "\n[instrument]\nsigma_m = {sigma_m:e}\nsigma_rad = {sigma_rad:e}")?;
    writeln!(out, "base_from_reference = {:?}", values(&session.base_from_reference))?;
    writeln!(out, "tool_from_marker = {:?}", values(&session.tool_from_marker))?;
    let [ahead_s, faster] = session.clock;
    writeln!(out, "clock_ahead_s = {ahead_s:.9}\nclock_faster = {faster:e}")?;
    writeln!(out, "\n[pivot]\nin_tool_m = {:?}", session.pivot.in_tool_m.to_array())?;
    writeln!(out, "in_base_m = {:?}", session.pivot.in_base_m.to_array())?;
    writeln!(out, "\n[stage]\nstart = {:?}", values(&session.stage_start))?;
    writeln!(out, "direction = {:?}", session.stage_direction.to_array())?;
    writeln!(out, "\n[rest]\npose = {:?}", values(&session.rest))?;
    writeln!(out, "\n# Parameters: name, deviation from the scene, most probable one, its sigma, unit.")?;
    for number in 0..head.nominal.scene.cells.len() {
        writeln!(out, "[[cell]]")?;
        if let Some(beyond) = head.beyond.get(number) {
            write_beyond(out, beyond)?;
        }
        write_parameters(out, head, Some(number))?;
    }
    writeln!(out, "[converter]")?;
    write_parameters(out, head, None)
}

fn write_parameters(out: &mut String, head: &DrawnHead, cell: Option<usize>) -> std::fmt::Result {
    writeln!(out, "parameters = [")?;
    for entry in head.parameters.iter().filter(|entry| entry.cell == cell) {
        let Parameter { quantity, prior, prior_sigma, value, .. } = entry;
        writeln!(out, "[\"{quantity}\", {value:e}, {prior:e}, {prior_sigma:e}, \"{}\"],", quantity.unit())?;
    }
    writeln!(out, "]\n")
}

fn write_beyond(out: &mut String, beyond: &Beyond) -> std::fmt::Result {
    let Beyond { ripple_m, ripple_period_m, ripple_phase_rad, chip, slit_step_m, stray_a_per_rad } = beyond;
    writeln!(out, "ripple_m = {ripple_m:e}\nripple_period_m = {ripple_period_m:e}")?;
    writeln!(out, "ripple_phase_rad = {ripple_phase_rad:e}\nchip = {chip:?}\nslit_step_m = {slit_step_m:e}")?;
    writeln!(out, "stray_a_per_rad = {stray_a_per_rad:?}")
}

fn values(pose: &Pose) -> [f64; 6] {
    let (t, r) = (pose.translation_m, pose.rotation_rad());
    [t.x, t.y, t.z, r.x, r.y, r.z]
}
