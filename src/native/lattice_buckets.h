// Magnitudes of the lattice engine as buckets, and activities as contexts.
#pragma once

#include <algorithm>
#include <cstdint>

namespace lattice {

constexpr int BUCKETS = 96, COMMON = 30;  // buckets of magnitudes; buckets with separate contexts

// ---- magnitudes: 0 … 4, then two buckets an octave
struct Bucket {
    int64_t first;
    int width;
};

struct Buckets {
    Bucket table[BUCKETS] = {};
    constexpr Buckets() {
        int64_t first = 0;
        for (int b = 0; b < BUCKETS; ++b) {
            const int width = b < 5 ? 0 : (b - 5) / 2 + 1;
            table[b].first = first;
            table[b].width = width;
            first += int64_t(1) << (width < 62 ? width : 62);
        }
    }
};

inline const Bucket *buckets() {
    static constexpr Buckets all;
    return all.table;
}

inline int bucket_of(int64_t magnitude) {
    const Bucket *table = buckets();
    int b = int(std::min<int64_t>(magnitude, 5));
    while (b + 1 < BUCKETS && magnitude >= table[b + 1].first) ++b;
    return b;
}

// Bit costs of coordinates of one kind and parity, 1/256 bit: `of` for `known` buckets; `sum` for "beyond" all of them.
struct Costs {
    int32_t of[16], sum = 0;
    int known = 0;
};

// Logarithm of an activity (unit 1/16) in half octaves, 0 … 23.
inline int coarse_log(int64_t v) {
    if (v <= 0) return 0;
    int octave = 63 - __builtin_clzll(uint64_t(v));
    const int half = octave ? int(v >> (octave - 1) & 1) : 0;
    return std::min(23, 2 * octave + half + 1);
}

}  // namespace lattice
