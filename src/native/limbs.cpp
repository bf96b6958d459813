// codecs/tempo/limbs.py, Limbs._turned: where bones point, given their turns. The same operations in the same order as
// there, frame by frame; sines and cosines come from NumPy, whose last bits are its own.

#include <algorithm>
#include <stdexcept>

#include "arrays.h"

namespace {

constexpr size_t BLOCK = 64;  // frames worked on at a time, so that all frames of a body stay in the cache

using Block = double[BLOCK];

// out = frame · vector, both columns of blocks; frames are their axes, one after another.
void out_of(const Block *frame, const Block *vector, size_t n, Block *out) {
    for (size_t a = 0; a < 3; ++a)
        for (size_t f = 0; f < n; ++f) {
            double sum = frame[a][f] * vector[0][f];
            sum += frame[3 + a][f] * vector[1][f];
            sum += frame[6 + a][f] * vector[2][f];
            out[a][f] = sum;
        }
}

// The same with one frame, of three axes, for all.
void out_of_one(const double *frame, const Block *vector, size_t n, Block *out) {
    for (size_t a = 0; a < 3; ++a)
        for (size_t f = 0; f < n; ++f) {
            double sum = frame[a] * vector[0][f];
            sum += frame[3 + a] * vector[1][f];
            sum += frame[6 + a] * vector[2][f];
            out[a][f] = sum;
        }
}

// Rotation matrices of rotation vectors: limbs._turning.
void turning(const Block *vector, const double *sine, const double *cosine, const double *versed, size_t n, Block *out) {
    for (size_t f = 0; f < n; ++f) {
        const double x = vector[0][f], y = vector[1][f], z = vector[2][f], s = sine[f], v = versed[f];
        out[0][f] = cosine[f] + v * x * x;
        out[4][f] = cosine[f] + v * y * y;
        out[8][f] = cosine[f] + v * z * z;
        const double xy = v * (x * y), xz = v * (x * z), yz = v * (y * z);
        out[3][f] = xy - s * z, out[1][f] = xy + s * z;
        out[6][f] = xz - s * -y, out[2][f] = xz + s * -y;
        out[7][f] = yz - s * x, out[5][f] = yz + s * x;
    }
}

// The third axis of a frame at rest, tilted: limbs._directions.
void direction(const double *rest, const double *x, const double *y, const double *sine, const double *cosine, size_t n,
               Block *out) {
    for (size_t a = 0; a < 3; ++a)
        for (size_t f = 0; f < n; ++f) {
            double sum = rest[a] * (x[f] * sine[f]);
            sum += rest[3 + a] * (y[f] * sine[f]);
            sum += rest[6 + a] * cosine[f];
            out[a][f] = sum;
        }
}

// All three axes of it: limbs._frames.
void frames_of(const double *rest, const double *x, const double *y, const double *sine, const double *cosine,
               const double *versed, size_t n, Block *out) {
    for (size_t a = 0; a < 3; ++a)
        for (size_t f = 0; f < n; ++f) {
            double tilt = rest[a] * x[f];
            tilt += rest[3 + a] * y[f];
            double third = tilt * sine[f];
            third += rest[6 + a] * cosine[f];
            out[6 + a][f] = third;
            tilt *= versed[f];
            tilt += rest[6 + a] * sine[f];
            out[a][f] = rest[a] - x[f] * tilt;
            out[3 + a][f] = rest[3 + a] - y[f] * tilt;
        }
}

// bones (2, bones, frames) and hubs (3, hubs, frames): turns; sine, cosine, versed of each; program, children, rests,
// homes: limbs.Plan.program; lengths (points,), vectors (points, 3). Offsets (3, points, frames).
Output<double> tempo_limbs(Input<double, 3> bones, Input<double, 2> bone_sine, Input<double, 2> bone_cosine,
                           Input<double, 2> bone_versed, Input<double, 3> hubs, Input<double, 2> hub_sine,
                           Input<double, 2> hub_cosine, Input<double, 2> hub_versed, Input<int64_t, 2> program,
                           Input<int64_t, 1> children, Input<double, 3> rests, Input<double, 3> homes,
                           Input<double, 1> lengths, Input<double, 2> vectors) {
    const size_t of_bones = bones.shape(1), of_hubs = hubs.shape(1), frames = bones.shape(2);
    const size_t points = vectors.shape(0), steps = program.shape(0);
    if (program.shape(1) != 6) throw std::invalid_argument("tempo_limbs: shapes differ");
    int64_t slots = 0;
    for (size_t i = 0; i < steps; ++i) slots = std::max(slots, program.data()[6 * i + 3] + 1);
    for (size_t i = 0; i < steps; ++i) {
        const int64_t *p = program.data() + 6 * i;
        const bool fits = p[0] ? p[3] >= 0 && p[4] >= 0 && p[5] >= p[4] && size_t(p[5]) <= children.shape(0)
                               : p[4] >= 0 && size_t(p[4]) < points;
        if (p[1] < 0 || size_t(p[1]) >= (p[0] ? of_hubs : of_bones) || p[2] >= slots || !fits)
            throw std::invalid_argument("tempo_limbs: a program that does not fit");
    }
    for (size_t i = 0; i < children.shape(0); ++i)
        if (children.data()[i] < 0 || size_t(children.data()[i]) >= points)
            throw std::invalid_argument("tempo_limbs: a child that is no point");
    for (const auto *each : {&bone_sine, &bone_cosine, &bone_versed})
        if (each->shape(0) != of_bones || each->shape(1) != frames)
            throw std::invalid_argument("tempo_limbs: shapes differ");
    for (const auto *each : {&hub_sine, &hub_cosine, &hub_versed})
        if (each->shape(0) != of_hubs || each->shape(1) != frames)
            throw std::invalid_argument("tempo_limbs: shapes differ");
    for (const auto *each : {&rests, &homes})
        if (each->shape(0) != (each == &rests ? of_bones : of_hubs) || each->shape(1) != 3 || each->shape(2) != 3)
            throw std::invalid_argument("tempo_limbs: shapes differ");
    if (bones.shape(0) != 2 || hubs.shape(0) != 3 || hubs.shape(2) != frames || lengths.shape(0) != points ||
        vectors.shape(1) != 3)
        throw std::invalid_argument("tempo_limbs: shapes differ");
    Fresh<double> out(3 * points * frames);
    std::fill_n(out.data.get(), 3 * points * frames, 0.0);
    std::unique_ptr<Block[]> found(new Block[size_t(slots) * 9 + 1]);
    Block local[9], home[9], end[3], vector[3];
    for (size_t begin = 0; begin < frames; begin += BLOCK) {
        const size_t n = std::min(BLOCK, frames - begin);
        auto to = [&](size_t axis, size_t point) { return out.data.get() + (axis * points + point) * frames + begin; };
        for (size_t i = 0; i < steps; ++i) {
            const int64_t *p = program.data() + 6 * i;
            const size_t number = size_t(p[1]), at = number * frames + begin;
            const Block *carrier = p[2] < 0 ? nullptr : found.get() + 9 * p[2];
            Block *own = p[3] < 0 ? nullptr : found.get() + 9 * p[3];
            if (p[0]) {
                for (size_t a = 0; a < 3; ++a)
                    std::copy_n(hubs.data() + (a * of_hubs + number) * frames + begin, n, vector[a]);
                const double *sine = hub_sine.data() + at, *cosine = hub_cosine.data() + at;
                turning(vector, sine, cosine, hub_versed.data() + at, n, carrier ? local : own);
                for (size_t axis = 0; carrier && axis < 9; axis += 3) {
                    out_of_one(homes.data() + 9 * number, local + axis, n, home + axis);
                    out_of(carrier, home + axis, n, own + axis);
                }
                for (int64_t c = p[4]; c < p[5]; ++c) {
                    const size_t point = size_t(children.data()[c]);
                    const double *v = vectors.data() + 3 * point;
                    for (size_t a = 0; a < 3; ++a) {
                        double *row = to(a, point);
                        for (size_t f = 0; f < n; ++f) {
                            double sum = own[a][f] * v[0];
                            sum += own[3 + a][f] * v[1];
                            sum += own[6 + a][f] * v[2];
                            row[f] = sum;
                        }
                    }
                }
                continue;
            }
            const double *x = bones.data() + at, *y = x + of_bones * frames, *rest = rests.data() + 9 * number;
            const double *sine = bone_sine.data() + at, *cosine = bone_cosine.data() + at;
            const Block *points_to;
            if (own) {
                Block *in_carrier = carrier ? local : own;
                frames_of(rest, x, y, sine, cosine, bone_versed.data() + at, n, in_carrier);
                for (size_t axis = 0; carrier && axis < 9; axis += 3) out_of(carrier, local + axis, n, own + axis);
                points_to = own + 6;
            } else {
                direction(rest, x, y, sine, cosine, n, vector);
                if (carrier) out_of(carrier, vector, n, end);
                points_to = carrier ? end : vector;
            }
            const double length = lengths.data()[size_t(p[4])];
            for (size_t a = 0; a < 3; ++a)
                for (size_t f = 0; f < n; ++f) to(a, size_t(p[4]))[f] = points_to[a][f] * length;
        }
    }
    return out.give({3, points, frames});
}

}  // namespace

void bind_limbs(nb::module_ &m) { m.def("tempo_limbs", &tempo_limbs); }
