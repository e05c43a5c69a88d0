//! slitpose's pose estimation beside other least-squares solvers: the same equations, the same
//! problems, the same products, one thread, in one run. See `README.md`.

mod chart;
#[path = "../../../model/tests/testsuite/common/mod.rs"]
mod common;
mod contender;
mod levenberg_marquardt;
mod measure;
mod ours;
mod problems;
mod tiny_solver;
mod weights;

use std::hint::black_box;

use anyhow::{Context, Result};
use clap::Parser;

use contender::Contender;
use ours::Ours;
use problems::{BOX_DEG, BOX_MM, Kind};
use slitpose_model::{Scene, SceneError};
use tiny_solver::TinySolver;

/// Poses of each kind of problem.
const COUNT: usize = 2000;

/// Poses that `--only` cycles through: few, so that making them is little work.
const UNTIMED: usize = 100;

/// Compares solvers of the same problems and prints one table for each kind of problem.
#[derive(Parser)]
struct Arguments {
    /// Only problems of this kind
    #[arg(long)]
    problem: Option<Kind>,
    /// Rounds in which all take turns
    #[arg(long, default_value_t = 25)]
    rounds: usize,
    /// Only this contender, untimed: for instruction counters
    #[arg(long, requires = "problem")]
    only: Option<String>,
    /// Solves of the only contender, rounded up to hundreds
    #[arg(long, default_value_t = 1000, requires = "only")]
    count: usize,
}

/// All that take part in problems of `kind`; the first is the measure of the others.
fn contenders(scene: &Scene, kind: Kind) -> Result<Vec<Box<dyn Contender>>, SceneError> {
    Ok(vec![
        Box::new(Ours::new(scene, kind)?),
        Box::new(TinySolver::new(scene)),
        Box::new(levenberg_marquardt::Crate::new(scene)?),
    ])
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let scene = common::wide();
    if let (Some(name), Some(kind)) = (&arguments.only, arguments.problem) {
        let contenders = contenders(&scene, kind)?;
        let contender = contenders.iter().find(|contender| contender.name() == name).with_context(|| {
            let names: Vec<_> = contenders.iter().map(|contender| contender.name()).collect();
            format!("no contender {name}: there are {}", names.join(", "))
        })?;
        let problems = kind.problems(&scene, common::SEED, UNTIMED)?;
        for _ in 0..arguments.count.div_ceil(UNTIMED) {
            contender.solve_all(black_box(&problems));
        }
        return Ok(());
    }
    println!(
        "Scene wide, paper tier, f64, one thread. {COUNT} poses within {BOX_MM} mm and {BOX_DEG} degrees of home, all\n\
         six cells lit; seed {}. Time per solve, covariance included: least and median of {} rounds\n\
         in which all take turns. Found: within {:e} mm of the least chi2 (rotation counted at {} mm).",
        common::SEED,
        arguments.rounds,
        measure::FOUND_MM,
        chart::ARM_M * 1e3,
    );
    let kinds = arguments.problem.map_or(Kind::ALL.to_vec(), |kind| vec![kind]);
    for kind in kinds {
        println!("\n{}", kind.heading());
        let problems = kind.problems(&scene, common::SEED, COUNT)?;
        measure::compare(&contenders(&scene, kind)?, &problems, arguments.rounds);
    }
    Ok(())
}
