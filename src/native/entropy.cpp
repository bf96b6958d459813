// Serial loops of entropy/: packed bits, and the coder with one state. Integers only.

#include <algorithm>
#include <numeric>
#include <stdexcept>
#include <utility>
#include <vector>

#include "arrays.h"
#include "tokens.h"

namespace {

using tokens::decode_tokens;
using tokens::mean_shift;

using Table = Input<int64_t, 1>;

constexpr uint32_t LOWEST = 1u << 16;  // rans.LOW

// bits.pack: values as an array of 0 and 1, each in widths[i] bits, highest first.
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

// The coder with one state has 14-bit probabilities.
constexpr int FINE_PRECISION = 14;
constexpr uint64_t FINE_TOTAL = 1u << FINE_PRECISION;

// neighbours._means: running mean of each lane before each step, × 256, from tokens (steps, lanes) and first values (lanes).
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

// Codes symbols, given in decoding order, and raw bits after them: one_state.StateEncoder.
class Encoder {
public:
    void put(int64_t frequency, int64_t start) {
        if (frequency < 1 || frequency > int64_t(FINE_TOTAL)) throw std::invalid_argument("a symbol of weight zero cannot be coded");
        symbols_.emplace_back(uint32_t(frequency), uint32_t(start));
    }

    void raw(uint64_t value, unsigned width) {
        while (width--) bits_.push_back(uint8_t(value >> width & 1));
    }

    nb::bytes finish() const {
        constexpr uint64_t MANY = 64;  // one_state.MANY
        uint64_t state = 1;
        std::vector<uint16_t> words;
        auto make_room = [&](bool full) {
            if (!full) return;
            words.push_back(uint16_t(state));
            state >>= 16;
        };
        for (size_t at = 0, width; at < bits_.size(); at += width) {
            width = at ? 8 : (bits_.size() - 1) % 8 + 1;
            uint64_t byte = 0;
            for (size_t i = 0; i < width; ++i) byte = byte << 1 | bits_[at + i];
            make_room(state >> (32 - width) != 0);
            state = state << width | byte;
        }
        auto push = [&](uint64_t f, uint64_t start) {
            make_room(state >= f << (32 - FINE_PRECISION));
            state += state / f * (FINE_TOTAL - f) + start;
        };
        for (size_t i = symbols_.size(); i-- > 0;) push(symbols_[i].first, symbols_[i].second);
        push(FINE_TOTAL - MANY, MANY);
        std::vector<char> out;
        for (; state; state >>= 8) out.push_back(char(state & 255));
        for (size_t i = words.size(); i-- > 0;) out.push_back(char(words[i] & 255)), out.push_back(char(words[i] >> 8));
        return nb::bytes(out.data(), out.size());
    }

private:
    std::vector<std::pair<uint32_t, uint32_t>> symbols_;
    std::vector<uint8_t> bits_;
};

// one_state.StateEncoder.finish: the bytes of symbols and of raw bits, each 0 or 1.
nb::bytes entropy_encode(Table frequencies, Table starts, Input<uint8_t, 1> raw) {
    const size_t count = frequencies.shape(0);
    if (starts.shape(0) != count) throw std::invalid_argument("entropy_encode: shapes differ");
    Encoder encoder;
    for (size_t i = 0; i < count; ++i) encoder.put(frequencies.data()[i], starts.data()[i]);
    for (size_t i = 0; i < raw.shape(0); ++i) encoder.raw(raw.data()[i], 1);
    return encoder.finish();
}

// coder._pack_one: bytes of numbers (steps, lanes) and their tokens. heads: for each parameter, table × width + value, in
// the tables of parameters; ladder: law of each expected token (unit 1/16). The last table codes the excess of escapes.
nb::bytes entropy_pack_one(Input<int64_t, 2> numbers, Input<uint8_t, 2> tokens, Input<uint8_t, 2> hints, Table mixture,
                           Input<uint8_t, 1> ladder, Table frequency, Table start, Table sizes, Table heads, Table head_frequency,
                           Table head_start) {
    const size_t steps = tokens.shape(0), lanes = tokens.shape(1), tables = sizes.shape(0);
    const bool hinted = hints.shape(0) != 0;
    if (mixture.shape(0) != 7 || numbers.shape(0) != steps || numbers.shape(1) != lanes || !tables ||
        (hinted && (hints.shape(0) != steps || hints.shape(1) != lanes)) || start.shape(0) != frequency.shape(0) ||
        head_start.shape(0) != head_frequency.shape(0))
        throw std::invalid_argument("entropy_pack_one: shapes differ");
    const size_t width = frequency.shape(0) / tables;
    const int64_t *w = mixture.data();
    Encoder encoder;
    for (size_t i = 0; i < heads.shape(0); ++i) {
        const size_t at = size_t(heads.data()[i]);
        if (at >= head_frequency.shape(0)) throw std::invalid_argument("entropy_pack_one: no such parameter");
        encoder.put(head_frequency.data()[at], head_start.data()[at]);
    }
    auto put = [&](size_t table, size_t symbol) {
        if (table >= tables || symbol >= width) throw std::invalid_argument("a symbol of weight zero cannot be coded");
        encoder.put(frequency.data()[table * width + symbol], start.data()[table * width + symbol]);
    };
    std::vector<int64_t> mean(lanes, 0), row(lanes + 3, 0), up(lanes + 3, 0), up2(lanes + 3, 0);
    for (size_t step = 0; step < steps; ++step) {
        row[0] = row[1] = up[1] = up[2];
        for (size_t lane = 0; lane < lanes; ++lane) {
            if (step == 0) mean[lane] = up[lane + 2] << 8;
            int64_t mixed = w[0] * up[lane + 2] + w[1] * up2[lane + 2] + w[2] * row[lane + 1] + w[3] * row[lane] +
                            w[4] * up[lane + 1] + (w[5] * mean[lane] >> 8);
            if (hinted) mixed += w[6] * hints.data()[step * lanes + lane];
            if (mixed < 0 || size_t(mixed) >= ladder.shape(0)) throw std::invalid_argument("entropy_pack_one: no such law");
            const size_t law = ladder.data()[mixed];
            const int64_t token = tokens.data()[step * lanes + lane];
            if (law >= tables) throw std::invalid_argument("entropy_pack_one: no such law");
            const int64_t last = sizes.data()[law] - 1;
            put(law, size_t(std::min(token, last)));
            if (token >= last) put(tables - 1, size_t(token - last));
            row[lane + 2] = token;
            if (lane == 0) row[1] = token;
            if (step == 0) up[lane + 3] = up2[lane + 3] = token;  // outside the array the nearest value counts
            mean[lane] += ((token << 8) - mean[lane]) >> mean_shift(int64_t(step));
        }
        std::swap(up2, up);
        std::swap(up, row);
    }
    for (size_t i = 0; i < steps * lanes; ++i) {
        if (!tokens.data()[i]) continue;
        const int64_t number = numbers.data()[i];
        const unsigned bits = tokens::mantissa_bits(tokens.data()[i]);
        const uint64_t magnitude = number < 0 ? -uint64_t(number) : uint64_t(number);
        encoder.raw(uint64_t(number < 0) << bits | (magnitude & ((uint64_t(1) << bits) - 1)), bits + 1);
    }
    return encoder.finish();
}

// choice._counts: counts (mixtures, rungs, most) of tokens below `most` under the rung that each mixture expects; then
// the numbers of active tokens, of counted active tokens, and of all tokens.
nb::tuple entropy_counts(Input<uint8_t, 2> tokens, Input<uint8_t, 2> hints, Table rungs, Input<int64_t, 2> mixtures, size_t laws,
                         size_t most, size_t counted) {
    const size_t steps = tokens.shape(0), lanes = tokens.shape(1), size = steps * lanes;
    const bool hinted = hints.shape(0) != 0;
    if (!size || mixtures.shape(1) != 7 || !counted || (hinted && (hints.shape(0) != steps || hints.shape(1) != lanes)))
        throw std::invalid_argument("entropy_counts: shapes differ");
    const uint8_t *token = tokens.data();
    // Neighbours.of
    auto past = [&](size_t t, size_t l) -> int32_t { return t ? token[(t - 1) * lanes + l] : l ? token[l - 1] : 0; };
    auto near = [&](size_t t, size_t l, int32_t (&out)[5]) {
        out[0] = past(t, l);
        out[1] = t > 1 ? token[(t - 2) * lanes + l] : l ? token[l - 1] : 0;
        out[2] = l ? token[t * lanes + l - 1] : past(t, 0);
        out[3] = l > 1 ? token[t * lanes + l - 2] : l ? token[t * lanes] : past(t, 0);
        out[4] = l ? past(t, l - 1) : past(t, 0);
    };
    // neighbours.rough_means
    std::vector<float> means(size);
    for (size_t t = 0; t < steps; ++t)
        for (size_t l = 0; l < lanes; ++l) means[t * lanes + l] = float(past(t, l)) / (t ? 8.0f : 1.0f);
    float keep = 7.0f / 8.0f;
    for (size_t reach = 1; reach < std::min<size_t>(steps, 32); reach *= 2, keep *= keep)
        for (size_t i = size; i-- > reach * lanes;) means[i] += means[i - reach * lanes] * keep;
    // choice._some
    std::vector<size_t> active;
    int32_t around[5];
    for (size_t t = 0, i = 0; t < steps; ++t)
        for (size_t l = 0; l < lanes; ++l, ++i) {
            near(t, l, around);
            if (token[i] | around[0] | around[1] | around[2] | around[3] | around[4] || (hinted && hints.data()[i]) ||
                means[i] >= 1.0f / 16)
                active.push_back(i);
        }
    size_t stride = std::max<size_t>(1, active.size() / counted);
    while (std::gcd(stride, lanes) > 1) --stride;
    const size_t mixes = mixtures.shape(0), rows = laws + 1;
    Fresh<int64_t> counts(mixes * rows * most);
    std::fill_n(counts.data.get(), counts.size, 0);
    size_t some = 0;
    for (size_t n = 0; n < active.size(); n += stride, ++some) {
        const size_t i = active[n];
        near(i / lanes, i % lanes, around);
        if (token[i] >= most) throw std::invalid_argument("entropy_counts: a token out of range");
        for (size_t m = 0; m < mixes; ++m) {
            const int64_t *w = mixtures.data() + 7 * m;
            int64_t expected = int64_t(means[i] * float(w[5]));
            for (size_t k = 0; k < 5; ++k) expected += w[k] * around[k];
            if (hinted) expected += w[6] * hints.data()[i];
            if (expected < 0 || size_t(expected) >= rungs.shape(0)) throw std::invalid_argument("entropy_counts: no such rung");
            const int64_t rung = rungs.data()[expected];
            if (rung < 0 || size_t(rung) >= rows) throw std::invalid_argument("entropy_counts: no such law");
            ++counts.data[(m * rows + size_t(rung)) * most + token[i]];
        }
    }
    return nb::make_tuple(counts.give({mixes, rows, most}), active.size(), some, size);
}

// coder._decode_tokens: tokens (steps, lanes), the state, and the number of words read.
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

// Loop of one_state.StateDecoder.raw: reads whole bytes, then single bits, from the low end of the state. Returns them
// in this order, the state, and the number of words read.
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
    m.def("entropy_pack_one", &entropy_pack_one);
    m.def("entropy_counts", &entropy_counts);
    m.def("entropy_decode", &entropy_decode);
    m.def("entropy_raw", &entropy_raw);
}
