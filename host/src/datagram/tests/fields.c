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
int main(void)
{
    struct slitpose_pose p;
    if (fread(&p, sizeof p, 1, stdin) != 1 || p.magic != SLITPOSE_POSE_MAGIC || p.version != SLITPOSE_VERSION)
        return 1;
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
