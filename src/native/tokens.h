// Tokens of entropy/: the magnitudes below DIRECT, then four tokens for each octave; a token's mantissa is raw bits.
#pragma once

#include <cstdint>

namespace tokens {

constexpr unsigned DIRECT = 16;

// models.mantissa_bits, models.token_floor
inline unsigned mantissa_bits(unsigned token) { return token < DIRECT ? 0 : (token - DIRECT) / 4 + 2; }
inline int64_t token_floor(unsigned token) {
    return token < DIRECT ? token : int64_t(4 + token % 4) << mantissa_bits(token);
}

// neighbours.mean_shift: how slowly a lane's mean follows its tokens.
inline int mean_shift(int64_t step) { return step == 0 ? 1 : step < 3 ? 2 : 3; }

}  // namespace tokens
