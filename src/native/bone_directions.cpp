// Unit directions of bones from tilts and hub rotations: codecs/tempo/pose/bone_directions.py, _directions, with the
// same operations in the same order. Sines and cosines come from NumPy, so that their last bits agree.

#include <algorithm>
#include <stdexcept>

#include "arrays.h"

namespace {

constexpr size_t BLOCK = 64;  // frames at a time, so that the frames of all references fit into the cache

using Block = double[BLOCK];

// out = frame · vector for each frame of a block: rotations.out_of. A rotation is stored as its three axes.
void out_of(const Block *frame, const Block *vector, size_t n, Block *out) {
    for (size_t a = 0; a < 3; ++a)
        for (size_t f = 0; f < n; ++f) {
            double sum = frame[a][f] * vector[0][f];
            sum += frame[3 + a][f] * vector[1][f];
            sum += frame[6 + a][f] * vector[2][f];
            out[a][f] = sum;
        }
}

// `out_of` with one constant rotation.
void out_of_one(const double *frame, const Block *vector, size_t n, Block *out) {
    for (size_t a = 0; a < 3; ++a)
        for (size_t f = 0; f < n; ++f) {
            double sum = frame[a] * vector[0][f];
            sum += frame[3 + a] * vector[1][f];
            sum += frame[6 + a] * vector[2][f];
            out[a][f] = sum;
        }
}

// Rotations of rotation vectors: rotations.frames_with.
constexpr size_t PLUS[] = {5, 6, 1}, MINUS[] = {7, 2, 3};

void frames_with(const Block *vector, const double *sine, const double *cosine, const double *versed, size_t n, Block *out) {
    for (size_t f = 0; f < n; ++f) {
        for (size_t a = 0; a < 3; ++a)
            for (size_t b = 0; b < 3; ++b) out[3 * a + b][f] = vector[a][f] * (vector[b][f] * versed[f]);
        for (size_t a = 0; a < 3; ++a) {
            const double across = vector[a][f] * sine[f];
            out[4 * a][f] += cosine[f];
            out[PLUS[a]][f] += across;
            out[MINUS[a]][f] -= across;
        }
    }
}

// Direction of a bone after a tilt: rotations.tilted_directions.
void tilted_direction(const double *rest, const double *x, const double *y, const double *sine, const double *cosine, size_t n,
            Block *out) {
    for (size_t a = 0; a < 3; ++a)
        for (size_t f = 0; f < n; ++f) {
            double sum = rest[a] * (x[f] * sine[f]);
            sum += rest[3 + a] * (y[f] * sine[f]);
            sum += rest[6 + a] * cosine[f];
            out[a][f] = sum;
        }
}

// All three axes of a bone after a tilt: rotations.tilted_frames.
void tilted_frame(const double *rest, const double *x, const double *y, const double *sine, const double *cosine,
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

// Directions (3, bones and bones of hubs, frames). bones (2, bones, frames): tilts; hubs (3, hubs, frames): rotation
// vectors; sines, cosines, verseds (bones + hubs, frames): rotations.SinCos; other arguments: BoneSchedule.program.
Output<double> tempo_bone_directions(Input<double, 3> bones, Input<double, 3> hubs, Input<double, 2> sines,
                           Input<double, 2> cosines, Input<double, 2> verseds, Input<int64_t, 2> program,
                           Input<double, 3> rests, Input<double, 3> homes, Input<double, 2> ends) {
    const size_t of_bones = bones.shape(1), of_hubs = hubs.shape(1), frames = bones.shape(2);
    const size_t directions = of_bones + ends.shape(0), steps = program.shape(0);
    for (const auto *each : {&sines, &cosines, &verseds})
        if (each->shape(0) != of_bones + of_hubs || each->shape(1) != frames)
            throw std::invalid_argument("tempo_bone_directions: shapes differ");
    for (const auto *each : {&rests, &homes})
        if (each->shape(0) != (each == &rests ? of_bones : of_hubs) || each->shape(1) != 3 || each->shape(2) != 3)
            throw std::invalid_argument("tempo_bone_directions: shapes differ");
    if (bones.shape(0) != 2 || hubs.shape(0) != 3 || hubs.shape(2) != frames || program.shape(1) != 6 ||
        ends.shape(1) != 3)
        throw std::invalid_argument("tempo_bone_directions: shapes differ");
    int64_t slots = 0;
    for (size_t i = 0; i < steps; ++i) slots = std::max(slots, program.data()[6 * i + 3] + 1);
    for (size_t i = 0; i < steps; ++i) {
        const int64_t *p = program.data() + 6 * i;
        const int64_t first = p[0] ? int64_t(of_bones) : 0, past = int64_t(p[0] ? directions : of_bones);
        if (p[1] < 0 || size_t(p[1]) >= (p[0] ? of_hubs : of_bones) || p[2] >= slots || p[4] < first || p[5] > past ||
            p[p[0] ? 3 : 5] <= (p[0] ? -1 : p[4]))
            throw std::invalid_argument("tempo_bone_directions: the program does not match");
    }
    Fresh<double> out(3 * directions * frames);
    std::fill_n(out.data.get(), 3 * directions * frames, 0.0);
    std::unique_ptr<Block[]> found(new Block[size_t(slots) * 9 + 1]);
    Block local[9], home[9], end[3], vector[3];
    for (size_t begin = 0; begin < frames; begin += BLOCK) {
        const size_t n = std::min(BLOCK, frames - begin);
        auto to = [&](size_t axis, size_t at) { return out.data.get() + (axis * directions + at) * frames + begin; };
        for (size_t i = 0; i < steps; ++i) {
            const int64_t *p = program.data() + 6 * i;
            const size_t number = size_t(p[1]), at = (number + (p[0] ? of_bones : 0)) * frames + begin;
            const double *sine = sines.data() + at, *cosine = cosines.data() + at, *versed = verseds.data() + at;
            const Block *reference = p[2] < 0 ? nullptr : found.get() + 9 * p[2];
            Block *own = p[3] < 0 ? nullptr : found.get() + 9 * p[3];
            if (p[0]) {
                for (size_t a = 0; a < 3; ++a)
                    std::copy_n(hubs.data() + (a * of_hubs + number) * frames + begin, n, vector[a]);
                frames_with(vector, sine, cosine, versed, n, reference ? local : own);
                for (size_t axis = 0; reference && axis < 9; axis += 3) {
                    out_of_one(homes.data() + 9 * number, local + axis, n, home + axis);
                    out_of(reference, home + axis, n, own + axis);
                }
                for (size_t child = size_t(p[4]); child < size_t(p[5]); ++child) {
                    const double *v = ends.data() + 3 * (child - of_bones);
                    for (size_t a = 0; a < 3; ++a)
                        for (size_t f = 0; f < n; ++f) {
                            double sum = own[a][f] * v[0];
                            sum += own[3 + a][f] * v[1];
                            sum += own[6 + a][f] * v[2];
                            to(a, child)[f] = sum;
                        }
                }
                continue;
            }
            const double *x = bones.data() + at, *y = x + of_bones * frames, *rest = rests.data() + 9 * number;
            const Block *direction = own ? own + 6 : reference ? end : vector;
            if (own) {
                tilted_frame(rest, x, y, sine, cosine, versed, n, reference ? local : own);
                for (size_t axis = 0; reference && axis < 9; axis += 3) out_of(reference, local + axis, n, own + axis);
            } else {
                tilted_direction(rest, x, y, sine, cosine, n, vector);
                if (reference) out_of(reference, vector, n, end);
            }
            for (size_t a = 0; a < 3; ++a) std::copy_n(direction[a], n, to(a, size_t(p[4])));
        }
    }
    return out.give({3, directions, frames});
}

}  // namespace

void bind_bone_directions(nb::module_ &m) { m.def("tempo_bone_directions", &tempo_bone_directions); }
