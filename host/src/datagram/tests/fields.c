#define _POSIX_C_SOURCE 200809L
#include <stdio.h>
#include "slitpose_pose.h"
static void list(const char *name, const double *values, int count)
{
    printf("%s", name);
    for (int i = 0; i < count; i++)
        printf(" %.17e", values[i]);
    printf("\n");
}
static int near(double found, double expected) { return fabs(found - expected) < 1e-12 * (1 + fabs(expected)); }
/* A tool at home that moves along x and turns by a quarter about z within a second, 1 s later and in two steps. */
static int predicts(struct slitpose_pose p)
{
    const double quarter = 1.5707963267948966;
    struct slitpose_pose still = p, whole, half;
    memset(p.translation_m, 0, sizeof p.translation_m);
    memset(p.rotation_xyzw, 0, sizeof p.rotation_xyzw);
    memset(p.linear_m_per_s, 0, sizeof p.linear_m_per_s);
    memset(p.angular_rad_per_s, 0, sizeof p.angular_rad_per_s);
    p.rotation_xyzw[3] = 1, p.linear_m_per_s[0] = 0.25, p.angular_rad_per_s[2] = quarter;
    p.covariance[0] = 9, p.twist_sigma[0] = 4;
    whole = half = p;
    still.flags &= ~SLITPOSE_HAS_TWIST;
    if (slitpose_predict(&still, 1, 0, 0) != -1 || slitpose_predict(&whole, 1000000000, 48, 0) != 0)
        return 0;
    slitpose_predict(&half, 400000000, 0, 0);
    slitpose_predict(&half, 600000000, 0, 0);
    return near(whole.translation_m[0], 0.25) && near(whole.rotation_xyzw[2], sin(quarter / 2)) &&
           near(whole.rotation_xyzw[3], cos(quarter / 2)) && near(half.rotation_xyzw[2], sin(quarter / 2)) &&
           near(whole.covariance[0], (3 + 4) * (3 + 4) + 24 * 24) && near(half.covariance[0], 49) &&
           whole.device_time_ns == p.device_time_ns + 1000000000;
}
int main(void)
{
    struct slitpose_pose p;
    if (fread(&p, sizeof p, 1, stdin) != 1 || p.magic != SLITPOSE_POSE_MAGIC || p.version != SLITPOSE_VERSION)
        return 1;
    if ((p.flags & SLITPOSE_HAS_TWIST) && !predicts(p))
        return 2;
    unsigned long long age_ns = slitpose_age_ns(&p);
    printf("%u %u %u %u %.12s %u %u\n", p.size, p.flags, p.status, p.cells_used, (const char *)p.device,
           p.excluded_cells, p.redundancy);
    unsigned long long n[] = {p.datagram, p.missed, p.sequence, p.device_time_ns, p.host_monotonic_ns, p.host_utc_ns,
                              p.host_uncertainty_ns, p.arrival_monotonic_ns, p.published_monotonic_ns};
    for (int i = 0; i < 9; i++)
        printf("%llu ", n[i]);
    printf("\n");
    list("t", p.translation_m, 3);
    list("q", p.rotation_xyzw, 4);
    list("c", p.covariance, 36);
    list("v", p.linear_m_per_s, 3);
    list("w", p.angular_rad_per_s, 3);
    list("s", p.twist_sigma, 6);
    list("l", &p.light_level, 1);
    printf("%llu\n", (unsigned long long)p.no_twist);
    printf("%llu\n", age_ns);
    return 0;
}
