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
    explicit NearCubes(const Surface &surface) : surface_(surface), of_(surface.size()) {
        for (size_t s = 0; s < surface.size(); ++s) {
            const Place &normal = surface.normal(int32_t(s));
            of_[s].is_fit = surface.reach(int32_t(s)) <= NEAR;
            for (size_t d = 0; d < 3; ++d) {
                of_[s].is_fit &= normal[d] <= LARGEST_NORMAL && normal[d] >= -LARGEST_NORMAL;
                of_[s].normal[d] = int16_t(normal[d]);
            }
        }
    }

    // No sample has cubes. side: of children. spacing: at most 2^16.
    void start_level(int64_t side, int64_t spacing) {
        is_usable_ = side <= LARGEST_SIDE && spacing <= LARGEST_SPACING;
        above_ = double(spacing * spacing << 16);
        for (OfSample &own : of_) own.size = 0, own.is_near = own.is_fit, std::fill_n(own.counts, CUBES_OF_SAMPLE, int16_t(0));
    }

    // One more cube of a sample shows this place of the surface. Its weight is a quotient: below stand the squared distance and
    // `least`.
    void add(size_t sample, const std::array<int32_t, 3> &place, int64_t least) {
        if (!is_usable_) return;
        OfSample &own = of_[sample];
        own.counts[own.size] = -1;
        put(sample, own.size++, place, least);
        for (size_t d = 0; d < 3; ++d) {
            const int64_t apart = place[d] - surface_.place(int32_t(sample))[d];
            own.is_near &= apart <= NEAR && apart >= -NEAR;
        }
    }

    // Cube number k of a sample shows another place, within itself.
    void put(size_t sample, size_t k, const std::array<int32_t, 3> &place, int64_t least) {
        if (!is_usable_) return;
        OfSample &own = of_[sample];
        own.places[2 * k] = int16_t(place[0]), own.places[2 * k + 1] = int16_t(place[1]), own.heights[k] = int16_t(place[2]);
        own.least[k] = int32_t(least);
    }

    // What is around a cube of sample `own` at a centre, which lies `far` from the sample's tangent plane. False where numbers are
    // too large.
    bool find(int32_t own, const Place &centre, int64_t far, SurfaceAround &found) const {
        if (!is_usable_ || far > LARGEST_AWAY || far < -LARGEST_AWAY) return false;
        for (size_t d = 0; d < 3; ++d) {
            const int64_t apart = centre[d] - surface_.place(own)[d];
            if (apart > NEAR || apart < -NEAR) return false;
        }
        const std::array<const OfSample *, 2 * BLOCKS> samples = samples_around(own);
        const Cube cube{load_half(of_[size_t(own)].normal), _mm_set1_epi32((int32_t(centre[0]) & 0xffff) | int32_t(uint32_t(centre[1]) << 16)),
                        _mm_set1_epi32(int32_t(centre[2]) & 0xffff), _mm_set1_epi32(int32_t(far))};
        const __m128i largest = _mm_set1_epi16(LARGEST_AWAY), ones = _mm_set1_epi16(1), zero = _mm_setzero_si128();
        __m128i weights[BLOCKS], distances[BLOCKS];
        __m128i total = zero, sum = zero, beyond = zero;
        for (size_t b = 0; b < BLOCKS; ++b) {
            const OfSample &first = *samples[2 * b], &last = *samples[2 * b + 1];
            const Compared one = compare(cube, first), other = compare(cube, last);
            const __m128i counts = _mm_unpacklo_epi64(load_half(first.counts), load_half(last.counts));
            distances[b] = _mm_and_si128(_mm_packs_epi32(one.away, other.away), counts);
            weights[b] = _mm_and_si128(_mm_packs_epi32(one.weight, other.weight), counts);
            beyond = _mm_or_si128(beyond, _mm_or_si128(_mm_cmpgt_epi16(distances[b], largest),
                                                       _mm_cmplt_epi16(distances[b], _mm_sub_epi16(zero, largest))));
            beyond = _mm_or_si128(beyond, _mm_cmpeq_epi16(_mm_set1_epi16(first.is_near & last.is_near), zero));
            total = _mm_add_epi32(total, _mm_madd_epi16(weights[b], ones));
            sum = _mm_add_epi32(sum, _mm_madd_epi16(weights[b], distances[b]));
        }
        if (_mm_movemask_epi8(beyond)) return false;
        found.total = all(total);
        found.offset = floor_quotient(all(sum), found.total + SAMPLE_WEIGHT);
        const __m128i middle = _mm_set1_epi16(int16_t(found.offset));
        __m128i spread = zero;
        for (size_t b = 0; b < BLOCKS; ++b) {
            const __m128i away = _mm_sub_epi16(distances[b], middle);
            spread = _mm_add_epi32(spread, _mm_madd_epi16(weights[b], _mm_max_epi16(away, _mm_sub_epi16(zero, away))));
        }
        found.spread = all(spread);
        return true;
    }

private:
    // Three times NEAR and a cube's side is the largest difference of coordinates: with LARGEST_SIDE and LARGEST_SPACING, divisors
    // are below 2^31. Weights are below 2^13, so sums of weight · 2 · LARGEST_AWAY of all cubes are below 2^31.
    static constexpr int64_t NEAR = 1600, LARGEST_SIDE = 512, LARGEST_SPACING = 1024, LARGEST_NORMAL = 2047;
    static constexpr int LARGEST_AWAY = 3000;
    static constexpr size_t BLOCKS = (NEIGHBOURS + 2) / 2;  // of the cubes of two samples

    // The cubes of a sample, in one line of the cache. is_fit: whether its neighbours are near; is_near: its cubes too.
    struct alignas(64) OfSample {
        int16_t places[2 * CUBES_OF_SAMPLE] = {};  // pairs of x and y
        int32_t least[CUBES_OF_SAMPLE] = {};
        int16_t heights[CUBES_OF_SAMPLE] = {}, counts[CUBES_OF_SAMPLE] = {};  // counts: −1 for each cube
        int16_t normal[4] = {};
        uint8_t size = 0;
        bool is_fit = true, is_near = true;
    };

    // The normal of its sample, x and y, z, and the distance from the sample's tangent plane: the same four times.
    struct Cube {
        __m128i normal, at, height, far;
    };

    // Four cubes of a sample: their weights, and the distances of the surface that they show.
    struct Compared {
        __m128i weight, away;
    };

    static __m128i load(const void *from) { return _mm_loadu_si128(static_cast<const __m128i *>(from)); }
    static __m128i load_half(const void *from) { return _mm_loadl_epi64(static_cast<const __m128i *>(from)); }
    static void store(void *to, __m128i values) { _mm_storeu_si128(static_cast<__m128i *>(to), values); }
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

    Compared compare(const Cube &cube, const OfSample &other) const {
        const __m128i sums = _mm_add_epi16(cube.normal, load_half(other.normal));
        const __m128i aside = _mm_sub_epi16(load(other.places), cube.at);
        const __m128i above = _mm_sub_epi16(_mm_unpacklo_epi16(load_half(other.heights), _mm_setzero_si128()), cube.height);
        const __m128i square = _mm_add_epi32(_mm_madd_epi16(aside, aside), _mm_madd_epi16(above, above));
        const __m128i along = _mm_add_epi32(_mm_madd_epi16(aside, _mm_shuffle_epi32(sums, 0)),
                                            _mm_madd_epi16(above, _mm_shuffle_epi32(sums, _MM_SHUFFLE(1, 1, 1, 1))));
        return {quotients(_mm_add_epi32(thirteen(square), load(other.least))),
                _mm_add_epi32(_mm_srai_epi32(along, NORMAL_BITS + 1), cube.far)};
    }

    // A sample and those around it, an empty one in place of itself.
    std::array<const OfSample *, 2 * BLOCKS> samples_around(int32_t own) const {
        static const OfSample EMPTY;
        const int32_t *around = surface_.around(own);
        std::array<const OfSample *, 2 * BLOCKS> samples;
        samples[0] = &of_[size_t(own)];
        for (size_t k = 0; k < NEIGHBOURS; ++k) samples[k + 1] = around[k] == own ? &EMPTY : &of_[size_t(around[k])];
        std::fill(samples.begin() + NEIGHBOURS + 1, samples.end(), &EMPTY);
        return samples;
    }

    const Surface &surface_;
    bool is_usable_ = false;
    double above_ = 0;
    std::vector<OfSample> of_;
};
#else
class NearCubes {
public:
    explicit NearCubes(const Surface &) {}
    void start_level(int64_t, int64_t) {}
    void add(size_t, const std::array<int32_t, 3> &, int64_t) {}
    void put(size_t, size_t, const std::array<int32_t, 3> &, int64_t) {}
    bool find(int32_t, const Place &, int64_t, SurfaceAround &) const { return false; }
};
#endif

}  // namespace point_octree
