/* A virtual wall in a loop of 4 kHz:
 *
 *     slitpose run --device sim --trajectory contact --publish unix:pose --format none &
 *     cc -O2 -std=c11 $(pkg-config --cflags slitpose-pose) -o virtual_wall virtual_wall.c -lm -pthread
 *     ./virtual_wall unix:pose --stiffness 2000 --damping 2 --duration 20 --csv wall.csv
 *
 * The loop has a clock of its own and never waits for the daemon: each period it sets a force from the newest pose
 * that has come. virtual_wall.h has the equations, and when the wall lets go: a daemon that stalls or ends leaves no
 * force behind. Against a stall of this program the motors need a watchdog of their own.
 * At the end, and after an interrupt, it prints how old the poses were (nan: none was used) and how even the loop
 * was. (A simulated board sends its scans in bursts, real ones one by one.) Exit code 1: daemon unreachable or gone,
 * or no pose; 2: usage.
 */
#define _POSIX_C_SOURCE 200809L

#include <inttypes.h>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <sys/mman.h>

#include "virtual_wall.h"

#define PERIOD_NS 250000u

/* Times by the microsecond, the last bin for all above: the loop asks for no memory. */
enum { BINS = 20000 };
struct histogram {
    uint64_t count, bins[BINS];
    double most_us;
};

static void add(struct histogram *times, double time_s)
{
    times->bins[(int)fmin(time_s * 1e6, BINS - 1)]++;
    times->count++;
    times->most_us = fmax(times->most_us, time_s * 1e6);
}

/* NAN of no times. */
static double percentile_us(const struct histogram *times, double percent)
{
    const double rank = percent / 100 * (double)times->count;
    uint64_t below = 0;
    int bin = 0;
    if (!times->count)
        return NAN;
    while (bin < BINS - 1 && (double)(below += times->bins[bin]) < rank)
        bin++;
    return bin < BINS - 1 ? fmin(bin + 0.5, times->most_us) : times->most_us;
}

static void print_times(const char *what, const struct histogram *times)
{
    printf("%s: p1 %.0f us, median %.0f us, p99 %.0f us, most %.0f us\n", what, percentile_us(times, 1),
           percentile_us(times, 50), percentile_us(times, 99), times->count ? times->most_us : NAN);
}

/* What is printed at the end. */
static struct {
    uint64_t loops, late, poses, missed, inputs[WALL_INPUTS], pushes, releases;
    double greatest_n;
    struct histogram ages, intervals;
} tally;

static void print_tally(const struct wall *wall, double duration_s)
{
    int i;
    printf("%.1f s, %" PRIu64 " loops, %" PRIu64 " late by a period or more\n", duration_s, tally.loops, tally.late);
    printf("%" PRIu64 " poses came, %" PRIu64 " were missed; loops by their newest:", tally.poses, tally.missed);
    for (i = 0; i < WALL_INPUTS; i++)
        printf("%s %s %" PRIu64, i ? "," : "", WALL_INPUT_NAMES[i], tally.inputs[i]);
    printf("\nforce in %" PRIu64 " loops, at most %.2f N; let go %" PRIu64 " times\n", tally.pushes, tally.greatest_n,
           tally.releases);
    print_times("between loops", &tally.intervals);
    print_times("age of the newest pose as the force is set", &tally.ages);
    printf("passive if the mechanism's own damping exceeds K (T/2 + age) + B = %.2f N s/m (with the p99 of age)\n",
           wall_passive_ns_per_m(wall, PERIOD_NS * 1e-9, percentile_us(&tally.ages, 99) * 1e-6));
}

static volatile sig_atomic_t interrupted;
static void interrupt(int signal_number)
{
    (void)signal_number;
    interrupted = 1;
}

/* The daemon's queue of requests was full, or all its places for followers are taken: that may pass. */
static int passes(int reason)
{
    return reason == EAGAIN || reason == EWOULDBLOCK || reason == ENOBUFS || reason == EUSERS;
}

/* Takes the newest pose. How many have come; or -1 with errno. slitpose_follow() would do, but where it finds itself
   late it waits for an answer, up to 4 ms. */
static int newest(struct slitpose_link *link, struct slitpose_pose *pose, uint64_t now)
{
    int received;
    if (link->followed_ns == 0 || now - link->followed_ns > 1000000000u) {
        if (slitpose_ask(link, SLITPOSE_FOLLOW) == 0)
            link->followed_ns = now;
        else if (!passes(errno))
            return -1;
    }
    received = slitpose_drain(link, pose);
    return received < 0 && passes(errno) ? 0 : received;
}

struct option {
    const char *name;
    double *value, least, most, unit;
};

/* 0, or -1 after a message. */
static int parse(int argc, char **argv, const struct option *options, const char **csv)
{
    int i;
    for (i = 2; i + 1 < argc; i += 2) {
        const struct option *option = options;
        char *end;
        if (strcmp(argv[i], "--csv") == 0) {
            *csv = argv[i + 1];
            continue;
        }
        while (option->name && strcmp(argv[i], option->name) != 0)
            option++;
        if (!option->name)
            break;
        const double number = strtod(argv[i + 1], &end);
        if (end == argv[i + 1] || *end != 0 || !(number >= option->least && number <= option->most)) {
            fprintf(stderr, "%s %s: a number from %g to %g\n", argv[i], argv[i + 1], option->least, option->most);
            return -1;
        }
        *option->value = number * option->unit;
    }
    if (argc >= 2 && i == argc && argv[1][0] != '-')
        return 0;
    fputs("usage: virtual_wall unix:PATH|udp:127.0.0.1:PORT|shm:NAME [--wall MM] [--stiffness N/M] [--damping NS/M] [--limit N]\n"
          "       [--oldest MS] [--release MS] [--duration S] [--realtime PRIORITY] [--csv FILE]\n", stderr);
    return -1;
}

static void be_realtime(int priority)
{
    struct sched_param parameter;
    memset(&parameter, 0, sizeof parameter);
    parameter.sched_priority = priority;
    if ((errno = pthread_setschedparam(pthread_self(), SCHED_FIFO, &parameter)) != 0)
        perror("--realtime is not granted (host/INSTALL.md has the limit), it goes on without");
    if (mlockall(MCL_CURRENT | MCL_FUTURE) != 0)
        perror("memory is not locked");
}

/* Until the time is over, or an interrupt. NULL, or why it ended. */
static const char *run(const struct wall *wall, struct slitpose_link *link, double duration_s, FILE *csv)
{
    struct wall_state state = {0, 0, 0, 0};
    struct slitpose_pose pose;
    uint8_t device[sizeof pose.device];
    uint64_t datagram = 0, newest_ns = 0, start = slitpose_now_ns(), now = start, tick = start;
    struct timespec pause = {0, 0};
    const char *fault = NULL;
    int is_ending = 0, received;
    while (!is_ending || state.force_n > 0) {
        const uint64_t before = now;
        const int was_engaged = state.is_engaged;
        enum wall_input input;
        double age_s;
        tick += PERIOD_NS;
        if (tick < now) /* The loops that follow a late one are not hurried. */
            tally.late++, tick = now;
        now = slitpose_now_ns();
        pause.tv_nsec = tick > now ? (long)(tick - now) : 0;
        nanosleep(&pause, NULL);
        /* However it ends, the wall lets go first. */
        state.is_engaged = was_engaged && !is_ending;
        received = is_ending ? 0 : newest(link, &pose, slitpose_now_ns());
        if (received < 0)
            fault = strerror(errno);
        if (received > 0 && datagram > 0 && memcmp(device, pose.device, sizeof device) != 0)
            received = 0, fault = "several boards: give slitpose_open() the id of one";
        now = slitpose_now_ns();
        input = wall_step(wall, &state, received > 0 ? &pose : NULL, now);
        /* Here state.force_n would go to the motors, towards -x. */

        is_ending = is_ending || fault || interrupted || wall_age_s(start, now) >= duration_s;
        tally.loops++;
        tally.inputs[input]++;
        tally.pushes += state.force_n > 0;
        tally.releases += was_engaged && !state.is_engaged;
        tally.greatest_n = fmax(tally.greatest_n, state.force_n);
        add(&tally.intervals, wall_age_s(before, now));
        if (received > 0) {
            tally.poses += (uint64_t)received;
            if (datagram > 0 && pose.datagram > datagram + (uint64_t)received)
                tally.missed += pose.datagram - datagram - (uint64_t)received;
            datagram = pose.datagram;
            newest_ns = pose.flags & SLITPOSE_HAS_HOST_TIME ? pose.host_monotonic_ns : 0;
            memcpy(device, pose.device, sizeof device);
        }
        age_s = newest_ns > 0 ? wall_age_s(newest_ns, now) : (double)NAN;
        if (newest_ns > 0)
            add(&tally.ages, age_s);
        if (csv)
            fprintf(csv, "%.9f,%s,%" PRIu64 ",%.9f,%.17g,%.17g,%.17g\n", wall_age_s(start, now),
                    WALL_INPUT_NAMES[input], datagram, age_s, datagram > 0 ? pose.translation_m[0] : (double)NAN,
                    datagram > 0 ? pose.linear_m_per_s[0] : (double)NAN, state.force_n);
    }
    print_tally(wall, wall_age_s(start, now));
    return fault ? fault : tally.poses == 0 ? "no pose came; `slitpose status` says what the daemon does" : NULL;
}

int main(int argc, char **argv)
{
    struct wall wall = {1e-3, 2000, 2, 10, 5e-3, 5e-3};
    double duration_s = 10, priority = 0;
    const struct option options[] = {{"--wall", &wall.position_m, -1e3, 1e3, 1e-3},
                                     {"--stiffness", &wall.stiffness_n_per_m, 0, 1e6, 1},
                                     {"--damping", &wall.damping_ns_per_m, 0, 1e4, 1},
                                     {"--limit", &wall.limit_n, 0, 1e3, 1},
                                     {"--oldest", &wall.oldest_s, 0.1, 1e6, 1e-3},
                                     {"--release", &wall.release_s, 0.1, 1e3, 1e-3},
                                     {"--duration", &duration_s, 0.01, 1e6, 1},
                                     {"--realtime", &priority, 1, 99, 1},
                                     {NULL, NULL, 0, 0, 0}};
    const char *csv = NULL, *fault;
    struct slitpose_link link;
    FILE *file = NULL;
    if (parse(argc, argv, options, &csv) < 0)
        return 2;
    if (slitpose_open(&link, argv[1], NULL) < 0)
        return perror(argv[1]), 1;
    if (csv) {
        if (!(file = fopen(csv, "w")))
            return perror(csv), 1;
        /* Written about once a second. A disk that stalls then delays the loop: prefer a file in memory. */
        setvbuf(file, NULL, _IOFBF, 1 << 19);
        fprintf(file, "time_s,input,datagram,age_s,x_m,v_m_per_s,force_n\n");
    }
    if (priority > 0)
        be_realtime((int)priority);
    signal(SIGINT, interrupt);
    signal(SIGTERM, interrupt);
    fault = run(&wall, &link, duration_s, file);
    slitpose_close(&link);
    if (fault)
        fprintf(stderr, "%s: %s\n", argv[1], fault);
    if (file && (ferror(file) | fclose(file)) != 0)
        return perror(csv), 1;
    return fault ? 1 : 0;
}
