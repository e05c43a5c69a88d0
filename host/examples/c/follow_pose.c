/* Prints poses as they come, with their age:
 *
 *     cc -O2 -std=c11 $(pkg-config --cflags slitpose-pose) -o follow_pose follow_pose.c
 *     ./follow_pose unix:/run/slitpose/pose        (or udp:127.0.0.1:7440, or shm:slitpose)
 *     ./follow_pose unix:/run/slitpose/pose 100    (ends after 100)
 */
#define _POSIX_C_SOURCE 200809L

#include <stdio.h>

#include "slitpose_pose.h"

static const char *const STATUS[] = {"converged",    "degraded", "ambiguous",
                                     "unobservable", "too_dark", "diverged"};

static void print(const struct slitpose_pose *pose)
{
    const double *t = pose->translation_m, *q = pose->rotation_xyzw, *c = pose->covariance;
    printf("scan %llu %s", (unsigned long long)pose->sequence, pose->status < 6 ? STATUS[pose->status] : "?");
    if (pose->flags & SLITPOSE_HAS_POSE)
        printf("  t %+.6f %+.6f %+.6f m  q %+.5f %+.5f %+.5f %+.5f  variance %.1e %.1e %.1e m2", t[0], t[1], t[2], q[0],
               q[1], q[2], q[3], c[0], c[7], c[14]);
    if (pose->flags & SLITPOSE_HAS_TWIST)
        printf("  v %+.4f %+.4f %+.4f m/s", pose->linear_m_per_s[0], pose->linear_m_per_s[1], pose->linear_m_per_s[2]);
    /* Without host time the age only counts from the arrival of the scan: it is at least that. */
    printf("  age %s%.0f us", pose->flags & SLITPOSE_HAS_HOST_TIME ? "" : "over ",
           (double)slitpose_age_ns(pose) / 1e3);
    printf("%s\n", pose->flags & SLITPOSE_SIMULATED ? "  simulated" : "");
}

int main(int argc, char **argv)
{
    struct slitpose_link link;
    struct slitpose_pose pose;
    long left = argc > 2 ? atol(argv[2]) : -1;
    if (argc < 2) {
        fprintf(stderr, "usage: %s unix:PATH|udp:127.0.0.1:PORT|shm:NAME [COUNT]\n", argv[0]);
        return 2;
    }
    if (slitpose_open(&link, argv[1], NULL) < 0) {
        perror(argv[1]);
        return 1;
    }
    while (left != 0) {
        int received = slitpose_follow(&link, &pose, 1000);
        if (received < 0 && errno == EUSERS) {
            fprintf(stderr, "all places for followers are taken; waiting for one\n");
            continue;
        }
        if (received < 0) {
            perror(argv[1]);
            return 1;
        }
        if (received == 0) {
            fprintf(stderr, "no pose for a second\n");
            continue;
        }
        print(&pose);
        left -= left > 0;
    }
    slitpose_close(&link);
    return 0;
}
