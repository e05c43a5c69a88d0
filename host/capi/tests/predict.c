/* Both headers in one program: what slitpose_predict() and slitpose_solution_predict() make of the same pose. */
#define _POSIX_C_SOURCE 200809L

#include "slitpose_pose.h"
#include "slitpose_solver.h"

#define SAME(field) (memcmp(&of_library.field, &of_header.field, sizeof of_library.field) == 0)

int main(void)
{
    struct slitpose_pose of_header;
    struct slitpose_solution of_library;
    int i;
    memset(&of_header, 0, sizeof of_header);
    memset(&of_library, 0, sizeof of_library);
    of_header.flags = SLITPOSE_HAS_POSE | SLITPOSE_HAS_TWIST;
    of_library.has_pose = of_library.has_twist = 1;
    of_header.device_time_ns = of_library.time_ns = 123456789;
    for (i = 0; i < 3; i++) {
        of_header.translation_m[i] = of_library.translation_m[i] = 1e-3 * (i + 1.1);
        of_header.linear_m_per_s[i] = of_library.linear_m_per_s[i] = 0.3 - 0.17 * i;
        of_header.angular_rad_per_s[i] = of_library.angular_rad_per_s[i] = 2.1 * i - 1.3;
        of_header.rotation_xyzw[i] = of_library.rotation_xyzw[i] = 0.1 * (i + 1);
    }
    of_header.rotation_xyzw[3] = of_library.rotation_xyzw[3] = sqrt(0.86);
    for (i = 0; i < 36; i++)
        of_header.covariance[i] = of_library.covariance[i] = i % 7 == 0 ? 1e-11 * (i + 1.7) : 1e-13;
    for (i = 0; i < 6; i++)
        of_header.twist_sigma[i] = of_library.twist_sigma[i] = 1e-3 * (i + 0.9);
    if (slitpose_predict(&of_header, 1700000, 40, 300) != 0 ||
        slitpose_solution_predict(&of_library, 1700000, 40, 300) != SLITPOSE_RESULT_OK)
        return 1;
    if (!SAME(translation_m) || !SAME(rotation_xyzw) || !SAME(covariance) || of_library.time_ns != of_header.device_time_ns)
        return 2;
    of_library.has_twist = 0;
    return slitpose_solution_predict(&of_library, 1, 0, 0) == SLITPOSE_RESULT_NO_TWIST ? 0 : 3;
}
