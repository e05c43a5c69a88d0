/* What callers do wrong has a code and a sentence, and nothing is written where nothing may be. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "slitpose_solver.h"

static struct slitpose_solver *solver;
static int failed;

static void check(int line, int holds, const char *what)
{
    if (!holds) {
        fprintf(stderr, "line %d: %s\n", line, what);
        failed = 1;
    }
}
#define CHECK(condition) check(__LINE__, condition, #condition)

/* Whether the last refusal of the solver reads so. */
static int says(const char *expected)
{
    char error[300];
    size_t length = slitpose_solver_error(solver, error, sizeof error);
    if (length == strlen(expected) && strcmp(error, expected) == 0)
        return 1;
    fprintf(stderr, "\"%s\" instead of \"%s\"\n", error, expected);
    return 0;
}

static int refuses(const char *scene, const char *calibration, const char *part)
{
    char error[300] = "";
    int refused = slitpose_solver_open(scene, calibration, error, sizeof error) == NULL && strstr(error, part) != NULL;
    if (!refused)
        fprintf(stderr, "\"%s\" instead of \"%s\"\n", error, part);
    return refused;
}

/* Arguments: a file that is no calibration, and the currents of a pose. */
int main(int argc, char **argv)
{
    double row[12], exposures_s[6] = {0};
    char name[3];
    struct slitpose_solution found;
    int i;
    for (i = 0; i < 12 && i + 2 < argc; i++)
        sscanf(argv[i + 2], "%lf", &row[i]);

    CHECK(refuses(NULL, NULL, "scene is NULL; give its address"));
    CHECK(refuses("\xff", NULL, "give it as UTF-8"));
    CHECK(refuses("missing.toml", NULL, "missing.toml"));
    CHECK(refuses("wide", argv[1], "slitpose calibrate"));
    CHECK(slitpose_solver_open("missing.toml", NULL, NULL, 0) == NULL);
    CHECK(slitpose_solver_cells(NULL) == 0 && slitpose_solver_reset(NULL) == SLITPOSE_RESULT_NULL);
    CHECK(slitpose_solver_solve(NULL, row, 12, &found) == SLITPOSE_RESULT_NULL && says("the solver is NULL; open one"));
    CHECK(slitpose_solution_predict(NULL, 1, 0, 0) == SLITPOSE_RESULT_NULL);
    slitpose_solver_close(NULL);

    solver = slitpose_solver_open("wide", NULL, NULL, 0);
    CHECK(slitpose_solver_cells(solver) == 6 && slitpose_solver_abi() == SLITPOSE_SOLVER_ABI);
    /* Cut off where the buffer ends. */
    CHECK(slitpose_solver_name(solver, name, sizeof name) > 3 && strlen(name) == 2);
    CHECK(slitpose_solver_track(solver, 0, row, 12, &found) == SLITPOSE_RESULT_NOT_STARTED);
    CHECK(slitpose_solver_reset(solver) == SLITPOSE_RESULT_NOT_STARTED);
    CHECK(says("no frame rate is known; call slitpose_solver_start() first"));
    CHECK(slitpose_solver_solve(solver, row, 11, &found) == SLITPOSE_RESULT_ARGUMENT);
    CHECK(says("11 currents_a for 6 cells; give 12"));
    CHECK(slitpose_solver_solve(solver, NULL, 12, &found) == SLITPOSE_RESULT_NULL);
    CHECK(says("currents_a is NULL; give its address"));
    CHECK(slitpose_solver_solve(solver, row, 12, NULL) == SLITPOSE_RESULT_NULL);
    CHECK(says("solution is NULL; give its address"));
    CHECK(slitpose_solver_start(solver, NAN, NULL, 0) == SLITPOSE_RESULT_ARGUMENT);
    CHECK(says("rate_hz = NaN; give 1 to 1000000 Hz"));
    CHECK(slitpose_solver_start(solver, 1000, exposures_s, 5) == SLITPOSE_RESULT_ARGUMENT);
    CHECK(says("5 exposures_s for 6 cells; give 6"));
    exposures_s[5] = 1;
    CHECK(slitpose_solver_start(solver, 1000, exposures_s, 6) == SLITPOSE_RESULT_ARGUMENT);
    CHECK(says("an exposure = 1; give seconds, at most a period"));
    CHECK(slitpose_solver_start(solver, 1000, NULL, 0) == SLITPOSE_RESULT_OK);
    CHECK(slitpose_solver_track(solver, 2000000, row, 12, &found) == SLITPOSE_RESULT_OK);
    CHECK(slitpose_solver_track(solver, 2400000, row, 12, &found) == SLITPOSE_RESULT_TIME);
    CHECK(says("2400000 ns is less than half a period after 2000000 ns; give later instants, or reset the solver"));
    CHECK(slitpose_solver_track(solver, 1000000, row, 12, &found) == SLITPOSE_RESULT_TIME);
    CHECK(slitpose_solver_reset(solver) == SLITPOSE_RESULT_OK);
    CHECK(slitpose_solver_track(solver, 1000000, row, 12, &found) == SLITPOSE_RESULT_OK && found.no_twist == 1);

    row[3] = NAN;
    CHECK(slitpose_solver_solve(solver, row, 12, &found) == SLITPOSE_RESULT_ARGUMENT);
    CHECK(says("current I_X2 of cell 1 is NaN; give amperes, 0 for a cell that was not measured"));
    /* A cell without light is left out; with five there are too few. */
    row[2] = row[3] = 0;
    CHECK(slitpose_solver_solve(solver, row, 12, &found) == SLITPOSE_RESULT_OK);
    CHECK(found.status == SLITPOSE_STATUS_DEGRADED && found.reason == SLITPOSE_REASON_FEWER_CELLS && found.cells_used == 5);
    CHECK(slitpose_solution_predict(&found, 1, 0, 0) == SLITPOSE_RESULT_NO_TWIST);
    CHECK(slitpose_solution_predict(&found, 1, -1, 0) == SLITPOSE_RESULT_ARGUMENT);
    CHECK(slitpose_solution_predict(&found, 1, 0, INFINITY) == SLITPOSE_RESULT_ARGUMENT);
    memset(row, 0, sizeof row);
    CHECK(slitpose_solver_solve(solver, row, 12, &found) == SLITPOSE_RESULT_OK);
    CHECK(found.status == SLITPOSE_STATUS_TOO_DARK && !found.has_pose && isnan(found.translation_m[0]));
    slitpose_solver_close(solver);
    return failed;
}
