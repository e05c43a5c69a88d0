#define _POSIX_C_SOURCE 200809L
#include <stdio.h>
#include "slitpose_pose.h"
int main(int argc, char **argv)
{
    struct slitpose_link link;
    struct slitpose_pose pose;
    if (argc < 3 || slitpose_open(&link, argv[1], (const uint8_t *)argv[2]) < 0 ||
        slitpose_newest(&link, &pose, 60000) != 1)
        return 1;
    printf("%.12s %llu", (const char *)pose.device, (unsigned long long)pose.datagram);
    slitpose_close(&link);
    return 0;
}
