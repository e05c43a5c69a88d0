/*
 * Frames of poses from a slitpose board, for a motor controller: C99 or C++11, nothing but a compiler.
 *
 *     static struct slitpose_receiver receiver;
 *     struct slitpose_frame frame;
 *     for each byte that comes:
 *         if (slitpose_receive(&receiver, byte, &frame) && slitpose_has_pose(&frame)) ...
 *
 * firmware/src/pose/frame.rs in the project describes the bytes, what each status asks of a controller, how old a pose
 * is, and what is not promised. Use a timeout as well: a board that stops sends nothing.
 */
#ifndef SLITPOSE_FRAME_H
#define SLITPOSE_FRAME_H

#include <stdint.h>
#include <string.h>

#define SLITPOSE_FRAME_BYTES 64
#define SLITPOSE_FRAME_VERSION 1
#define SLITPOSE_TICKS_PER_SECOND 170000000u

/* Values of `status`; up to SLITPOSE_FRAME_MISFIT there is a pose. */
enum slitpose_frame_status {
    SLITPOSE_FRAME_CONVERGED = 0,
    SLITPOSE_FRAME_FEWER_CELLS = 1,
    SLITPOSE_FRAME_CELL_EXCLUDED = 2,
    SLITPOSE_FRAME_MISFIT = 3,
    SLITPOSE_FRAME_AMBIGUOUS = 4,
    SLITPOSE_FRAME_UNOBSERVABLE = 5,
    SLITPOSE_FRAME_TOO_DARK = 6,
    SLITPOSE_FRAME_DIVERGED = 7
};

/* One pose: p_base = R p_tool + t. Without a pose its numbers are NaN. */
struct slitpose_frame {
    uint8_t status;
    uint32_t sequence;       /* of the scan, low half */
    uint32_t tick;           /* device time of the start of its frame, low half */
    uint32_t ready_ticks;    /* from then to the pose, in steps of 64 */
    uint16_t unsent;         /* frames that were not sent or cut short, since reset */
    uint16_t cells_used;     /* bit k: cell k */
    uint16_t excluded_cells; /* left out because they contradict all others */
    float translation_m[3];
    float rotation_xyzw[4];
    float sigma_m;   /* of the translation and of the rotation: in no direction more */
    float sigma_rad;
    float chi2;
};

/* All zero to begin with. */
struct slitpose_receiver {
    uint8_t bytes[SLITPOSE_FRAME_BYTES];
    uint8_t length;
};

static inline uint32_t slitpose_frame_word(const uint8_t *bytes)
{
    return (uint32_t)bytes[0] | (uint32_t)bytes[1] << 8 | (uint32_t)bytes[2] << 16 | (uint32_t)bytes[3] << 24;
}

static inline float slitpose_frame_number(const uint8_t *bytes)
{
    const uint32_t word = slitpose_frame_word(bytes);
    float number;
    memcpy(&number, &word, sizeof number);
    return number;
}

/* CRC-32/ISO-HDLC, half a byte at a time; a CRC unit does it faster. */
static inline uint32_t slitpose_frame_crc(const uint8_t *bytes, int length)
{
    static const uint32_t steps[16] = {
        0x00000000u, 0x1db71064u, 0x3b6e20c8u, 0x26d930acu,
        0x76dc4190u, 0x6b6b51f4u, 0x4db26158u, 0x5005713cu,
        0xedb88320u, 0xf00f9344u, 0xd6d6a3e8u, 0xcb61b38cu,
        0x9b64c2b0u, 0x86d3d2d4u, 0xa00ae278u, 0xbdbdf21cu,
    };
    uint32_t crc = 0xffffffffu;
    for (int i = 0; i < length; i++) {
        crc ^= bytes[i];
        crc = crc >> 4 ^ steps[crc & 15u];
        crc = crc >> 4 ^ steps[crc & 15u];
    }
    return ~crc;
}

/* Reads 64 bytes; 0 if they are no frame of this version, or damaged. */
static inline int slitpose_frame_read(const uint8_t *bytes, struct slitpose_frame *frame)
{
    if (bytes[0] != 0xa5 || bytes[1] != 0x5a || bytes[2] != SLITPOSE_FRAME_VERSION ||
        slitpose_frame_crc(bytes, SLITPOSE_FRAME_BYTES - 4) != slitpose_frame_word(bytes + SLITPOSE_FRAME_BYTES - 4))
        return 0;
    frame->status = bytes[3];
    frame->sequence = slitpose_frame_word(bytes + 4);
    frame->tick = slitpose_frame_word(bytes + 8);
    frame->ready_ticks = 64u * (slitpose_frame_word(bytes + 12) & 0xffffu);
    frame->unsent = (uint16_t)(slitpose_frame_word(bytes + 12) >> 16);
    frame->cells_used = (uint16_t)(slitpose_frame_word(bytes + 16) & 0xffffu);
    frame->excluded_cells = (uint16_t)(slitpose_frame_word(bytes + 16) >> 16);
    for (int i = 0; i < 3; i++)
        frame->translation_m[i] = slitpose_frame_number(bytes + 20 + 4 * i);
    for (int i = 0; i < 4; i++)
        frame->rotation_xyzw[i] = slitpose_frame_number(bytes + 32 + 4 * i);
    frame->sigma_m = slitpose_frame_number(bytes + 48);
    frame->sigma_rad = slitpose_frame_number(bytes + 52);
    frame->chi2 = slitpose_frame_number(bytes + 56);
    return 1;
}

static inline int slitpose_has_pose(const struct slitpose_frame *frame)
{
    return frame->status <= SLITPOSE_FRAME_MISFIT;
}

/* Takes the next byte of the line; 1 if a frame has ended with it. After a damaged one it goes on behind that one's
   first byte. */
static inline int slitpose_receive(struct slitpose_receiver *receiver, uint8_t byte, struct slitpose_frame *frame)
{
    uint8_t *bytes = receiver->bytes;
    bytes[receiver->length++] = byte;
    if (receiver->length == SLITPOSE_FRAME_BYTES && slitpose_frame_read(bytes, frame)) {
        receiver->length = 0;
        return 1;
    }
    while (receiver->length == SLITPOSE_FRAME_BYTES ||
           (receiver->length > 0 && (bytes[0] != 0xa5 || (receiver->length > 1 && bytes[1] != 0x5a))))
        memmove(bytes, bytes + 1, --receiver->length);
    return 0;
}

#endif
