// Coordinates of bones and hubs from positions, four frames at a time: codecs/tempo/pose/bone_directions.py, forward.
// Bit for bit those of NumPy: bases are fitted to them, and a basis of hardly any motion follows the last bits.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "rotations4.h"

namespace bones {

using namespace rotations4;

constexpr double PI = 3.14159265358979323846;
constexpr double TINY = 1e-8;  // rotations._ratio

// BoneSchedule; `joints`: end joints of the bones in schedule order; `pairs`: the two bones of each hub's pair.
struct Schedule {
    const int64_t *program, *order, *joints, *parents, *pairs;
    const double *rests, *homes, *pair_frames;
    size_t steps, bones, hubs, slots;
};

struct Positions {
    const double *data;  // (3, points, frames)
    size_t points, frames;

    // Vector from a joint's parent to the joint, in four frames from `first` on; beyond the end the last frame repeats.
    ALWAYS_INLINE void offset(int64_t joint, int64_t parent, size_t first, Four *out) const {
        for (size_t k = 0; k < 3; ++k) {
            const double *to = data + (k * points + size_t(joint)) * frames;
            const double *from = data + (k * points + size_t(parent)) * frames;
            if (first + 4 <= frames) {
                Four a, b;
                load(a, to + first);
                load(b, from + first);
                out[k] = a - b;
            } else {
                for (size_t i = 0; i < 4; ++i) {
                    const size_t at = std::min(first + i, frames - 1);
                    out[k][i] = to[at] - from[at];
                }
            }
        }
    }
};

// The quaternion of a rotation matrix, by rows, times any positive number: real part first, which is not negative.
inline void quaternion_of(const double (&m)[3][3], double *out) {
    const double trace = m[0][0] + m[1][1] + m[2][2];
    const double w[3] = {m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]};
    double *q = out + 1, largest = trace;
    out[0] = 1 + trace;
    std::copy_n(w, 3, q);
    for (size_t a = 0; a < 3; ++a) {
        if (!(m[a][a] > largest)) continue;
        const size_t b = (a + 1) % 3, c = (a + 2) % 3;
        largest = m[a][a];
        out[0] = w[a];
        q[a] = 1 + m[a][a] - m[b][b] - m[c][c];
        q[b] = m[b][a] + m[a][b];
        q[c] = m[c][a] + m[a][c];
    }
    if (out[0] < 0)
        for (size_t i = 0; i < 4; ++i) out[i] *= -1;
}

// rotations.vector_of, of quaternions.
ALWAYS_INLINE void vector_of(const Four *quaternion, Four *out) {
    const Four &real = quaternion[0], *q = quaternion + 1;
    const Four size_2 = q[0] * q[0] + q[1] * q[1] + q[2] * q[2], size = root(size_2);
    const Four ratio = where_less(size, TINY, Four{} * 0.0, angle_of(size, size_2, real) * 2.0 / size);
    for (size_t k = 0; k < 3; ++k) out[k] = q[k] * ratio;
}

inline void cross(const double *a, const double *b, double *out) {
    for (size_t k = 0; k < 3; ++k) out[k] = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
}

inline void to_unit(double *v) {
    const double length = std::max(std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]), 1e-30);
    for (size_t k = 0; k < 3; ++k) v[k] /= length;
}

// The quaternion of a hub whose pair of bones points along `pair`: rotations.frame_of_pair.
inline void hub_quaternion(const Four (&pair)[2][3], size_t lane, const double *pair_frame, double *out) {
    double a[3], b[3], axes[3][3], matrix[3][3];
    for (size_t k = 0; k < 3; ++k) a[k] = pair[0][k][lane], b[k] = pair[1][k][lane];
    to_unit(a), to_unit(b);
    for (size_t k = 0; k < 3; ++k) axes[0][k] = a[k] + b[k], axes[1][k] = a[k] - b[k];
    cross(axes[0], axes[1], axes[2]);
    for (auto &axis : axes) to_unit(axis);
    for (size_t i = 0; i < 3; ++i)
        for (size_t j = 0; j < 3; ++j) {
            matrix[i][j] = 0;
            for (size_t k = 0; k < 3; ++k) matrix[i][j] += axes[k][i] * pair_frame[3 * j + k];
        }
    quaternion_of(matrix, out);
}

// All coordinates of four frames, (dimensions, 4), in the order of the tree.
ALWAYS_INLINE void coordinates(const Schedule &of, const Positions &positions, size_t first, Four *frames, Four *out) {
    for (size_t step = 0; step < of.steps; ++step) {
        const int64_t *p = of.program + 6 * step;
        const Four *reference = p[2] < 0 ? nullptr : frames + 9 * p[2];
        Four *own = p[3] < 0 ? nullptr : frames + 9 * p[3];
        const size_t number = size_t(p[1]);
        Four offset[3], turned[3], local[9];
        if (p[0]) {
            Four pair[2][3], *vector = out + 2 * of.bones + 3 * number;
            const double *home = of.homes + 9 * number;
            for (size_t i = 0; i < 2; ++i) {
                const int64_t joint = of.pairs[2 * number + i];
                positions.offset(joint, of.parents[joint], first, reference ? offset : pair[i]);
                if (!reference) continue;
                into(reference, offset, turned);
                into(home, turned, pair[i]);
            }
            Four quaternion[4];
            for (size_t lane = 0; lane < 4; ++lane) {
                double found[4];
                hub_quaternion(pair, lane, of.pair_frames + 9 * number, found);
                for (size_t k = 0; k < 4; ++k) quaternion[k][lane] = found[k];
            }
            vector_of(quaternion, vector);
            frame_of(vector, reference ? local : own);
            for (size_t axis = 0; reference && axis < 9; axis += 3) {
                out_of(home, local + axis, turned);
                out_of(reference, turned, own + axis);
            }
            continue;
        }
        const int64_t joint = of.joints[number];
        const double *rest = of.rests + 9 * number;
        Four *tilt = out + 2 * of.order[number];
        positions.offset(joint, of.parents[joint], first, offset);
        if (reference) into(reference, offset, turned);
        into(rest, reference ? turned : offset, local);
        const Four horizontal_2 = local[0] * local[0] + local[1] * local[1];
        const Four horizontal = root(horizontal_2), angle = angle_of(horizontal, horizontal_2, local[2]);
        const Four ratio = where_less(horizontal, TINY, Four{} * 0.0, angle / horizontal);
        tilt[0] = local[0] * ratio, tilt[1] = local[1] * ratio;
        if (!own) continue;
        tilted_frame(rest, tilt[0], tilt[1], reference ? local : own);
        for (size_t axis = 0; reference && axis < 9; axis += 3) out_of(reference, local + axis, own + axis);
    }
}

ALWAYS_INLINE void all_coordinates(const Schedule &of, const Positions &positions, double *out) {
    const size_t dimensions = 2 * of.bones + 3 * of.hubs;
    std::vector<double> frames_memory(36 * of.slots + 4), found_memory(4 * dimensions);
    Four *frames = fours(frames_memory), *found = fours(found_memory);
    for (size_t first = 0; first < positions.frames; first += 4) {
        coordinates(of, positions, first, frames, found);
        const size_t count = std::min<size_t>(4, positions.frames - first);
        for (size_t d = 0; d < dimensions; ++d)
            for (size_t i = 0; i < count; ++i) out[d * positions.frames + first + i] = found[d][i];
    }
}

// rotations.unwrapped for one vector of `size` numbers, (size, frames).
inline void unwrap(double *vector, size_t size, size_t frames) {
    bool odd = false;
    double before[3] = {};
    for (size_t f = 0; f < frames; ++f) {
        double step_2 = 0, length_2 = 0;
        for (size_t k = 0; k < size; ++k) {
            const double here = vector[k * frames + f];
            step_2 += (here - before[k]) * (here - before[k]);
            length_2 += here * here;
            before[k] = here;
        }
        if (f && step_2 > PI * PI) odd = !odd;
        if (!odd) continue;  // nearly always: roots are slow
        const double length = std::sqrt(length_2);
        if (!(length < TINY))
            for (size_t k = 0; k < size; ++k) vector[k * frames + f] *= 1 - 2 * PI / length;
    }
}

// Unwraps the vectors of all bones and hubs in coordinates (dimensions, frames).
inline void unwrap_all(size_t bones, size_t hubs, double *coordinates, size_t frames) {
    for (size_t b = 0; b < bones; ++b) unwrap(coordinates + 2 * b * frames, 2, frames);
    for (size_t h = 0; h < hubs; ++h) unwrap(coordinates + (2 * bones + 3 * h) * frames, 3, frames);
}

}  // namespace bones
