// Moves lattice points towards the surface around them, for codecs/bodycast/point_smoothing.py, which defines the results.
//
//     cells, sample of each point ─► points of the samples around it ─► mean distance along the normals ─► shift

#include <algorithm>
#include <cstdlib>
#include <stdexcept>
#include <vector>

#include "arrays.h"

namespace {

constexpr int FINE_BITS = 8, NORMAL_BITS = 10, SUBUNIT_BITS = 4, WEIGHT_BITS = 10;
constexpr int PER_SAMPLE = 4;  // points of a sample that others are compared with
constexpr int64_t LEAST_COSINE = 315;
constexpr int64_t GAIN_AT_UNIT = 48000, GAIN_LOSS = 90, LARGEST_MOVE = 1 << (FINE_BITS - 1);

int64_t floor_division(int64_t a, int64_t b) { return a / b - (a % b != 0 && (a < 0) != (b < 0)); }

int64_t dot(const int64_t *a, const int64_t *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// (count, PER_SAMPLE): points of each sample, evenly among those that it has in order; −1 for fewer.
std::vector<int32_t> references(const int64_t *samples, size_t points, size_t count) {
    std::vector<int32_t> first(count + 2, 0);
    for (size_t i = 0; i < points; ++i)
        if (samples[i] >= 0) ++first[size_t(samples[i]) + 2];
    for (size_t s = 2; s < first.size(); ++s) first[s] += first[s - 1];
    std::vector<int32_t> order(size_t(first.back()));
    for (size_t i = 0; i < points; ++i)
        if (samples[i] >= 0) order[size_t(first[size_t(samples[i]) + 1]++)] = int32_t(i);
    std::vector<int32_t> table(count * PER_SAMPLE, -1);
    for (size_t s = 0; s < count; ++s) {
        const int size = first[s + 1] - first[s];
        for (int k = 0; k < std::min(size, PER_SAMPLE); ++k)
            table[s * PER_SAMPLE + size_t(k)] = order[size_t(first[s] + (size > PER_SAMPLE ? k * size / PER_SAMPLE : k))];
    }
    return table;
}

struct Move {
    int64_t length = 0, deviation = 0;
};

class Neighbourhood {
public:
    Neighbourhood(const int64_t *cells, const int64_t *samples, const int64_t *normals, const int64_t *neighbours,
                  size_t around, const std::vector<int32_t> &table, int64_t spacing)
        : cells_(cells), samples_(samples), normals_(normals), neighbours_(neighbours), around_(around), table_(table),
          square_(spacing * spacing) {
        weights_.reserve((around + 1) * PER_SAMPLE);
        distances_.reserve((around + 1) * PER_SAMPLE);
    }

    Move of(size_t point) {
        weights_.clear();
        distances_.clear();
        compare(point, samples_[point]);
        const int64_t *others = neighbours_ + size_t(samples_[point]) * around_;
        for (size_t k = 0; k < around_; ++k) compare(point, others[k]);
        int64_t total = 0, largest = 0, sum = 0;
        for (size_t k = 0; k < weights_.size(); ++k) {
            total += weights_[k];
            largest = std::max(largest, weights_[k]);
            sum += weights_[k] * distances_[k];
        }
        const int64_t mean = floor_division(sum, std::max<int64_t>(total + largest, 1));
        int64_t away = 0;
        for (size_t k = 0; k < weights_.size(); ++k) away += weights_[k] * std::abs(distances_[k] - mean);
        Move move;
        move.deviation = away / std::max<int64_t>(total, 1);
        const int64_t gain = GAIN_AT_UNIT / std::max<int64_t>(move.deviation, 1) - GAIN_LOSS;
        move.length = std::clamp(mean * std::clamp<int64_t>(gain, 0, 256) >> 8, -LARGEST_MOVE, LARGEST_MOVE);
        return move;
    }

private:
    // Adds the weights and distances of the points of another sample, if it faces the same way.
    void compare(size_t point, int64_t sample) {
        const int64_t *own = normals_ + 3 * samples_[point], *other = normals_ + 3 * sample;
        if (dot(own, other) < LEAST_COSINE << NORMAL_BITS) return;
        const int64_t both[3] = {own[0] + other[0], own[1] + other[1], own[2] + other[2]};
        for (size_t k = 0; k < PER_SAMPLE; ++k) {
            const int32_t row = table_[size_t(sample) * PER_SAMPLE + k];
            if (row < 0) return;
            if (size_t(row) == point) continue;
            const int64_t *a = cells_ + 3 * row, *b = cells_ + 3 * point;
            const int64_t apart[3] = {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
            const int64_t away = dot(apart, apart) << 2 * SUBUNIT_BITS;
            weights_.push_back((square_ << WEIGHT_BITS) / (away + square_ / 4 + 1));
            distances_.push_back(dot(apart, both) * (1 << FINE_BITS) >> (NORMAL_BITS + 1));
        }
    }

    const int64_t *cells_, *samples_, *normals_, *neighbours_;
    const size_t around_;
    const std::vector<int32_t> &table_;
    const int64_t square_;
    std::vector<int64_t> weights_, distances_;
};

nb::tuple smooth_points(Input<int64_t, 2> cells, Input<int64_t, 1> samples, Input<int64_t, 2> normals,
                        Input<int64_t, 2> neighbours, int64_t spacing) {
    const size_t n = samples.shape(0), m = normals.shape(0), around = neighbours.shape(1);
    if (cells.shape(0) != n || cells.shape(1) != 3 || normals.shape(1) != 3 || neighbours.shape(0) != m || spacing < 1 ||
        spacing > 1 << 16)
        throw std::invalid_argument("smooth_points: shapes differ");
    for (size_t i = 0; i < n; ++i)
        if (samples.data()[i] >= int64_t(m)) throw std::invalid_argument("smooth_points: a sample that is not there");
    for (size_t i = 0; i < neighbours.size(); ++i)
        if (neighbours.data()[i] < 0 || neighbours.data()[i] >= int64_t(m))
            throw std::invalid_argument("smooth_points: a neighbour that is not there");
    const std::vector<int32_t> table = references(samples.data(), n, m);
    Neighbourhood around_points(cells.data(), samples.data(), normals.data(), neighbours.data(), around, table, spacing);
    Fresh<int64_t> shifts(3 * n), moves(n), deviations(n);
    for (size_t i = 0; i < n; ++i) {
        const int64_t sample = samples.data()[i];
        const Move move = sample < 0 ? Move{} : around_points.of(i);
        moves.data[i] = move.length;
        deviations.data[i] = move.deviation;
        for (size_t d = 0; d < 3; ++d) {
            const int64_t product = sample < 0 ? 0 : normals.data()[3 * size_t(sample) + d] * move.length;
            shifts.data[3 * i + d] = product + (1 << (NORMAL_BITS - 1)) >> NORMAL_BITS;
        }
    }
    return nb::make_tuple(shifts.give({n, 3}), moves.give({n}), deviations.give({n}));
}

}  // namespace

void bind_point_smoothing(nb::module_ &m) { m.def("smooth_points", &smooth_points); }
