//! Every fault of the silicon, alone and mixed, through every end of the light: one table on stdout; exit code 1 if a
//! word is not the model's, a scan has another's number, or a board is lit for longer than it may or lights again by
//! itself. All times are device time. It needs the image of `firmware/build`.
//!
//! ```text
//! cargo run --release -p slitpose-emulator --example silicon -- [--seconds 0.4] [--mixtures 10] [--seed 1]
//! ```

#[path = "../tests/testsuite/common/chain.rs"]
mod chain;
#[path = "../tests/testsuite/common/trial.rs"]
mod trial;

use std::num::NonZero;
use std::process::ExitCode;

use clap::Parser;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slitpose_emulator::faults::{Fault, Faults, Kind};
use slitpose_emulator::peripherals::TICKS_PER_SECOND;
use slitpose_emulator::rig::open_image;
use slitpose_head::threads;
use trial::Ending;
use trial::Plan;

/// What ends the light without waiting for anything.
const AT_ONCE: [Ending; 6] =
    [Ending::Panic, Ending::Halt, Ending::DeadCrystal, Ending::LowSupply, Ending::BrownOut, Ending::ResetPin];

#[derive(Parser)]
#[command(about = "Every fault of the silicon through every end of the light")]
struct Options {
    /// Light of each board before its end, seconds
    #[arg(long, default_value_t = 0.4)]
    seconds: f64,
    /// Mixtures of faults by chance, each of them with a half
    #[arg(long, default_value_t = 10)]
    mixtures: usize,
    /// Seed of mixtures, motion and phases
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Boards at a time [default: one a processor]
    #[arg(long)]
    jobs: Option<NonZero<usize>>,
}

fn main() -> ExitCode {
    let options = Options::parse();
    let image = open_image(None).unwrap_or_else(|error| panic!("{error}"));
    let mut chance = ChaCha8Rng::seed_from_u64(options.seed);
    let mut silicons = vec![("none".to_owned(), Faults::default())];
    silicons.extend(Fault::of(Kind::Silicon).iter().map(|fault| (fault.name(), Faults::default().with(*fault))));
    silicons.push(("all".to_owned(), Faults::all_of_silicon()));
    for _ in 0..options.mixtures {
        let faults: Vec<Fault> = Fault::of(Kind::Silicon).iter().copied().filter(|_| chance.random()).collect();
        let names: Vec<_> = faults.iter().map(|fault| fault.name()).collect();
        silicons.push((names.join("+"), faults.into_iter().collect()));
    }
    let plans: Vec<(usize, Plan)> = silicons
        .iter()
        .enumerate()
        .flat_map(|(row, (_, silicon))| Ending::ALL.map(|ending| (row, *silicon, ending)))
        .filter(|(_, silicon, ending)| ending.is_possible(*silicon))
        .map(|(row, silicon, ending)| {
            (row, Plan { silicon, ending, seconds: options.seconds, seed: chance.random_range(1..1 << 32) })
        })
        .collect();

    options.jobs.into_iter().for_each(threads::limit);
    let outcomes = threads::on_all_cores(&plans, |(_, plan)| plan.carry_out(&image));

    println!("seed {}, {} boards, {} s of light each", options.seed, plans.len(), options.seconds);
    println!("                                 lit beyond the end, us, by what ended it:");
    println!("boards    scans  missing  codes  at once   stop    hang host gone  silicon");
    let mut is_sound = true;
    for (row, (name, _)) in silicons.iter().enumerate() {
        let lived: Vec<_> =
            plans.iter().zip(&outcomes).filter(|((of, _), _)| *of == row).map(|((_, plan), is)| (plan, is)).collect();
        let sound: Vec<_> = lived.iter().filter_map(|(plan, is)| Some((plan, is.as_ref().ok()?))).collect();
        let lit_us = |endings: &[Ending]| {
            let of = sound.iter().filter(|(plan, _)| endings.contains(&plan.ending));
            let most = of.map(|(_, outcome)| outcome.lit_ticks).max().unwrap_or(0);
            most as f64 * 1e6 / TICKS_PER_SECOND as f64
        };
        println!(
            "{:>6} {:>8} {:>8} {:>6.3} {:>8.1} {:>6.0} {:>7.0} {:>9.0}  {name}",
            lived.len(),
            sound.iter().map(|(_, outcome)| outcome.scans).sum::<usize>(),
            sound.iter().map(|(_, outcome)| outcome.missing).sum::<u64>(),
            sound.iter().map(|(_, outcome)| outcome.worst_codes).fold(0.0, f64::max),
            lit_us(&AT_ONCE),
            lit_us(&[Ending::Stop]),
            lit_us(&[Ending::Hang]),
            lit_us(&[Ending::ClosedPort, Ending::PulledCable]),
        );
        for (plan, error) in lived.iter().filter_map(|(plan, is)| Some((plan, is.as_ref().err()?))) {
            println!("       {:?}, seed {}: {error}", plan.ending, plan.seed);
            is_sound = false;
        }
    }
    println!("{}", if is_sound { "each word is the model's, and each board dark in time" } else { "NOT SOUND" });
    if is_sound { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
