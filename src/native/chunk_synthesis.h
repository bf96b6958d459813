// Positions of a chunk of codecs/tempo from its integers: models/model.py, synthesise; coding/quantise.py, dequantise;
// pose/bone_directions.py, inverse; coding/corrections.py, apply. They agree with NumPy's to rounding.
//
//   integers ─steps─► coefficients ─bases─► spectrum of coordinates ─inverse DCT─► curves (frames, columns)
//   curves ─four frames at a time─► pose ─heading, place─► positions ─corrections─► the caller's array
#pragma once

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "chunk_symbols.h"
#include "rotations4.h"

namespace chunks {

using namespace rotations4;

// coding/rows.py, coding/quantise.py
constexpr size_t HEADING = 0, POSE = 4;
constexpr double INWARD = 0.05;
constexpr size_t PANEL = 8, TILE = 4;  // columns and frames that the inverse DCT computes at a time

// pose/bone_tree.py, BoneSchedule.program and what turns directions into poses.
struct Tree {
    std::vector<int64_t> program;          // (steps, 6)
    std::vector<double> rests, homes, ends;  // (bones, 3, 3), (hubs, 3, 3), (bones of hubs, 3)
    std::vector<int64_t> order;            // coordinates of each bone in schedule order
    std::vector<int64_t> parents, direction, column;  // of each joint: parent, its direction (−1: none), output column
    std::vector<double> lengths;           // of each joint's bone, metres
    size_t bones = 0, hubs = 0, slots = 0;
};

// A model's coordinates. Columns of curves are the coordinates of the pose, heading, place.
struct Shape {
    size_t points = 0, dimensions = 0, columns = 0;  // columns: those of curves, a multiple of PANEL
    std::vector<std::shared_ptr<const std::vector<double>>> bases; // of each band, (components, columns)
    std::vector<double> pose;                        // (points, 3), for positions
    std::unique_ptr<Tree> tree;                      // for directions of bones
    std::vector<double> weights;                     // (points,), or none
};

// Cosines of the inverse DCT: of even and odd frequencies, in blocks of TILE samples of the first half.
struct Cosines {
    explicit Cosines(size_t frames) : frames(frames), half((frames + 1) / 2), blocks((half + TILE - 1) / TILE) {
        const double pi = 3.14159265358979323846;
        std::vector<double> quarter_turns(4 * frames);
        for (size_t j = 0; j < 4 * frames; ++j) quarter_turns[j] = std::cos(pi * double(j) / double(2 * frames));
        const double first = std::sqrt(1.0 / double(frames)), others = std::sqrt(2.0 / double(frames));
        for (size_t parity = 0; parity < 2; ++parity) {
            const size_t count = frequencies(frames, parity);
            of[parity].assign(blocks * count * TILE, 0.0);
            for (size_t t = 0; t < half; ++t) {
                double *to = of[parity].data() + t / TILE * count * TILE + t % TILE;
                size_t turn = parity ? 2 * t + 1 : 0;  // (2 t + 1) k modulo 4 frames, for k = 2 i + parity
                for (size_t i = 0; i < count; ++i) {
                    to[i * TILE] = (i || parity ? others : first) * quarter_turns[turn];
                    turn += 2 * (2 * t + 1);
                    if (turn >= 4 * frames) turn -= 4 * frames;
                }
            }
        }
    }

    // How many even or odd frequencies there are among the first `known`.
    static size_t frequencies(size_t known, size_t parity) { return (known + 1 - parity) / 2; }

    const double *block(size_t number, size_t parity) const {
        return of[parity].data() + number * frequencies(frames, parity) * TILE;
    }

    const size_t frames, half, blocks;
    std::vector<double> of[2];
};

struct Target {
    double *positions;      // (last − first, points, 3), in the axes of `axis`
    size_t first, last;     // frames of the chunk
    size_t axis[3];         // output axis of x, y and z
};

// A run of corrections, as corrections.from_numbers reads it.
struct Correction {
    size_t start, length;
    double by[3];
};

inline bool corrections_of(const std::vector<int64_t> &lists, size_t frames, size_t points, std::vector<Correction> &out) {
    const size_t n = lists.size() / FIELDS, samples = frames * points;
    size_t end = 0;
    for (size_t i = 0; i < n; ++i) {
        const uint64_t gap = uint64_t(lists[3 * n + i]), length = uint64_t(lists[4 * n + i]) + 1;
        if (gap > samples || length > frames) return false;
        const size_t start = end + size_t(gap);
        end = start + size_t(length);
        if (end > samples || start % frames + length > frames) return false;
        out.push_back({start, size_t(length), {double(lists[i]), double(lists[n + i]), double(lists[2 * n + i])}});
    }
    return true;
}

struct Scratch {
    std::vector<size_t> numbers[2];  // of even and of odd frequencies with coefficients: half of the frequency
    std::vector<double> panels, curves, row, frames, directions, pose;  // the last three: four doubles each

    static NEVER_INLINE Scratch &of_thread() {  // its address is looked up once
        static thread_local Scratch scratch;
        return scratch;
    }
};

class Synthesis {
public:
    Synthesis(const Shape &shape, const Cosines &cosines, const size_t *band_ends, double step_m, double heading_step)
        : of_(shape), cosines_(cosines), band_ends_(band_ends), step_m_(step_m), heading_step_(heading_step) {}

    ALWAYS_INLINE void run(const Integers &integers, const Target &out) const {
        Scratch &scratch = Scratch::of_thread();
        const size_t known = integers.coefficients.empty() ? 0 : integers.coefficients.back().frequency + 1;
        spectrum(integers, known, scratch);
        curves(known, scratch, out);
        poses(scratch, out);
    }

    // sums[i][…] = Σ cosines[f][i] · panel[f][…]
    ALWAYS_INLINE static void tile(const double *cosines, const double *panel, size_t count, Four (&sums)[TILE][2]) {
        tile(cosines, [](size_t f) { return f; }, panel, count, sums);
    }

    // sums[i][…] = Σ cosines[number(f)][i] · panel[f][…]
    template <class Number>
    ALWAYS_INLINE static void tile(const double *cosines, Number number, const double *panel, size_t count,
                                   Four (&sums)[TILE][2]) {
        const Four zero = Four{} * 0.0;
        Four a0 = zero, a1 = zero, b0 = zero, b1 = zero, c0 = zero, c1 = zero, d0 = zero, d1 = zero;
        for (size_t f = 0; f < count; ++f) {
            Four left, right;
            load(left, panel + f * PANEL);
            load(right, panel + f * PANEL + 4);
            const double *c = cosines + number(f) * TILE;
            a0 += left * c[0], a1 += right * c[0];
            b0 += left * c[1], b1 += right * c[1];
            c0 += left * c[2], c1 += right * c[2];
            d0 += left * c[3], d1 += right * c[3];
        }
        sums[0][0] = a0, sums[0][1] = a1, sums[1][0] = b0, sums[1][1] = b1;
        sums[2][0] = c0, sums[2][1] = c1, sums[3][0] = d0, sums[3][1] = d1;
    }

private:
    // The spectrum of the columns, in panels of PANEL columns: first even frequencies, then odd ones; those with
    // coefficients only.
    ALWAYS_INLINE void spectrum(const Integers &integers, size_t known, Scratch &scratch) const {
        const size_t columns = of_.columns, even = Cosines::frequencies(known, 0);
        scratch.panels.resize(columns * known + PANEL);
        scratch.numbers[0].clear(), scratch.numbers[1].clear();
        scratch.row.resize(columns);
        double *row = scratch.row.data();
        const Coefficient *at = integers.coefficients.data(), *end = at + integers.coefficients.size();
        size_t band = 0;
        while (at != end) {
            const size_t frequency = at->frequency;
            while (frequency >= band_ends_[band]) ++band;
            const double *basis = of_.bases[band]->data();
            std::fill_n(row, columns, 0.0);
            for (; at != end && at->frequency == frequency && at->row < POSE; ++at)
                row[of_.dimensions + at->row] = double(at->value) * (at->row == HEADING ? heading_step_ : step_m_);
            const Coefficient *next = at;
            while (next != end && next->frequency == frequency) ++next;
            for (; next - at >= 4; at += 4) add<4>(row, basis, at);
            for (; at != next; ++at) add<1>(row, basis, at);
            std::vector<size_t> &numbers = scratch.numbers[frequency % 2];
            const size_t place = (frequency % 2 ? even : 0) + numbers.size();
            numbers.push_back(frequency / 2);
            for (size_t panel = 0; panel < columns / PANEL; ++panel)
                std::memcpy(scratch.panels.data() + (panel * known + place) * PANEL, row + panel * PANEL,
                            PANEL * sizeof(double));
        }
    }

    template <int N>
    ALWAYS_INLINE void add(double *row, const double *basis, const Coefficient *from) const {
        const double *components[N];
        double values[N];
        for (int i = 0; i < N; ++i) {
            const int64_t v = from[i].value;
            components[i] = basis + (from[i].row - POSE) * of_.columns;
            values[i] = (double(v) - (v > 0 ? INWARD : -INWARD)) * step_m_;
        }
        for (size_t c = 0; c < of_.columns; c += 4) {
            Four sum, one;
            load(sum, row + c);
            for (int i = 0; i < N; ++i) {
                load(one, components[i] + c);
                sum += one * values[i];
            }
            store(sum, row + c);
        }
    }

    // stages/dct.py, inverse: (frames, columns), of the frames that `poses` takes four at a time; of all frames if `out`
    // has none, which is for timing.
    ALWAYS_INLINE void curves(size_t known, Scratch &scratch, const Target &out) const {
        const size_t columns = of_.columns, frames = cosines_.frames, half = cosines_.half;
        const size_t last = std::min(frames, out.first + (out.last - out.first + 3) / 4 * 4);
        scratch.curves.resize((frames + 3) * columns);
        for (size_t block = 0; block < cosines_.blocks; ++block) {
            const size_t t0 = block * TILE, t1 = std::min(half, t0 + TILE);
            const bool in_head = t0 < last && out.first < t1;
            const bool in_tail = frames - t1 < last && out.first < frames - t0;
            if (!in_head && !in_tail && out.first < out.last) continue;
            const double *even = cosines_.block(block, 0), *odd = cosines_.block(block, 1);
            for (size_t panel = 0; panel < columns / PANEL; ++panel) {
                const double *of_panel = scratch.panels.data() + panel * known * PANEL;
                const size_t *evens = scratch.numbers[0].data(), *odds = scratch.numbers[1].data();
                Four symmetric[TILE][2], antisymmetric[TILE][2];
                tile(even, [evens](size_t f) { return evens[f]; }, of_panel, scratch.numbers[0].size(), symmetric);
                tile(odd, [odds](size_t f) { return odds[f]; }, of_panel + Cosines::frequencies(known, 0) * PANEL,
                     scratch.numbers[1].size(), antisymmetric);
                for (size_t i = 0; i < TILE && block * TILE + i < half; ++i) {
                    const size_t t = block * TILE + i;
                    double *head = scratch.curves.data() + t * columns + panel * PANEL;
                    double *tail = scratch.curves.data() + (frames - 1 - t) * columns + panel * PANEL;
                    for (size_t j = 0; j < 2; ++j) {
                        store(symmetric[i][j] - antisymmetric[i][j], tail + 4 * j);
                        store(symmetric[i][j] + antisymmetric[i][j], head + 4 * j);
                    }
                }
            }
        }
        for (size_t i = 0; i < 3; ++i)  // so that the last frames are four, too
            std::memcpy(scratch.curves.data() + (frames + i) * columns, scratch.curves.data() + (frames - 1) * columns,
                        columns * sizeof(double));
    }

    ALWAYS_INLINE void poses(Scratch &scratch, const Target &out) const {
        const size_t columns = of_.columns, points = of_.points;
        const double share = 1 / std::sqrt(double(points));
        scratch.pose.resize(12 * points);
        Four *pose = fours(scratch.pose);
        for (size_t first = out.first; first < out.last; first += 4) {
            const double *curves = scratch.curves.data() + first * columns;
            if (of_.tree) directions(*of_.tree, curves, scratch);
            else
                for (size_t i = 0; i < 3 * points; ++i) {
                    column(pose[i], curves, i);
                    pose[i] += of_.pose[i];
                }
            Four angle, cosine, sine, place[3];
            column(angle, curves, of_.dimensions + HEADING);
            for (size_t k = 0; k < 3; ++k) {
                column(place[k], curves, of_.dimensions + 1 + k);
                place[k] *= share;
            }
            for (size_t i = 0; i < 4; ++i) cosine[i] = std::cos(angle[i]), sine[i] = std::sin(angle[i]);
            const size_t count = std::min<size_t>(4, out.last - first);
            for (size_t p = 0; p < points; ++p) {
                const Four x = pose[3 * p], z = pose[3 * p + 2];
                const Four moved[3] = {cosine * x + sine * z + place[0], pose[3 * p + 1] + place[1],
                                       cosine * z - sine * x + place[2]};
                for (size_t k = 0; k < 3; ++k) {
                    double *at = out.positions + ((first - out.first) * points + p) * 3 + out.axis[k];
                    for (size_t i = 0; i < count; ++i) at[i * points * 3] = moved[k][i];
                }
            }
        }
    }

    // One column of four frames.
    ALWAYS_INLINE void column(Four &into, const double *curves, size_t number) const {
        const double *at = curves + number;
        for (size_t i = 0; i < 4; ++i) into[i] = at[i * of_.columns];
    }

    // pose/bone_directions.py, inverse: four poses, their mean in the origin.
    ALWAYS_INLINE void directions(const Tree &tree, const double *curves, Scratch &scratch) const {
        scratch.frames.resize(36 * tree.slots);
        scratch.directions.resize(12 * (tree.bones + tree.ends.size() / 3));
        Four *frames = fours(scratch.frames), *found = fours(scratch.directions);
        for (const int64_t *p = tree.program.data(); p != tree.program.data() + tree.program.size(); p += 6) {
            const Four *reference = p[2] < 0 ? nullptr : frames + 9 * p[2];
            if (p[0]) hub(tree, p, curves, reference, frames + 9 * p[3], found);
            else bone(tree, p, curves, reference, p[3] < 0 ? nullptr : frames + 9 * p[3], found + 3 * p[4]);
        }
        Four *pose = fours(scratch.pose), mean[3] = {Four{} * 0.0, Four{} * 0.0, Four{} * 0.0};
        const size_t joints = tree.parents.size();
        for (size_t j = 0; j < joints; ++j) {
            Four *at = pose + 3 * tree.column[j];
            for (size_t k = 0; k < 3; ++k) {
                at[k] = tree.parents[j] < 0 ? Four{} * 0.0 : pose[3 * tree.column[size_t(tree.parents[j])] + k];
                if (tree.direction[j] >= 0) at[k] += found[3 * tree.direction[j] + k] * tree.lengths[j];
                mean[k] += at[k];
            }
        }
        for (size_t k = 0; k < 3; ++k) mean[k] *= 1 / double(joints);
        for (size_t j = 0; j < joints; ++j)
            for (size_t k = 0; k < 3; ++k) pose[3 * j + k] -= mean[k];
    }

    ALWAYS_INLINE void bone(const Tree &tree, const int64_t *p, const double *curves, const Four *reference, Four *own,
                            Four *direction) const {
        Four x, y, local[9];
        column(x, curves, size_t(2 * tree.order[size_t(p[1])]));
        column(y, curves, size_t(2 * tree.order[size_t(p[1])] + 1));
        const double *rest = tree.rests.data() + 9 * p[1];
        if (!own) {
            tilted_direction(rest, x, y, reference ? local : direction);
            if (reference) out_of(reference, local, direction);
            return;
        }
        tilted_frame(rest, x, y, reference ? local : own);
        for (size_t axis = 0; reference && axis < 9; axis += 3) out_of(reference, local + axis, own + axis);
        std::copy_n(own + 6, 3, direction);
    }

    ALWAYS_INLINE void hub(const Tree &tree, const int64_t *p, const double *curves, const Four *reference, Four *own,
                           Four *found) const {
        Four vector[3], local[9], home[3];
        for (size_t k = 0; k < 3; ++k) column(vector[k], curves, 2 * tree.bones + 3 * size_t(p[1]) + k);
        frame_of(vector, reference ? local : own);
        for (size_t axis = 0; reference && axis < 9; axis += 3) {
            out_of(tree.homes.data() + 9 * p[1], local + axis, home);
            out_of(reference, home, own + axis);
        }
        for (size_t child = size_t(p[4]); child < size_t(p[5]); ++child) {
            const double *v = tree.ends.data() + 3 * (child - tree.bones);
            for (size_t a = 0; a < 3; ++a) found[3 * child + a] = own[a] * v[0] + own[3 + a] * v[1] + own[6 + a] * v[2];
        }
    }

    const Shape &of_;
    const Cosines &cosines_;
    const size_t *band_ends_;
    const double step_m_, heading_step_;
};

// corrections.apply. step_m: the step of the corrections.
inline void apply(const std::vector<Correction> &corrections, const Shape &of, size_t frames, double step_m,
                  const Target &out) {
    const double pi = 3.14159265358979323846;
    for (const Correction &each : corrections) {
        const size_t point = each.start / frames, frame = each.start % frames;
        const double size = of.weights.empty() ? step_m : step_m / of.weights[point];
        for (size_t i = 0; i < each.length; ++i) {
            const size_t t = frame + i;
            if (t < out.first || t >= out.last) continue;
            const double weight = each.length == 1 ? size : size * std::sin(pi * double(i + 1) / double(each.length + 1));
            double *at = out.positions + ((t - out.first) * of.points + point) * 3;
            for (size_t k = 0; k < 3; ++k) at[out.axis[k]] += each.by[k] * weight;
        }
    }
}

}  // namespace chunks
