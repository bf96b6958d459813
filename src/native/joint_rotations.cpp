// Joint rotations from targets, forward kinematics, and errors at shell points. codecs/tempo/rotation_layer/solve.py
// and shell.py have the same steps and explain them.

#include "algebra3.h"
#include "arrays.h"
#include "joint_solver.h"

namespace {

using joint_solver::matrix_of;
using joint_solver::product;
using joint_solver::turned;

#if defined(HAS_AVX2_TWIN)
WITH_AVX2 void solve_with_avx2(const joint_solver::Tables &tables, size_t frames, size_t values, size_t aimed,
                               size_t hinges, const double *targets, const double *side, double *local,
                               double *positions) {
    joint_solver::solve<Four>(tables, frames, values, aimed, hinges, targets, side, local, positions);
}
#endif

nb::tuple aim_joints(Input<double, 3> targets, Input<double, 2> side, Input<int64_t, 2> joint_integers,
                     Input<double, 2> joint_floats, Input<int64_t, 1> carried_integers, Input<double, 2> carried,
                     Input<int64_t, 2> hinge_integers, Input<double, 2> hinge_floats) {
    const size_t frames = targets.shape(0), joints = targets.shape(1), values = side.shape(1);
    Fresh<double> local(frames * joints * 4), positions(frames * joints * 3);
    const joint_solver::Tables tables{joints,
                                      reinterpret_cast<const joint_solver::JointIntegers *>(joint_integers.data()),
                                      reinterpret_cast<const joint_solver::JointFloats *>(joint_floats.data()),
                                      carried_integers.data(),
                                      reinterpret_cast<const joint_solver::Carried *>(carried.data()),
                                      reinterpret_cast<const joint_solver::HingeIntegers *>(hinge_integers.data()),
                                      reinterpret_cast<const joint_solver::HingeFloats *>(hinge_floats.data())};
    const auto solve = [&](auto by) {
        by(tables, frames, values, carried_integers.shape(0), hinge_integers.shape(0), targets.data(), side.data(),
           local.data.get(), positions.data.get());
    };
#if defined(HAS_AVX2_TWIN)
    if (processor_has_avx2())
        solve(solve_with_avx2);
    else
#endif
        solve(joint_solver::solve<double>);
    return nb::make_tuple(local.give({frames, joints, 4}), positions.give({frames, joints, 3}));
}

Output<double> world_rotations(Input<double, 3> local, Input<int64_t, 1> parents) {
    const size_t frames = local.shape(0), joints = local.shape(1);
    Fresh<double> world(frames * joints * 4);
    for (size_t f = 0; f < frames; ++f) {
        const double *from = local.data() + f * joints * 4;
        double *to = world.data.get() + f * joints * 4;
        for (size_t j = 0; j < joints; ++j) {
            if (parents.data()[j] < 0)
                std::copy_n(from + 4 * j, 4, to + 4 * j);
            else
                product(to + 4 * parents.data()[j], from + 4 * j, to + 4 * j);
        }
    }
    return world.give({frames, joints, 4});
}

// geometry.kinematics.forward, without translations.
Output<double> forward_kinematics(Input<double, 3> local, Input<double, 2> roots, Input<int64_t, 1> parents,
                                  Input<double, 2> offsets, bool own_frame) {
    const size_t frames = local.shape(0), joints = local.shape(1);
    Fresh<double> positions(frames * joints * 3);
    std::vector<double> world(4 * joints);
    for (size_t f = 0; f < frames; ++f) {
        const double *from = local.data() + f * joints * 4, *root = roots.data() + 3 * f;
        double *to = positions.data.get() + f * joints * 3, moved[3];
        for (size_t j = 0; j < joints; ++j) {
            const int64_t parent = parents.data()[j];
            const double *offset = offsets.data() + 3 * j;
            if (parent < 0) {
                std::copy_n(from + 4 * j, 4, world.data() + 4 * j);
                for (int i = 0; i < 3; ++i) to[3 * j + i] = root[i] + offset[i];
            } else {
                product(world.data() + 4 * parent, from + 4 * j, world.data() + 4 * j);
                turned(world.data() + 4 * (own_frame ? int64_t(j) : parent), offset, moved);
                for (int i = 0; i < 3; ++i) to[3 * j + i] = to[3 * parent + i] + moved[i];
            }
        }
    }
    return positions.give({frames, joints, 3});
}

nb::tuple shell_errors(Input<double, 3> positions, Input<double, 3> world, Input<double, 3> positions_2,
                       Input<double, 3> world_2, double reach) {
    const size_t frames = positions.shape(0), joints = positions.shape(1);
    Fresh<double> at_joints(frames * joints), at_shell(frames * joints);
    double total = 0;
    for (size_t s = 0; s < frames * joints; ++s) {
        double off[3], m[9], m_2[9], largest = 0;
        for (int i = 0; i < 3; ++i) off[i] = positions_2.data()[3 * s + i] - positions.data()[3 * s + i];
        matrix_of(world.data() + 4 * s, m);
        matrix_of(world_2.data() + 4 * s, m_2);
        const double here = std::sqrt(dot(off, off));
        double sum = here;
        for (int axis = 0; axis < 3; ++axis) {
            double square = 0;
            for (int i = 0; i < 3; ++i) square += squared(off[i] + reach * (m_2[3 * i + axis] - m[3 * i + axis]));
            const double around = std::sqrt(square);
            largest = std::max(largest, around);
            sum += around;
        }
        at_joints.data[s] = here;
        at_shell.data[s] = largest;
        total += sum;
    }
    return nb::make_tuple(at_joints.give({frames, joints}), at_shell.give({frames, joints}), total);
}

}  // namespace

void bind_joint_rotations(nb::module_ &m) {
    m.def("aim_joints", &aim_joints);
    m.def("world_rotations", &world_rotations);
    m.def("forward_kinematics", &forward_kinematics);
    m.def("shell_errors", &shell_errors);
}
