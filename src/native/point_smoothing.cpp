// Moves lattice points towards the surface around them, for codecs/bodycast/point_smoothing.py, which defines the results.
//
//     cells, sample of each point ─► points of the samples around it ─► mean distance along the normals ─► shift

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <stdexcept>
#include <vector>

#include "arrays.h"
#include "integers.h"

namespace {

constexpr int FINE_BITS = 8, NORMAL_BITS = 10, SUBUNIT_BITS = 4, WEIGHT_BITS = 10;
constexpr int PER_SAMPLE = 4;  // points of a sample that others are compared with
constexpr int64_t LEAST_COSINE = 315;
constexpr int64_t GAIN_AT_UNIT = 48000, GAIN_LOSS = 90, LARGEST_MOVE = 1 << (FINE_BITS - 1);

using Numbers = Input<int64_t, 2>;

// The points of each sample, in order.
struct PointsOfSamples {
    std::vector<int32_t> first, points;

    PointsOfSamples(const int64_t *samples, size_t count, size_t of_samples) : first(of_samples + 2, 0) {
        for (size_t i = 0; i < count; ++i)
            if (samples[i] >= 0) ++first[size_t(samples[i]) + 2];
        for (size_t s = 2; s < first.size(); ++s) first[s] += first[s - 1];
        points.resize(size_t(first.back()));
        for (size_t i = 0; i < count; ++i)
            if (samples[i] >= 0) points[size_t(first[size_t(samples[i]) + 1]++)] = int32_t(i);
    }

    int size(size_t sample) const { return first[sample + 1] - first[sample]; }

    // Reference number k of a sample: evenly among its points.
    int32_t reference(size_t sample, int k) const {
        return points[size_t(first[sample] + (size(sample) > PER_SAMPLE ? k * size(sample) / PER_SAMPLE : k))];
    }
};

struct Move {
    int64_t length, deviation;
};

// total, largest: of the weights. sum: of weight · distance; deviation_of: the sum of weight · |distance − mean|.
template <class DeviationOf>
Move move_of(int64_t total, int64_t largest, int64_t sum, DeviationOf deviation_of) {
    const int64_t mean = floor_division(sum, std::max<int64_t>(total + largest, 1));
    const int64_t deviation = deviation_of(mean) / std::max<int64_t>(total, 1);
    const int64_t gain = std::clamp<int64_t>(GAIN_AT_UNIT / std::max<int64_t>(deviation, 1) - GAIN_LOSS, 0, 256);
    return {std::clamp(mean * gain >> 8, -LARGEST_MOVE, LARGEST_MOVE), deviation};
}

// The points that those of one sample are compared with.
class Neighbourhood {
public:
    Neighbourhood(const Numbers &cells, const Numbers &normals, const Numbers &neighbours, int64_t spacing)
        : cells_(cells.data()), normals_(normals.data()), neighbours_(neighbours.data()), around_(neighbours.shape(1)),
          square_(spacing * spacing) {
        const size_t most = (around_ + 1) * PER_SAMPLE + LANES;
        for (auto *values : {&x_, &y_, &z_, &u_, &v_, &w_, &weights_, &distances_}) values->resize(most, 0.0);
        rows_.resize(most);
        std::array<int64_t, 3> low, high;
        low.fill(std::numeric_limits<int64_t>::max());
        high.fill(std::numeric_limits<int64_t>::min());
        for (size_t i = 0; i < cells.size(); ++i) {
            low[i % 3] = std::min(low[i % 3], cells_[i]);
            high[i % 3] = std::max(high[i % 3], cells_[i]);
        }
        is_near_ = true;
        for (size_t d = 0; cells.size() && d < 3; ++d) is_near_ &= high[d] - NEAR <= low[d];
    }

    void gather(const PointsOfSamples &of, size_t sample) {
        size_ = 0;
        add(of, sample, sample);
        for (size_t k = 0; k < around_; ++k) add(of, sample, size_t(neighbours_[sample * around_ + k]));
    }

    Move move(size_t point) { return move_at(cells_ + 3 * point, int32_t(point), is_near_); }

    // The move of a point at a place. skipped: a reference that does not count, nor do those at the place itself. is_near:
    // whether the place is known to be near all references.
    Move move_at(const int64_t *place, int32_t skipped, bool is_near = false) {
        if (is_near || all_are_near(place)) return near_move(double(place[0]), double(place[1]), double(place[2]), skipped);
        return distant_move(place, skipped);
    }

private:
    // Differences of coordinates up to which doubles are exact: a divisor below 2^40 keeps quotients that are no
    // integers, below 2^12, farther from the next integer than they round, and products fit into int32.
    static constexpr int64_t NEAR = 1 << 14;
    static constexpr double OFFSET = 1 << 29;
    static constexpr size_t LANES = 4;  // sums side by side

    bool all_are_near(const int64_t *place) const {
        for (size_t k = 0; k < size_; ++k)
            for (size_t d = 0; d < 3; ++d)
                if (std::abs(cells_[3 * size_t(rows_[k]) + d] - place[d]) > NEAR) return false;
        return true;
    }

    // Adds the references of another sample, if it faces the same way.
    void add(const PointsOfSamples &of, size_t sample, size_t other) {
        const int64_t *own = normals_ + 3 * sample, *away = normals_ + 3 * other;
        if (!of.size(other) || dot(own, away) < LEAST_COSINE << NORMAL_BITS) return;
        for (int k = 0; k < std::min(of.size(other), PER_SAMPLE); ++k, ++size_) {
            const int32_t row = of.reference(other, k);
            const int64_t *place = cells_ + 3 * row;
            rows_[size_] = row;
            x_[size_] = double(place[0]), y_[size_] = double(place[1]), z_[size_] = double(place[2]);
            u_[size_] = double(own[0] + away[0]), v_[size_] = double(own[1] + away[1]), w_[size_] = double(own[2] + away[2]);
        }
    }

    // Sums are of integers below 2^53, the same in any order.
    Move near_move(double px, double py, double pz, int32_t skipped) {
        const double unit = double(square_ << WEIGHT_BITS), least = double(square_ / 4 + 1);
        const double *x = x_.data(), *y = y_.data(), *z = z_.data(), *u = u_.data(), *v = v_.data(), *w = w_.data();
        double *weights = weights_.data(), *distances = distances_.data();
        for (size_t k = 0; k < size_; ++k) {
            const double a = x[k] - px, b = y[k] - py, c = z[k] - pz;
            weights[k] = double(int32_t(unit / ((a * a + b * b + c * c) * (1 << 2 * SUBUNIT_BITS) + least)));
            // rounded down: the offset is even, and larger than the distances
            const double along = (a * u[k] + b * v[k] + c * w[k]) * (1.0 / (1 << (NORMAL_BITS + 1 - FINE_BITS)));
            distances[k] = double(int32_t(along + OFFSET)) - OFFSET;
        }
        for (size_t k = 0; k < size_; ++k)
            if (rows_[k] == skipped || (x[k] == px && y[k] == py && z[k] == pz)) weights[k] = 0;
        const size_t end = (size_ + LANES - 1) / LANES * LANES;
        for (size_t k = size_; k < end; ++k) weights[k] = 0;
        double total[LANES] = {}, largest[LANES] = {}, sum[LANES] = {};
        for (size_t k = 0; k < end; k += LANES)
            for (size_t j = 0; j < LANES; ++j) {
                total[j] += weights[k + j];
                largest[j] = largest[j] > weights[k + j] ? largest[j] : weights[k + j];
                sum[j] += weights[k + j] * distances[k + j];
            }
        const auto all = [](const double *parts) { return int64_t(parts[0] + parts[1] + parts[2] + parts[3]); };
        return move_of(all(total), int64_t(*std::max_element(largest, largest + LANES)), all(sum), [&](int64_t mean) {
            const double middle = double(mean);
            double deviation[LANES] = {};
            for (size_t k = 0; k < end; k += LANES)
                for (size_t j = 0; j < LANES; ++j) deviation[j] += weights[k + j] * std::abs(distances[k + j] - middle);
            return all(deviation);
        });
    }

    // The same in integers, for points far apart.
    Move distant_move(const int64_t *place, int32_t skipped) {
        std::vector<int64_t> weights, distances;
        int64_t total = 0, largest = 0, sum = 0;
        for (size_t k = 0; k < size_; ++k) {
            const int64_t *a = cells_ + 3 * size_t(rows_[k]);
            const int64_t apart[3] = {a[0] - place[0], a[1] - place[1], a[2] - place[2]};
            if (rows_[k] == skipped || !(apart[0] || apart[1] || apart[2])) continue;
            const int64_t both[3] = {int64_t(u_[k]), int64_t(v_[k]), int64_t(w_[k])};
            const int64_t away = (dot(apart, apart) << 2 * SUBUNIT_BITS) + square_ / 4 + 1;
            weights.push_back((square_ << WEIGHT_BITS) / away);
            distances.push_back(dot(apart, both) * (1 << FINE_BITS) >> (NORMAL_BITS + 1));
            total += weights.back();
            largest = std::max(largest, weights.back());
            sum += weights.back() * distances.back();
        }
        return move_of(total, largest, sum, [&](int64_t mean) {
            int64_t deviation = 0;
            for (size_t k = 0; k < weights.size(); ++k) deviation += weights[k] * std::abs(distances[k] - mean);
            return deviation;
        });
    }

    const int64_t *cells_, *normals_, *neighbours_;
    const size_t around_;
    const int64_t square_;
    size_t size_ = 0;
    bool is_near_;  // all points of the frame to one another
    std::vector<int32_t> rows_;
    std::vector<double> x_, y_, z_, u_, v_, w_;  // places of the references; sums of normals
    std::vector<double> weights_, distances_;
};

void require(bool good) {
    if (!good) throw std::invalid_argument("moves_of_candidates: shapes differ, or a row lies beyond the samples");
}

void require_shapes(const Numbers &cells, const Input<int64_t, 1> &samples, const Numbers &normals,
                    const Numbers &neighbours, int64_t spacing) {
    const size_t n = samples.shape(0), m = normals.shape(0);
    if (cells.shape(0) != n || cells.shape(1) != 3 || normals.shape(1) != 3 || neighbours.shape(0) != m || spacing < 1 ||
        spacing > 1 << 16)
        throw std::invalid_argument("smooth_points: shapes differ");
    for (size_t i = 0; i < n; ++i)
        if (samples.data()[i] >= int64_t(m)) throw std::invalid_argument("smooth_points: a sample that is not there");
    for (size_t i = 0; i < neighbours.size(); ++i)
        if (neighbours.data()[i] < 0 || neighbours.data()[i] >= int64_t(m))
            throw std::invalid_argument("smooth_points: a neighbour that is not there");
}

nb::tuple smooth_points(Numbers cells, Input<int64_t, 1> samples, Numbers normals, Numbers neighbours, int64_t spacing) {
    require_shapes(cells, samples, normals, neighbours, spacing);
    const size_t n = samples.shape(0), m = normals.shape(0);
    Fresh<int64_t> shifts(3 * n), moves(n), deviations(n);
    std::fill_n(shifts.data.get(), 3 * n, 0);
    std::fill_n(moves.data.get(), n, 0);
    std::fill_n(deviations.data.get(), n, 0);
    const PointsOfSamples of(samples.data(), n, m);
    Neighbourhood around(cells, normals, neighbours, spacing);
    for (size_t s = 0; s < m; ++s) {
        if (!of.size(s)) continue;
        around.gather(of, s);
        for (int32_t at = of.first[s]; at < of.first[s + 1]; ++at) {
            const size_t i = size_t(of.points[size_t(at)]);
            const Move move = around.move(i);
            moves.data[i] = move.length;
            deviations.data[i] = move.deviation;
            for (size_t d = 0; d < 3; ++d)
                shifts.data[3 * i + d] = normals.data()[3 * s + d] * move.length + (1 << (NORMAL_BITS - 1)) >> NORMAL_BITS;
        }
    }
    return nb::make_tuple(shifts.give({n, 3}), moves.give({n}), deviations.give({n}));
}

// (k): the moves of candidates at places (k, 3) with a sample each, beside points at cells (n, 3). skipped (k): a point that
// does not count, −1 for none.
Output<int64_t> moves_of_candidates(Numbers places, Input<int64_t, 1> place_samples, Input<int64_t, 1> skipped, Numbers cells,
                                    Input<int64_t, 1> samples, Numbers normals, Numbers neighbours, int64_t spacing) {
    require_shapes(cells, samples, normals, neighbours, spacing);
    require_shapes(places, place_samples, normals, neighbours, spacing);
    const size_t k = place_samples.shape(0), m = normals.shape(0);
    require(skipped.shape(0) == k);
    Fresh<int64_t> moves(k);
    std::fill_n(moves.data.get(), k, 0);
    const PointsOfSamples points(samples.data(), samples.shape(0), m), candidates(place_samples.data(), k, m);
    Neighbourhood around(cells, normals, neighbours, spacing);
    for (size_t s = 0; s < m; ++s) {
        if (!candidates.size(s)) continue;
        around.gather(points, s);
        for (int32_t at = candidates.first[s]; at < candidates.first[s + 1]; ++at) {
            const size_t i = size_t(candidates.points[size_t(at)]);
            moves.data[i] = around.move_at(places.data() + 3 * i, int32_t(skipped.data()[i])).length;
        }
    }
    return moves.give({k});
}

}  // namespace

void bind_point_smoothing(nb::module_ &m) {
    m.def("smooth_points", &smooth_points);
    m.def("moves_of_candidates", &moves_of_candidates);
}
