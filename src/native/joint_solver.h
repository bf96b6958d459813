// Joint rotations from targets. codecs/tempo/rotation_layer/solve.py has the same steps and explains them. T is one
// frame (double) or four (Four), with the same operations in the same order.
#pragma once

#include "lanes3.h"

#include <algorithm>
#include <cstdint>
#include <memory>
#include <vector>

namespace joint_solver {

enum Rule { FIXED, HUB, SWING, FREE, HINGE, HINGE_CODED, UNIVERSAL, UNIVERSAL_REFINED, UNIVERSAL_CODED };
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

template <class T>
struct Term {
    T a, b, e;
};

template <class T>
ALWAYS_INLINE T refined(const T &coded, const Term<T> *terms, size_t count) {
    T x = coded;
    for (int i = 0; i < REFINEMENTS; ++i) {
        const T c = cosine(x), s = sine(x);
        T top = REFINE_WEIGHT * (x - coded), bottom = T{} + REFINE_WEIGHT;
        for (size_t k = 0; k < count; ++k) {
            const T value = terms[k].a * c + terms[k].b * s - terms[k].e, slope = terms[k].b * c - terms[k].a * s;
            top += slope * value;
            bottom += slope * slope;
        }
        x -= top / bottom;
    }
    return x;
}

template <class T>
ALWAYS_INLINE void hub(const JointIntegers &joint, const Carried *carried, const T *aims, T *q) {
    double rest[9];
    T seen[9], m[9];
    pair_frame(carried[joint.pair[0]].vector, carried[joint.pair[1]].vector, rest);
    pair_frame(aims + 3 * joint.pair[0], aims + 3 * joint.pair[1], seen);
    matrix_product(seen, rest, m, true);
    for (int step = 0; step < HUB_STEPS; ++step) {
        T turn[3] = {}, inertia[9] = {};
        for (int64_t k = 0; k < joint.count; ++k) {
            T r[3], c[3];
            for (int i = 0; i < 3; ++i) r[i] = inner<T>(m + 3 * i, carried[k].vector);
            crossed(r, aims + 3 * k, c);
            const T square = inner<T>(r, r);
            for (int i = 0; i < 3; ++i) {
                turn[i] += c[i];
                for (int j = 0; j < 3; ++j) inertia[3 * i + j] += (i == j ? square : T{}) - r[i] * r[j];
            }
        }
        T across[3], first[3], second[3], by[4];
        crossed(inertia + 3, inertia + 6, across);  // symmetric: rows are columns
        const T determinant = inner<T>(inertia, across);
        const T size = each([](double x) { return std::fabs(x); }, determinant);
        crossed(turn, inertia + 6, first);
        crossed(inertia + 3, turn, second);
        by[0] = T{} + 1.0;
        by[1] = where_above(size, 1e-30, inner<T>(turn, across) / determinant / 2.0, T{});
        by[2] = where_above(size, 1e-30, inner<T>(inertia, first) / determinant / 2.0, T{});
        by[3] = where_above(size, 1e-30, inner<T>(inertia, second) / determinant / 2.0, T{});
        normalise<4>(by);
        T correction[9], next[9];
        matrix_of(by, correction);
        matrix_product(correction, m, next);
        for (int i = 0; i < 9; ++i) m[i] = next[i];
    }
    quaternion_of(m, q);
}

template <class T>
ALWAYS_INLINE void combined(const JointIntegers &joint, const Carried *carried, const T *aims, T *out) {
    for (int i = 0; i < 3; ++i) out[i] = T{};
    for (int64_t k = 0; k < joint.count; ++k)
        for (int i = 0; i < 3; ++i) out[i] += carried[k].weight * aims[3 * k + i];
}

template <class T>
ALWAYS_INLINE void of_angles(const JointFloats &joint, const T &first, const T *second, T *q) {
    T turn[4];
    about(joint.axis, first, turn);
    product(joint.before, turn, q);
    if (second) {
        about(joint.second, *second, turn);
        product(q, joint.between, q);
        product(q, turn, q);
    }
    product(q, joint.after, q);
}

template <class T>
ALWAYS_INLINE T hinge_angle(const JointIntegers &of, const JointFloats &joint, const Carried *carried, const T *aims) {
    T sines{}, cosines{};
    for (int64_t k = 0; k < of.count; ++k) {
        double u[3], c[3];
        T e[3];
        turned(joint.after, carried[k].vector, u);
        turned_back(joint.before, aims + 3 * k, e);
        crossed(joint.axis, u, c);
        sines += inner<T>(c, e);
        cosines += inner<T>(e, u) - inner<double>(joint.axis, u) * inner<T>(joint.axis, e);
    }
    return arctangent(sines, cosines);
}

template <class T>
ALWAYS_INLINE void two_angles(const JointIntegers &of, const JointFloats &joint, const Carried *carried, const T *aims,
                              const T *coded, T *angles) {
    double w[3], n[3], across[3], side[3], lengthwise[3];
    T e[3], sum[3], u[3];
    turned(joint.after, joint.direction, w);
    combined(of, carried, aims, sum);
    normalise<3>(sum);
    turned_back(joint.before, sum, e);
    turned_back(joint.between, joint.axis, n);
    const double along = inner<double>(joint.second, w);
    for (int i = 0; i < 3; ++i) lengthwise[i] = joint.second[i] * along, across[i] = w[i] - lengthwise[i];
    crossed(joint.second, w, side);
    const double a = inner<double>(n, across), b = inner<double>(n, side), shift = inner<double>(n, lengthwise);
    const T height = inner<T>(e, joint.axis) - shift;
    T y;
    if (coded) {
        const Term<T> term = {T{} + joint.lever * a, T{} + joint.lever * b, joint.lever * height};
        y = refined(*coded, &term, 1);
    } else {
        const double size = std::max(std::hypot(a, b), TINY), middle = std::atan2(b, a), branch = double(of.branch);
        y = each([=](double h) { return middle + branch * std::acos(std::min(std::max(h / size, -1.0), 1.0)); }, height);
    }
    const T c = cosine(y), s = sine(y);
    T t[3], over[3];
    for (int i = 0; i < 3; ++i) t[i] = lengthwise[i] + c * across[i] + s * side[i];
    turned(joint.between, t, u);
    crossed(u, e, over);
    const T sines = inner<T>(over, joint.axis);
    const T cosines = inner<T>(u, e) - inner<T>(u, joint.axis) * inner<T>(e, joint.axis);
    angles[0] = arctangent(sines, cosines);
    angles[1] = y;
}

// The rules of all joints.
struct Tables {
    size_t joints;
    const JointIntegers *integers;
    const JointFloats *floats;
    const int64_t *targets_of;
    const Carried *carried;
    const HingeIntegers *hinge_integers;
    const HingeFloats *hinge_floats;
};

// Solves as many frames as T has lanes: from targets (joints, 3) and side values to local rotations, positions and world
// rotations. The caller owns all memory; `aims` has three numbers for every carried vector, `terms` three for every hinge.
template <class T>
struct Solver {
    Tables of_all;
    T *targets, *side, *local, *positions, *world, *aims;
    Term<T> *terms;

    ALWAYS_INLINE void swing(size_t j, const T *above, const T &twist, T *q) {
        const JointIntegers &of = of_all.integers[j];
        const JointFloats &joint = of_all.floats[j];
        double start[3];
        T end[3], turn[4], swung[4];
        turned(joint.usual, joint.direction, start);
        combined(of, of_all.carried + of.first, aims, end);
        const T length = root(inner<T>(end, end));
        for (int i = 0; i < 3; ++i) end[i] = where_above(length, TINY, end[i] / length, T{} + start[i]);
        swung[0] = 1.0 + inner<T>(start, end);
        crossed(start, end, swung + 1);
        normalise<4>(swung);
        product(swung, joint.usual, swung);
        about(joint.direction, twist, turn);
        product(swung, turn, q);
        if (!of.hinges) return;
        T here[4], offset[3];
        product(above, q, here);
        for (int64_t h = 0; h < of.hinges; ++h) terms[h] = hinge_term(of, joint, of.first_hinge + h, j, here, offset);
        about(joint.direction, refined(T{}, terms, size_t(of.hinges)), turn);
        product(q, turn, q);
    }

    ALWAYS_INLINE Term<T> hinge_term(const JointIntegers &of, const JointFloats &joint, int64_t h, size_t j, const T *here,
                                     T *offset) {
        const HingeFloats &hinge = of_all.hinge_floats[h];
        const int64_t child = of_all.hinge_integers[h].child;
        const JointIntegers &child_of = of_all.integers[child];
        const T *from = positions + 3 * j;
        const double *moved = nullptr;
        if (of.own_frame) {
            if (!of.held) from = positions + 3 * of.parent, moved = joint.offset;
        } else if (of_all.hinge_integers[h].placed) {
            from = targets + 3 * child;
        } else {
            moved = of_all.floats[child].offset;
        }
        T begin[3] = {from[0], from[1], from[2]};
        if (moved) {
            turned(here, moved, offset);
            for (int i = 0; i < 3; ++i) begin[i] += offset[i];
        }
        T aim[3] = {}, seen[3], apart[3];
        for (int64_t k = child_of.first; k < child_of.first + child_of.count; ++k) {
            for (int i = 0; i < 3; ++i) apart[i] = targets[3 * of_all.targets_of[k] + i] - begin[i];
            turned_back(here, apart, seen);
            for (int i = 0; i < 3; ++i) aim[i] += of_all.carried[k].weight * seen[i];
        }
        const double along = inner<double>(joint.direction, hinge.axis);
        double lengthwise[3], across[3], sideways[3];
        for (int i = 0; i < 3; ++i) {
            lengthwise[i] = joint.direction[i] * along;
            across[i] = hinge.axis[i] - lengthwise[i];
        }
        crossed(joint.direction, hinge.axis, sideways);
        return {hinge.scale * inner<T>(aim, across), hinge.scale * inner<T>(aim, sideways),
                hinge.scale * (hinge.along - inner<T>(aim, lengthwise))};
    }

    ALWAYS_INLINE void aim(const JointIntegers &of, const T *above) {
        const T *anchor = positions + 3 * of.anchor;
        T apart[3];
        for (int64_t k = 0; k < of.count; ++k) {
            for (int i = 0; i < 3; ++i) apart[i] = targets[3 * of_all.targets_of[of.first + k] + i] - anchor[i];
            turned_back(above, apart, aims + 3 * k);
        }
    }

    ALWAYS_INLINE void rotation(size_t j, const T *above, T *q) {
        const JointIntegers &of = of_all.integers[j];
        const JointFloats &joint = of_all.floats[j];
        const Carried *own = of_all.carried + of.first;
        const T *values = side + of.side;
        T angles[2];
        switch (of.rule) {
            case FIXED:
                for (int i = 0; i < 4; ++i) q[i] = T{} + joint.usual[i];
                return;
            case FREE:
                for (int i = 0; i < 4; ++i) q[i] = values[i];
                normalise<4>(q);
                product(joint.usual, q, q);
                return;
            case HINGE_CODED: of_angles<T>(joint, values[0], nullptr, q); return;
            case UNIVERSAL_CODED: of_angles(joint, values[0], values + 1, q); return;
            default: aim(of, above);
        }
        switch (of.rule) {
            case HUB: hub(of, own, aims, q); return;
            case SWING: swing(j, above, values[0], q); return;
            case HINGE: of_angles<T>(joint, hinge_angle(of, joint, own, aims), nullptr, q); return;
            default:
                two_angles<T>(of, joint, own, aims, of.rule == UNIVERSAL ? nullptr : values, angles);
                of_angles(joint, angles[0], angles + 1, q);
        }
    }

    ALWAYS_INLINE void frames() {
        T none[4] = {}, moved[3];
        none[0] += 1.0;
        for (size_t j = 0; j < of_all.joints; ++j) {
            const JointIntegers &of = of_all.integers[j];
            const JointFloats &joint = of_all.floats[j];
            const T *above = of.parent < 0 ? none : world + 4 * of.parent;
            T *here = positions + 3 * j, *q = local + 4 * j;
            if (of.held) {
                for (int i = 0; i < 3; ++i) here[i] = targets[3 * j + i];
            } else if (!of.own_frame) {
                turned(above, joint.offset, moved);
                for (int i = 0; i < 3; ++i) here[i] = positions[3 * of.parent + i] + moved[i];
            }
            rotation(j, above, q);
            product(above, q, world + 4 * j);
            if (of.own_frame && !of.held) {
                turned(world + 4 * j, joint.offset, moved);
                for (int i = 0; i < 3; ++i) here[i] = positions[3 * of.parent + i] + moved[i];
            }
        }
    }
};

// Solves all frames of a motion, as many at a time as T has lanes; the last frame repeats to fill the lanes.
template <class T>
ALWAYS_INLINE void solve(const Tables &tables, size_t frames, size_t values, size_t aimed, size_t hinges,
                         const double *targets, const double *side, double *local, double *positions) {
    constexpr size_t LANES = sizeof(T) / sizeof(double);
    const size_t joints = tables.joints, sizes[7] = {3 * joints, values,    4 * joints, 3 * joints,
                                                     4 * joints, 3 * aimed, 3 * hinges};
    size_t all = 0;
    for (const size_t size : sizes) all += size;
    std::vector<double> memory(LANES * (all + 1));
    void *begin = memory.data();
    size_t room = memory.size() * sizeof(double);
    T *at[7], *next = static_cast<T *>(std::align(sizeof(T), all * sizeof(T), begin, room));
    for (int i = 0; i < 7; ++i) at[i] = next, next += sizes[i];
    Solver<T> solver{tables, at[0], at[1], at[2], at[3], at[4], at[5], reinterpret_cast<Term<T> *>(at[6])};
    for (size_t f = 0; f < frames; f += LANES) {
        for (size_t l = 0; l < LANES; ++l) {
            const size_t from = std::min(f + l, frames - 1);
            for (size_t i = 0; i < sizes[0]; ++i) set_lane(at[0][i], l, targets[from * sizes[0] + i]);
            for (size_t i = 0; i < values; ++i) set_lane(at[1][i], l, side[from * values + i]);
        }
        solver.frames();
        for (size_t l = 0; l < LANES && f + l < frames; ++l) {
            for (size_t i = 0; i < sizes[2]; ++i) local[(f + l) * sizes[2] + i] = lane(at[2][i], l);
            for (size_t i = 0; i < sizes[3]; ++i) positions[(f + l) * sizes[3] + i] = lane(at[3][i], l);
        }
    }
}

}  // namespace joint_solver
