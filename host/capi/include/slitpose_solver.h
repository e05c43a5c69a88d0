/*
 * Poses from photocurrents, in the caller's own process: for C, C++, C#, MATLAB, LabVIEW.
 *
 *     char error[1024];
 *     struct slitpose_solution solution;
 *     struct slitpose_solver *solver = slitpose_solver_open("head.toml", "calibration.toml", error, sizeof error);
 *     if (solver == NULL)
 *         fprintf(stderr, "%s\n", error);
 *     else if (slitpose_solver_solve(solver, currents_a, 12, &solution) == SLITPOSE_RESULT_OK && solution.has_pose)
 *         printf("x = %g m\n", solution.translation_m[0]);
 *     slitpose_solver_close(solver);
 *
 * slitpose_solver_solve() solves a row of currents by itself. slitpose_solver_start() and slitpose_solver_track() solve
 * frame after frame: faster, and with velocities.
 *
 * One thread at a time may use a solver; which one may change. Different solvers are independent. Text is UTF-8, ends with
 * 0, and is cut off where the caller's buffer ends. Functions return 0 (SLITPOSE_RESULT_OK) or why not; then
 * slitpose_solver_error() has a sentence about it. After opening and starting, nothing is allocated. An error inside the
 * library never unwinds into the caller: it becomes SLITPOSE_RESULT_DEFECT.
 *
 * SI units. A pose is base_from_tool: p_base = R p_tool + t.
 */


#ifndef SLITPOSE_SOLVER_H
#define SLITPOSE_SOLVER_H

/* Made from host/capi/src by cbindgen: change it there. */

#include <stddef.h>
#include <stdint.h>

// Values of `status`, as in slitpose_pose.h. The first two have a pose.
enum slitpose_status_of_solution {
    SLITPOSE_STATUS_CONVERGED = 0,    // a pose from all cells, and the currents fit it
    SLITPOSE_STATUS_DEGRADED = 1,     // a pose that deserves less trust: see `reason`
    SLITPOSE_STATUS_AMBIGUOUS = 2,    // several distinct poses explain the currents
    SLITPOSE_STATUS_UNOBSERVABLE = 3, // the currents leave directions free
    SLITPOSE_STATUS_TOO_DARK = 4,     // too few cells see enough light
    SLITPOSE_STATUS_DIVERGED = 5      // no pose near the currents was found
};

// Values of `reason`: why a pose is degraded.
enum slitpose_reason_of_solution {
    SLITPOSE_REASON_NONE = 0,          // it is not
    SLITPOSE_REASON_FEWER_CELLS = 1,   // some cells are saturated or faint; the others decide
    SLITPOSE_REASON_CELL_EXCLUDED = 2, // a cell contradicted all others and was left out
    SLITPOSE_REASON_MISFIT = 3,        // the residuals are larger than the noise explains
    SLITPOSE_REASON_UNFINISHED = 4,    // the solver had to stop before the minimum
    SLITPOSE_REASON_UNCALIBRATED = 5,  // the head is known by the tolerances of its parts alone: calibrate it
    SLITPOSE_REASON_DOUBTED = 6        // frames shortly before contradicted the scene
};

// Number of this interface: another one may have changed functions and structures. Compare with slitpose_solver_abi().
#define SLITPOSE_SOLVER_ABI 1

// Whether a function has done what it was called for.
enum slitpose_result {
    // Done. Whether there is a pose is in the solution.
    SLITPOSE_RESULT_OK = 0,
    // A pointer that must not be NULL is.
    SLITPOSE_RESULT_NULL = 1,
    // A number that is not finite or out of range, or too many or too few numbers.
    SLITPOSE_RESULT_ARGUMENT = 2,
    // Frames cannot be tracked before slitpose_solver_start().
    SLITPOSE_RESULT_NOT_STARTED = 3,
    // The instant is not later than that of the frame before.
    SLITPOSE_RESULT_TIME = 4,
    // There is no pose or no velocity to predict with.
    SLITPOSE_RESULT_NO_TWIST = 5,
    // A defect of this library: close the solver, and report it.
    SLITPOSE_RESULT_DEFECT = 6,
};

// A head, and what solves its currents. One thread at a time may use it.
struct slitpose_solver;

// The pose of one frame. What is not known is NaN. Fields have names, units and numbers of those in slitpose_pose.h.
struct slitpose_solution {
    // The instant the pose refers to, as the caller gave it; 0 of slitpose_solver_solve().
    uint64_t time_ns;
    // See slitpose_status_of_solution.
    uint16_t status;
    // Why a pose is degraded: see slitpose_reason_of_solution.
    uint16_t reason;
    // 1: translation, rotation and covariance are numbers; else 0.
    uint16_t has_pose;
    // 1: so are the velocities; else 0.
    uint16_t has_twist;
    // How many cells were used.
    uint16_t cells_used;
    // Bit k: cell k contradicts all others and was left out.
    uint16_t excluded_cells;
    // Data minus unknowns: what chi2 is distributed over.
    uint16_t redundancy;
    // Why a pose has no velocity. 1: too few poses yet; 2: the tool is not where its motion led; else 0.
    uint16_t no_twist;
    // Of base_from_tool.
    double translation_m[3];
    // Unit quaternion.
    double rotation_xyzw[4];
    // Of (t, theta), row-major: m^2, m rad, rad^2; t' = t + dt, R' = exp(dtheta) R.
    double covariance[36];
    // Velocity in the base frame.
    double linear_m_per_s[3];
    // Angular velocity in the base frame.
    double angular_rad_per_s[3];
    // Standard deviations of the six.
    double twist_sigma[6];
    // Brightness of all light, relative to scene or calibration.
    double light_level;
    // Sum of the squared whitened residuals.
    double chi2;
};

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Number of the interface that the library has: SLITPOSE_SOLVER_ABI of its header.
uint32_t slitpose_solver_abi(void);

// A solver for the scene file `scene`, or the shipped scene of that name, and the calibration file `calibration`; NULL: the
// head is known by its scene, and by its tolerances if the scene has any. Returns NULL if it cannot be opened, and why in
// `error`, which has room for `error_bytes` bytes (NULL and 0: not wanted).
//
// # Safety
// `scene` and `calibration` are NULL or end with 0; `error` is NULL or has room for `error_bytes` bytes.
struct slitpose_solver *slitpose_solver_open(const char *scene,
                                             const char *calibration,
                                             char *error,
                                             size_t error_bytes);

// Frees a solver. NULL is allowed.
//
// # Safety
// `solver` is NULL or from slitpose_solver_open(), and is not used afterwards.
void slitpose_solver_close(struct slitpose_solver *solver);

// How many cells the scene has; 0 for NULL. Rows have two currents for each.
//
// # Safety
// `solver` is NULL or an open solver that no other thread uses.
size_t slitpose_solver_cells(const struct slitpose_solver *solver);

// Copies the name of the scene to `buffer` of `bytes` bytes. Returns the length of the name, which may be more.
//
// # Safety
// `solver` is NULL or an open solver that no other thread uses; `buffer` is NULL or has room for `bytes` bytes.
size_t slitpose_solver_name(const struct slitpose_solver *solver,
                            char *buffer,
                            size_t bytes);

// Copies a sentence about the last call of this solver that did not return 0 to `buffer` of `bytes` bytes: what was wrong, and
// what to give instead. Returns the length of the sentence, which may be more.
//
// # Safety
// `solver` is NULL or an open solver that no other thread uses; `buffer` is NULL or has room for `bytes` bytes.
size_t slitpose_solver_error(const struct slitpose_solver *solver,
                             char *buffer,
                             size_t bytes);

// Solves one row by itself, as `slitpose solve` does: I_X1 and I_X2 of cell 0, of cell 1, ..., in ampere, dark current
// included, all at one instant. A cell that was not measured has 0 and 0, and is left out. `count`: of the currents, twice
// that of the cells.
//
// # Safety
// `solver` is NULL or an open solver that no other thread uses; `currents_a` is NULL or has `count` numbers; `solution` is NULL
// or has room for one.
enum slitpose_result slitpose_solver_solve(struct slitpose_solver *solver,
                                           const double *currents_a,
                                           size_t count,
                                           struct slitpose_solution *solution);

// Makes ready to track frames that come `rate_hz` times a second; anew, if it was called before. Cell k is exposed
// `exposures_s[k]` seconds after the instant of a frame; NULL: all at that instant. `count`: that of the cells.
//
// # Safety
// `solver` is NULL or an open solver that no other thread uses; `exposures_s` is NULL or has `count` numbers.
enum slitpose_result slitpose_solver_start(struct slitpose_solver *solver,
                                           double rate_hz,
                                           const double *exposures_s,
                                           size_t count);

// Solves the next frame from where the tool was and how it moved; currents as for slitpose_solver_solve(). `time_ns`: its
// instant by any clock that only goes forward, within a quarter of a period. Frames may be missing; after more than eight
// the motion is forgotten.
//
// # Safety
// That of slitpose_solver_solve().
enum slitpose_result slitpose_solver_track(struct slitpose_solver *solver,
                                           uint64_t time_ns,
                                           const double *currents_a,
                                           size_t count,
                                           struct slitpose_solution *solution);

// Forgets all frames: the next may have any instant, and is searched for anywhere.
//
// # Safety
// `solver` is NULL or an open solver that no other thread uses.
enum slitpose_result slitpose_solver_reset(struct slitpose_solver *solver);

// Moves a pose on by `later_ns`, as its velocity goes on: translation, rotation, covariance and time. Variances grow by what
// velocities are uncertain, and by what accelerations of these rms sizes may add (0: none). slitpose_predict() of
// slitpose_pose.h does the same with poses of the daemon.
//
// # Safety
// `solution` is NULL or points to one that no other thread uses.
enum slitpose_result slitpose_solution_predict(struct slitpose_solution *solution,
                                               uint64_t later_ns,
                                               double rms_m_per_s2,
                                               double rms_rad_per_s2);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* SLITPOSE_SOLVER_H */
