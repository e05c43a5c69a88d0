//! Poses from photocurrents, in the caller's own process: functions that C and whatever calls C can call.
//!
//! `include/slitpose_solver.h` is made from this crate by cbindgen and says what the functions do. Every pointer stops in this
//! file, the only one outside the board's drivers with `unsafe`: `solver` is what stands behind a handle, `solution` what C reads.
//!
//! No panic unwinds into C: [`Solver`] catches it. What it was working on may be half done then, so that solver answers
//! [`ErrorCode::Defect`] from there on.

#![allow(unsafe_op_in_unsafe_fn, reason = "what each function does with pointers is what its section on safety says")]

mod solution;
mod solver;

use std::ffi::{CStr, c_char};
use std::mem::MaybeUninit;
use std::panic::catch_unwind;

pub use solution::PoseSolution;
use solver::Refusal;
pub use solver::Solver;

/// Number of this interface: another one may have changed functions and structures. Compare with slitpose_solver_abi().
pub const ABI: u32 = 1;

/// Whether a function has done what it was called for.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorCode {
    /// Done. Whether there is a pose is in the solution.
    Ok = 0,
    /// A pointer that must not be NULL is.
    Null = 1,
    /// A number that is not finite or out of range, or too many or too few numbers.
    Argument = 2,
    /// Frames cannot be tracked before slitpose_solver_start().
    NotStarted = 3,
    /// The instant is not later than that of the frame before.
    Time = 4,
    /// There is no pose or no velocity to predict with.
    NoTwist = 5,
    /// A defect of this library: close the solver, and report it.
    Defect = 6,
}

/// Number of the interface that the library has: SLITPOSE_SOLVER_ABI of its header.
#[unsafe(no_mangle)]
pub extern "C" fn slitpose_solver_abi() -> u32 {
    ABI
}

/// A solver for the scene file `scene`, or the shipped scene of that name, and the calibration file `calibration`; NULL: the
/// head is known by its scene, and by its tolerances if the scene has any. Returns NULL if it cannot be opened, and why in
/// `error`, which has room for `error_bytes` bytes (NULL and 0: not wanted).
///
/// # Safety
/// `scene` and `calibration` are NULL or end with 0; `error` is NULL or has room for `error_bytes` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn slitpose_solver_open(
    scene: *const c_char,
    calibration: *const c_char,
    error: *mut c_char,
    error_bytes: usize,
) -> Option<Box<Solver>> {
    let open = || Solver::open(text(scene)?.ok_or(Refusal::Null("scene"))?, text(calibration)?).map(Box::new);
    let opened = catch_unwind(open).unwrap_or(Err(Refusal::Defect));
    opened.map_err(|refusal| copy(&refusal.to_string(), error, error_bytes)).ok()
}

/// Frees a solver. NULL is allowed.
///
/// # Safety
/// `solver` is NULL or from slitpose_solver_open(), and is not used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn slitpose_solver_close(solver: Option<Box<Solver>>) {
    drop(solver);
}

/// How many cells the scene has; 0 for NULL. Rows have two currents for each.
///
/// # Safety
/// `solver` is NULL or an open solver that no other thread uses.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn slitpose_solver_cells(solver: Option<&Solver>) -> usize {
    solver.map_or(0, Solver::cells)
}

/// Copies the name of the scene to `buffer` of `bytes` bytes. Returns the length of the name, which may be more.
///
/// # Safety
/// `solver` is NULL or an open solver that no other thread uses; `buffer` is NULL or has room for `bytes` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn slitpose_solver_name(solver: Option<&Solver>, buffer: *mut c_char, bytes: usize) -> usize {
    copy(solver.map_or("", Solver::name), buffer, bytes)
}

/// Copies a sentence about the last call of this solver that did not return 0 to `buffer` of `bytes` bytes: what was wrong, and
/// what to give instead. Returns the length of the sentence, which may be more.
///
/// # Safety
/// `solver` is NULL or an open solver that no other thread uses; `buffer` is NULL or has room for `bytes` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn slitpose_solver_error(solver: Option<&Solver>, buffer: *mut c_char, bytes: usize) -> usize {
    copy(solver.map_or("the solver is NULL; open one", |solver| &solver.error), buffer, bytes)
}

/// Solves one row by itself, as `slitpose solve` does: I_X1 and I_X2 of cell 0, of cell 1, ..., in ampere, dark current
/// included, all at one instant. A cell that was not measured has 0 and 0, and is left out. `count`: of the currents, twice
/// that of the cells.
///
/// # Safety
/// `solver` is NULL or an open solver that no other thread uses; `currents_a` is NULL or has `count` numbers; `solution` is NULL
/// or has room for one.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn slitpose_solver_solve(
    solver: Option<&mut Solver>,
    currents_a: *const f64,
    count: usize,
    solution: Option<&mut MaybeUninit<PoseSolution>>,
) -> ErrorCode {
    attempt(solver, |solver| {
        let (place, currents_a) = (solution.ok_or(Refusal::Null("solution"))?, numbers(currents_a, count));
        place.write(solver.solve(currents_a.ok_or(Refusal::Null("currents_a"))?)?);
        Ok(())
    })
}

/// Makes ready to track frames that come `rate_hz` times a second; anew, if it was called before. Cell k is exposed
/// `exposures_s[k]` seconds after the instant of a frame; NULL: all at that instant. `count`: that of the cells.
///
/// # Safety
/// `solver` is NULL or an open solver that no other thread uses; `exposures_s` is NULL or has `count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn slitpose_solver_start(
    solver: Option<&mut Solver>,
    rate_hz: f64,
    exposures_s: *const f64,
    count: usize,
) -> ErrorCode {
    attempt(solver, |solver| solver.start(rate_hz, numbers(exposures_s, count)))
}

/// Solves the next frame from where the tool was and how it moved; currents as for slitpose_solver_solve(). `time_ns`: its
/// instant by any clock that only goes forward, within a quarter of a period. Frames may be missing; after more than eight
/// the motion is forgotten.
///
/// # Safety
/// That of slitpose_solver_solve().
#[unsafe(no_mangle)]
pub unsafe extern "C" fn slitpose_solver_track(
    solver: Option<&mut Solver>,
    time_ns: u64,
    currents_a: *const f64,
    count: usize,
    solution: Option<&mut MaybeUninit<PoseSolution>>,
) -> ErrorCode {
    attempt(solver, |solver| {
        let (place, currents_a) = (solution.ok_or(Refusal::Null("solution"))?, numbers(currents_a, count));
        place.write(solver.track(time_ns, currents_a.ok_or(Refusal::Null("currents_a"))?)?);
        Ok(())
    })
}

/// Forgets all frames: the next may have any instant, and is searched for anywhere.
///
/// # Safety
/// `solver` is NULL or an open solver that no other thread uses.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn slitpose_solver_reset(solver: Option<&mut Solver>) -> ErrorCode {
    attempt(solver, Solver::reset)
}

/// Moves a pose on by `later_ns`, as its velocity goes on: translation, rotation, covariance and time. Variances grow by what
/// velocities are uncertain, and by what accelerations of these rms sizes may add (0: none). slitpose_predict() of
/// slitpose_pose.h does the same with poses of the daemon.
///
/// # Safety
/// `solution` is NULL or points to one that no other thread uses.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn slitpose_solution_predict(
    solution: Option<&mut PoseSolution>,
    later_ns: u64,
    rms_m_per_s2: f64,
    rms_rad_per_s2: f64,
) -> ErrorCode {
    let rms = [rms_m_per_s2, rms_rad_per_s2];
    match solution {
        None => return ErrorCode::Null,
        Some(_) if !rms.iter().all(|rms| (0.0..f64::INFINITY).contains(rms)) => return ErrorCode::Argument,
        Some(solution) if solution.has_pose == 0 || solution.has_twist == 0 => return ErrorCode::NoTwist,
        Some(solution) => solution.predict(later_ns, rms),
    }
    ErrorCode::Ok
}

fn attempt(solver: Option<&mut Solver>, work: impl FnOnce(&mut Solver) -> Result<(), Refusal>) -> ErrorCode {
    solver.map_or(ErrorCode::Null, |solver| solver.attempt(work))
}

/// # Safety
/// `at` is NULL or ends with 0, for as long as the text is used.
unsafe fn text<'a>(at: *const c_char) -> Result<Option<&'a str>, Refusal> {
    if at.is_null() { Ok(None) } else { Ok(Some(CStr::from_ptr(at).to_str()?)) }
}

/// # Safety
/// `at` is NULL or has `count` numbers, for as long as they are used.
unsafe fn numbers<'a>(at: *const f64, count: usize) -> Option<&'a [f64]> {
    (!at.is_null()).then(|| std::slice::from_raw_parts(at, count))
}

/// Copies as many whole letters of `text` as `buffer` has room for, and 0. The length of the text.
///
/// # Safety
/// `buffer` is NULL or has room for `bytes` bytes.
unsafe fn copy(text: &str, buffer: *mut c_char, bytes: usize) -> usize {
    if !buffer.is_null() && bytes > 0 {
        let room = text.len().min(bytes - 1);
        let copied = (0..=room).rev().find(|&at| text.is_char_boundary(at)).unwrap_or(0);
        buffer.copy_from_nonoverlapping(text.as_ptr().cast(), copied);
        buffer.add(copied).write(0);
    }
    text.len()
}
