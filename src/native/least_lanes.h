// The four least of many numbers, four at a time.
#pragma once

#if defined(__SSE2__)  // part of every x86-64 processor
#include <emmintrin.h>

// Sorted numbers of four lanes: least[0] has the least of each lane. Positive integers may take part as the bits of
// floats, which have the same order; below 2^23 these are slow, and above 0x7f800000 no numbers.
struct LeastLanes {
    __m128 least[4];

    static LeastLanes of(__m128 a, __m128 b, __m128 c, __m128 d) {
        LeastLanes result{{a, b, c, d}};
        result.order(0, 1);
        result.order(2, 3);
        result.order(0, 2);
        result.order(1, 3);
        result.order(1, 2);
        return result;
    }

    // Keeps the four least of each lane and the other's.
    void merge(const LeastLanes &other) {
        for (int k = 0; k < 4; ++k) least[k] = _mm_min_ps(least[k], other.least[3 - k]);  // rises, then falls
        order(0, 2);
        order(1, 3);
        order(0, 1);
        order(2, 3);
    }

    // Gives all lanes the four least of all.
    void merge_lanes() {
        merge(turned<_MM_SHUFFLE(1, 0, 3, 2)>());
        merge(turned<_MM_SHUFFLE(2, 3, 0, 1)>());
    }

private:
    void order(int i, int j) {
        const __m128 less = _mm_min_ps(least[i], least[j]);
        least[j] = _mm_max_ps(least[i], least[j]);
        least[i] = less;
    }

    template <int LANES>
    LeastLanes turned() const {
        LeastLanes result;
        for (int k = 0; k < 4; ++k) result.least[k] = _mm_shuffle_ps(least[k], least[k], LANES);
        return result;
    }
};

#endif
