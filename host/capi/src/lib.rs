//! Poses from photocurrents, in the caller's own process: functions that C and whatever calls C can call.
//!
//! `include/slitpose_solver.h` is made from this crate by cbindgen and says what the functions do. Every pointer stops
//! in this file, which is the only one of the workspace's hosts with `unsafe`: `solver` is what stands behind a handle,
//! `solution` what C reads.
//!
//! No panic unwinds into C: each function that could meet one catches it. What it was working on may be half done then, so
//! that solver answers [`ErrorCode::Defect`] from there on.

mod solution;
mod solver;

use std::ffi::{CStr, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};

pub use solution::{ErrorCode, NoTwistCode, PoseSolution, ReasonCode, StatusCode};
pub use solver::Solver;

use solver::{OpenError, Refusal};

/// Number of this interface: another one may have changed functions and structures. Compare with slitpose_solver_abi().
pub const ABI: u32 = 1;

/// Number of the interface that the library has: SLITPOSE_SOLVER_ABI of its header.
#[unsafe(no_mangle)]
pub extern "C" fn slitpose_solver_abi() -> u32 {
    ABI
}

/// Version of the library, such as "0.1.0".
#[unsafe(no_mangle)]
pub extern "C" fn slitpose_solver_version() -> *const c_char {
    concat!(env!("CARGO_PKG_VERSION"), "\0").as_ptr().cast()
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
) -> *mut Solver {
    let open = || {
        // SAFETY: as the caller promises.
        let [scene, calibration] = unsafe { [text("scene", scene)?, text("calibration", calibration)?] };
        Solver::open(scene.ok_or(OpenError::Null("scene"))?, calibration)
    };
    match catch_unwind(open).unwrap_or(Err(OpenError::Defect)) {
        Ok(solver) => Box::into_raw(Box::new(solver)),
        Err(reason) => {
            // SAFETY: as the caller promises.
            unsafe { copy(&reason.to_string(), error, error_bytes) };
            std::ptr::null_mut()
        }
    }
}

/// Frees a solver. NULL is allowed.
///
/// # Safety
/// `solver` is NULL or from slitpose_solver_open(), and is not used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn slitpose_solver_close(solver: *mut Solver) {
    if !solver.is_null() {
        // SAFETY: it came from a box, and the caller gives it back.
        let solver = unsafe { Box::from_raw(solver) };
        // What is dropped is memory alone; of a panic in it nobody could be told.
        let _ = catch_unwind(AssertUnwindSafe(|| drop(solver)));
    }
}

/// How many cells the scene has; 0 for NULL. Rows have two currents for each.
///
/// # Safety
/// `solver` is NULL or an open solver that no other thread uses.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn slitpose_solver_cells(solver: *const Solver) -> usize {
    // SAFETY: as the caller promises.
    unsafe { solver.as_ref() }.map_or(0, Solver::cells)
}

/// Copies the name of the scene to `buffer` of `bytes` bytes. Returns the length of the name, which may be more.
///
/// # Safety
/// `solver` is NULL or an open solver that no other thread uses; `buffer` is NULL or has room for `bytes` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn slitpose_solver_name(solver: *const Solver, buffer: *mut c_char, bytes: usize) -> usize {
    // SAFETY: as the caller promises.
    unsafe { copy(solver.as_ref().map_or("", Solver::name), buffer, bytes) }
}

/// Copies a sentence about the last call of this solver that did not return 0 to `buffer` of `bytes` bytes: what was wrong, and
/// what to give instead. Returns the length of the sentence, which may be more.
///
/// # Safety
/// `solver` is NULL or an open solver that no other thread uses; `buffer` is NULL or has room for `bytes` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn slitpose_solver_error(solver: *const Solver, buffer: *mut c_char, bytes: usize) -> usize {
    // SAFETY: as the caller promises.
    unsafe { copy(solver.as_ref().map_or("the solver is NULL; open one", Solver::error), buffer, bytes) }
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
    solver: *mut Solver,
    currents_a: *const f64,
    count: usize,
    solution: *mut PoseSolution,
) -> ErrorCode {
    let solve = |solver: &mut Solver| {
        // SAFETY: as the caller promises.
        let currents_a = unsafe { numbers("currents_a", currents_a, count, 2, solver.cells()) }?;
        // SAFETY: as the caller promises.
        unsafe { put(solution, || solver.solve(currents_a)) }
    };
    // SAFETY: as the caller promises.
    unsafe { attempt(solver, solve) }
}

/// Makes ready to track frames that come `rate_hz` times a second; anew, if it was called before. Cell k is exposed
/// `exposures_s[k]` seconds after the instant of a frame; NULL and 0: all at that instant. `count`: that of the cells.
///
/// # Safety
/// `solver` is NULL or an open solver that no other thread uses; `exposures_s` is NULL or has `count` numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn slitpose_solver_start(
    solver: *mut Solver,
    rate_hz: f64,
    exposures_s: *const f64,
    count: usize,
) -> ErrorCode {
    let start = |solver: &mut Solver| {
        let exposures_s = if exposures_s.is_null() && count == 0 {
            &[]
        } else {
            // SAFETY: as the caller promises.
            unsafe { numbers("exposures_s", exposures_s, count, 1, solver.cells()) }?
        };
        solver.start(rate_hz, exposures_s)
    };
    // SAFETY: as the caller promises.
    unsafe { attempt(solver, start) }
}

/// Solves the next frame from where the tool was and how it moved; currents as for slitpose_solver_solve(). `time_ns`: its
/// instant by any clock that only goes forward, within a quarter of a period. Frames may be missing; after more than eight
/// the motion is forgotten.
///
/// # Safety
/// That of slitpose_solver_solve().
#[unsafe(no_mangle)]
pub unsafe extern "C" fn slitpose_solver_track(
    solver: *mut Solver,
    time_ns: u64,
    currents_a: *const f64,
    count: usize,
    solution: *mut PoseSolution,
) -> ErrorCode {
    let track = |solver: &mut Solver| {
        // SAFETY: as the caller promises.
        let currents_a = unsafe { numbers("currents_a", currents_a, count, 2, solver.cells()) }?;
        // SAFETY: as the caller promises.
        unsafe { put(solution, || solver.track(time_ns, currents_a)) }
    };
    // SAFETY: as the caller promises.
    unsafe { attempt(solver, track) }
}

/// Forgets all frames: the next may have any instant, and is searched for anywhere.
///
/// # Safety
/// `solver` is NULL or an open solver that no other thread uses.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn slitpose_solver_reset(solver: *mut Solver) -> ErrorCode {
    // SAFETY: as the caller promises.
    unsafe { attempt(solver, Solver::reset) }
}

/// Moves a pose on by `later_ns`, as its velocity goes on: translation, rotation, covariance and time. Variances grow by what
/// velocities are uncertain, and by what accelerations of these rms sizes may add (0: none). slitpose_predict() of
/// slitpose_pose.h does the same with poses of the daemon.
///
/// # Safety
/// `solution` is NULL or points to one that no other thread uses.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn slitpose_solution_predict(
    solution: *mut PoseSolution,
    later_ns: u64,
    rms_m_per_s2: f64,
    rms_rad_per_s2: f64,
) -> ErrorCode {
    // SAFETY: as the caller promises.
    let Some(solution) = (unsafe { solution.as_mut() }) else {
        return ErrorCode::Null;
    };
    let rms = [rms_m_per_s2, rms_rad_per_s2];
    if !rms.iter().all(|rms| rms.is_finite()) {
        return ErrorCode::NotFinite;
    }
    if rms.iter().any(|&rms| rms < 0.0) {
        return ErrorCode::Range;
    }
    if solution.predict(later_ns, rms) { ErrorCode::Ok } else { ErrorCode::NoTwist }
}

/// Does `work` with `solver`.
///
/// # Safety
/// `solver` is NULL or an open solver that no other thread uses.
unsafe fn attempt(solver: *mut Solver, work: impl FnOnce(&mut Solver) -> Result<(), Refusal>) -> ErrorCode {
    // SAFETY: as the caller promises.
    match unsafe { solver.as_mut() } {
        Some(solver) => solver.attempt(work),
        None => ErrorCode::Null,
    }
}

/// Text of C; `None` for NULL.
///
/// # Safety
/// `at` is NULL or ends with 0, for as long as the text is used.
unsafe fn text<'a>(what: &'static str, at: *const c_char) -> Result<Option<&'a str>, OpenError> {
    if at.is_null() {
        return Ok(None);
    }
    // SAFETY: as the caller promises.
    unsafe { CStr::from_ptr(at) }.to_str().map(Some).map_err(|_| OpenError::Text(what))
}

/// `per_cell` numbers for each of `cells` cells.
///
/// # Safety
/// `at` is NULL or has `given` numbers, for as long as they are used.
unsafe fn numbers<'a>(
    what: &'static str,
    at: *const f64,
    given: usize,
    per_cell: usize,
    cells: usize,
) -> Result<&'a [f64], Refusal> {
    let needed = per_cell * cells;
    if at.is_null() {
        return Err(Refusal::Null(what));
    }
    if given != needed {
        return Err(Refusal::Count { what, given, cells, needed });
    }
    // SAFETY: not NULL, and as the caller promises.
    Ok(unsafe { std::slice::from_raw_parts(at, given) })
}

/// Puts what `found` finds at `at`.
///
/// # Safety
/// `at` is NULL or has room for one.
unsafe fn put(at: *mut PoseSolution, found: impl FnOnce() -> Result<PoseSolution, Refusal>) -> Result<(), Refusal> {
    if at.is_null() {
        return Err(Refusal::Null("solution"));
    }
    // SAFETY: not NULL, and as the caller promises.
    unsafe { at.write(found()?) };
    Ok(())
}

/// Copies as many whole letters of `text` as `buffer` has room for, and 0. The length of the text.
///
/// # Safety
/// `buffer` is NULL or has room for `bytes` bytes.
unsafe fn copy(text: &str, buffer: *mut c_char, bytes: usize) -> usize {
    if !buffer.is_null() && bytes > 0 {
        let room = text.len().min(bytes - 1);
        let copied = (0..=room).rev().find(|&at| text.is_char_boundary(at)).unwrap_or(0);
        // SAFETY: `copied` is less than `bytes`, and the caller promises that many.
        unsafe {
            buffer.copy_from_nonoverlapping(text.as_ptr().cast(), copied);
            buffer.add(copied).write(0);
        }
    }
    text.len()
}
