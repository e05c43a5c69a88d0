/* Reads steps, each an instant, whether a pose has come, and the pose; prints what became of it. */
#define _POSIX_C_SOURCE 200809L
#include <stdio.h>
#include "../../../examples/c/virtual_wall.h"
int main(int argc, char **argv)
{
    struct wall wall = {1e-3, 2000, 2, 10, 5e-3, 4e-3};
    struct wall_state state = {0, 0, 0, 0};
    struct slitpose_pose pose;
    uint64_t head[2];
    if (argc == 5) {
        wall.stiffness_n_per_m = atof(argv[1]), wall.damping_ns_per_m = atof(argv[2]);
        printf("%.17g\n", wall_passive_ns_per_m(&wall, atof(argv[3]), atof(argv[4])));
    }
    while (fread(head, sizeof head, 1, stdin) == 1 && fread(&pose, sizeof pose, 1, stdin) == 1) {
        enum wall_input input = wall_step(&wall, &state, head[1] ? &pose : NULL, head[0]);
        printf("%.17g %s\n", state.force_n, WALL_INPUT_NAMES[input]);
    }
    return 0;
}
