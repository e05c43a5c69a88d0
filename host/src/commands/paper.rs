//! `slitpose paper`: the source paper's experiments, calculated.

use std::path::PathBuf;

use super::talk::store;
use super::{CommandError, Outcome, talk};
use slitpose_design::paper::{Experiment, Point, Study, account, figures};
use slitpose_design::report::Folder;
use slitpose_head::scene_file::BENCH;
use slitpose_head::table::{Output, OutputError, TableWriter};

/// Calculates the experiments of De La Cruz et al. 2018 with the shipped scene `bench`.
///
/// Experiment 1 moves the emitter along the detector, experiment 2 turns it. Both are given as
/// equations (1) to (6) are printed (paper tier) and integrated over the spot (exact tier). The
/// paper's measured points were published without numbers and do not appear.
///
/// With --output the folder also gets a page (index.html, report.md) on the four errors that the paper does publish as
/// numbers: simulated benches with imperfect parts that have the same errors.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose paper > experiments.csv\n  slitpose paper --output paper-figures")]
pub(super) struct Args {
    /// Make this folder with the table and its figures, instead of the table on standard output
    #[arg(long, value_name = "DIR")]
    output: Option<PathBuf>,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let bench = BENCH.read()?;
    let study = Study::of(&bench)?;
    let Some(folder) = &args.output else {
        write_table(&study, Output::open(None)?)?;
        return Ok(Outcome::Done);
    };
    let page = Folder::create(folder)?;
    let table = folder.join("experiments.csv");
    write_table(&study, Output::file(&table)?)?;
    talk(format_args!("wrote {}", table.display()));
    for (name, svg) in figures(&study, &bench.scene.cells[0]) {
        let path = folder.join(name);
        Output::file(&path)?.write_text(&svg)?;
        talk(format_args!("wrote {}", path.display()));
    }
    store(&account(&bench)?, &page)?;
    Ok(Outcome::Done)
}

fn write_table(study: &Study, output: Output) -> Result<(), OutputError> {
    let header = [
        "experiment",
        "position_mm",
        "angle_deg",
        "status",
        "gamma_deg",
        "paper_x_a_mm",
        "exact_x_a_mm",
        "paper_solid_angle_sr",
        "exact_solid_angle_sr",
        "paper_i_o_a",
        "exact_i_o_a",
        "identified_relative_intensity",
        "identified_i_o_a",
    ];
    let mut table = TableWriter::new(output, header)?;
    for (index, point) in study.translation.iter().enumerate() {
        let with_identified = study.with_identified.get(index).map(|response| response.i_o_a);
        write_point(&mut table, Experiment::Translation, point, [None, with_identified])?;
    }
    for (index, point) in study.rotation.iter().enumerate() {
        let identified = study.identified.get(index).map(|identified| identified.relative_intensity);
        write_point(&mut table, Experiment::Rotation, point, [identified, None])?;
    }
    table.finish()
}

fn write_point(
    table: &mut TableWriter,
    experiment: Experiment,
    point: &Point,
    identified: [Option<f64>; 2],
) -> Result<(), OutputError> {
    let (position_mm, angle_deg) = match experiment {
        Experiment::Translation => (point.amount, 0.0),
        Experiment::Rotation => (0.0, point.amount),
    };
    table.text(&experiment.number().to_string());
    table.number(position_mm);
    table.number(angle_deg);
    table.text(point.paper.status.as_str());
    table.optional(point.paper.gamma_rad.map(f64::to_degrees));
    table.optional(point.paper.x_a_m.map(|x_a_m| x_a_m * 1e3));
    table.optional(point.exact.x_a_m.map(|x_a_m| x_a_m * 1e3));
    table.number(point.paper.solid_angle_sr);
    table.number(point.exact.solid_angle_sr);
    table.number(point.paper.i_o_a);
    table.number(point.exact.i_o_a);
    table.optional(identified[0]);
    table.optional(identified[1]);
    table.end_row()
}
