// Inverse DCT of a chunk (stages/dct.py, inverse), in tiles of frames and columns that fit into registers.
#pragma once

#include <cmath>
#include <cstddef>
#include <vector>

#include "vectors.h"

namespace chunks {

constexpr size_t PANEL = 8, TILE = 4;  // columns and frames of a tile

// Cosines of the inverse DCT, for even and odd frequencies, in blocks of TILE samples of the first half.
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

    // Number of even or odd frequencies among the first `known`.
    static size_t frequencies(size_t known, size_t parity) { return (known + 1 - parity) / 2; }

    const double *block(size_t number, size_t parity) const {
        return of[parity].data() + number * frequencies(frames, parity) * TILE;
    }

    const size_t frames, half, blocks;
    std::vector<double> of[2];
};

// sums[i][…] = Σ cosines[number(f)][i] · panel[f][…]
template <class Number>
ALWAYS_INLINE void tile(const double *cosines, Number number, const double *panel, size_t count,
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

// sums[i][…] = Σ cosines[f][i] · panel[f][…]
ALWAYS_INLINE void tile(const double *cosines, const double *panel, size_t count, Four (&sums)[TILE][2]) {
    tile(cosines, [](size_t f) { return f; }, panel, count, sums);
}

}  // namespace chunks
