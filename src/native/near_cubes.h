// What the cubes around a cube show of the surface, in 16-bit numbers, eight cubes side by side: for cube_octree.cpp, where
// cubes, samples and normals are near one another. Elsewhere Passage::find_surface does the same in wider numbers.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <vector>

#include "octree_surface.h"

namespace point_octree {

constexpr int CUBES_OF_SAMPLE = 4;
constexpr int64_t SAMPLE_WEIGHT = 5120;

// Of the cubes around: the sum of their weights, the mean distance of the surface from that of the sample, and the sum of
// weight · deviation from it.
struct SurfaceAround {
    int64_t total, offset, spread;
};

#if defined(__SSE2__)
class NearCubes {
public:
    explicit NearCubes(const Surface &surface) : surface_(surface), is_fit_(surface.size()), spans_(surface.size()) {
        for (size_t s = 0; s < surface.size(); ++s) {
            bool is_fit = surface.reach(int32_t(s)) <= NEAR;
            for (int64_t n : surface.normal(int32_t(s))) is_fit &= n <= LARGEST_NORMAL && n >= -LARGEST_NORMAL;
            is_fit_[s] = is_fit;
        }
    }

    // No sample has cubes. side: of children. spacing: at most 2^16.
    void start_level(int64_t side, int64_t spacing) {
        is_usable_ = side <= LARGEST_SIDE && spacing <= LARGEST_SPACING && surface_.size() <= MOST_SAMPLES;
        above_ = double(spacing * spacing << 16);
        cubes_.clear();
        listed_ = NOWHERE;
        for (size_t s = 0; s < spans_.size(); ++s) spans_[s] = is_fit_[s] ? 0 : IS_FAR;
    }

    // One more cube of a sample shows this place of the surface. Its weight is a quotient: below stand the squared distance and
    // `least`. Samples come one after the other.
    void add(size_t sample, const std::array<int32_t, 3> &place, int64_t least) {
        if (!is_usable_) return;
        int32_t &span = spans_[sample];
        if (!(span & COUNT)) span |= int32_t(cubes_.size() << FIRST_BIT);
        ++span;
        for (size_t d = 0; d < 3; ++d) {
            const int64_t apart = place[d] - surface_.place(int32_t(sample))[d];
            if (apart > NEAR || apart < -NEAR) span |= IS_FAR;
        }
        cubes_.emplace_back();
        put(cubes_.size() - 1, sample, place, least);
    }

    // Cube number k of all, one of this sample, shows another place, within itself.
    void put(size_t k, size_t sample, const std::array<int32_t, 3> &place, int64_t least) {
        if (!is_usable_) return;
        const Place &normal = surface_.normal(int32_t(sample));
        const __m128i cube = _mm_setr_epi32(pair(place[0], place[1]), pair(place[2], normal[2]), pair(normal[0], normal[1]), int32_t(least));
        _mm_store_si128(reinterpret_cast<__m128i *>(cubes_[k].words), cube);
    }

    // What is around a cube of sample `own` at a centre, which lies `far` from the sample's tangent plane. False where numbers are
    // too large.
    bool find(int32_t own, const Place &centre, int64_t far, SurfaceAround &found) {
        if (!is_usable_ || far > LARGEST_AWAY || far < -LARGEST_AWAY) return false;
        for (size_t d = 0; d < 3; ++d) {
            const int64_t apart = centre[d] - surface_.place(own)[d];
            if (apart > NEAR || apart < -NEAR) return false;
        }
        if (own != listed_) list_around(own);
        if (is_far_) return false;
        const Place &normal = surface_.normal(own);
        const Centre cube{_mm_set1_epi32(pair(centre[0], centre[1])), _mm_set1_epi32(int32_t(centre[2] & 0xffff)),
                          _mm_set1_epi32(pair(normal[0], normal[1])), _mm_set1_epi32(int32_t(normal[2])), _mm_set1_epi32(int32_t(far))};
        const __m128i zero = _mm_setzero_si128(), ones = _mm_set1_epi16(1), lanes = _mm_setr_epi16(0, 1, 2, 3, 4, 5, 6, 7);
        __m128i weights[MOST / 8 + 1], distances[MOST / 8 + 1];
        __m128i total = zero, sum = zero, least = zero, largest = zero;
        const int count = count_;
        for (int k = 0; k < count; k += 8) {
            const __m128i is_listed = _mm_cmpgt_epi16(_mm_set1_epi16(int16_t(count - k)), lanes);
            const Compared one = compare(cube, &around_[k]), other = compare(cube, &around_[k + 4]);
            const __m128i weight = _mm_and_si128(_mm_packs_epi32(one.weight, other.weight), is_listed);
            const __m128i away = _mm_and_si128(_mm_packs_epi32(one.away, other.away), is_listed);
            weights[k / 8] = weight, distances[k / 8] = away;
            least = _mm_min_epi16(least, away), largest = _mm_max_epi16(largest, away);
            total = _mm_add_epi32(total, _mm_madd_epi16(weight, ones));
            sum = _mm_add_epi32(sum, _mm_madd_epi16(weight, away));
        }
        const __m128i most = _mm_set1_epi16(LARGEST_AWAY);
        if (_mm_movemask_epi8(_mm_or_si128(_mm_cmpgt_epi16(largest, most), _mm_cmplt_epi16(least, _mm_sub_epi16(zero, most))))) return false;
        found.total = all(total);
        found.offset = mean(all(sum), found.total + SAMPLE_WEIGHT);
        const __m128i middle = _mm_set1_epi16(int16_t(found.offset));
        __m128i spread = zero;
        for (int k = 0; k < count; k += 8) {
            const __m128i away = _mm_sub_epi16(distances[k / 8], middle);
            spread = _mm_add_epi32(spread, _mm_madd_epi16(weights[k / 8], _mm_max_epi16(away, _mm_sub_epi16(zero, away))));
        }
        found.spread = all(spread);
        return true;
    }

private:
    // Three times NEAR and a cube's side is the largest difference of coordinates: with LARGEST_SIDE and LARGEST_SPACING, divisors
    // are below 2^31. Weights are below 2^13, so sums of weight · 2 · LARGEST_AWAY of all cubes are below 2^31.
    static constexpr int64_t NEAR = 1600, LARGEST_SIDE = 512, LARGEST_SPACING = 1024, LARGEST_NORMAL = 2047;
    static constexpr int LARGEST_AWAY = 3000, MOST = (NEIGHBOURS + 1) * CUBES_OF_SAMPLE;
    static constexpr int32_t COUNT = 7, IS_FAR = 8, FIRST_BIT = 4;  // parts of a span
    static constexpr size_t MOST_SAMPLES = size_t(1) << 24;

    // A place of the surface, the normal of the cube's sample, and the least divisor of the weight: pairs of x and y, z and the
    // normal's z, the normal's x and y; `least`.
    struct alignas(16) Cube {
        int32_t words[4];
    };

    // A centre's x and y, and z; its sample's normal, likewise; the distance from the sample's tangent plane: the same four times.
    struct Centre {
        __m128i at, height, normal, up, far;
    };

    // Four cubes: their weights, and the distances of the surface that they show.
    struct Compared {
        __m128i weight, away;
    };

    // A quotient between ±LARGEST_AWAY, rounded down.
    static int64_t mean(int64_t sum, int64_t weight) {
        return int64_t(double(sum + weight * LARGEST_AWAY) / double(weight)) - LARGEST_AWAY;
    }

    // The lower halves of two numbers.
    static int32_t pair(int64_t low, int64_t high) { return int32_t((uint32_t(low) & 0xffff) | uint32_t(high) << 16); }
    static __m128i thirteen(__m128i v) { return _mm_add_epi32(_mm_add_epi32(_mm_slli_epi32(v, 3), _mm_slli_epi32(v, 2)), v); }

    static int64_t all(__m128i sums) {
        sums = _mm_add_epi32(sums, _mm_shuffle_epi32(sums, _MM_SHUFFLE(1, 0, 3, 2)));
        return _mm_cvtsi128_si32(_mm_add_epi32(sums, _mm_shuffle_epi32(sums, _MM_SHUFFLE(2, 3, 0, 1))));
    }

    // Weights from their divisors: quotients of floats are exact enough, since the dividend is below 2^49.
    __m128i quotients(__m128i below) const {
        const __m128d above = _mm_set1_pd(above_);
        const __m128i first = _mm_cvttpd_epi32(_mm_div_pd(above, _mm_cvtepi32_pd(below)));
        const __m128i last = _mm_cvttpd_epi32(_mm_div_pd(above, _mm_cvtepi32_pd(_mm_unpackhi_epi64(below, below))));
        return _mm_unpacklo_epi64(first, last);
    }

    Compared compare(const Centre &cube, const int32_t *numbers) const {
        const auto load = [&](int k) { return _mm_load_si128(reinterpret_cast<const __m128i *>(cubes_[size_t(numbers[k])].words)); };
        const __m128i a = load(0), b = load(1), c = load(2), d = load(3);
        const __m128i places = _mm_unpacklo_epi32(a, b), others = _mm_unpackhi_epi32(a, b);
        const __m128i more_places = _mm_unpacklo_epi32(c, d), more_others = _mm_unpackhi_epi32(c, d);
        const __m128i heights = _mm_unpackhi_epi64(places, more_places);
        const __m128i aside = _mm_sub_epi16(_mm_unpacklo_epi64(places, more_places), cube.at);
        const __m128i above = _mm_and_si128(_mm_sub_epi16(heights, cube.height), _mm_set1_epi32(0xffff));
        const __m128i square = _mm_add_epi32(_mm_madd_epi16(aside, aside), _mm_madd_epi16(above, above));
        const __m128i normals = _mm_add_epi16(_mm_unpacklo_epi64(others, more_others), cube.normal);
        const __m128i ups = _mm_add_epi16(_mm_srli_epi32(heights, 16), cube.up);
        const __m128i along = _mm_add_epi32(_mm_madd_epi16(aside, normals), _mm_madd_epi16(above, ups));
        return {quotients(_mm_add_epi32(thirteen(square), _mm_unpackhi_epi64(others, more_others))),
                _mm_add_epi32(_mm_srai_epi32(along, NORMAL_BITS + 1), cube.far)};
    }

    // Lists the cubes of a sample and of those around it. Four numbers are written for each sample, which avoids an unpredictable
    // branch, and four after the last.
    void list_around(int32_t own) {
        const int32_t *around = surface_.around(own);
        const __m128i lanes = _mm_setr_epi32(0, 1, 2, 3);
        int32_t seen = 0, *end = around_;
        const auto add = [&](int32_t span) {
            _mm_storeu_si128(reinterpret_cast<__m128i *>(end), _mm_add_epi32(_mm_set1_epi32(span >> FIRST_BIT), lanes));
            end += span & COUNT;
            seen |= span;
        };
        add(spans_[size_t(own)]);
        for (size_t k = 0; k < NEIGHBOURS; ++k) add(around[k] == own ? 0 : spans_[size_t(around[k])]);
        _mm_storeu_si128(reinterpret_cast<__m128i *>(end), _mm_setzero_si128());
        _mm_storeu_si128(reinterpret_cast<__m128i *>(end + 4), _mm_setzero_si128());
        count_ = int(end - around_);
        is_far_ = seen & IS_FAR;
        listed_ = own;
    }

    const Surface &surface_;
    bool is_usable_ = false;
    double above_ = 0;
    std::vector<Cube> cubes_;         // of all samples
    std::vector<uint8_t> is_fit_;     // whether a sample's neighbours are near
    std::vector<int32_t> spans_;      // of each sample: number of its cubes, whether one is far, and the first
    int32_t listed_ = NOWHERE;        // sample whose cubes and those around it are listed
    int32_t around_[MOST + 8] = {};  // their numbers
    int count_ = 0;
    bool is_far_ = false;
};
#else
class NearCubes {
public:
    explicit NearCubes(const Surface &) {}
    void start_level(int64_t, int64_t) {}
    void add(size_t, const std::array<int32_t, 3> &, int64_t) {}
    void put(size_t, size_t, const std::array<int32_t, 3> &, int64_t) {}
    bool find(int32_t, const Place &, int64_t, SurfaceAround &) { return false; }
};
#endif

}  // namespace point_octree
