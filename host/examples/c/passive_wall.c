/* How stiff a virtual wall may be, by the rate of its loop and the age of its poses: simulated with the force of
 * virtual_wall.h, beside the condition of passivity.
 *
 *     cc -O2 -std=c11 $(pkg-config --cflags slitpose-pose) -o passive_wall passive_wall.c -lm
 *     ./passive_wall --mass 0.1 --damping 2
 *
 * A mechanism with a mass and viscous damping of its own is pushed into the wall by a constant force of 1 N: a hand that
 * neither helps nor disturbs, which is hard for a wall. Its loop has exact poses of one age. A stiffness counts as stable if the
 * swings of two seconds die out. A passive wall is stable with every hand, and so the formula stays below.
 */
#define _POSIX_C_SOURCE 200809L

#include <stdio.h>

#include "virtual_wall.h"

/* Of the mechanism's motion. */
#define STEP_S 5e-6
#define DURATION_S 2.0
#define PUSH_N 1.0

/* Steps whose motion is kept: no pose is older. */
enum { KEPT = 4096 };

struct mechanism {
    double mass_kg, damping_ns_per_m;
};

/* Whether the swings of the mechanism in the wall die out. */
static int is_stable(const struct mechanism *mechanism, const struct wall *wall, double period_s, double age_s)
{
    static double x_m[KEPT], v_m_per_s[KEPT];
    const long steps = lround(DURATION_S / STEP_S), late = lround(age_s / STEP_S);
    struct wall_state state = {0, 0, 0, 0};
    struct slitpose_pose pose;
    double x = -1e-3, v = 0.1, due_s = 0, low[2] = {1e9, 1e9}, high[2] = {-1e9, -1e9};
    long i;
    memset(&pose, 0, sizeof pose);
    pose.flags = SLITPOSE_HAS_POSE | SLITPOSE_HAS_TWIST | SLITPOSE_HAS_HOST_TIME;
    for (i = 0; i < steps; i++) {
        const double now_s = (double)i * STEP_S, share = now_s / DURATION_S;
        x_m[i % KEPT] = x, v_m_per_s[i % KEPT] = v;
        if (now_s >= due_s && i >= late) {
            due_s += period_s;
            pose.translation_m[0] = x_m[(i - late) % KEPT];
            pose.linear_m_per_s[0] = v_m_per_s[(i - late) % KEPT];
            pose.host_monotonic_ns = 1 + (uint64_t)((now_s - age_s) * 1e9);
            wall_step(wall, &state, &pose, 1 + (uint64_t)(now_s * 1e9));
        }
        v += (PUSH_N - state.force_n - mechanism->damping_ns_per_m * v) / mechanism->mass_kg * STEP_S;
        x += v * STEP_S;
        if (!(fabs(x) < 1))
            return 0;
        if (share >= 0.5) {
            const int half = share >= 0.75;
            low[half] = fmin(low[half], x), high[half] = fmax(high[half], x);
        }
    }
    /* It rests, or will. */
    return high[1] - low[1] < 1e-7 || high[1] - low[1] < 0.98 * (high[0] - low[0]);
}

/* The greatest stiffness up to which walls are stable, in steps of a fiftieth from a tenth of the passive one on. */
static double stiffest_n_per_m(const struct mechanism *mechanism, double damping_ns_per_m, double period_s, double age_s)
{
    struct wall wall = {0, 0, damping_ns_per_m, 1e9, 1, 1};
    double stiffest = 0;
    wall.stiffness_n_per_m = mechanism->damping_ns_per_m / (period_s / 2 + age_s) / 10;
    while (is_stable(mechanism, &wall, period_s, age_s)) {
        stiffest = wall.stiffness_n_per_m;
        wall.stiffness_n_per_m *= 1.02;
    }
    return stiffest;
}

int main(int argc, char **argv)
{
    static const double RATES_HZ[] = {1e3, 4e3, 8e3}, AGES_S[] = {0.3e-3, 0.5e-3, 1e-3, 2e-3};
    struct mechanism mechanism = {0.1, 2};
    double damping_ns_per_m = 0;
    int i, j;
    for (i = 1; i + 1 < argc; i += 2) {
        double *value = strcmp(argv[i], "--mass") == 0             ? &mechanism.mass_kg
                        : strcmp(argv[i], "--damping") == 0        ? &mechanism.damping_ns_per_m
                        : strcmp(argv[i], "--wall-damping") == 0   ? &damping_ns_per_m
                                                                   : NULL;
        if (!value || !((*value = atof(argv[i + 1])) >= 0))
            break;
    }
    if (i < argc || !(mechanism.mass_kg > 0)) {
        fputs("usage: passive_wall [--mass KG] [--damping NS/M] [--wall-damping NS/M]\n", stderr);
        return 2;
    }
    printf("mechanism of %g kg and %g N s/m, wall of %g N s/m: stiffest wall, N/m\n", mechanism.mass_kg,
           mechanism.damping_ns_per_m, damping_ns_per_m);
    puts("rate, Hz  age, ms  passive  stable");
    for (i = 0; i < 3; i++) {
        for (j = 0; j < 4; j++) {
            const double period_s = 1 / RATES_HZ[i];
            const struct wall unit = {0, 1, 0, 1e9, 1, 1};
            const double left_ns_per_m = mechanism.damping_ns_per_m - damping_ns_per_m;
            const double passive = left_ns_per_m / wall_passive_ns_per_m(&unit, period_s, AGES_S[j]);
            const double stable = stiffest_n_per_m(&mechanism, damping_ns_per_m, period_s, AGES_S[j]);
            printf("%8g  %7g  %7.0f  %6.0f\n", RATES_HZ[i], AGES_S[j] * 1e3, passive, stable);
        }
    }
    return 0;
}
