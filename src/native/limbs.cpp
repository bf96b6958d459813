// codecs/tempo/limbs.py, Limbs._turned: where bones point, given their turns. The same operations in the same order as
// there, frame by frame; sines and cosines come from NumPy, whose last bits are its own.

#include <algorithm>
#include <stdexcept>

#include "arrays.h"

namespace {

constexpr size_t BLOCK = 64;  // frames worked on at a time, so that all frames of a body stay in the cache

using Block = double[BLOCK];

// out = carrier · vector, each a column of blocks; without a carrier the vector itself.
void out_of(const Block *carrier, const Block *vector, size_t pitch, size_t n, Block *out) {
    for (size_t a = 0; a < 3; ++a)
        for (size_t f = 0; f < n; ++f) {
            if (!carrier) {
                out[a * pitch][f] = vector[a * pitch][f];
                continue;
            }
            double sum = carrier[a * 3][f] * vector[0][f];
            sum += carrier[a * 3 + 1][f] * vector[pitch][f];
            sum += carrier[a * 3 + 2][f] * vector[2 * pitch][f];
            out[a * pitch][f] = sum;
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
        out[1][f] = xy - s * z, out[3][f] = xy + s * z;
        out[2][f] = xz - s * -y, out[6][f] = xz + s * -y;
        out[5][f] = yz - s * x, out[7][f] = yz + s * x;
    }
}

// bones (bones, 2, frames) and hubs (hubs, 3, frames): turns; sine, cosine, versed of each; program, children:
// limbs.Plan.program; axes (bones, 3, 3); lengths (points,), vectors (points, 3). Offsets (3, points, frames).
Output<double> tempo_limbs(Input<double, 3> bones, Input<double, 2> bone_sine, Input<double, 2> bone_cosine,
                           Input<double, 2> bone_versed, Input<double, 3> hubs, Input<double, 2> hub_sine,
                           Input<double, 2> hub_cosine, Input<double, 2> hub_versed, Input<int64_t, 2> program,
                           Input<int64_t, 1> children, Input<double, 3> axes, Input<double, 1> lengths,
                           Input<double, 2> vectors) {
    const size_t frames = bones.shape(2), points = vectors.shape(0), steps = program.shape(0);
    int64_t slots = 0;
    for (size_t i = 0; i < steps; ++i) {
        const int64_t *p = program.data() + 6 * i;
        const size_t among = p[0] ? hubs.shape(0) : bones.shape(0);
        if (p[1] < 0 || size_t(p[1]) >= among || p[2] >= slots || p[4] < 0 || p[5] < p[4] ||
            size_t(p[5]) > (p[0] ? children.shape(0) : points))
            throw std::invalid_argument("tempo_limbs: a program that does not fit");
        slots = std::max(slots, p[3] + 1);
    }
    for (size_t i = 0; i < children.shape(0); ++i)
        if (children.data()[i] < 0 || size_t(children.data()[i]) >= points)
            throw std::invalid_argument("tempo_limbs: a child that is no point");
    for (const auto *each : {&bone_sine, &bone_cosine, &bone_versed})
        if (each->shape(0) != bones.shape(0) || each->shape(1) != frames)
            throw std::invalid_argument("tempo_limbs: shapes differ");
    for (const auto *each : {&hub_sine, &hub_cosine, &hub_versed})
        if (each->shape(0) != hubs.shape(0) || each->shape(1) != frames)
            throw std::invalid_argument("tempo_limbs: shapes differ");
    if (bones.shape(1) != 2 || hubs.shape(1) != 3 || hubs.shape(2) != frames || program.shape(1) != 6 ||
        axes.shape(0) != bones.shape(0) || lengths.shape(0) != points || vectors.shape(1) != 3)
        throw std::invalid_argument("tempo_limbs: shapes differ");
    Fresh<double> out(3 * points * frames);
    std::fill_n(out.data.get(), 3 * points * frames, 0.0);
    std::unique_ptr<Block[]> found(new Block[size_t(slots) * 9 + 1]);
    Block local[9], turned[9], vector[3];
    for (size_t begin = 0; begin < frames; begin += BLOCK) {
        const size_t n = std::min(BLOCK, frames - begin);
        auto to = [&](size_t axis, size_t point) { return out.data.get() + (axis * points + point) * frames + begin; };
        for (size_t i = 0; i < steps; ++i) {
            const int64_t *p = program.data() + 6 * i;
            const size_t number = size_t(p[1]);
            const Block *carrier = p[2] < 0 ? nullptr : found.get() + 9 * p[2];
            if (p[0]) {
                const size_t at = number * frames + begin;
                for (size_t a = 0; a < 3; ++a)
                    std::copy_n(hubs.data() + (number * 3 + a) * frames + begin, n, vector[a]);
                turning(vector, hub_sine.data() + at, hub_cosine.data() + at, hub_versed.data() + at, n, local);
                for (size_t column = 0; column < 3; ++column) out_of(carrier, local + column, 3, n, turned + column);
                if (p[3] >= 0) std::copy_n(&turned[0][0], 9 * BLOCK, &found[9 * size_t(p[3])][0]);
                for (int64_t c = p[4]; c < p[5]; ++c) {
                    const size_t point = size_t(children.data()[c]);
                    const double *v = vectors.data() + 3 * point;
                    for (size_t a = 0; a < 3; ++a) {
                        double *row = to(a, point);
                        for (size_t f = 0; f < n; ++f) {
                            double sum = turned[a * 3][f] * v[0];
                            sum += turned[a * 3 + 1][f] * v[1];
                            sum += turned[a * 3 + 2][f] * v[2];
                            row[f] = sum;
                        }
                    }
                }
                continue;
            }
            const size_t point = size_t(p[4]), at = number * frames + begin;
            const double *t0 = bones.data() + number * 2 * frames + begin, *t1 = t0 + frames;
            const double *sine = bone_sine.data() + at, *cosine = bone_cosine.data() + at;
            const double *axis = axes.data() + 9 * number, length = lengths.data()[point];
            for (size_t a = 0; a < 3; ++a) {
                const double e0 = axis[3 * a] * length, e1 = axis[3 * a + 1] * length, e2 = axis[3 * a + 2] * length;
                for (size_t f = 0; f < n; ++f) {
                    double sum = e0 * (t0[f] * sine[f]);
                    sum += e1 * (t1[f] * sine[f]);
                    sum += e2 * cosine[f];
                    vector[a][f] = sum;
                }
            }
            out_of(carrier, vector, 1, n, local);
            for (size_t a = 0; a < 3; ++a) std::copy_n(local[a], n, to(a, point));
            if (p[3] < 0) continue;
            for (size_t a = 0; a < 3; ++a)
                for (size_t f = 0; f < n; ++f) vector[a][f] = axis[3 * a + 1] * t0[f] - axis[3 * a] * t1[f];
            turning(vector, sine, cosine, bone_versed.data() + at, n, local);
            for (size_t column = 0; column < 3; ++column)
                out_of(carrier, local + column, 3, n, found.get() + 9 * p[3] + column);
        }
    }
    return out.give({3, points, frames});
}

}  // namespace

void bind_limbs(nb::module_ &m) { m.def("tempo_limbs", &tempo_limbs); }
