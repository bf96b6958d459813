// What the known points around a point tell about its colour, for point_colours.cpp. codecs/bodycast/colour_lifting.py
// defines the results. Integers only: floats hold keys to compare, doubles exact quotients.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstdlib>

#include "integers.h"
#include "least_lanes.h"

namespace colours {

constexpr size_t AVERAGED = 4;  // nearest known points to average
constexpr size_t WINDOW = 16;   // known points among which the nearest are searched
constexpr int64_t CELL_WEIGHT = 1 << 20, CELL_SOFTENING = 2;
constexpr int64_t NARROW = 1 << 12;  // lattice units: in a smaller extent, squared distances are below 2^26

// The cell of a point, relative to the frame's lowest, in an extent below NARROW. The fourth number is 0.
struct Cell {
    int16_t at[4];
};

// A known point: its colour, and the error of the base of its prediction, of magnitudes below 2^10. The fourth numbers
// are 0.
struct Known {
    int16_t colour[4], error[4];
};

// The nearest known points: their numbers and weights. Missing ones repeat the first, without weight.
struct Neighbours {
    size_t at[AVERAGED];
    int32_t weight[AVERAGED];
};

// Means over the neighbours of the colours, the errors and their magnitudes; spread: the largest difference of a colour
// from the mean. The fourth numbers have no meaning.
struct Means {
    int16_t colour[4], error[4], magnitude[4], spread[4];
};

class Weights {
public:
    Weights() {
        for (size_t square = 0; square < NEAR; ++square) near_[square] = quotient(int64_t(square));
    }

    int32_t of(int64_t square) const { return square < int64_t(NEAR) ? near_[square] : quotient(square); }

private:
    static int32_t quotient(int64_t square) {
        return square + CELL_SOFTENING < CELL_WEIGHT ? int32_t(CELL_WEIGHT / (square + CELL_SOFTENING)) : 1;
    }

    static constexpr size_t NEAR = 1024;
    int32_t near_[NEAR];
};

inline const Weights WEIGHTS;

// The nearest of the known points first … first + width − 1; square_to(number): the squared distance. Of equal ones the
// first counts.
template <class SquareTo>
Neighbours nearest_known(size_t first, size_t width, SquareTo square_to) {
    int64_t squares[AVERAGED];
    Neighbours near{};
    size_t count = 0;
    for (size_t number = first; number < first + width; ++number) {
        const int64_t own = square_to(number);
        if (count == AVERAGED && own >= squares[AVERAGED - 1]) continue;
        size_t i = count < AVERAGED ? count++ : AVERAGED - 1;
        for (; i && squares[i - 1] > own; --i) squares[i] = squares[i - 1], near.at[i] = near.at[i - 1];
        squares[i] = own;
        near.at[i] = number;
    }
    for (size_t i = 0; i < AVERAGED; ++i)
        if (i < count) near.weight[i] = WEIGHTS.of(squares[i]);
        else near.at[i] = near.at[0];
    return near;
}

#if defined(__SSE2__)

// `nearest_known` of WINDOW points in a narrow extent. A key is a squared distance and a place in the window, as the bits
// of a float of at least 2: floats of the same sign have the order of their bits.
class NearestOfWindow {
public:
    static Neighbours find(const Cell *cells, size_t first, const Cell &own) {
        const Cell *window = cells + first;
        LeastLanes keys = LeastLanes::of(four_keys(window, 0, own), four_keys(window, 4, own), four_keys(window, 8, own),
                                         four_keys(window, 12, own));
        keys.merge_lanes();
        Neighbours near;
        for (size_t i = 0; i < AVERAGED; ++i) {
            const int32_t key = _mm_cvtsi128_si32(_mm_castps_si128(keys.least[i]));
            near.at[i] = first + size_t(key & int32_t(WINDOW - 1));
            near.weight[i] = WEIGHTS.of((key & (ONE - 1)) >> PLACE_BITS);
        }
        return near;
    }

private:
    static constexpr int PLACE_BITS = 4;
    static constexpr int32_t ONE = 1 << 30;  // makes the least key the float 2
    static_assert(WINDOW == 1 << PLACE_BITS && WINDOW == 16, "four groups of four keys");

    // Keys of the points start … start + 3 of the window.
    static __m128 four_keys(const Cell *window, int start, const Cell &own) {
        const __m128i one = _mm_loadl_epi64(reinterpret_cast<const __m128i *>(&own)), here = _mm_unpacklo_epi64(one, one);
        const auto squares_of_two = [&](const Cell *two) {  // x² + y², z² of each
            const __m128i apart = _mm_sub_epi16(_mm_loadu_si128(reinterpret_cast<const __m128i *>(two)), here);
            return _mm_castsi128_ps(_mm_madd_epi16(apart, apart));
        };
        const __m128 a = squares_of_two(window + start), b = squares_of_two(window + start + 2);
        const __m128i squares = _mm_add_epi32(_mm_castps_si128(_mm_shuffle_ps(a, b, _MM_SHUFFLE(2, 0, 2, 0))),
                                              _mm_castps_si128(_mm_shuffle_ps(a, b, _MM_SHUFFLE(3, 1, 3, 1))));
        const __m128i places = _mm_add_epi32(_mm_setr_epi32(0, 1, 2, 3), _mm_set1_epi32(ONE + start));
        return _mm_castsi128_ps(_mm_or_si128(_mm_slli_epi32(squares, PLACE_BITS), places));
    }
};

// Weighted sums of four numbers of AVERAGED points, and their quotients by the sum of the weights.
class WeightedMean {
public:
    explicit WeightedMean(const int32_t *weight) {
        int32_t total = 0;
        for (size_t i = 0; i < AVERAGED; ++i) total += weight[i];
        for (size_t i = 0; i < 2; ++i) {
            low_[i] = _mm_set1_epi32((weight[2 * i] & LOW) | (weight[2 * i + 1] & LOW) << 16);
            high_[i] = _mm_set1_epi32(weight[2 * i] >> LOW_BITS | weight[2 * i + 1] >> LOW_BITS << 16);
        }
        inverse_ = _mm_set1_pd(1.0 / total);
        half_ = _mm_add_pd(_mm_set1_pd(BIAS), _mm_mul_pd(_mm_set1_pd(0.5), inverse_));
    }

    // pairs[i]: numbers of points 2i and 2i + 1 in turn.
    __m128i of(const __m128i *pairs) const {
        const __m128i low = _mm_add_epi32(_mm_madd_epi16(pairs[0], low_[0]), _mm_madd_epi16(pairs[1], low_[1]));
        const __m128i high = _mm_add_epi32(_mm_madd_epi16(pairs[0], high_[0]), _mm_madd_epi16(pairs[1], high_[1]));
        return quotients(_mm_add_epi32(low, _mm_slli_epi32(high, LOW_BITS)));
    }

private:
    static constexpr int LOW_BITS = 15;
    static constexpr int32_t LOW = (1 << LOW_BITS) - 1;
    static constexpr int BIAS = 1 << 12;  // above all quotients, so that rounding towards 0 rounds down

    // (sum + 1/2) / total is at least 2^-23 from an integer, so roundings do not matter.
    __m128i quotients(__m128i sums) const {
        const auto two = [&](__m128i s) { return _mm_cvttpd_epi32(_mm_add_pd(_mm_mul_pd(_mm_cvtepi32_pd(s), inverse_), half_)); };
        const __m128i whole = _mm_unpacklo_epi64(two(sums), two(_mm_unpackhi_epi64(sums, sums)));
        return _mm_sub_epi32(whole, _mm_set1_epi32(BIAS));
    }

    __m128i low_[2], high_[2];
    __m128d inverse_, half_;
};

inline Means means_of(const Known *known, const Neighbours &near) {
    const auto magnitude = [](__m128i v) { return _mm_max_epi16(v, _mm_sub_epi16(_mm_setzero_si128(), v)); };
    __m128i points[AVERAGED], colours[2], errors[2], sizes[2];
    for (size_t i = 0; i < AVERAGED; ++i) points[i] = _mm_loadu_si128(reinterpret_cast<const __m128i *>(known + near.at[i]));
    for (size_t i = 0; i < 2; ++i) {
        colours[i] = _mm_unpacklo_epi16(points[2 * i], points[2 * i + 1]);
        errors[i] = _mm_unpackhi_epi16(points[2 * i], points[2 * i + 1]);
        sizes[i] = magnitude(errors[i]);
    }
    const WeightedMean mean(near.weight);
    const __m128i first = _mm_packs_epi32(mean.of(colours), mean.of(errors));
    __m128i spread = _mm_setzero_si128();
    for (const __m128i &point : points) spread = _mm_max_epi16(spread, magnitude(_mm_sub_epi16(point, first)));
    const __m128i activity = mean.of(sizes);
    Means means;
    _mm_storeu_si128(reinterpret_cast<__m128i *>(means.colour), first);
    _mm_storeu_si128(reinterpret_cast<__m128i *>(means.magnitude), _mm_unpacklo_epi64(_mm_packs_epi32(activity, activity), spread));
    return means;
}

#else

struct NearestOfWindow {
    static Neighbours find(const Cell *cells, size_t first, const Cell &own) {
        return nearest_known(first, WINDOW, [&](size_t number) {
            int64_t sum = 0;
            for (int d = 0; d < 3; ++d) sum += int64_t(cells[number].at[d] - own.at[d]) * (cells[number].at[d] - own.at[d]);
            return sum;
        });
    }
};

inline Means means_of(const Known *known, const Neighbours &near) {
    int64_t total = 0;
    for (int32_t weight : near.weight) total += weight;
    Means means{};
    for (size_t d = 0; d < 3; ++d) {
        int64_t colour = 0, error = 0, magnitude = 0;
        for (size_t i = 0; i < AVERAGED; ++i) {
            const Known &point = known[near.at[i]];
            colour += int64_t(near.weight[i]) * point.colour[d];
            error += int64_t(near.weight[i]) * point.error[d];
            magnitude += int64_t(near.weight[i]) * std::abs(point.error[d]);
        }
        means.colour[d] = int16_t(floor_quotient(colour, total));
        means.error[d] = int16_t(floor_quotient(error, total));
        means.magnitude[d] = int16_t(floor_quotient(magnitude, total));
        for (size_t at : near.at)
            means.spread[d] = int16_t(std::max<int>(means.spread[d], std::abs(known[at].colour[d] - means.colour[d])));
    }
    return means;
}

#endif

}  // namespace colours
