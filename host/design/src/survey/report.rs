//! The survey as a text for people.

use std::fmt::{self, Write};

use super::{End, Survey, Travel, rounded};
use slitpose_head::foreign::printable;

pub(super) fn write(survey: &Survey) -> String {
    let mut text = String::new();
    let sections = [head, home, coverage, travel, lighting, warnings];
    for section in sections {
        // Writing to a String cannot fail.
        let _ = section(survey, &mut text);
    }
    text
}

fn head(survey: &Survey, text: &mut String) -> fmt::Result {
    writeln!(text, "{}: {} (hash {})", printable(&survey.origin), survey.name, survey.hash)?;
    writeln!(text, "workspace {}", survey.workspace)
}

fn home(survey: &Survey, text: &mut String) -> fmt::Result {
    writeln!(text, "\nAt home")?;
    writeln!(text, "  cell  status   d_A/mm  d_B/mm  X_A/mm    γ/°  Ω/msr  I_O/µA  flags")?;
    for cell in &survey.home {
        writeln!(
            text,
            "  {:>4}  {:<7} {:>7.3} {:>7.3} {:>7} {:>6} {:>6.3} {:>7.4}  {}",
            cell.cell,
            cell.status,
            cell.emitter_distance_m * 1e3,
            cell.slit_distance_m * 1e3,
            optional(cell.x_a_m.map(|x_a| x_a * 1e3), 3),
            optional(cell.gamma_rad.map(f64::to_degrees), 1),
            cell.solid_angle_sr * 1e3,
            cell.i_o_a * 1e6,
            cell.flags
        )?;
    }
    let reading = survey.noise.reading();
    let Some(sigma) = survey.sigma_at_home else { return writeln!(text, "  {reading} gives no pose") };
    let [x, y, z, rx, ry, rz] = sigma.map(|sigma| sigma * 1e6);
    writeln!(
        text,
        "  {reading} gives the pose within ({x:.3}, {y:.3}, {z:.3}) µm, ({rx:.1}, {ry:.1}, {rz:.1}) µrad (1 σ)"
    )
}

fn coverage(survey: &Survey, text: &mut String) -> fmt::Result {
    let coverage = &survey.coverage;
    writeln!(text, "\nOver the workspace ({} poses)", coverage.samples)?;
    writeln!(
        text,
        "  cell   lit/%  clipped/%  dark/%  behind/%  faint/%  saturated/%  overscale/%     I_O/µA     electrode/µA"
    )?;
    for cell in &coverage.cells {
        let percent = |share: f64| 100.0 * share;
        let range =
            cell.i_o_range_a.map_or("-".to_owned(), |[least, most]| format!("{:.3} … {:.3}", least * 1e6, most * 1e6));
        writeln!(
            text,
            "  {:>4} {:>7.2} {:>10.2} {:>7.2} {:>9.2} {:>8.2} {:>12.2} {:>12.2}  {range:>15}  up to {:.3}",
            cell.cell,
            percent(cell.lit),
            percent(cell.clipped),
            percent(cell.dark),
            percent(cell.behind),
            percent(cell.faint),
            percent(cell.saturated),
            percent(cell.over_scale),
            cell.most_electrode_a * 1e6
        )?;
    }
    writeln!(text, "  saturated: the detector, above its saturation_a; overscale: an electrode above full_scale_a")?;
    let cells = coverage.cells.len();
    write!(text, "  all {cells} lit in {:.2} %", 100.0 * coverage.at_least_lit[cells])?;
    for least in (1..cells).rev() {
        write!(text, ", ≥ {least} in {:.2} %", 100.0 * coverage.at_least_lit[least])?;
        if coverage.at_least_lit[least] >= 1.0 {
            break;
        }
    }
    writeln!(text)
}

fn travel(survey: &Survey, text: &mut String) -> fmt::Result {
    writeln!(text, "\nPure motion from home with every cell lit and not faint")?;
    for travel in &survey.travel {
        let reason = |end: &End| match (end.cell, end.becomes) {
            (Some(cell), Some(becomes)) => format!("cell {cell} {becomes}"),
            _ => "end of search".to_owned(),
        };
        writeln!(
            text,
            "  {}  {} … {}  ({}; {})",
            travel.axis,
            amount(travel, travel.negative.at),
            amount(travel, travel.positive.at),
            reason(&travel.negative),
            reason(&travel.positive)
        )?;
    }
    Ok(())
}

fn amount(travel: &Travel, amount: f64) -> String {
    match travel.axis.starts_with('t') {
        true => format!("{:+8.3} mm", amount * 1e3),
        false => format!("{:+8.2}°  ", amount.to_degrees()),
    }
}

fn lighting(survey: &Survey, text: &mut String) -> fmt::Result {
    writeln!(text, "\nLighting")?;
    for slot in &survey.crosstalk {
        let emitters: Vec<_> = slot.emitters.iter().map(ToString::to_string).collect();
        let share = match slot.share {
            0.0 => "no cross-talk".to_owned(),
            share => format!("cross-talk up to {:.3} % (cell {})", 100.0 * share, slot.cell),
        };
        writeln!(text, "  slot {}: emitters {}, {share}", slot.slot, emitters.join(", "))?;
    }
    if survey.crosstalk.is_empty() {
        writeln!(text, "  one emitter at a time: no cross-talk")?;
    }
    match survey.timing {
        Some(timing) => writeln!(
            text,
            "  {} slots of {:.1} µs: {:.1} µs of a {:.1} µs frame ({:.0} %)",
            timing.slots,
            timing.slot_s * 1e6,
            timing.busy_s * 1e6,
            timing.frame_s * 1e6,
            100.0 * timing.busy_s / timing.frame_s
        ),
        None => writeln!(text, "  no [front_end]: timing and full scale not checked"),
    }
}

fn warnings(survey: &Survey, text: &mut String) -> fmt::Result {
    if survey.warnings.is_empty() {
        return writeln!(text, "\nNo warnings.");
    }
    writeln!(text, "\nWarnings")?;
    for warning in &survey.warnings {
        writeln!(text, "{warning:#}")?;
    }
    Ok(())
}

fn optional(value: Option<f64>, digits: usize) -> String {
    value.map_or("-".to_owned(), |value| format!("{:.digits$}", rounded(value)))
}
