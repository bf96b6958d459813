// The serial loops of entropy/: packed bits, and the coder of one state. Integers only.

#include <algorithm>
#include <stdexcept>
#include <vector>

#include "arrays.h"
#include "tokens.h"

namespace {

using tokens::decode_tokens;
using tokens::mean_shift;

using Table = Input<int64_t, 1>;

constexpr uint32_t LOWEST = 1u << 16;  // rans.LOW

// bits.pack: each value in its own number of bits, highest first, as an array of 0 and 1.
Output<uint8_t> entropy_pack_bits(Table values, Table widths) {
    const size_t count = values.shape(0);
    if (widths.shape(0) != count) throw std::invalid_argument("entropy_pack_bits: shapes differ");
    size_t total = 0;
    for (size_t i = 0; i < count; ++i) total += size_t(std::clamp<int64_t>(widths.data()[i], 0, 64));
    Fresh<uint8_t> out(total);
    uint8_t *to = out.data.get();
    for (size_t i = 0; i < count; ++i)
        for (int64_t place = std::min<int64_t>(widths.data()[i], 64); place-- > 0;)
            *to++ = uint8_t(values.data()[i] >> place & 1);
    return out.give({total});
}

// bits.unpack: missing bits count as 0.
Output<int64_t> entropy_unpack_bits(Input<uint8_t, 1> bits, Table widths) {
    const size_t count = widths.shape(0), known = bits.shape(0);
    Fresh<int64_t> out(count);
    size_t at = 0;
    for (size_t i = 0; i < count; ++i) {
        uint64_t value = 0;
        for (int64_t place = std::min<int64_t>(widths.data()[i], 64); place-- > 0; ++at)
            value = value << 1 | (at < known ? bits.data()[at] : 0);
        out.data[i] = int64_t(value);
    }
    return out.give({count});
}

// The coder of one state: 14-bit probabilities.
constexpr int FINE_PRECISION = 14;
constexpr uint64_t FINE_TOTAL = 1u << FINE_PRECISION;

// neighbours._means: each lane's running mean before each step, × 256, from the tokens (steps, lanes) and its first value.
Output<int32_t> entropy_means(Input<uint8_t, 2> tokens, Input<int32_t, 1> first) {
    const size_t steps = tokens.shape(0), lanes = tokens.shape(1);
    if (first.shape(0) != lanes) throw std::invalid_argument("entropy_means: shapes differ");
    Fresh<int32_t> out(steps * lanes);
    std::vector<int32_t> mean(lanes);
    for (size_t lane = 0; lane < lanes; ++lane) mean[lane] = first.data()[lane] << 8;
    for (size_t step = 0; step < steps; ++step)
        for (size_t lane = 0, at = step * lanes; lane < lanes; ++lane, ++at) {
            out.data[at] = mean[lane];
            mean[lane] += ((int32_t(tokens.data()[at]) << 8) - mean[lane]) >> mean_shift(int64_t(step));
        }
    return out.give({steps, lanes});
}

// The loop of one_state.StateEncoder.finish: the final state, and words in the order in which they leave the state.
nb::tuple entropy_encode(Table frequencies, Table starts, uint64_t state) {
    const size_t count = frequencies.shape(0);
    if (starts.shape(0) != count) throw std::invalid_argument("entropy_encode: shapes differ");
    std::vector<uint16_t> words;
    for (size_t i = 0; i < count; ++i) {
        const uint64_t f = uint64_t(frequencies.data()[i]);
        if (!f || f > FINE_TOTAL) throw std::invalid_argument("entropy_encode: a frequency out of range");
        if (state >= f << (32 - FINE_PRECISION)) {
            words.push_back(uint16_t(state));
            state >>= 16;
        }
        state += state / f * (FINE_TOTAL - f) + uint64_t(starts.data()[i]);
    }
    Fresh<uint16_t> moved(words.size());
    std::copy(words.begin(), words.end(), moved.data.get());
    return nb::make_tuple(state, moved.give({moved.size}));
}

// coder._decode_tokens: tokens (steps, lanes), the state, and how many words were used.
nb::tuple entropy_decode(Table frequency, Table start, Input<uint8_t, 1> symbols, Table sizes, size_t width,
                         size_t excess, Input<uint8_t, 1> ladder, Table mixture, uint64_t x, size_t at,
                         Input<uint16_t, 1> words, size_t steps, size_t lanes, Input<uint8_t, 2> hints) {
    const bool hinted = hints.shape(0) != 0;
    if (mixture.shape(0) != 7 || (hinted && (hints.shape(0) != steps || hints.shape(1) != lanes)))
        throw std::invalid_argument("entropy_decode: shapes differ");
    const size_t end = words.shape(0), tables = symbols.shape(0) >> FINE_PRECISION;
    auto symbol_of = [&](size_t table) {
        const size_t slot = x & (FINE_TOTAL - 1);
        if (table >= tables) throw std::invalid_argument("entropy_decode: no such law");
        const size_t symbol = symbols.data()[(table << FINE_PRECISION) + slot], place = table * width + symbol;
        x = uint64_t(frequency.data()[place]) * (x >> FINE_PRECISION) + slot - uint64_t(start.data()[place]);
        if (x < LOWEST && at < end) x = x << 16 | words.data()[at++];
        return symbol;
    };
    auto next = [&](size_t law) {
        const size_t found = symbol_of(law);
        const bool escapes = int64_t(found) == sizes.data()[law] - 1;
        return int64_t(escapes ? std::min<size_t>(found + symbol_of(excess), 255) : found);
    };
    Fresh<uint8_t> out(steps * lanes);
    const uint8_t *of_hints = hinted ? hints.data() : nullptr;
    if (!decode_tokens(mixture.data(), ladder.data(), ladder.shape(0), of_hints, steps, lanes, next, out.data.get()))
        throw std::invalid_argument("entropy_decode: no such law");
    return nb::make_tuple(out.give({steps, lanes}), x, at);
}

// The loop of one_state.StateDecoder.raw: whole bytes, then the bits that are left, from the low end of the state; in the
// order in which they leave it, with the state and how many words were used.
nb::tuple entropy_raw(uint64_t x, size_t at, Input<uint16_t, 1> words, size_t bits) {
    Fresh<uint8_t> out(bits / 8 + 1);
    const size_t end = words.shape(0);
    for (size_t i = 0; i <= bits / 8; ++i) {
        const unsigned width = i < bits / 8 ? 8 : unsigned(bits % 8);
        out.data[i] = uint8_t(x & ((1u << width) - 1));
        x >>= width;
        if (x < LOWEST && at < end) x = x << 16 | words.data()[at++];
    }
    return nb::make_tuple(out.give({bits / 8 + 1}), x, at);
}

}  // namespace

void bind_entropy(nb::module_ &m) {
    m.def("entropy_pack_bits", &entropy_pack_bits);
    m.def("entropy_unpack_bits", &entropy_unpack_bits);
    m.def("entropy_means", &entropy_means);
    m.def("entropy_encode", &entropy_encode);
    m.def("entropy_decode", &entropy_decode);
    m.def("entropy_raw", &entropy_raw);
}
