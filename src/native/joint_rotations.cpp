// Rotations of joints from the positions of their targets, forward kinematics, and errors at shell points: the twins of
// codecs/tempo/rotation_layer/solve.py and shell.py, which say what each step is for.

#include "algebra3.h"
#include "arrays.h"

#include <vector>

namespace {

enum Rule { FIXED, HUB, SWING, FREE, HINGE, HINGE_CODED, UNIVERSAL, UNIVERSAL_REFINED, UNIVERSAL_CODED };
constexpr double TINY = 1e-12;
constexpr double REFINE_WEIGHT = 0.03 * 0.03;
constexpr int REFINEMENTS = 4, HUB_STEPS = 3;

struct JointIntegers {
    int64_t rule, parent, held, branch, side, anchor, first, count, pair[2], first_hinge, hinges, own_frame;
};
struct JointFloats {
    double offset[3], usual[4], before[4], between[4], after[4], axis[3], second[3], direction[3], lever;
};
struct Carried {
    double vector[3], weight;
};
struct HingeIntegers {
    int64_t child, placed;
};
struct HingeFloats {
    double axis[3], along, scale;
};
static_assert(sizeof(JointIntegers) == 13 * 8 && sizeof(JointFloats) == 29 * 8 && sizeof(HingeFloats) == 5 * 8);

// Quaternions, w first.

void product(const double *p, const double *q, double *out) {
    const double r[4] = {p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
                         p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
                         p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
                         p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0]};
    std::copy_n(r, 4, out);
}

void turned(const double *q, const double *v, double *out, double sign = 1) {
    const double u[3] = {sign * q[1], sign * q[2], sign * q[3]};
    double c[3], d[3];
    cross(u, v, c);
    for (int i = 0; i < 3; ++i) c[i] += q[0] * v[i];
    cross(u, c, d);
    for (int i = 0; i < 3; ++i) out[i] = v[i] + 2.0 * d[i];
}

void turned_back(const double *q, const double *v, double *out) { turned(q, v, out, -1); }

template <int N>
void normalise(double *v) {
    double sum = 0;
    for (int i = 0; i < N; ++i) sum += v[i] * v[i];
    const double length = std::sqrt(sum);
    for (int i = 0; i < N; ++i) v[i] = length > TINY ? v[i] / length : (i == 0 ? 1.0 : 0.0);
}

void about(const double *axis, double angle, double *out) {
    const double s = std::sin(angle / 2);
    out[0] = std::cos(angle / 2);
    for (int i = 0; i < 3; ++i) out[1 + i] = s * axis[i];
}

// Matrix of a quaternion of any length, as that of the unit quaternion.
void matrix_of(const double *q, double *m) {
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    const double rows[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
                            2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                            2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
    std::copy_n(rows, 9, m);
}

void quaternion_of(const double *m, double *q) {
    const double trace = m[0] + m[4] + m[8];
    const double squares[4] = {1 + trace, 1 - trace + 2 * m[0], 1 - trace + 2 * m[4], 1 - trace + 2 * m[8]};
    const double a[4][4] = {{squares[0], m[7] - m[5], m[2] - m[6], m[3] - m[1]},
                            {m[7] - m[5], squares[1], m[1] + m[3], m[2] + m[6]},
                            {m[2] - m[6], m[1] + m[3], squares[2], m[5] + m[7]},
                            {m[3] - m[1], m[2] + m[6], m[5] + m[7], squares[3]}};
    std::copy_n(a[std::max_element(squares, squares + 4) - squares], 4, q);
    normalise<4>(q);
}

// Columns along a, in the plane of a and b, and normal to both.
void pair_frame(const double *a, const double *b, double *m) {
    double x[3] = {a[0], a[1], a[2]}, y[3], z[3];
    normalise<3>(x);
    cross(x, b, z);
    normalise<3>(z);
    cross(z, x, y);
    for (int i = 0; i < 3; ++i) m[3 * i] = x[i], m[3 * i + 1] = y[i], m[3 * i + 2] = z[i];
}

struct Term {
    double a, b, e;
};

double refined(double coded, const Term *terms, size_t count) {
    double x = coded;
    for (int i = 0; i < REFINEMENTS; ++i) {
        const double c = std::cos(x), s = std::sin(x);
        double top = REFINE_WEIGHT * (x - coded), bottom = REFINE_WEIGHT;
        for (size_t k = 0; k < count; ++k) {
            const double value = terms[k].a * c + terms[k].b * s - terms[k].e, slope = terms[k].b * c - terms[k].a * s;
            top += slope * value;
            bottom += slope * slope;
        }
        x -= top / bottom;
    }
    return x;
}

void hub(const JointIntegers &joint, const Carried *carried, const double *aims, double *q) {
    double rest[9], seen[9], m[9];
    pair_frame(carried[joint.pair[0]].vector, carried[joint.pair[1]].vector, rest);
    pair_frame(aims + 3 * joint.pair[0], aims + 3 * joint.pair[1], seen);
    multiply(seen, rest, m, true);
    for (int step = 0; step < HUB_STEPS; ++step) {
        double turn[3] = {0, 0, 0}, inertia[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0};
        for (int64_t k = 0; k < joint.count; ++k) {
            double r[3], c[3];
            transform(m, carried[k].vector, r);
            cross(r, aims + 3 * k, c);
            const double square = dot(r, r);
            for (int i = 0; i < 3; ++i) {
                turn[i] += c[i];
                for (int j = 0; j < 3; ++j) inertia[3 * i + j] += (i == j ? square : 0.0) - r[i] * r[j];
            }
        }
        double crossed[3], first[3], second[3], by[4] = {1, 0, 0, 0};
        cross(inertia + 3, inertia + 6, crossed);  // symmetric: rows are columns
        const double determinant = dot(inertia, crossed);
        if (std::fabs(determinant) > 1e-30) {
            cross(turn, inertia + 6, first);
            cross(inertia + 3, turn, second);
            by[1] = dot(turn, crossed) / determinant / 2;
            by[2] = dot(inertia, first) / determinant / 2;
            by[3] = dot(inertia, second) / determinant / 2;
        }
        normalise<4>(by);
        double correction[9], next[9];
        matrix_of(by, correction);
        multiply(correction, m, next);
        std::copy_n(next, 9, m);
    }
    quaternion_of(m, q);
}

void shortest(const double *start, const double *end, double *q) {
    q[0] = 1.0 + dot(start, end);
    cross(start, end, q + 1);
    normalise<4>(q);
}

void combined(const JointIntegers &joint, const Carried *carried, const double *aims, double *out) {
    std::fill_n(out, 3, 0.0);
    for (int64_t k = 0; k < joint.count; ++k)
        for (int i = 0; i < 3; ++i) out[i] += carried[k].weight * aims[3 * k + i];
}

void of_angles(const JointFloats &joint, double first, const double *second, double *q) {
    double turn[4];
    about(joint.axis, first, turn);
    product(joint.before, turn, q);
    if (second) {
        about(joint.second, *second, turn);
        product(q, joint.between, q);
        product(q, turn, q);
    }
    product(q, joint.after, q);
}

double hinge_angle(const JointIntegers &of, const JointFloats &joint, const Carried *carried, const double *aims) {
    double sine = 0, cosine = 0;
    for (int64_t k = 0; k < of.count; ++k) {
        double u[3], e[3], c[3];
        turned(joint.after, carried[k].vector, u);
        turned_back(joint.before, aims + 3 * k, e);
        cross(joint.axis, u, c);
        sine += dot(c, e);
        cosine += dot(e, u) - dot(joint.axis, u) * dot(joint.axis, e);
    }
    return std::atan2(sine, cosine);
}

void two_angles(const JointIntegers &of, const JointFloats &joint, const Carried *carried, const double *aims,
                const double *coded, double *angles) {
    double w[3], e[3], n[3], sum[3], across[3], side[3], lengthwise[3], u[3];
    turned(joint.after, joint.direction, w);
    combined(of, carried, aims, sum);
    normalise<3>(sum);
    turned_back(joint.before, sum, e);
    turned_back(joint.between, joint.axis, n);
    const double along = dot(joint.second, w);
    for (int i = 0; i < 3; ++i) lengthwise[i] = joint.second[i] * along, across[i] = w[i] - lengthwise[i];
    cross(joint.second, w, side);
    const double a = dot(n, across), b = dot(n, side), height = dot(e, joint.axis) - dot(n, lengthwise);
    double y;
    if (coded) {
        const Term term = {joint.lever * a, joint.lever * b, joint.lever * height};
        y = refined(*coded, &term, 1);
    } else {
        const double size = std::max(std::hypot(a, b), TINY);
        y = std::atan2(b, a) + double(of.branch) * std::acos(std::min(std::max(height / size, -1.0), 1.0));
    }
    const double c = std::cos(y), s = std::sin(y);
    double t[3], crossed[3];
    for (int i = 0; i < 3; ++i) t[i] = lengthwise[i] + c * across[i] + s * side[i];
    turned(joint.between, t, u);
    cross(u, e, crossed);
    angles[0] = std::atan2(dot(crossed, joint.axis), dot(u, e) - dot(u, joint.axis) * dot(e, joint.axis));
    angles[1] = y;
}

// One frame: targets (joints, 3) and side values to local rotations, positions and world rotations.
struct Solver {
    size_t joints;
    const JointIntegers *integers;
    const JointFloats *floats;
    const int64_t *targets_of;
    const Carried *carried;
    const HingeIntegers *hinge_integers;
    const HingeFloats *hinge_floats;
    std::vector<double> world, aims;
    std::vector<Term> terms;

    void swing(size_t j, const double *targets, const double *above, double twist, double *positions, double *q) {
        const JointIntegers &of = integers[j];
        const JointFloats &joint = floats[j];
        double start[3], end[3], turn[4], swung[4];
        turned(joint.usual, joint.direction, start);
        combined(of, carried + of.first, aims.data(), end);
        const double length = std::sqrt(dot(end, end));
        for (int i = 0; i < 3; ++i) end[i] = length > TINY ? end[i] / length : start[i];
        shortest(start, end, swung);
        product(swung, joint.usual, swung);
        about(joint.direction, twist, turn);
        product(swung, turn, q);
        if (!of.hinges) return;
        double here[4], offset[3];
        product(above, q, here);
        terms.clear();
        for (int64_t h = of.first_hinge; h < of.first_hinge + of.hinges; ++h) {
            const HingeFloats &hinge = hinge_floats[h];
            const int64_t child = hinge_integers[h].child;
            const JointIntegers &child_of = integers[child];
            const double *from = positions + 3 * j;
            const double *moved = nullptr;
            if (of.own_frame) {
                if (!of.held) from = positions + 3 * of.parent, moved = joint.offset;
            } else if (hinge_integers[h].placed) {
                from = targets + 3 * child;
            } else {
                moved = floats[child].offset;
            }
            double begin[3] = {from[0], from[1], from[2]};
            if (moved) {
                turned(here, moved, offset);
                for (int i = 0; i < 3; ++i) begin[i] += offset[i];
            }
            double aim[3] = {0, 0, 0}, seen[3], apart[3];
            for (int64_t k = child_of.first; k < child_of.first + child_of.count; ++k) {
                for (int i = 0; i < 3; ++i) apart[i] = targets[3 * targets_of[k] + i] - begin[i];
                turned_back(here, apart, seen);
                for (int i = 0; i < 3; ++i) aim[i] += carried[k].weight * seen[i];
            }
            const double along = dot(joint.direction, hinge.axis);
            double lengthwise[3], across[3], side[3];
            for (int i = 0; i < 3; ++i) {
                lengthwise[i] = joint.direction[i] * along;
                across[i] = hinge.axis[i] - lengthwise[i];
            }
            cross(joint.direction, hinge.axis, side);
            terms.push_back({hinge.scale * dot(aim, across), hinge.scale * dot(aim, side),
                             hinge.scale * (hinge.along - dot(aim, lengthwise))});
        }
        about(joint.direction, refined(0.0, terms.data(), terms.size()), turn);
        product(q, turn, q);
    }

    void frame(const double *targets, const double *side, double *local, double *positions) {
        const double none[4] = {1, 0, 0, 0};
        double moved[3], apart[3];
        for (size_t j = 0; j < joints; ++j) {
            const JointIntegers &of = integers[j];
            const JointFloats &joint = floats[j];
            const double *above = of.parent < 0 ? none : world.data() + 4 * of.parent;
            double *here = positions + 3 * j, *q = local + 4 * j;
            if (of.held) {
                std::copy_n(targets + 3 * j, 3, here);
            } else if (!of.own_frame) {
                turned(above, joint.offset, moved);
                for (int i = 0; i < 3; ++i) here[i] = positions[3 * of.parent + i] + moved[i];
            }
            const Carried *own = carried + of.first;
            const bool aiming = of.rule == HUB || of.rule == SWING || of.rule == HINGE || of.rule == UNIVERSAL ||
                                of.rule == UNIVERSAL_REFINED;
            if (aiming) {
                if (aims.size() < size_t(3 * of.count)) aims.resize(3 * of.count);
                const double *anchor = positions + 3 * of.anchor;
                for (int64_t k = 0; k < of.count; ++k) {
                    for (int i = 0; i < 3; ++i) apart[i] = targets[3 * targets_of[of.first + k] + i] - anchor[i];
                    turned_back(above, apart, aims.data() + 3 * k);
                }
            }
            const double *values = side + of.side;
            double angles[2];
            switch (of.rule) {
                case FIXED: std::copy_n(joint.usual, 4, q); break;
                case HUB: hub(of, own, aims.data(), q); break;
                case SWING: swing(j, targets, above, values[0], positions, q); break;
                case FREE:
                    std::copy_n(values, 4, q);
                    normalise<4>(q);
                    product(joint.usual, q, q);
                    break;
                case HINGE: of_angles(joint, hinge_angle(of, joint, own, aims.data()), nullptr, q); break;
                case HINGE_CODED: of_angles(joint, values[0], nullptr, q); break;
                case UNIVERSAL_CODED: of_angles(joint, values[0], values + 1, q); break;
                default:
                    two_angles(of, joint, own, aims.data(), of.rule == UNIVERSAL ? nullptr : values, angles);
                    of_angles(joint, angles[0], angles + 1, q);
            }
            product(above, q, world.data() + 4 * j);
            if (of.own_frame && !of.held) {
                turned(world.data() + 4 * j, joint.offset, moved);
                for (int i = 0; i < 3; ++i) here[i] = positions[3 * of.parent + i] + moved[i];
            }
        }
    }
};

nb::tuple aim_joints(Input<double, 3> targets, Input<double, 2> side, Input<int64_t, 2> joint_integers,
                     Input<double, 2> joint_floats, Input<int64_t, 1> carried_integers, Input<double, 2> carried,
                     Input<int64_t, 2> hinge_integers, Input<double, 2> hinge_floats) {
    const size_t frames = targets.shape(0), joints = targets.shape(1), values = side.shape(1);
    Fresh<double> local(frames * joints * 4), positions(frames * joints * 3);
    Solver solver{joints,
                  reinterpret_cast<const JointIntegers *>(joint_integers.data()),
                  reinterpret_cast<const JointFloats *>(joint_floats.data()),
                  carried_integers.data(),
                  reinterpret_cast<const Carried *>(carried.data()),
                  reinterpret_cast<const HingeIntegers *>(hinge_integers.data()),
                  reinterpret_cast<const HingeFloats *>(hinge_floats.data()),
                  std::vector<double>(4 * joints),
                  {},
                  {}};
    for (size_t f = 0; f < frames; ++f)
        solver.frame(targets.data() + f * joints * 3, side.data() + f * values, local.data.get() + f * joints * 4,
                     positions.data.get() + f * joints * 3);
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

// As geometry.kinematics.forward, without translations.
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
