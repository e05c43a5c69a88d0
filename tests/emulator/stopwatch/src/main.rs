//! The image: builds solvers in `f32` and times them, as its host asks.
//!
//! Nothing else runs and no interrupt is enabled: the cycles are the solver's. Its code runs from CCM
//! SRAM, without the wait states of flash: `memory.x` says which.

#![no_std]
#![no_main]

use core::hint::{black_box, spin_loop};
use core::panic::PanicInfo;

use cortex_m::Peripherals;
use cortex_m::asm::{dsb, isb};
use cortex_m::peripheral::DWT;
use cortex_m_rt::entry;
use slitpose_model::{MotionPrior, Outcome, Photocurrents, Pose, Scene, Solver, Start};
use slitpose_stopwatch::{Answer, Mailbox, Request, Solved, State};

/// Found by its name, [`slitpose_stopwatch::MAILBOX_SYMBOL`].
#[allow(unsafe_code, reason = "an exported name, which nothing else in the image has")]
#[unsafe(export_name = "SLITPOSE_STOPWATCH_MAILBOX")]
static MAILBOX: Mailbox = Mailbox::new();

/// Access control register of the flash (RM0440, "FLASH_ACR").
const FLASH_ACR: *mut u32 = 0x4002_2000 as *mut u32;
const LATENCY: u32 = 0xF;
/// Wait states that the board's image runs with, at 170 MHz.
const WAIT_STATES: u32 = 4;

// Of memory.x: the code that runs from CCM SRAM, and its image in flash.
#[allow(unsafe_code, reason = "the linker's symbols; only their addresses are used")]
unsafe extern "C" {
    static mut __sccm: u64;
    static __eccm: u64;
    static __siccm: u64;
}

#[entry]
fn main() -> ! {
    load_ccm();
    run()
}

/// Brings the solver's code to CCM SRAM. Nothing of it may be called before: hence word by word, as
/// what copies memory is there, too.
fn load_ccm() {
    let (from, to, end) = (&raw const __siccm, &raw mut __sccm, &raw const __eccm);
    for index in 0..(end as usize - to as usize) / size_of::<u64>() {
        // SAFETY: the linker has set both places aside in this size, each aligned to 8 bytes, and
        // nothing else refers to them.
        #[allow(unsafe_code)]
        unsafe {
            to.add(index).write_volatile(from.add(index).read_volatile());
        }
    }
    dsb();
    isb();
}

#[inline(never)]
fn run() -> ! {
    wait_for_flash_as_at_full_speed();
    let mut core = Peripherals::take().expect("the first to ask");
    core.DCB.enable_trace();
    core.DWT.enable_cycle_counter();

    let mut scene = Scene::default();
    let tier = loop {
        match asked() {
            Some(Request::Scene(noise, uncertainty)) => {
                scene.cells.clear();
                (scene.noise, scene.uncertainty) = (noise, uncertainty);
                say(&Answer::Done);
            }
            Some(Request::Cell(cell)) => {
                let is_one_more = scene.cells.push(cell).is_ok();
                say(if is_one_more { &Answer::Done } else { &Answer::Refused });
            }
            Some(Request::Compile(tier)) => break tier,
            _ => say(&Answer::Refused),
        }
    };
    // Compiled where it is: a solver is too large to be moved about.
    let mut solver = Solver::<f32>::empty();
    let compiled = solver.set_scene(&scene, tier);
    say(if compiled.is_ok() { &Answer::Done } else { &Answer::Refused });
    loop {
        match (asked(), &compiled) {
            (Some(Request::Solve(readings, prior)), Ok(())) => {
                say(&Answer::Solved(time(&solver, &readings.rounded(), prior.as_ref())));
            }
            _ => say(&Answer::Refused),
        }
    }
}

/// Waits for the host; `None`: what it says is no request.
fn asked() -> Option<Request> {
    MAILBOX.set_state(State::Waiting);
    while MAILBOX.state() != State::Asked {
        spin_loop();
    }
    Request::read(&MAILBOX.read())
}

fn say(answer: &Answer) {
    MAILBOX.write(&answer.write());
}

/// The core's clock may stay slow: what counts is cycles, and the flash has to answer as late as
/// it does at 170 MHz.
fn wait_for_flash_as_at_full_speed() {
    // SAFETY: the register exists, more wait states than needed do no harm, and nobody else
    // writes it.
    #[allow(unsafe_code)]
    unsafe {
        FLASH_ACR.write_volatile(FLASH_ACR.read_volatile() & !LATENCY | WAIT_STATES);
    }
}

#[inline(never)]
fn time(solver: &Solver<f32>, readings: &Photocurrents<f32>, prior: Option<&Pose>) -> Solved {
    let (readings, prior) = black_box((readings, prior));
    MAILBOX.set_state(State::Timing);
    let started = DWT::cycle_count();
    let solution = match prior {
        Some(prior) => solver.solve(readings, Start::Near(prior), &MotionPrior::AT_REST),
        None => solver.solve(readings, Start::Cold, &MotionPrior::AT_REST),
    };
    // Looked at in place: the copy would be counted.
    black_box(&solution);
    let cycles = DWT::cycle_count().wrapping_sub(started);
    MAILBOX.set_state(State::Asked);
    Solved {
        cycles,
        iterations: solution.iterations as u32,
        converged: solution.outcome == Outcome::Converged,
        estimate: solution.estimate.map(|estimate| (estimate.pose, estimate.widened().covariance)),
    }
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    MAILBOX.set_state(State::Panicked);
    loop {
        spin_loop();
    }
}
