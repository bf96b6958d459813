// Positions of a chunk of codecs/tempo from its integers: models/model.py, synthesise; coding/quantise.py, dequantise;
// pose/bone_directions.py, inverse; coding/corrections.py, apply. They agree with NumPy's up to rounding.
//
//   integers ─steps─► coefficients ─bases─► spectrum of coordinates ─inverse DCT─► curves (frames, columns)
//   curves ─four frames at a time─► pose ─heading, place─► positions ─corrections─► the caller's array
#pragma once

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "chunk_symbols.h"
#include "component_curves.h"
#include "dct_tiles.h"
#include "rotations4.h"

namespace chunks {

using namespace rotations4;

constexpr double INWARD = 0.05;  // coding/quantise.py

// pose/bone_tree.py, BoneSchedule.program, and the data that turn directions into poses.
struct Tree {
    std::vector<int64_t> program;          // (steps, 6)
    std::vector<double> rests, homes, ends;  // (bones, 3, 3), (hubs, 3, 3), (bones of hubs, 3)
    std::vector<int64_t> order;            // index among the coordinates of each bone in schedule order
    std::vector<int64_t> parents, direction, column;  // parent, direction (−1: none) and output column of each joint
    std::vector<double> lengths;           // length of each joint's bone, metres
    size_t bones = 0, hubs = 0, slots = 0;
};

// A model's coordinates. Columns of curves: coordinates of the pose, heading, place.
struct Shape {
    size_t points = 0, dimensions = 0, columns = 0;  // columns: of curves, a multiple of PANEL
    std::vector<std::shared_ptr<const double>> bases;  // basis of each band, (components, dimensions)
    std::vector<double> pose;                        // mean pose (points, 3), for models of positions
    std::unique_ptr<Tree> tree;                      // for models of bone directions
    std::vector<double> weights;                     // (points,), or empty
};

struct Target {
    double *positions;      // (last − first, points, 3), in the axes of `axis`
    size_t first, last;     // frames of the chunk
    size_t axis[3];         // output axis of x, y and z
};

// A run of corrections: corrections.from_numbers.
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
    std::vector<size_t> numbers[2];  // even and odd frequencies with coefficients, divided by 2
    std::vector<double> panels, curves, row, frames, directions, pose;  // the last three: four doubles each
    std::vector<double> components, packed;  // curves of components, in blocks of TILE frames; a panel of their basis
    Division division;

    static NEVER_INLINE Scratch &of_thread() {  // looks its address up once
        static thread_local Scratch scratch;
        return scratch;
    }
};

class Synthesis {
public:
    Synthesis(const Shape &shape, const Cosines &cosines, const size_t *band_ends, double step_m, double heading_step)
        : of_(shape), cosines_(cosines), band_ends_(band_ends), step_m_(step_m), heading_step_(heading_step) {}

    // Whether all positions are finite: corrections do not change it.
    ALWAYS_INLINE bool run(const Integers &integers, const Target &out) const {
        Scratch &scratch = Scratch::of_thread();
        const size_t known = integers.coefficients.empty() ? 0 : integers.coefficients.back().frequency + 1;
        const bool divided = of_.bases.front() == of_.bases.back() &&
                             scratch.division.divide(integers.coefficients, known, of_.columns);
        const size_t of_columns = divided ? scratch.division.frequencies : known;
        spectrum(divided ? scratch.division.few : integers.coefficients, of_columns, scratch);
        curves(of_columns, scratch, out);
        if (divided) add_components(known, scratch, out);
        repeat_last_frame(scratch);
        return poses(scratch, out);
    }

private:
    // The spectrum of the columns, in panels of PANEL columns: even frequencies, then odd
    // ones; only frequencies with coefficients.
    ALWAYS_INLINE void spectrum(const std::vector<Coefficient> &coefficients, size_t known, Scratch &scratch) const {
        const size_t columns = of_.columns, even = Cosines::frequencies(known, 0);
        scratch.panels.resize(columns * known + PANEL);
        scratch.numbers[0].clear(), scratch.numbers[1].clear();
        scratch.row.resize(columns);
        double *row = scratch.row.data();
        const Coefficient *at = coefficients.data(), *end = at + coefficients.size();
        size_t band = 0;
        while (at != end) {
            const size_t frequency = at->frequency;
            while (frequency >= band_ends_[band]) ++band;
            const double *basis = of_.bases[band].get();
            std::fill_n(row, columns, 0.0);
            for (; at != end && at->frequency == frequency && at->row < POSE; ++at)
                row[of_.dimensions + at->row] = value_of(*at);
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
            components[i] = basis + (from[i].row - POSE) * of_.dimensions;
            values[i] = value_of(from[i]);
        }
        const size_t dimensions = of_.dimensions;
        size_t c = 0;
        for (; c + 4 <= dimensions; c += 4) {
            Four sum, one;
            load(sum, row + c);
            for (int i = 0; i < N; ++i) {
                load(one, components[i] + c);
                sum += one * values[i];
            }
            store(sum, row + c);
        }
        for (; c < dimensions; ++c)
            for (int i = 0; i < N; ++i) row[c] += components[i][c] * values[i];
    }

    // stages/dct.py, inverse: curves (frames, columns) of the frames that `poses` needs, four at a time; of all frames
    // if `out` has none, for timing.
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
    }

    // Dequantised value: radians for the heading, metres for other rows.
    ALWAYS_INLINE double value_of(const Coefficient &of) const {
        if (of.row < POSE) return double(of.value) * (of.row == HEADING ? heading_step_ : step_m_);
        return (double(of.value) - (of.value > 0 ? INWARD : -INWARD)) * step_m_;
    }

    // Adds the part of the curves from the coefficients `division.many`.
    ALWAYS_INLINE void add_components(size_t known, Scratch &scratch, const Target &out) const {
        const Division &of = scratch.division;
        const size_t columns = of_.columns, frames = cosines_.frames, count = of.rows.size();
        component_curves(known, scratch);
        scratch.packed.resize(count * PANEL);
        double *packed = scratch.packed.data();
        const double *basis = of_.bases.front().get();
        for (size_t panel = 0; panel < columns / PANEL; ++panel) {
            const size_t first = panel * PANEL, dimensions = of_.dimensions;
            const size_t inside = first < dimensions ? std::min(PANEL, dimensions - first) : 0;
            for (size_t j = 0; j < count; ++j) {
                double *to = packed + j * PANEL;
                if (of.rows[j] < POSE) {  // heading and place have their own columns
                    for (size_t c = 0; c < PANEL; ++c) to[c] = first + c == dimensions + of.rows[j];
                } else {
                    std::copy_n(basis + (of.rows[j] - POSE) * dimensions + first, inside, to);
                    std::fill(to + inside, to + PANEL, 0.0);
                }
            }
            for (size_t t0 = 0; t0 < frames; t0 += TILE) {
                if (out.first < out.last && (t0 + TILE <= out.first || t0 >= out.last + TILE)) continue;
                Four sums[TILE][2], sum;
                tile(scratch.components.data() + t0 * count, packed, count, sums);
                for (size_t i = 0; i < TILE && t0 + i < frames; ++i)
                    for (size_t j = 0; j < 2; ++j) {
                        double *at = scratch.curves.data() + (t0 + i) * columns + panel * PANEL + 4 * j;
                        load(sum, at);
                        store(sum + sums[i][j], at);
                    }
            }
        }
    }

    // Curves of the rows of `division.many`, in blocks of TILE frames.
    ALWAYS_INLINE void component_curves(size_t known, Scratch &scratch) const {
        const Division &of = scratch.division;
        const size_t frames = cosines_.frames, count = of.rows.size(), panels = (count + PANEL - 1) / PANEL;
        const size_t even = Cosines::frequencies(known, 0), odd = Cosines::frequencies(known, 1);
        scratch.panels.assign(panels * known * PANEL, 0.0);
        for (const Coefficient &each : of.many) {
            const size_t column = of.place[each.row], place = (each.frequency % 2 ? even : 0) + each.frequency / 2;
            scratch.panels[(column / PANEL * known + place) * PANEL + column % PANEL] = value_of(each);
        }
        scratch.components.assign((frames + TILE - 1) / TILE * TILE * count, 0.0);
        auto at = [&](size_t t, size_t column) -> double & {
            return scratch.components[(t / TILE * count + column) * TILE + t % TILE];
        };
        for (size_t block = 0; block < cosines_.blocks; ++block)
            for (size_t panel = 0; panel < panels; ++panel) {
                const double *of_panel = scratch.panels.data() + panel * known * PANEL;
                Four symmetric[TILE][2], antisymmetric[TILE][2];
                tile(cosines_.block(block, 0), of_panel, even, symmetric);
                tile(cosines_.block(block, 1), of_panel + even * PANEL, odd, antisymmetric);
                for (size_t i = 0; i < TILE && block * TILE + i < cosines_.half; ++i)
                    for (size_t c = 0; c < PANEL && panel * PANEL + c < count; ++c) {
                        const size_t t = block * TILE + i, column = panel * PANEL + c;
                        at(frames - 1 - t, column) = symmetric[i][c / 4][c % 4] - antisymmetric[i][c / 4][c % 4];
                        at(t, column) = symmetric[i][c / 4][c % 4] + antisymmetric[i][c / 4][c % 4];
                    }
            }
    }

    // Pads the curves, so that the last block has four frames, too.
    ALWAYS_INLINE void repeat_last_frame(Scratch &scratch) const {
        const size_t columns = of_.columns;
        double *last = scratch.curves.data() + (cosines_.frames - 1) * columns;
        for (size_t i = 1; i <= 3; ++i) std::memcpy(last + i * columns, last, columns * sizeof(double));
    }

    // Whether their sum is finite.
    ALWAYS_INLINE bool poses(Scratch &scratch, const Target &out) const {
        const size_t columns = of_.columns, points = of_.points;
        const double share = 1 / std::sqrt(double(points));
        scratch.pose.resize(12 * points);
        Four *pose = fours(scratch.pose), sum = Four{} * 0.0;
        for (size_t first = out.first; first < out.last; first += 4) {
            const double *curves = scratch.curves.data() + first * columns;
            if (of_.tree) directions(*of_.tree, curves, scratch);
            else
                for (size_t i = 0; i < 3 * points; ++i) {
                    Four one;
                    column(one, curves, i);
                    pose[i] = one + of_.pose[i];
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
                sum += moved[0] + moved[1] + moved[2];
                double *to = out.positions + ((first - out.first) * points + p) * 3;
                for (size_t k = 0; k < 3; ++k)
                    for (size_t i = 0; i < count; ++i) to[i * points * 3 + out.axis[k]] = moved[k][i];
            }
        }
        return std::isfinite(sum[0] + sum[1] + sum[2] + sum[3]);
    }

    // One column in four frames.
    ALWAYS_INLINE void column(Four &into, const double *curves, size_t number) const {
        const double *at = curves + number;
        const size_t next = of_.columns;
        into = Four{at[0], at[next], at[2 * next], at[3 * next]};  // not element by element, which would read while writing
    }

    // pose/bone_directions.py, inverse: four poses with their mean at the origin.
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
