// Codes long arrays of integers, diagonal by diagonal, with integers of 16 and 32 bits: entropy/bulk.py.

#include <nanobind/stl/optional.h>

#include <cstring>
#include <optional>
#include <stdexcept>

#include "arrays.h"
#include "bulk_layout.h"
#include "contexts.h"
#include "tokens.h"

namespace {

using namespace bulk;
using contexts::LOWEST;
using contexts::PRECISION;
using contexts::TOTAL;
using tokens::DIRECT;
using tokens::mantissa_bits;
using tokens::token_floor;

constexpr uint32_t MASK = TOTAL - 1, ESCAPE_FLAG = 1u << 31;
constexpr uint16_t ESCAPE = 255;
constexpr int64_t MAX_TURNS = 15;
constexpr unsigned TOO_WIDE = DIRECT + 4 * 30;  // tokens from here on have mantissas of 32 bits or more

// Reads bits, highest first. The data must have PADDING bytes of 0 after their end.
class Bits {
public:
    static constexpr size_t PADDING = 8;

    Bits(const uint8_t *data, size_t bytes) : data_(data), size(8 * bytes) {}

    uint32_t take(unsigned width) {
        if (at >= size) return at += width, 0;
        const uint8_t *p = data_ + at / 8;
        const uint64_t window = uint64_t(p[0]) << 56 | uint64_t(p[1]) << 48 | uint64_t(p[2]) << 40 | uint64_t(p[3]) << 32 |
                                uint64_t(p[4]) << 24 | uint64_t(p[5]) << 16 | uint64_t(p[6]) << 8 | p[7];
        const uint32_t value = uint32_t(window >> (64 - at % 8 - width)) & uint32_t((uint64_t(1) << width) - 1);
        at += width;
        return value;
    }

    // The next bit; advance `at` to skip it.
    uint32_t next() const { return data_[at / 8] >> (7 - at % 8) & 1; }

    bool rest_is_zero() {
        while (at < size)
            if (take(unsigned(std::min<size_t>(8, size - at)))) return false;
        return true;
    }

private:
    const uint8_t *data_;

public:
    const size_t size;
    size_t at = 0;
};

// bulk._unpack_states: reads the states and their number of bytes. False for bytes that no encoder writes.
bool unpack_states(const uint8_t *data, size_t size, std::vector<uint32_t> &states, size_t &used) {
    const size_t n = states.size(), nibbles = (n + 1) / 2;
    if (size < nibbles || (n % 2 && data[nibbles - 1] & 15)) return false;
    size_t total = 0;
    for (size_t i = 0; i < n; ++i) total += 16 + (data[i / 2] >> (i % 2 ? 0 : 4) & 15);
    used = nibbles + (total + 7) / 8;
    if (size < used) return false;
    std::vector<uint8_t> lower(used - nibbles + Bits::PADDING, 0);
    std::copy_n(data + nibbles, used - nibbles, lower.data());
    Bits bits(lower.data(), used - nibbles);
    for (size_t i = 0; i < n; ++i) {
        const unsigned width = 16 + (data[i / 2] >> (i % 2 ? 0 : 4) & 15);
        states[i] = bits.take(width) | uint32_t(1) << width;
    }
    return bits.rest_is_zero();
}

struct Tables {
    Tables(const Input<uint8_t, 1> &ladder, const Input<int64_t, 1> &last)
        : ladder(ladder.data()), rungs(int64_t(ladder.shape(0))), last(last.data()), laws(int64_t(last.shape(0)) - 1) {
        if (laws < 1 || std::any_of(this->ladder, this->ladder + rungs, [=](uint8_t law) { return law >= laws; }))
            throw std::invalid_argument("bulk: a law without a table");
    }

    const uint8_t *ladder;
    const int64_t rungs;
    const int64_t *last;
    const int64_t laws;  // the table after them codes the excess of escapes
};

// Finds the laws of the tokens of a diagonal. False for an expected token beyond the ladder.
bool laws_of(const Tables &tables, const Contexts &contexts, int64_t i, int64_t begin, int64_t end, std::vector<uint16_t> &laws) {
    contexts.expected(i, begin, end, laws.data());
    for (int64_t j = 0; j < end - begin; ++j) {
        if (laws[size_t(j)] >= tables.rungs) return false;
        laws[size_t(j)] = tables.ladder[laws[size_t(j)]];
    }
    return true;
}

// bulk.Laws: the symbol of a slot at law << PRECISION | slot; frequency and start of a symbol at law << 8 | symbol.
// Small tables fit into a fast cache.
struct Symbols {
    const uint8_t *of_slot;
    const uint32_t *code;
};

// bulk._pop: decodes `count` symbols. law(j): law of symbol j; put(j, symbol) stores it. False if there are too few words.
template <class Law, class Put>
bool pop(std::vector<uint32_t> &states, int64_t count, const Symbols &symbols, const uint8_t *words, size_t known, size_t &used,
         Law law, Put put) {
    const int64_t n = int64_t(states.size());
    for (int64_t turn = 0; turn < count; turn += n) {
        const int64_t here = std::min(n, count - turn);
        uint32_t *state = states.data();
        auto next = [&](int64_t j) {
            const uint32_t x = state[j], slot = x & MASK;
            const size_t own = size_t(law(turn + j));
            const uint8_t symbol = symbols.of_slot[own << PRECISION | slot];
            const uint32_t code = symbols.code[own << 8 | symbol] & (ESCAPE_FLAG - 1);
            put(turn + j, symbol);
            return (x >> PRECISION) * (code >> PRECISION) + slot - (code & MASK);
        };
        if (known - used >= size_t(here)) {  // no branch depends on the data
            const uint8_t *word = words + 2 * used;
            for (int64_t j = 0; j < here; ++j) {
                const uint32_t x = next(j), low = x < LOWEST;
                state[j] = x << (16 * low) | ((word[0] | uint32_t(word[1]) << 8) & (0 - low));
                word += 2 * low;
            }
            used = size_t(word - words) / 2;
            continue;
        }
        for (int64_t j = 0; j < here; ++j) {
            uint32_t x = next(j);
            if (x < LOWEST) {
                if (used == known) return false;
                x = x << 16 | words[2 * used] | uint32_t(words[2 * used + 1]) << 8;
                ++used;
            }
            state[j] = x;
        }
    }
    return true;
}

// bulk._tokens_by_numpy: fills `flat`; leaves the final states in `states`.
bool decode_tokens(const Layout &layout, const Tables &tables, const Symbols &symbols, Contexts &contexts, uint16_t *flat,
                   std::vector<uint32_t> &states, const uint8_t *words, size_t known, size_t &used) {
    std::vector<uint16_t> law(size_t(layout.lanes * layout.segments));
    std::vector<int64_t> escaped;
    for (int64_t i = 0, begin, end; i < layout.diagonals(); ++i) {
        layout.diagonal(i, begin, end);
        if (begin == end) continue;
        if (!laws_of(tables, contexts, i, begin, end, law)) return false;
        escaped.clear();
        auto put = [&](int64_t j, uint16_t symbol) {
            flat[begin + j] = symbol;
            if (symbol == ESCAPE) escaped.push_back(j);
        };
        auto beyond = [&](int64_t e, uint16_t symbol) {
            const int64_t j = escaped[size_t(e)];
            flat[begin + j] = uint16_t(std::min<int64_t>(tables.last[law[size_t(j)]] + symbol, 255));
        };
        if (!pop(states, end - begin, symbols, words, known, used, [&](int64_t j) { return law[size_t(j)]; }, put) ||
            !pop(states, int64_t(escaped.size()), symbols, words, known, used, [&](int64_t) { return tables.laws; }, beyond))
            return false;
        contexts.update(i, begin, end);
    }
    return true;
}

// bulk._values: signs, then mantissas, from the final states and from the bytes after the words.
bool values_of(std::vector<uint8_t> &tokens, const std::vector<uint32_t> &states, const uint8_t *rest, size_t size, int64_t *out) {
    const size_t bytes = 2 * states.size() + size;
    std::vector<uint8_t> raw(bytes + Bits::PADDING, 0);
    for (size_t i = 0; i < states.size(); ++i) {
        if (states[i] >> 16 != 1) return false;
        raw[2 * i] = uint8_t(states[i] >> 8), raw[2 * i + 1] = uint8_t(states[i]);
    }
    std::copy_n(rest, size, raw.data() + 2 * states.size());
    const size_t n = tokens.size(), signs = n - size_t(std::count(tokens.begin(), tokens.end(), 0));
    size_t mantissas = 0;
    for (uint8_t token : tokens) {
        if (token < DIRECT) continue;
        if (token >= TOO_WIDE) return false;
        mantissas += mantissa_bits(token);
    }
    const size_t used = signs + mantissas, in_states = 16 * states.size();
    const size_t later = used > in_states ? used - in_states : 0;
    if (8 * size < later || 8 * size - later >= 8) return false;
    Bits sign(raw.data(), bytes), magnitude(raw.data(), bytes);
    magnitude.at = signs;
    for (size_t i = 0; i < n; ++i) {  // most tokens are less than DIRECT: no branches for zeros and signs
        if (uint64_t zeros; n - i >= 8 && (std::memcpy(&zeros, &tokens[i], 8), !zeros)) {
            std::fill_n(out + i, 8, int64_t(0));
            i += 7;
            continue;
        }
        const unsigned token = tokens[i];
        const int64_t value = token < DIRECT ? token : token_floor(token) | int64_t(magnitude.take(mantissa_bits(token)));
        const int64_t negative = sign.next() & uint32_t(token > 0);
        out[i] = (value ^ -negative) + negative;
        sign.at += token > 0;
    }
    return magnitude.rest_is_zero();
}

// bulk.unpack: integers (steps, lanes); nothing for bytes that no encoder writes. hints: flat, or empty.
std::optional<Output<int64_t>> bulk_unpack(nb::bytes data, int64_t steps, int64_t lanes, Input<uint16_t, 1> weights,
                                           Input<uint8_t, 1> ladder, Input<uint8_t, 1> symbols, Input<uint32_t, 1> code, Input<int64_t, 1> last,
                                           Input<uint16_t, 1> hints) {
    const Tables tables(ladder, last);
    if (steps < 1 || lanes < 1 || weights.shape(0) != 7 || symbols.shape(0) != last.shape(0) << PRECISION ||
        code.shape(0) != 256 * last.shape(0))
        throw std::invalid_argument("bulk_unpack: shapes differ");
    const Layout layout(steps, lanes);
    if (hints.shape(0) && int64_t(hints.shape(0)) != layout.places()) throw std::invalid_argument("bulk_unpack: wrong number of hints");
    const uint8_t *bytes = static_cast<const uint8_t *>(data.data());
    const size_t size = data.size();
    if (!size || bytes[0] < 1 || bytes[0] > MAX_TURNS) return std::nullopt;
    Fresh<int64_t> out(size_t(steps * lanes));
    bool whole = false;
    {
        nb::gil_scoped_release release;
        std::vector<uint32_t> states(size_t((layout.width + bytes[0] - 1) / bytes[0]));
        std::vector<uint16_t> flat(size_t(layout.places()), 0);
        std::vector<uint8_t> tokens(size_t(steps * lanes));
        Contexts contexts(layout, flat.data(), weights.data(), hints.shape(0) ? hints.data() : nullptr);
        size_t at = 0, used = 0;
        if (unpack_states(bytes + 1, size - 1, states, at)) {
            const uint8_t *words = bytes + 1 + at;
            const size_t left = size - 1 - at;
            if (decode_tokens(layout, tables, {symbols.data(), code.data()}, contexts, flat.data(), states, words, left / 2, used)) {
                layout.each([&](int64_t place, int64_t to) { tokens[size_t(to)] = uint8_t(flat[size_t(place)]); });
                whole = values_of(tokens, states, words + 2 * used, left - 2 * used, out.data.get());
            }
        }
    }
    if (!whole) return std::nullopt;
    return out.give({size_t(steps), size_t(lanes)});
}

// bulk._push_all: codes tokens (steps, lanes) into the states (n), in place; returns the words in decoding order.
Output<uint16_t> bulk_push(InPlace<uint32_t, 1> states, Input<uint8_t, 2> token, Input<uint16_t, 1> weights,
                           Input<uint8_t, 1> ladder, Input<uint32_t, 1> code, Input<int64_t, 1> last, Input<uint16_t, 1> hints) {
    const Tables tables(ladder, last);
    if (!token.shape(0) || !token.shape(1) || weights.shape(0) != 7 || !states.shape(0) || code.shape(0) != 256 * last.shape(0))
        throw std::invalid_argument("bulk_push: shapes differ");
    const Layout layout(int64_t(token.shape(0)), int64_t(token.shape(1)));
    if (hints.shape(0) && int64_t(hints.shape(0)) != layout.places()) throw std::invalid_argument("bulk_push: wrong number of hints");
    std::vector<uint16_t> flat(size_t(layout.places()), 0), words, laws;
    std::vector<uint8_t> law(size_t(layout.places()));
    {
        nb::gil_scoped_release release;
        layout.each([&](int64_t place, int64_t from) { flat[size_t(place)] = token.data()[from]; });
        Contexts contexts(layout, flat.data(), weights.data(), hints.shape(0) ? hints.data() : nullptr);
        laws.resize(size_t(layout.lanes * layout.segments));
        for (int64_t i = 0, begin, end; i < layout.diagonals(); ++i) {
            layout.diagonal(i, begin, end);
            if (begin == end) continue;
            if (!laws_of(tables, contexts, i, begin, end, laws)) throw std::invalid_argument("bulk_push: a token beyond the ladder");
            std::copy_n(laws.begin(), end - begin, law.begin() + begin);
            contexts.update(i, begin, end);
        }
        const int64_t n = int64_t(states.shape(0));
        std::vector<uint32_t> codes, beyond;
        auto push_all = [&](const std::vector<uint32_t> &of) {  // backwards, state by state in turn
            for (int64_t j = int64_t(of.size()); j-- > 0;)
                contexts::push(states.data()[j % n], of[size_t(j)] >> PRECISION, of[size_t(j)] & MASK, words);
        };
        for (int64_t i = layout.diagonals(), begin, end; i-- > 0;) {
            layout.diagonal(i, begin, end);
            codes.clear(), beyond.clear();
            for (int64_t at = begin; at < end; ++at) {
                const int64_t own = law[size_t(at)], symbol = flat[size_t(at)];
                const uint32_t found = code.data()[256 * own + symbol];
                codes.push_back(found & (ESCAPE_FLAG - 1));
                if (found >= ESCAPE_FLAG) beyond.push_back(code.data()[256 * tables.laws + symbol - tables.last[own]]);
            }
            push_all(beyond);
            push_all(codes);
        }
    }
    Fresh<uint16_t> out(words.size());
    std::reverse_copy(words.begin(), words.end(), out.data.get());
    return out.give({out.size});
}

}  // namespace

void bind_bulk(nb::module_ &m) {
    m.def("bulk_unpack", &bulk_unpack);
    m.def("bulk_push", &bulk_push, nb::arg().noconvert(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg());
}
