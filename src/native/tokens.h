// Tokens of entropy/: magnitudes below DIRECT, then four tokens for each octave, with the mantissa as raw bits.
#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace tokens {

constexpr unsigned DIRECT = 16;

// models.mantissa_bits, models.token_floor
inline unsigned mantissa_bits(unsigned token) { return token < DIRECT ? 0 : (token - DIRECT) / 4 + 2; }
inline int64_t token_floor(unsigned token) {
    return token < DIRECT ? token : int64_t(4 + token % 4) << mantissa_bits(token);
}

// neighbours.mean_shift: inertia of a lane's mean, as a shift.
inline int mean_shift(int64_t step) { return step == 0 ? 1 : step < 3 ? 2 : 3; }

// coder._decode_tokens: tokens (steps, lanes). w: weights of the neighbours and hints; hints (steps, lanes), or null;
// ladder: law of each expected token; next(law): a token. False for an expected token beyond the ladder.
template <class Next>
bool decode_tokens(const int64_t *w, const uint8_t *ladder, size_t rungs, const uint8_t *hints, size_t steps, size_t lanes,
                   Next next, uint8_t *out) {
    std::vector<int64_t> mean(lanes, 0), row(lanes + 3, 0), up(lanes + 3, 0), up2(lanes + 3, 0);
    for (size_t step = 0; step < steps; ++step) {
        row[0] = row[1] = up[1] = up[2];
        const int shift = mean_shift(int64_t(step));
        for (size_t lane = 0; lane < lanes; ++lane) {
            if (step == 0) mean[lane] = up[lane + 2] << 8;
            int64_t expected = w[0] * up[lane + 2] + w[1] * up2[lane + 2] + w[2] * row[lane + 1] + w[3] * row[lane] +
                               w[4] * up[lane + 1] + (w[5] * mean[lane] >> 8);
            if (hints) expected += w[6] * hints[step * lanes + lane];
            if (expected < 0 || size_t(expected) >= rungs) return false;
            const int64_t token = next(ladder[size_t(expected)]);
            row[lane + 2] = token;
            if (lane == 0) row[1] = token;
            if (step == 0) up[lane + 3] = up2[lane + 3] = token;  // outside the array the nearest value counts
            mean[lane] += ((token << 8) - mean[lane]) >> shift;
            out[step * lanes + lane] = uint8_t(token);
        }
        std::swap(up2, up);
        std::swap(up, row);
    }
    return true;
}

}  // namespace tokens
