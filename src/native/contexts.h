// Constants of lanes, contexts and symbols, on which the bytes of codecs/tempo/coding and entropy depend.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace contexts {

// entropy/lanes.py
constexpr int PRECISION = 12;
constexpr uint32_t TOTAL = 1u << PRECISION, LOWEST = 1u << 16;

// rans.push for one symbol; moves a word out first if the state is full.
inline void push(uint32_t &x, uint32_t frequency, uint32_t start, std::vector<uint16_t> &words) {
    if (x >= uint64_t(frequency) << (32 - PRECISION)) {
        words.push_back(uint16_t(x));
        x >>= 16;
    }
    x += x / frequency * (TOTAL - frequency) + start;
}

// coding/contexts.py: weights of neighbours, and the farthest neighbour
constexpr int NEAR = 13, BELOW_3 = 8, OLDER = 6, BESIDE = 6, BLOCK = 3;
constexpr int DEPTH = 7, BORDER = 4;
constexpr int64_t CEILING = 300;

// entropy/symbols.py
constexpr int DIRECT = 11, SYMBOLS = 21;

inline int width_of(int symbol) {
    return symbol < DIRECT ? 0 : symbol == SYMBOLS - 1 ? 48 : symbol - DIRECT + 1;
}

constexpr int64_t first_of(int symbol) {
    return symbol < DIRECT ? symbol : DIRECT + (int64_t(1) << (symbol - DIRECT + 1)) - 2;
}

inline int symbol_of(int64_t magnitude) {
    if (magnitude < DIRECT) return magnitude < 0 ? 0 : int(magnitude);
    int symbol = DIRECT;
    while (symbol < SYMBOLS - 1 && magnitude >= first_of(symbol + 1)) ++symbol;
    return symbol;
}

}  // namespace contexts
