/*
 * Poses from the slitpose daemon, for control loops in C and C++.
 *
 * The daemon sends each pose as one datagram, over a Unix socket or UDP on the same host:
 *
 *     struct slitpose_link link;
 *     struct slitpose_pose pose;
 *     if (slitpose_open(&link, "unix:/run/slitpose/pose", NULL) == 0)
 *         while (slitpose_follow(&link, &pose, 1000) > 0)
 *             if (pose.flags & SLITPOSE_HAS_POSE) ...
 *
 * Or it writes it to shared memory ("shm:NAME"), where any number of programs read it without a call to
 * the system. All functions here are the same for both.
 *
 * slitpose_follow() is for loops that wait for each pose, slitpose_newest() for loops with a pace of
 * their own. Both give the newest pose there is. Whether it is new enough is for the caller
 * to tell: see slitpose_age_ns(), and `datagram`, whose gaps are what was not received. `pose` means
 * something only after a result above 0.
 *
 * Needs nothing but POSIX, a little-endian host, and GCC or Clang: C99 or C++11. With a strict standard (-std=c11)
 * define _POSIX_C_SOURCE as 200809L ahead of all includes. Not for several threads on one link.
 */
#ifndef SLITPOSE_POSE_H
#define SLITPOSE_POSE_H

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <netinet/in.h>
#include <poll.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "datagrams are little endian: swap the bytes of every field on this host"
#endif

/* Of this file, as `pkg-config --modversion slitpose-pose` prints it. */
#define SLITPOSE_HEADER_MAJOR 0
#define SLITPOSE_HEADER_MINOR 1
#define SLITPOSE_HEADER_PATCH 0

#define SLITPOSE_POSE_MAGIC 0x50504c53u    /* "SLPP" */
#define SLITPOSE_REQUEST_MAGIC 0x51504c53u /* "SLPQ" */
#define SLITPOSE_ANSWER_MAGIC 0x41504c53u  /* "SLPA" */
#define SLITPOSE_VERSION 1u /* of the datagrams */

/* Shared memory, in words of 8 bytes. A head of 8 words: SLITPOSE_MEMORY_MAGIC, the generation. Then rings, one for each
   board: a head of 8 words, of which the first counts poses; then records. A record: its version, a pose, a word unused.
   The pose with number n, from 1, is in record (n - 1) % SLITPOSE_RECORDS, and complete while its version is 2 n. */
#define SLITPOSE_MEMORY_MAGIC 0x000000014d504c53u /* "SLPM", version 1 */
#define SLITPOSE_RINGS 8u
#define SLITPOSE_RECORDS 256u
#define SLITPOSE_RECORD_WORDS 72u
#define SLITPOSE_RING_WORDS (8u + SLITPOSE_RECORDS * SLITPOSE_RECORD_WORDS)
#define SLITPOSE_MEMORY_BYTES (8u * (8u + SLITPOSE_RINGS * SLITPOSE_RING_WORDS))

/* Of shared memory: how long slitpose_wait() sleeps between two looks, unless you define it. */
#ifndef SLITPOSE_LOOK_NS
#define SLITPOSE_LOOK_NS 50000
#endif

/* Bits of `flags`. */
#define SLITPOSE_HAS_POSE 1u      /* translation, rotation and covariance are numbers, not NaN */
#define SLITPOSE_HAS_TWIST 2u     /* so are the velocities */
#define SLITPOSE_HAS_HOST_TIME 4u /* the pose's instant is known by the host's clocks */
#define SLITPOSE_HAS_ARRIVAL 8u   /* arrival_monotonic_ns is known */
#define SLITPOSE_SIMULATED 16u    /* computed, not measured */
#define SLITPOSE_BEHIND 32u       /* scans before this one were passed over: they come faster than the daemon
                                     can solve or print them, and this was the newest */
#define SLITPOSE_IN_FRAME 64u     /* the pose is in a frame of the user, or of the tip: run --frame, --tip */

/* Values of `status`. The first two have a pose. */
enum slitpose_status {
    SLITPOSE_CONVERGED = 0,
    SLITPOSE_DEGRADED = 1, /* a pose from fewer data than usual, or that fits them badly */
    SLITPOSE_AMBIGUOUS = 2,
    SLITPOSE_UNOBSERVABLE = 3,
    SLITPOSE_TOO_DARK = 4,
    SLITPOSE_DIVERGED = 5
};

/* One pose. SI units, frame base_from_tool: p_base = R p_tool + t. Times in ns; monotonic ones are
   CLOCK_MONOTONIC. What is not known is 0 or NaN, and its flag is clear. */
struct slitpose_pose {
    uint32_t magic;
    uint16_t version;
    uint16_t size; /* of the datagram; fields may be added at its end */
    uint32_t flags;
    uint16_t status;
    uint16_t cells_used;
    uint8_t device[12];      /* id of the board */
    uint16_t excluded_cells; /* bit k: cell k contradicts all others and was left out */
    uint16_t redundancy;     /* data minus unknowns */
    uint64_t datagram;       /* counts the datagrams of the board, from 1 */
    uint64_t missed;         /* how many your full queue refused since you follow, or were overwritten in shared
                                memory before you took them; of UDP unknown */
    uint64_t sequence;       /* counts the scans of the board */
    uint64_t device_time_ns; /* the instant the pose refers to, by the board's clock */
    uint64_t host_monotonic_ns; /* the same instant */
    uint64_t host_utc_ns;       /* the same instant, since 1970 */
    uint64_t host_uncertainty_ns;
    uint64_t arrival_monotonic_ns;   /* the daemon had read the scan */
    uint64_t published_monotonic_ns; /* the datagram was made */
    double translation_m[3];
    double rotation_xyzw[4];
    double covariance[36]; /* of (t, theta), row-major; t' = t + dt, R' = exp(dtheta) R */
    double linear_m_per_s[3];
    double angular_rad_per_s[3];
    double twist_sigma[6]; /* standard deviations of the six */
    double light_level;    /* of all light, relative to scene or calibration */
    uint64_t no_twist;     /* why a pose has no velocity: see slitpose_no_twist */
};

/* Values of `no_twist`. */
enum slitpose_no_twist {
    SLITPOSE_TWIST_KNOWN = 0, /* or no pose */
    SLITPOSE_TWIST_START = 1, /* too few poses yet */
    SLITPOSE_TWIST_JUMP = 2   /* the tool is not where its motion led: it has hit something, or the pose is wrong */
};

/* What is sent to the daemon. */
struct slitpose_request {
    uint32_t magic;
    uint16_t version;
    uint16_t size;
    uint16_t mode;
    uint16_t zero;
    uint8_t device[12]; /* all zero: every board */
    uint64_t cookie;    /* of the last answer, or 0 */
};

/* What the daemon says besides poses. */
struct slitpose_answer {
    uint32_t magic;
    uint16_t version;
    uint16_t size;
    uint16_t kind;
    uint16_t zero;
    uint32_t zero_too;
    uint64_t cookie;
};

enum slitpose_answer_kind {
    SLITPOSE_PROVE = 1,   /* not served: ask again with this cookie, which proves your UDP address */
    SLITPOSE_REFUSED = 2, /* not served: all places for followers are taken; ask again each second */
    SLITPOSE_RENEW = 3    /* served; use this cookie from now on */
};

enum slitpose_mode {
    SLITPOSE_NEWEST = 1, /* the newest datagram of each board, once */
    SLITPOSE_FOLLOW = 2  /* all datagrams for 3 s; ask again each second */
};

#define SLITPOSE_CHECK(name, condition) typedef char slitpose_check_##name[(condition) ? 1 : -1]
#define SLITPOSE_CHECK_AT(field, offset) SLITPOSE_CHECK(field, offsetof(struct slitpose_pose, field) == (offset))
SLITPOSE_CHECK_AT(size, 6);
SLITPOSE_CHECK_AT(flags, 8);
SLITPOSE_CHECK_AT(status, 12);
SLITPOSE_CHECK_AT(device, 16);
SLITPOSE_CHECK_AT(excluded_cells, 28);
SLITPOSE_CHECK_AT(datagram, 32);
SLITPOSE_CHECK_AT(missed, 40);
SLITPOSE_CHECK_AT(sequence, 48);
SLITPOSE_CHECK_AT(device_time_ns, 56);
SLITPOSE_CHECK_AT(host_monotonic_ns, 64);
SLITPOSE_CHECK_AT(host_utc_ns, 72);
SLITPOSE_CHECK_AT(host_uncertainty_ns, 80);
SLITPOSE_CHECK_AT(arrival_monotonic_ns, 88);
SLITPOSE_CHECK_AT(published_monotonic_ns, 96);
SLITPOSE_CHECK_AT(translation_m, 104);
SLITPOSE_CHECK_AT(rotation_xyzw, 128);
SLITPOSE_CHECK_AT(covariance, 160);
SLITPOSE_CHECK_AT(linear_m_per_s, 448);
SLITPOSE_CHECK_AT(angular_rad_per_s, 472);
SLITPOSE_CHECK_AT(twist_sigma, 496);
SLITPOSE_CHECK_AT(light_level, 544);
SLITPOSE_CHECK_AT(no_twist, 552);
SLITPOSE_CHECK(pose_bytes, sizeof(struct slitpose_pose) == 560);
SLITPOSE_CHECK(request_bytes, sizeof(struct slitpose_request) == 32);
SLITPOSE_CHECK(answer_bytes, sizeof(struct slitpose_answer) == 24);

/* Sockets to and from the daemon, or its shared memory. */
struct slitpose_link {
    int fd;               /* non-blocking; readable when a datagram waits: for poll() and its like, not with memory */
    int ask_fd;           /* requests leave here */
    int far_fd;           /* the other end of fd, which the daemon gets with each request; -1 on UDP */
    uint64_t followed_ns; /* when datagrams were last asked for; 0: not yet */
    uint64_t cookie;      /* proves to the daemon that this socket receives */
    uint16_t mode;        /* what was asked for last */
    uint8_t device[12];
    const uint64_t *memory; /* NULL: sockets */
    uint64_t taken[SLITPOSE_RINGS]; /* poses of each ring that were taken */
    uint64_t missed;                /* poses that were overwritten before they were taken */
};

/* CLOCK_MONOTONIC. */
static inline uint64_t slitpose_now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000000u + (uint64_t)now.tv_nsec;
}

/* How old a pose is: since its instant; where that is not known (no SLITPOSE_HAS_HOST_TIME), at least
   this old: since the daemon had read the scan; where that is not known either, since it was sent. */
static inline uint64_t slitpose_age_ns(const struct slitpose_pose *pose)
{
    uint64_t now = slitpose_now_ns(), since = pose->published_monotonic_ns;
    if (pose->flags & SLITPOSE_HAS_HOST_TIME)
        since = pose->host_monotonic_ns;
    else if (pose->flags & SLITPOSE_HAS_ARRIVAL)
        since = pose->arrival_monotonic_ns;
    return now > since ? now - since : 0;
}

static inline void slitpose_close(struct slitpose_link *link)
{
    if (link->ask_fd != link->fd)
        close(link->ask_fd);
    if (link->far_fd >= 0)
        close(link->far_fd);
    if (link->fd >= 0)
        close(link->fd);
    if (link->memory)
        munmap((void *)(uintptr_t)link->memory, SLITPOSE_MEMORY_BYTES);
    link->memory = NULL;
    link->fd = link->ask_fd = link->far_fd = -1;
}

/* Count of the poses in a ring of shared memory. */
static inline uint64_t slitpose_count(const struct slitpose_link *link, unsigned ring)
{
    return __atomic_load_n(link->memory + 8 + ring * SLITPOSE_RING_WORDS, __ATOMIC_ACQUIRE);
}

/* Copies a pose from shared memory, as a sequence lock: the daemon never waits for who copies. 1; 0 if the
   ring has no pose with this number; or -1 if it was overwritten. Only after 1 `pose` has changed. */
static inline int slitpose_copy(const struct slitpose_link *link, unsigned ring, uint64_t number,
                                struct slitpose_pose *pose)
{
    const uint64_t *record = link->memory + 8 + ring * SLITPOSE_RING_WORDS + 8 +
                             (number - 1) % SLITPOSE_RECORDS * SLITPOSE_RECORD_WORDS;
    uint64_t words[sizeof *pose / sizeof(uint64_t)];
    const uint64_t version = __atomic_load_n(record, __ATOMIC_ACQUIRE);
    size_t i;
    if (version != 2 * number)
        return version < 2 * number ? 0 : -1;
    for (i = 0; i < sizeof *pose / sizeof(uint64_t); i++)
        words[i] = __atomic_load_n(record + 1 + i, __ATOMIC_RELAXED);
    /* No word is read after the version. */
    __atomic_thread_fence(__ATOMIC_ACQUIRE);
    if (__atomic_load_n(record, __ATOMIC_RELAXED) != version)
        return -1;
    memcpy(pose, words, sizeof *pose);
    return 1;
}

/* Whether poses of this board were asked for. */
static inline int slitpose_is_wanted(const struct slitpose_link *link, const struct slitpose_pose *pose)
{
    static const uint8_t all[12] = {0};
    return memcmp(link->device, all, sizeof all) == 0 || memcmp(link->device, pose->device, sizeof all) == 0;
}

/* Of shared memory: how many daemons have begun to write it. A change shows that the daemon was started again:
   poses go on in the same memory, and are counted from 1. 0 with sockets. */
static inline uint64_t slitpose_generation(const struct slitpose_link *link)
{
    return link->memory ? __atomic_load_n(link->memory + 1, __ATOMIC_ACQUIRE) : 0;
}

/* Of shared memory: 0 while a daemon writes it; or -1 with errno, ECONNREFUSED if none does. The daemon holds a lock
   on the file, which the kernel releases however it ends; this only asks for it. */
static inline int slitpose_is_written(const struct slitpose_link *link)
{
    struct flock lock;
    memset(&lock, 0, sizeof lock);
    lock.l_type = F_RDLCK;
    lock.l_whence = SEEK_SET;
    if (fcntl(link->fd, F_GETLK, &lock) < 0)
        return -1;
    if (lock.l_type != F_UNLCK && slitpose_generation(link) > 0)
        return 0;
    errno = ECONNREFUSED;
    return -1;
}

/* Maps the shared memory called `name`: in /dev/shm, or a path if it has a slash. 0, or -1 with errno. */
static inline int slitpose_map(struct slitpose_link *link, const char *name)
{
    char path[4096];
    struct stat found;
    void *memory = MAP_FAILED;
    unsigned ring;
    int reason = EINVAL;
    const char *folder = strchr(name, '/') ? "" : "/dev/shm/";
    if (*name && strlen(folder) + strlen(name) < sizeof path) {
        memcpy(path, folder, strlen(folder) + 1);
        memcpy(path + strlen(folder), name, strlen(name) + 1);
        link->fd = link->ask_fd = open(path, O_RDONLY | O_CLOEXEC);
        if (link->fd < 0)
            return -1;
        /* Of another size it would be no memory of this version, and reading it could end this program. */
        if (fstat(link->fd, &found) == 0 && found.st_size == (off_t)SLITPOSE_MEMORY_BYTES)
            memory = mmap(NULL, SLITPOSE_MEMORY_BYTES, PROT_READ, MAP_SHARED, link->fd, 0);
        if (memory != MAP_FAILED) {
            link->memory = (const uint64_t *)memory;
            reason = *link->memory != SLITPOSE_MEMORY_MAGIC ? EINVAL : slitpose_is_written(link) < 0 ? errno : 0;
        }
    }
    for (ring = 0; reason == 0 && ring < SLITPOSE_RINGS; ring++)
        link->taken[ring] = slitpose_count(link, ring);
    if (reason == 0)
        return 0;
    slitpose_close(link);
    errno = reason;
    return -1;
}

/* Connects to "unix:PATH" or "udp:127.0.0.1:PORT", or maps "shm:NAME", for the board with this id or, if NULL, for
   all. 0, or -1 with errno: ECONNREFUSED if no daemon serves it. On other systems than Linux only UDP. */
static inline int slitpose_open(struct slitpose_link *link, const char *address, const uint8_t device[12])
{
    union {
        struct sockaddr any;
        struct sockaddr_un local;
        struct sockaddr_in internet;
    } daemon;
    socklen_t length;
    int failed = 0;
    memset(&daemon, 0, sizeof daemon);
    memset(link, 0, sizeof *link);
    link->fd = link->ask_fd = link->far_fd = -1;
    if (device)
        memcpy(link->device, device, sizeof link->device);
#ifndef __linux__
    if (strncmp(address, "unix:", 5) == 0 || strncmp(address, "shm:", 4) == 0) {
        errno = ENOTSUP;
        return -1;
    }
#endif
    if (strncmp(address, "shm:", 4) == 0)
        return slitpose_map(link, address + 4);
    if (strncmp(address, "unix:", 5) == 0 && strlen(address + 5) < sizeof daemon.local.sun_path) {
        daemon.local.sun_family = AF_UNIX;
        memcpy(daemon.local.sun_path, address + 5, strlen(address + 5));
        length = (socklen_t)sizeof daemon.local;
    } else if (strncmp(address, "udp:", 4) == 0) {
        char host[16] = {0};
        const char *port = strrchr(address, ':');
        size_t letters = (size_t)(port - address);
        if (letters > 4 && letters - 4 < sizeof host)
            memcpy(host, address + 4, letters - 4);
        daemon.internet.sin_family = AF_INET;
        daemon.internet.sin_port = htons((uint16_t)strtoul(port + 1, NULL, 10));
        length = (socklen_t)sizeof daemon.internet;
        if (inet_pton(AF_INET, host, &daemon.internet.sin_addr) != 1)
            length = 0;
    } else {
        length = 0;
    }
    if (length == 0) {
        errno = EINVAL;
        return -1;
    }
    link->ask_fd = socket(daemon.any.sa_family, SOCK_DGRAM, 0);
    if (link->ask_fd < 0)
        return -1;
    link->fd = link->ask_fd;
    if (daemon.any.sa_family == AF_UNIX) {
        /* A queue of its own: from one socket for all clients, one that stops reading would silence the others. */
        int pair[2] = {-1, -1};
        failed = socketpair(AF_UNIX, SOCK_DGRAM, 0, pair);
        link->fd = pair[0];
        link->far_fd = pair[1];
        failed = failed != 0 || fcntl(link->far_fd, F_SETFD, FD_CLOEXEC) != 0 ||
                 fcntl(link->ask_fd, F_SETFL, O_NONBLOCK) != 0 || fcntl(link->ask_fd, F_SETFD, FD_CLOEXEC) != 0;
    }
    failed = failed || fcntl(link->fd, F_SETFL, O_NONBLOCK) != 0 || fcntl(link->fd, F_SETFD, FD_CLOEXEC) != 0 ||
             connect(link->ask_fd, &daemon.any, length) != 0;
    if (failed) {
        int reason = errno;
        slitpose_close(link);
        errno = reason;
        return -1;
    }
    return 0;
}

/* Asks for datagrams; with shared memory only whether it is written. 0, or -1 with errno: ECONNREFUSED if the daemon
   has gone. */
static inline int slitpose_ask(struct slitpose_link *link, enum slitpose_mode mode)
{
    struct slitpose_request request;
    struct iovec bytes;
    struct msghdr message;
    union {
        struct cmsghdr header; /* aligns the room */
        char room[CMSG_SPACE(sizeof(int))];
    } control;
    if (link->memory)
        return slitpose_is_written(link);
    memset(&request, 0, sizeof request);
    memset(&message, 0, sizeof message);
    memset(&control, 0, sizeof control);
    request.magic = SLITPOSE_REQUEST_MAGIC;
    request.version = SLITPOSE_VERSION;
    request.size = (uint16_t)sizeof request;
    request.mode = (uint16_t)mode;
    request.cookie = link->cookie;
    link->mode = request.mode;
    memcpy(request.device, link->device, sizeof request.device);
    bytes.iov_base = &request;
    bytes.iov_len = sizeof request;
    message.msg_iov = &bytes;
    message.msg_iovlen = 1;
    if (link->far_fd >= 0) {
        control.header.cmsg_level = SOL_SOCKET;
        control.header.cmsg_type = SCM_RIGHTS;
        control.header.cmsg_len = CMSG_LEN(sizeof(int));
        message.msg_control = &control;
        message.msg_controllen = CMSG_SPACE(sizeof(int));
        memcpy(CMSG_DATA(&control.header), &link->far_fd, sizeof(int));
    }
    return sendmsg(link->ask_fd, &message, 0) == (ssize_t)sizeof request ? 0 : -1;
}

/* slitpose_receive() from shared memory. It makes no call to the system. */
static inline int slitpose_take(struct slitpose_link *link, struct slitpose_pose *pose)
{
    unsigned ring;
    for (ring = 0; ring < SLITPOSE_RINGS; ring++) {
        uint64_t count = slitpose_count(link, ring), *taken = &link->taken[ring];
        if (count - *taken > SLITPOSE_RECORDS) {
            link->missed += count - *taken - SLITPOSE_RECORDS;
            *taken = count - SLITPOSE_RECORDS;
        }
        while (*taken != count) {
            const int copied = slitpose_copy(link, ring, ++*taken, pose);
            link->missed += copied < 0;
            if (copied <= 0 || !slitpose_is_wanted(link, pose))
                continue;
            pose->missed = link->missed;
            return 1;
        }
    }
    return 0;
}

/* Takes the next pose that waits, and does what the daemon asks for besides. 1; 0 if none does; or -1 with errno:
   EUSERS if all places for followers are taken; those who ask again each second get the next that is free. */
static inline int slitpose_receive(struct slitpose_link *link, struct slitpose_pose *pose)
{
    struct slitpose_answer answer;
    if (link->memory)
        return slitpose_take(link, pose);
    for (;;) {
        ssize_t bytes = recv(link->fd, pose, sizeof *pose, 0);
        if (bytes < 0 && errno == EINTR)
            continue;
        if (bytes < 0)
            return errno == EAGAIN || errno == EWOULDBLOCK ? 0 : -1;
        if (bytes == (ssize_t)sizeof *pose && pose->magic == SLITPOSE_POSE_MAGIC &&
            pose->version == SLITPOSE_VERSION && pose->size >= sizeof *pose)
            return 1;
        memcpy(&answer, pose, sizeof answer);
        if (bytes != (ssize_t)sizeof answer || answer.magic != SLITPOSE_ANSWER_MAGIC ||
            answer.version != SLITPOSE_VERSION)
            continue;
        if (answer.kind == SLITPOSE_REFUSED) {
            errno = EUSERS;
            return -1;
        }
        link->cookie = answer.cookie;
        if (answer.kind == SLITPOSE_PROVE && slitpose_ask(link, (enum slitpose_mode)link->mode) < 0)
            return -1;
    }
}

/* Of shared memory: sleeps until the next look at it. Returns whether there is time left for one. */
static inline int slitpose_sleep(uint64_t since_ns, int timeout_ms)
{
    struct timespec pause;
    if (timeout_ms >= 0 && slitpose_now_ns() - since_ns >= (uint64_t)timeout_ms * 1000000u)
        return 0;
    pause.tv_sec = 0;
    pause.tv_nsec = SLITPOSE_LOOK_NS;
    nanosleep(&pause, NULL);
    return 1;
}

/* Waits until a datagram can be received. 1; 0 if none came in time; or -1 with errno. Shared memory is looked at
   every SLITPOSE_LOOK_NS, and what the system adds to a sleep. */
static inline int slitpose_wait(struct slitpose_link *link, int timeout_ms)
{
    struct pollfd waiting;
    const uint64_t since_ns = link->memory ? slitpose_now_ns() : 0;
    unsigned ring;
    while (link->memory) {
        for (ring = 0; ring < SLITPOSE_RINGS; ring++)
            if (slitpose_count(link, ring) != link->taken[ring])
                return 1;
        if (!slitpose_sleep(since_ns, timeout_ms))
            return slitpose_is_written(link);
    }
    waiting.fd = link->fd;
    waiting.events = POLLIN;
    waiting.revents = 0;
    return poll(&waiting, 1, timeout_ms);
}

/* Takes all datagrams that wait and keeps the newest. How many, or -1 with errno. */
static inline int slitpose_drain(struct slitpose_link *link, struct slitpose_pose *pose)
{
    struct slitpose_pose next;
    int received = slitpose_receive(link, pose), count = received;
    while (received > 0 && (received = slitpose_receive(link, &next)) > 0) {
        if (next.published_monotonic_ns >= pose->published_monotonic_ns)
            *pose = next;
        count++;
    }
    return received < 0 ? -1 : count;
}

/* slitpose_newest() from shared memory. It makes no call to the system. */
static inline int slitpose_last(struct slitpose_link *link, struct slitpose_pose *pose)
{
    struct slitpose_pose next;
    unsigned ring;
    int found = 0;
    for (ring = 0; ring < SLITPOSE_RINGS; ring++) {
        /* Overwritten while it was copied: so late is only who was interrupted, and hardly twice. */
        int copied = -1, turn;
        for (turn = 0; copied < 0 && turn < 8; turn++)
            copied = slitpose_copy(link, ring, link->taken[ring] = slitpose_count(link, ring), &next);
        if (copied > 0 && slitpose_is_wanted(link, &next) &&
            (!found || next.published_monotonic_ns > pose->published_monotonic_ns)) {
            *pose = next;
            pose->missed = link->missed;
            found = 1;
        }
    }
    return found;
}

/* Asks for the newest pose and waits for the answer, some 50 us. 1; 0 if none came in time: the
   daemon has no board yet; or -1 with errno. With several boards, the one that sent last. From shared memory it
   comes at once, also after a daemon that was killed: its age shows that. */
static inline int slitpose_newest(struct slitpose_link *link, struct slitpose_pose *pose, int timeout_ms)
{
    const uint64_t since_ns = link->memory ? slitpose_now_ns() : 0;
    int ready, turn;
    while (link->memory) {
        if (slitpose_last(link, pose))
            return 1;
        if (!slitpose_sleep(since_ns, timeout_ms))
            return slitpose_is_written(link);
    }
    if (slitpose_drain(link, pose) < 0 || slitpose_ask(link, SLITPOSE_NEWEST) < 0)
        return -1;
    /* The first answer may be a cookie, which has been sent back then. */
    for (turn = 0; turn < 2; turn++) {
        ready = slitpose_wait(link, timeout_ms);
        if (ready <= 0)
            return ready;
        ready = slitpose_drain(link, pose);
        if (ready != 0)
            break;
    }
    return ready > 1 ? 1 : ready;
}

/* Waits for a pose, passes over older ones, and asks for the next ones in time, also while it waits:
   for ever if the timeout is negative. 1; 0 if none came in time; or -1 with errno: EUSERS if all places
   for followers are taken, after which it may be called again. A queue holds
   some hundred: whoever is so late that the newest were refused is given them at once. */
static inline int slitpose_follow(struct slitpose_link *link, struct slitpose_pose *pose, int timeout_ms)
{
    const uint64_t late_ns = 1000000, renewal_ns = 1000000000;
    const int renewal_ms = 1000;
    struct slitpose_pose newer;
    uint64_t now = slitpose_now_ns();
    const uint64_t until = now + (uint64_t)(timeout_ms < 0 ? 0 : timeout_ms) * 1000000u;
    int count, left_ms;
    do {
        if (link->followed_ns == 0 || now - link->followed_ns > renewal_ns) {
            if (slitpose_ask(link, SLITPOSE_FOLLOW) < 0)
                return -1;
            link->followed_ns = now;
        }
        left_ms = timeout_ms < 0 || until > now + renewal_ns ? renewal_ms
                  : until > now                              ? (int)((until - now + 999999u) / 1000000u)
                                                             : 0;
        count = slitpose_wait(link, left_ms);
        /* What waits may be no pose. */
        count = count > 0 ? slitpose_drain(link, pose) : count;
        now = slitpose_now_ns();
    } while (count == 0 && (timeout_ms < 0 || now < until));
    if (count > 1 && slitpose_now_ns() - pose->published_monotonic_ns > late_ns &&
        slitpose_newest(link, &newer, 2) > 0 && newer.published_monotonic_ns > pose->published_monotonic_ns) {
        newer.missed = pose->missed;
        *pose = newer;
    }
    return count > 1 ? 1 : count;
}

/* Moves a pose on by `later_ns`, as its velocity goes on: translation, rotation, covariance and times. Variances grow by
   what velocities are uncertain, and by what accelerations of these rms sizes may add (0: none). 0; or -1 without a pose or
   a velocity. host/guide/application.md has its errors. Who calls it links with -lm. */
static inline int slitpose_predict(struct slitpose_pose *pose, uint64_t later_ns, double rms_m_per_s2,
                                   double rms_rad_per_s2)
{
    const double t = (double)later_ns * 1e-9, *w = pose->angular_rad_per_s;
    const double half = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]) * t / 2;
    const double factor = half > 0 ? sin(half) / half * t / 2 : 0, scalar = cos(half);
    double p[4];
    int i;
    if (!(pose->flags & SLITPOSE_HAS_POSE) || !(pose->flags & SLITPOSE_HAS_TWIST))
        return -1;
    memcpy(p, pose->rotation_xyzw, sizeof p);
    for (i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        pose->translation_m[i] += pose->linear_m_per_s[i] * t;
        pose->rotation_xyzw[i] = scalar * p[i] + factor * (w[i] * p[3] + w[j] * p[k] - w[k] * p[j]);
    }
    pose->rotation_xyzw[3] = scalar * p[3] - factor * (w[0] * p[0] + w[1] * p[1] + w[2] * p[2]);
    for (i = 0; i < 6; i++) {
        /* Errors of a pose and of its velocity may go together. */
        const double sigma = sqrt(pose->covariance[7 * i]) + pose->twist_sigma[i] * t;
        const double bend = (i < 3 ? rms_m_per_s2 : rms_rad_per_s2) * t * t / 2;
        pose->covariance[7 * i] = sigma * sigma + bend * bend;
    }
    pose->device_time_ns += later_ns;
    if (pose->flags & SLITPOSE_HAS_HOST_TIME) {
        pose->host_monotonic_ns += later_ns;
        pose->host_utc_ns += later_ns;
    }
    return 0;
}

#endif
