/* The physics of virtual_wall.c, without clocks or devices: a plane at x = position_m of the base frame, with
 * everything beyond it solid for the origin of the tool.
 *
 *     F = min(K d + B v, limit), not below 0, where the depth d > 0; else 0      (it acts towards -x)
 *
 * Between usable poses the last force is held. When none has come that is younger than oldest_s, the wall lets go:
 * the force falls to zero at limit / release_s, and comes back only after the tool has been seen outside,
 * so that no force sets in abruptly and no energy stored in the spring appears from nowhere. So it is at the start.
 */
#ifndef VIRTUAL_WALL_H
#define VIRTUAL_WALL_H

#include <math.h>

#include "slitpose_pose.h"

struct wall {
    double position_m, stiffness_n_per_m, damping_ns_per_m, limit_n;
    double oldest_s;  /* a pose this old is not used */
    double release_s; /* from the greatest force to none */
};

struct wall_state {
    int is_engaged;
    double force_n;
    uint64_t pose_ns; /* the instant of the newest usable pose; 0: none yet */
    uint64_t step_ns; /* of the last step */
};

/* Why a pose is not used. */
enum wall_input {
    WALL_USED,
    WALL_NOTHING,  /* none has come since the last step */
    WALL_NO_POSE,  /* a scan without a pose: the tool is dark, or far away */
    WALL_DEGRADED, /* a pose from fewer data than usual, or that fits them badly */
    WALL_NO_TWIST, /* no velocity to damp */
    WALL_BEHIND,   /* the daemon cannot keep up with its board */
    WALL_NO_TIME,  /* its age is unknown */
    WALL_OLD,
    WALL_INPUTS
};
static const char *const WALL_INPUT_NAMES[WALL_INPUTS] = {
    "used", "nothing came", "no pose", "degraded", "no twist", "behind", "of unknown age", "too old",
};

static inline double wall_depth_m(const struct wall *wall, const struct slitpose_pose *pose)
{
    return pose->translation_m[0] - wall->position_m;
}

/* At a depth and the velocity of penetration. */
static inline double wall_force_n(const struct wall *wall, double depth_m, double speed_m_per_s)
{
    double force_n = wall->stiffness_n_per_m * depth_m + wall->damping_ns_per_m * speed_m_per_s;
    return depth_m > 0 ? fmin(fmax(force_n, 0), wall->limit_n) : 0;
}

static inline double wall_age_s(uint64_t pose_ns, uint64_t now_ns)
{
    return now_ns > pose_ns ? (double)(now_ns - pose_ns) * 1e-9 : 0;
}

/* Whether a pose, or NULL, may move the wall's force. */
static inline enum wall_input wall_judge(const struct wall *wall, const struct slitpose_pose *pose, uint64_t now_ns)
{
    if (!pose)
        return WALL_NOTHING;
    if (!(pose->flags & SLITPOSE_HAS_POSE))
        return WALL_NO_POSE;
    if (pose->status != SLITPOSE_CONVERGED)
        return WALL_DEGRADED;
    if (!(pose->flags & SLITPOSE_HAS_TWIST))
        return WALL_NO_TWIST;
    if (pose->flags & SLITPOSE_BEHIND)
        return WALL_BEHIND;
    if (!(pose->flags & SLITPOSE_HAS_HOST_TIME))
        return WALL_NO_TIME;
    return wall_age_s(pose->host_monotonic_ns, now_ns) < wall->oldest_s ? WALL_USED : WALL_OLD;
}

/* The force for the motors from now_ns (CLOCK_MONOTONIC) on is state->force_n. */
static inline enum wall_input wall_step(const struct wall *wall, struct wall_state *state,
                                        const struct slitpose_pose *pose, uint64_t now_ns)
{
    const enum wall_input input = wall_judge(wall, pose, now_ns);
    const double step_s = state->step_ns ? wall_age_s(state->step_ns, now_ns) : 0;
    state->step_ns = now_ns;
    if (input == WALL_USED) {
        state->pose_ns = pose->host_monotonic_ns;
        if (wall_depth_m(wall, pose) <= 0)
            state->is_engaged = 1;
    } else if (wall_age_s(state->pose_ns, now_ns) >= wall->oldest_s) {
        state->is_engaged = 0;
    }
    if (!state->is_engaged)
        state->force_n = fmax(state->force_n - wall->limit_n * step_s / wall->release_s, 0);
    else if (input == WALL_USED)
        state->force_n = wall_force_n(wall, wall_depth_m(wall, pose), pose->linear_m_per_s[0]);
    return input;
}

/* Damping that the mechanism itself must have, N s/m, for the wall to be passive: b > K T/2 + |B| (Colgate and
   Schenkel, J. Robotic Systems 14 (1997) 37-47) with the period T, B acting on backward differences. A delay, here
   the age of the poses, adds K times itself. The daemon's velocity is filtered: take it as a guide. */
static inline double wall_passive_ns_per_m(const struct wall *wall, double period_s, double delay_s)
{
    return wall->stiffness_n_per_m * (period_s / 2 + delay_s) + fabs(wall->damping_ns_per_m);
}

#endif
