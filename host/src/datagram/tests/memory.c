/* Reads poses of which every number is that of the datagram, as fast as it can: the newest and the next by turns. Prints how
   many were torn, how many came out of order, and how many different ones it saw. With no reads, what it finds. */
#define _POSIX_C_SOURCE 200809L
#include <stdio.h>
#include "slitpose_pose.h"
static int is_torn(const struct slitpose_pose *pose)
{
    const uint64_t n = pose->datagram;
    const double *number = pose->translation_m;
    int torn = pose->sequence != n || pose->device_time_ns != n || pose->host_monotonic_ns != n ||
               pose->host_utc_ns != n || pose->host_uncertainty_ns != n || pose->arrival_monotonic_ns != n ||
               pose->published_monotonic_ns != n || pose->magic != SLITPOSE_POSE_MAGIC;
    for (; number <= &pose->light_level; number++)
        torn |= *number != (double)n;
    return torn;
}
int main(int argc, char **argv)
{
    struct slitpose_link link;
    struct slitpose_pose pose;
    unsigned long long left = argc > 2 ? strtoull(argv[2], NULL, 10) : 0, torn = 0, back = 0, seen = 0, last = 0;
    if (argc < 3 || slitpose_open(&link, argv[1], NULL) < 0)
        return 1;
    if (left == 0) {
        int found = slitpose_newest(&link, &pose, 0);
        printf("generation %llu, newest %llu", (unsigned long long)slitpose_generation(&link),
               found > 0 ? (unsigned long long)pose.datagram : 0ULL);
    }
    while (left > 0) {
        int is_next = left % 2 && slitpose_receive(&link, &pose) > 0;
        if (is_next || slitpose_newest(&link, &pose, 0) > 0) {
            torn += is_torn(&pose);
            back += pose.datagram < last + is_next;
            seen += pose.datagram > last;
            last = pose.datagram;
            left--;
        }
    }
    if (seen > 0)
        printf("torn %llu, out of order %llu, different %llu", torn, back, seen);
    slitpose_close(&link);
    return 0;
}
