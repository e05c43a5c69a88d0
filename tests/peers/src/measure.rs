//! Rounds of all contenders in turn, and the table of what they found and how long it took.

use std::hint::black_box;
use std::time::Instant;

use slitpose_model::Pose;

use crate::chart::ARM_M;
use crate::contender::{Answer, Contender};
use crate::problems::Problem;

/// A pose this near to the least χ² is found, millimetres: see [`distance_mm`].
pub const FOUND_MM: f64 = 1e-4;

/// Problems solved by one contender before it is the next one's turn.
const STRETCH: usize = 64;

/// How far apart two poses are: translation, and rotation at the emitters' distance, millimetres.
fn distance_mm(a: &Pose, b: &Pose) -> f64 {
    let (shift, turn) = a.displacement_from(b);
    (shift.length() + turn.length() * ARM_M) * 1e3
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values[values.len() / 2]
}

fn least(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::INFINITY, f64::min)
}

/// Largest relative difference of two answers' σ.
fn sigma_difference(a: &Answer, b: &Answer) -> f64 {
    let off = |i: usize| ((a.covariance[i][i] / b.covariance[i][i]).sqrt() - 1.0).abs();
    (0..6).map(off).fold(0.0, f64::max)
}

/// What a contender needed, microseconds per solve.
struct Times {
    /// Nothing else on the machine: the least of each stretch over all rounds.
    least: f64,
    /// The median of each stretch over all rounds.
    median: f64,
}

/// Times `contenders` taking turns, stretch by stretch: neighbours in time, they suffer alike from
/// whatever else the machine does, and of each stretch some round is left in peace.
fn times_us(contenders: &[Box<dyn Contender>], problems: &[Problem], rounds: usize) -> Vec<Times> {
    let stretches: Vec<&[Problem]> = problems.chunks(STRETCH).collect();
    let mut times = vec![vec![Vec::with_capacity(rounds); stretches.len()]; contenders.len()];
    for _ in 0..rounds {
        for (number, stretch) in stretches.iter().enumerate() {
            for (contender, times) in contenders.iter().zip(&mut times) {
                let since = Instant::now();
                contender.solve_all(black_box(stretch));
                times[number].push(since.elapsed().as_secs_f64() * 1e6);
            }
        }
    }
    let per_solve = (problems.len() as f64).recip();
    let of_contender = |stretches: &mut Vec<Vec<f64>>| Times {
        least: stretches.iter().map(|times| least(times)).sum::<f64>() * per_solve,
        median: stretches.iter_mut().map(|times| median(times)).sum::<f64>() * per_solve,
    };
    times.iter_mut().map(of_contender).collect()
}

/// Lets all `contenders` solve all `problems` in `rounds` rounds and prints one line for each.
pub fn compare(contenders: &[Box<dyn Contender>], problems: &[Problem], rounds: usize) {
    println!(
        "  {:<24}{:>9}{:>12}{:>12}{:>9}{:>7}{:>10}{:>10}{:>8}{:>8}",
        "", "found", "median", "worst", "sigma", "steps", "min", "median", "ratio", "ratio"
    );
    println!(
        "  {:<24}{:>9}{:>12}{:>12}{:>9}{:>7}{:>10}{:>10}{:>8}{:>8}",
        "", "%", "error mm", "error mm", "off", "", "us", "us", "of min", "of med."
    );
    let measure: Vec<Answer> = problems.iter().map(|problem| contenders[0].solve(problem)).collect();
    let times = times_us(contenders, problems, rounds);
    for (contender, of) in contenders.iter().zip(&times) {
        let answers: Vec<Answer> = problems.iter().map(|problem| contender.solve(problem)).collect();
        let mut errors: Vec<f64> =
            answers.iter().zip(problems).map(|(answer, problem)| distance_mm(&answer.pose, &problem.minimum)).collect();
        let found = errors.iter().filter(|&&error| error <= FOUND_MM).count();
        let steps: usize = answers.iter().map(|answer| answer.steps).sum();
        let mut sigma: Vec<f64> = answers.iter().zip(&measure).map(|(a, b)| sigma_difference(a, b)).collect();
        println!(
            "  {:<24}{:>9.2}{:>12.1e}{:>12.1e}{:>9.0e}{:>7.2}{:>10.3}{:>10.3}{:>8.2}{:>8.2}",
            contender.name(),
            100.0 * found as f64 / problems.len() as f64,
            median(&mut errors),
            errors.iter().copied().fold(0.0, f64::max),
            median(&mut sigma),
            steps as f64 / problems.len() as f64,
            of.least,
            of.median,
            of.least / times[0].least,
            of.median / times[0].median,
        );
    }
}
