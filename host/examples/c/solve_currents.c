/* Poses of currents that any instrument has measured, in this process:
 *
 *     cc -O2 $(pkg-config --cflags slitpose-solver) -o solve_currents solve_currents.c $(pkg-config --libs slitpose-solver)
 *     ./solve_currents head.toml calibration.toml < currents.txt
 *     ./solve_currents wide - 1000 < currents.txt     (no calibration; lines are frames, 1000 a second)
 *
 * A line has I_X1 and I_X2 of each cell, in ampere, separated by spaces.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "slitpose_solver.h"

static const char *const STATUS[] = {"converged", "degraded", "ambiguous", "unobservable", "too_dark", "diverged"};

static void print(const struct slitpose_solution *found)
{
    const double *t = found->translation_m, *q = found->rotation_xyzw, *v = found->linear_m_per_s;
    const double *c = found->covariance;
    printf("%s %u", found->status < 6 ? STATUS[found->status] : "?", found->cells_used);
    if (found->has_pose)
        printf(" t %.17g %.17g %.17g q %.17g %.17g %.17g %.17g variance %.17g %.17g %.17g chi2 %.17g", t[0], t[1], t[2],
               q[0], q[1], q[2], q[3], c[0], c[7], c[14], found->chi2);
    if (found->has_twist)
        printf(" v %.17g %.17g %.17g", v[0], v[1], v[2]);
    printf("\n");
}

int main(int argc, char **argv)
{
    char error[1024];
    double currents_a[32];
    double rate_hz = argc > 3 ? atof(argv[3]) : 0;
    size_t count, read = 0;
    unsigned long long frame = 0;
    enum slitpose_result result = SLITPOSE_RESULT_OK;
    struct slitpose_solution found;
    struct slitpose_solver *solver;
    if (argc < 3) {
        fprintf(stderr, "usage: %s SCENE CALIBRATION|- [FRAMES_PER_SECOND]\n", argv[0]);
        return 2;
    }
    if (slitpose_solver_abi() != SLITPOSE_SOLVER_ABI) {
        fprintf(stderr, "the library is not that of the header: compile this program anew\n");
        return 1;
    }
    solver = slitpose_solver_open(argv[1], strcmp(argv[2], "-") ? argv[2] : NULL, error, sizeof error);
    if (solver == NULL) {
        fprintf(stderr, "%s\n", error);
        return 1;
    }
    count = 2 * slitpose_solver_cells(solver);
    if (argc > 3)
        result = slitpose_solver_start(solver, rate_hz, NULL, 0);
    while (result == SLITPOSE_RESULT_OK && scanf("%lf", &currents_a[read]) == 1) {
        if (++read < count)
            continue;
        read = 0;
        if (argc > 3)
            result = slitpose_solver_track(solver, (uint64_t)(1e9 / rate_hz * (double)frame++), currents_a, count, &found);
        else
            result = slitpose_solver_solve(solver, currents_a, count, &found);
        if (result == SLITPOSE_RESULT_OK)
            print(&found);
    }
    if (result != SLITPOSE_RESULT_OK) {
        slitpose_solver_error(solver, error, sizeof error);
        fprintf(stderr, "%s\n", error);
    }
    slitpose_solver_close(solver);
    return result == SLITPOSE_RESULT_OK ? 0 : 1;
}
