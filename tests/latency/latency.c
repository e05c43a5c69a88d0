/* How long poses take from the bytes of a board to a client: follows the daemon at an address,
 * receives COUNT datagrams after the first SKIP, and prints percentiles.
 *
 *     cc -O2 -std=c11 -I host/include -o latency tests/latency/latency.c
 *     ./latency unix:/run/slitpose/pose 40000 4000 [FILE]
 *
 * bytes-in to pose-out: from when the daemon's read returned to when this program's recv() did. FILE
 * gets a line for each of the COUNT: scan, number of the datagram, flags, and when it was taken (0: not
 * known), its bytes had been read, its datagram was made, and recv() returned, by CLOCK_MONOTONIC in ns.
 * Exit code 1 if nothing comes for two seconds, 2 for usage.
 */
#define _POSIX_C_SOURCE 200809L

#include <stdio.h>

#include "slitpose_pose.h"

/* What FILE gets of a pose. */
struct row {
    uint64_t sequence, datagram, at_ns[4];
    uint32_t flags;
};

static int compare(const void *a, const void *b)
{
    uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return (x > y) - (x < y);
}

static void print(const char *name, uint64_t *ns, size_t count)
{
    qsort(ns, count, sizeof *ns, compare);
    printf("%s median %.1f us, p99 %.1f us, p99.9 %.1f us, most %.1f us\n", name, ns[count / 2] / 1e3,
           ns[count - 1 - count / 100] / 1e3, ns[count - 1 - count / 1000] / 1e3, ns[count - 1] / 1e3);
}

int main(int argc, char **argv)
{
    struct slitpose_link link;
    struct slitpose_pose pose;
    size_t count = argc > 2 ? strtoul(argv[2], NULL, 10) : 0, skip = argc > 3 ? strtoul(argv[3], NULL, 10) : 0;
    size_t received = 0, kept = 0;
    int silent = 0;
    uint64_t lost = 0, last = 0, asked = 0;
    uint64_t *total = calloc(count + 1, sizeof *total), *sending = calloc(count + 1, sizeof *sending);
    struct row *rows = calloc(count + 1, sizeof *rows);
    FILE *file = argc > 4 ? fopen(argv[4], "w") : NULL;
    if (count == 0 || !total || !sending || !rows) {
        fprintf(stderr, "usage: %s unix:PATH|udp:127.0.0.1:PORT|shm:NAME COUNT [SKIP [FILE]]\n", argv[0]);
        return 2;
    }
    if (argc > 4 && !file) {
        perror(argv[4]);
        return 1;
    }
    /* Pages that are touched for the first time while poses come would count as their delay. */
    memset(rows, 1, (count + 1) * sizeof *rows);
    memset(total, 1, (count + 1) * sizeof *total);
    memset(sending, 1, (count + 1) * sizeof *sending);
    if (slitpose_open(&link, argv[1], NULL) < 0) {
        perror(argv[1]);
        return 1;
    }
    while (kept < count) {
        uint64_t now = slitpose_now_ns();
        int ready = 0;
        if (asked == 0 || now - asked > 1000000000u) {
            ready = slitpose_ask(&link, SLITPOSE_FOLLOW);
            asked = now;
        }
        if (ready == 0)
            ready = slitpose_wait(&link, 1000);
        if (ready == 0 && ++silent < 2)
            continue;
        if (ready == 0)
            errno = ETIMEDOUT;
        if (ready <= 0) {
            perror(argv[1]);
            return 1;
        }
        silent = 0;
        while (kept < count && slitpose_receive(&link, &pose) > 0) {
            now = slitpose_now_ns();
            if (last != 0)
                lost += pose.datagram - last - 1;
            last = pose.datagram;
            if (received++ < skip || !(pose.flags & SLITPOSE_HAS_ARRIVAL))
                continue;
            rows[kept].at_ns[0] = pose.host_monotonic_ns;
            rows[kept].at_ns[1] = pose.arrival_monotonic_ns;
            rows[kept].at_ns[2] = pose.published_monotonic_ns;
            rows[kept].at_ns[3] = now;
            rows[kept].sequence = pose.sequence;
            rows[kept].datagram = pose.datagram;
            rows[kept].flags = pose.flags;
            total[kept] = now - pose.arrival_monotonic_ns;
            sending[kept++] = now - pose.published_monotonic_ns;
        }
    }
    printf("datagrams %zu, lost %llu, refused by a full queue %llu\n", received, (unsigned long long)lost,
           (unsigned long long)pose.missed);
    print("bytes-in to pose-out:", total, count);
    print("of this, sending:    ", sending, count);
    for (kept = 0; file && kept < count; kept++)
        fprintf(file, "%llu %llu %u %llu %llu %llu %llu\n", (unsigned long long)rows[kept].sequence,
                (unsigned long long)rows[kept].datagram, rows[kept].flags, (unsigned long long)rows[kept].at_ns[0],
                (unsigned long long)rows[kept].at_ns[1], (unsigned long long)rows[kept].at_ns[2],
                (unsigned long long)rows[kept].at_ns[3]);
    if (file && fclose(file) != 0) {
        perror(argv[4]);
        return 1;
    }
    return 0;
}
