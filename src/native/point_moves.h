// Moves of lattice points towards the surface around them, as codecs/bodycast/point_smoothing.py defines them.
//
//     cells, sample of each point ─► points of the samples around a sample ─► mean distance of a place from them ─► move
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <utility>
#include <vector>

#if defined(__SSE2__)  // part of every x86-64 processor
#include <emmintrin.h>
#endif

#include "integers.h"
#include "octree_surface.h"

namespace point_moves {

using point_octree::NEIGHBOURS;
using point_octree::NORMAL_BITS;
using point_octree::SUBUNIT_BITS;
using point_octree::Surface;

constexpr int FINE_BITS = 8, WEIGHT_BITS = 10;
constexpr int PER_SAMPLE = 4;  // reference points of a sample
constexpr int64_t LEAST_COSINE = 315;
constexpr int64_t GAIN_AT_UNIT = 48000, GAIN_LOSS = 90, LARGEST_MOVE = 1 << (FINE_BITS - 1);

using Cell = std::array<int32_t, 3>;  // coordinates of a lattice point

// The points of each sample, ascending. Samples are rows of a Surface, NOWHERE for a point without one.
struct PointsOfSamples {
    std::vector<int32_t> first, points;

    PointsOfSamples(const int32_t *samples, size_t count, size_t of_samples) : first(of_samples + 2, 0) {
        for (size_t i = 0; i < count; ++i)
            if (samples[i] >= 0) ++first[size_t(samples[i]) + 2];
        for (size_t s = 2; s < first.size(); ++s) first[s] += first[s - 1];
        points.resize(size_t(first.back()));
        for (size_t i = 0; i < count; ++i)
            if (samples[i] >= 0) points[size_t(first[size_t(samples[i]) + 1]++)] = int32_t(i);
    }

    int size(size_t sample) const { return first[sample + 1] - first[sample]; }

    // Reference k of a sample; references are spread evenly over its points.
    int32_t reference(size_t sample, int k) const {
        return points[size_t(first[sample] + (size(sample) > PER_SAMPLE ? k * size(sample) / PER_SAMPLE : k))];
    }
};

struct Move {
    int64_t length, deviation;
};

// Along an axis, of a move along a normal with this component; lattice units with FINE_BITS.
inline int64_t shift_of_move(int64_t length, int64_t normal) {
    return (normal * length + (1 << (NORMAL_BITS - 1))) >> NORMAL_BITS;
}

// total, largest: of the weights; sum: Σ weight · distance; deviation_of: returns Σ weight · |distance − mean|.
template <class DeviationOf>
Move move_of(int64_t total, int64_t largest, int64_t sum, DeviationOf deviation_of) {
    const int64_t mean = floor_quotient(sum, std::max<int64_t>(total + largest, 1));
    const int64_t deviation = floor_quotient(deviation_of(mean), std::max<int64_t>(total, 1));
    const int64_t gain = std::clamp<int64_t>(GAIN_AT_UNIT / std::max<int64_t>(deviation, 1) - GAIN_LOSS, 0, 256);
    return {std::clamp(mean * gain >> 8, -LARGEST_MOVE, LARGEST_MOVE), deviation};
}

// The least and the largest coordinates of cells.
inline std::pair<Cell, Cell> box_of(const std::vector<Cell> &cells) {
    if (cells.empty()) return {};
    Cell low = cells.front(), high = low;
    for (const Cell &cell : cells)
        for (size_t d = 0; d < 3; ++d) low[d] = std::min(low[d], cell[d]), high[d] = std::max(high[d], cell[d]);
    return {low, high};
}

#if defined(__SSE2__)
// Neighbourhood in 16-bit numbers, eight references at a time, for frames with small coordinates. Weights come from a
// table over the squared distance.
class ShortNeighbourhood {
public:
    // spacing: between samples, subunits.
    ShortNeighbourhood(const PointsOfSamples &of, const std::vector<Cell> &cells, const Surface &surface, int64_t spacing)
        : surface_(surface) {
        is_usable = take_origin(cells) && take_normals();
        if (!is_usable) return;
        weights_.resize(size_t(WEIGHTS));
        const double unit = double(spacing * spacing << WEIGHT_BITS);
        const int64_t least = spacing * spacing / 4 + 1;
        for (int64_t square = 1; square < WEIGHTS; ++square)
            weights_[size_t(square)] = int16_t(unit / double((square << 2 * SUBUNIT_BITS) + least));
        const size_t samples = surface.size();
        counts_.resize(samples);
        places_.resize(8 * samples);
        heights_.resize(8 * samples);
        for (size_t s = 0; s < samples; ++s) {
            counts_[s] = uint8_t(std::min(of.size(s), PER_SAMPLE));
            for (int k = 0; k < counts_[s]; ++k) {
                const Cell &place = cells[size_t(of.reference(s, k))];
                const size_t at = 8 * s + 2 * size_t(k);
                places_[at] = short_of(place, 0), places_[at + 1] = short_of(place, 1), heights_[at] = short_of(place, 2);
            }
        }
    }

    bool is_usable;  // whether all numbers fit

    void gather(size_t sample) {
        const int16_t *own = &normals_[4 * sample];
        const int32_t *around = surface_.around(int32_t(sample));
        size_ = 0;
        for (size_t k = 0; k <= NEIGHBOURS; ++k) {
            const size_t other = k ? size_t(around[k - 1]) : sample;
            const int16_t *away = &normals_[4 * other];
            const int32_t cosine = own[0] * away[0] + own[1] * away[1] + own[2] * away[2];
            const int32_t x = own[0] + away[0], y = own[1] + away[1], z = own[2] + away[2];
            // four references at once; unused ones are overwritten
            put(near_places_, four(&places_[8 * other]));
            put(near_heights_, four(&heights_[8 * other]));
            put(near_normals_, _mm_set1_epi32((x & 0xffff) | y * 65536));
            put(near_ups_, _mm_set1_epi32(z & 0xffff));
            size_ += cosine >= LEAST_COSINE << NORMAL_BITS ? counts_[other] : 0;
        }
        count_all();
    }

    // All references count, besides those at the place of a candidate.
    void count_all() {
        std::fill_n(counting_, size_, int16_t(-1));
        std::fill(counting_ + size_, counting_ + (size_ + LANES - 1) / LANES * LANES, int16_t(0));
    }

    // References at this place do not count for the moves that follow.
    void leave_out(const Cell &place) {
        const __m128i at = pair(place, 0, 1), height = _mm_set1_epi32(short_of(place, 2) & 0xffff);
        for (size_t b = 0; b < (size_ + LANES - 1) / LANES; ++b) {
            __m128i same[2];
            for (size_t half = 0; half < 2; ++half) {
                const size_t from = 16 * b + 8 * half;
                same[half] = _mm_and_si128(_mm_cmpeq_epi32(four(near_places_ + from), at), _mm_cmpeq_epi32(four(near_heights_ + from), height));
            }
            const __m128i counts = _mm_andnot_si128(_mm_packs_epi32(same[0], same[1]), four(counting_ + LANES * b));
            _mm_storeu_si128(reinterpret_cast<__m128i *>(counting_ + LANES * b), counts);
        }
    }

    // The move of a point of the frame, or of a candidate for one, without references at its place (such as itself). False if
    // a reference is too far.
    bool move(const Cell &place, Move &result) const {
        const __m128i at = pair(place, 0, 1), height = _mm_set1_epi32(short_of(place, 2) & 0xffff);
        const __m128i ones = _mm_set1_epi16(1);
        const size_t blocks = (size_ + LANES - 1) / LANES;
        __m128i weights[BLOCKS], distances[BLOCKS];
        __m128i total = _mm_setzero_si128(), largest = total, sum = total, beyond = total;
        for (size_t b = 0; b < blocks; ++b) {
            __m128i squares[2], along[2];
            for (size_t half = 0; half < 2; ++half) {
                const size_t from = 16 * b + 8 * half;
                const __m128i apart = _mm_sub_epi16(four(near_places_ + from), at), above = _mm_sub_epi16(four(near_heights_ + from), height);
                squares[half] = _mm_add_epi32(_mm_madd_epi16(apart, apart), _mm_madd_epi16(above, above));
                along[half] = _mm_srai_epi32(_mm_add_epi32(_mm_madd_epi16(apart, four(near_normals_ + from)),
                                                           _mm_madd_epi16(above, four(near_ups_ + from))),
                                             NORMAL_BITS + 1 - FINE_BITS);
            }
            const __m128i counts = four(counting_ + LANES * b);
            const __m128i square = _mm_and_si128(_mm_packs_epi32(squares[0], squares[1]), counts);
            const __m128i distance = _mm_and_si128(_mm_packs_epi32(along[0], along[1]), counts);
            beyond = _mm_or_si128(beyond, _mm_or_si128(_mm_srai_epi16(square, 15), _mm_cmpgt_epi16(square, _mm_set1_epi16(WEIGHTS - 1))));
            beyond = _mm_or_si128(beyond, _mm_cmpgt_epi16(distance, _mm_set1_epi16(LARGEST)));
            beyond = _mm_or_si128(beyond, _mm_cmplt_epi16(distance, _mm_set1_epi16(-LARGEST)));
            if (_mm_movemask_epi8(beyond)) return false;
            weights[b] = weights_of(square);
            distances[b] = distance;
            total = _mm_add_epi32(total, _mm_madd_epi16(weights[b], ones));
            largest = _mm_max_epi16(largest, weights[b]);
            sum = _mm_add_epi32(sum, _mm_madd_epi16(weights[b], distance));
        }
        largest = _mm_max_epi16(largest, _mm_srli_si128(largest, 8));
        largest = _mm_max_epi16(largest, _mm_srli_si128(largest, 4));
        largest = _mm_max_epi16(largest, _mm_srli_si128(largest, 2));
        result = move_of(all(total), _mm_extract_epi16(largest, 0), all(sum), [&](int64_t mean) {
            const __m128i middle = _mm_set1_epi16(int16_t(mean));
            __m128i deviation = _mm_setzero_si128();
            for (size_t b = 0; b < blocks; ++b) {
                const __m128i away = _mm_sub_epi16(distances[b], middle);
                const __m128i size = _mm_max_epi16(away, _mm_sub_epi16(_mm_setzero_si128(), away));
                deviation = _mm_add_epi32(deviation, _mm_madd_epi16(weights[b], size));
            }
            return all(deviation);
        });
        return true;
    }

private:
    static constexpr size_t LANES = 8, BLOCKS = ((NEIGHBOURS + 1) * PER_SAMPLE + 7) / 8;
    static constexpr int LARGEST = 1 << 13;    // normals and distances: sums of BLOCKS products fit into 32 bits
    static constexpr int64_t WEIGHTS = 16384;  // entries of the weight table
    static constexpr int64_t OUTSIDE = 8;      // units: candidates lie at most so far outside the points of a frame

    bool take_origin(const std::vector<Cell> &cells) {
        if (cells.empty()) return false;
        const auto [low, high] = box_of(cells);
        origin_ = low;
        for (size_t d = 0; d < 3; ++d)
            if (int64_t(high[d]) - low[d] > INT16_MAX - 2 * OUTSIDE) return false;
        return true;
    }

    bool take_normals() {
        normals_.resize(4 * surface_.size());
        for (size_t s = 0; s < surface_.size(); ++s)
            for (size_t d = 0; d < 3; ++d) {
                const int64_t value = surface_.normal(int32_t(s))[d];
                if (value > LARGEST || value < -LARGEST) return false;
                normals_[4 * s + d] = int16_t(value);
            }
        return true;
    }

    int16_t short_of(const Cell &place, size_t axis) const { return int16_t(place[axis] - origin_[axis]); }

    __m128i pair(const Cell &place, size_t first, size_t second) const {
        return _mm_set1_epi32((short_of(place, first) & 0xffff) | short_of(place, second) * 65536);
    }

    static __m128i four(const int16_t *from) { return _mm_loadu_si128(reinterpret_cast<const __m128i *>(from)); }
    void put(int16_t *pairs, __m128i values) { _mm_storeu_si128(reinterpret_cast<__m128i *>(pairs + 2 * size_), values); }

    static int64_t all(__m128i sums) {
        std::array<int32_t, 4> lanes;
        _mm_storeu_si128(reinterpret_cast<__m128i *>(lanes.data()), sums);
        return int64_t(lanes[0]) + lanes[1] + lanes[2] + lanes[3];
    }

    __m128i weights_of(__m128i squares) const {
        const int16_t *table = weights_.data();
        __m128i result = _mm_cvtsi32_si128(table[_mm_extract_epi16(squares, 0)]);
        result = _mm_insert_epi16(result, table[_mm_extract_epi16(squares, 1)], 1);
        result = _mm_insert_epi16(result, table[_mm_extract_epi16(squares, 2)], 2);
        result = _mm_insert_epi16(result, table[_mm_extract_epi16(squares, 3)], 3);
        result = _mm_insert_epi16(result, table[_mm_extract_epi16(squares, 4)], 4);
        result = _mm_insert_epi16(result, table[_mm_extract_epi16(squares, 5)], 5);
        result = _mm_insert_epi16(result, table[_mm_extract_epi16(squares, 6)], 6);
        return _mm_insert_epi16(result, table[_mm_extract_epi16(squares, 7)], 7);
    }

    const Surface &surface_;
    Cell origin_;
    std::vector<uint8_t> counts_;                        // number of references of each sample
    std::vector<int16_t> places_, heights_;              // four references a sample: pairs of x and y, of z and 0
    std::vector<int16_t> normals_;                       // four numbers a sample
    std::vector<int16_t> weights_;                       // by squared distance in lattice units; 0 at distance 0
    size_t size_ = 0;                                    // number of gathered references
    static constexpr size_t ROOM = 2 * (LANES * BLOCKS + LANES);
    int16_t near_places_[ROOM] = {}, near_heights_[ROOM] = {}, near_normals_[ROOM] = {}, near_ups_[ROOM] = {};  // pairs
    int16_t counting_[ROOM] = {};                        // −1: reference; 0: after the last
};
#else
struct ShortNeighbourhood {
    template <class... Arguments>
    explicit ShortNeighbourhood(const Arguments &...) {}
    static constexpr bool is_usable = false;
    void gather(size_t) {}
    void count_all() {}
    void leave_out(const Cell &) {}
    bool move(const Cell &, Move &) const { return false; }
};
#endif

// The reference points for the points of one sample.
class Neighbourhood {
public:
    Neighbourhood(const std::vector<Cell> &cells, const Surface &surface, int64_t spacing)
        : cells_(cells), surface_(surface), square_(spacing * spacing) {
        constexpr size_t MOST = (NEIGHBOURS + 1) * PER_SAMPLE + LANES;
        for (auto *values : {&x_, &y_, &z_, &u_, &v_, &w_, &weights_, &distances_}) values->resize(MOST, 0.0);
        rows_.resize(MOST);
        const auto [low, high] = box_of(cells);
        is_near_ = true;
        for (size_t d = 0; d < 3; ++d) is_near_ &= int64_t(high[d]) - NEAR <= low[d];
    }

    void gather(const PointsOfSamples &of, size_t sample) {
        const int32_t *around = surface_.around(int32_t(sample));
        size_ = 0;
        add(of, sample, sample);
        for (size_t k = 0; k < NEIGHBOURS; ++k) add(of, sample, size_t(around[k]));
    }

    Move move(size_t point) { return move_at(cells_[point], int32_t(point), is_near_); }

    // The move of a point at a place. Ignores reference `skipped` and references at the place itself. is_near: the
    // place is known to be near all references.
    Move move_at(const Cell &place, int32_t skipped, bool is_near = false) {
        if (is_near || all_are_near(place)) return near_move(double(place[0]), double(place[1]), double(place[2]), skipped);
        return distant_move(place, skipped);
    }

private:
    // Limit of coordinate differences for exact doubles: divisors are below 2^40 and quotients below 2^12, so the
    // distance of a quotient from the next integer exceeds its rounding error; products fit into int32.
    static constexpr int64_t NEAR = 1 << 14;
    static constexpr double OFFSET = 1 << 29;
    static constexpr size_t LANES = 4;  // parallel sums

    bool all_are_near(const Cell &place) const {
        for (size_t k = 0; k < size_; ++k)
            for (size_t d = 0; d < 3; ++d)
                if (std::abs(cells_[size_t(rows_[k])][d] - place[d]) > NEAR) return false;
        return true;
    }

    // Adds the references of another sample if its normal has a similar direction.
    void add(const PointsOfSamples &of, size_t sample, size_t other) {
        const auto &own = surface_.normal(int32_t(sample)), &away = surface_.normal(int32_t(other));
        if (!of.size(other) || dot(own.data(), away.data()) < LEAST_COSINE << NORMAL_BITS) return;
        for (int k = 0; k < std::min(of.size(other), PER_SAMPLE); ++k, ++size_) {
            const int32_t row = of.reference(other, k);
            const Cell &place = cells_[size_t(row)];
            rows_[size_] = row;
            x_[size_] = double(place[0]), y_[size_] = double(place[1]), z_[size_] = double(place[2]);
            u_[size_] = double(own[0] + away[0]), v_[size_] = double(own[1] + away[1]), w_[size_] = double(own[2] + away[2]);
        }
    }

    // Sums are integers below 2^53, equal in any order.
    Move near_move(double px, double py, double pz, int32_t skipped) {
        const double unit = double(square_ << WEIGHT_BITS), least = double(square_ / 4 + 1);
        const double *x = x_.data(), *y = y_.data(), *z = z_.data(), *u = u_.data(), *v = v_.data(), *w = w_.data();
        double *weights = weights_.data(), *distances = distances_.data();
        for (size_t k = 0; k < size_; ++k) {
            const double a = x[k] - px, b = y[k] - py, c = z[k] - pz;
            weights[k] = double(int32_t(unit / ((a * a + b * b + c * c) * (1 << 2 * SUBUNIT_BITS) + least)));
            // rounds down: the offset is even and larger than the distances
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

    // near_move in integers, for points far apart.
    Move distant_move(const Cell &place, int32_t skipped) {
        std::vector<int64_t> weights, distances;
        int64_t total = 0, largest = 0, sum = 0;
        for (size_t k = 0; k < size_; ++k) {
            const Cell &a = cells_[size_t(rows_[k])];
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

    const std::vector<Cell> &cells_;
    const Surface &surface_;
    const int64_t square_;
    size_t size_ = 0;
    bool is_near_;  // whether all points of the frame are near each other
    std::vector<int32_t> rows_;
    std::vector<double> x_, y_, z_, u_, v_, w_;  // places of the references; sums of normals
    std::vector<double> weights_, distances_;
};

}  // namespace point_moves
