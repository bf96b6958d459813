// Short streams of integers, of one state: entropy/coder.py, _unpack_dense.
//
//   bytes ─state─► parameters ─laws from neighbours─► tokens ─raw bits─► integers ─sums─► integers (steps, lanes)
#pragma once

#include <algorithm>
#include <optional>
#include <stdexcept>
#include <vector>

#include "arrays.h"
#include "tokens.h"

namespace state_streams {

using tokens::DIRECT;
using tokens::mantissa_bits;
using tokens::decode_tokens;
using tokens::token_floor;

constexpr int PRECISION = 14;
constexpr uint64_t TOTAL = 1u << PRECISION, MASK = TOTAL - 1, LOWEST = 1u << 16, MANY = 64;
constexpr size_t FIELDS = 8, OFFSETS = 8, SHAPES = 2, MIXTURES = 10, WITHOUT_HINTS = 7, NEIGHBOURS = 7;
constexpr unsigned TOKENS = DIRECT + 4 * 59;
constexpr size_t WINDOW = 8;  // bytes that are read for some bits

// rans: a state and its words.
struct State {
    State(const uint8_t *data, size_t size) {
        const size_t head = size <= 4 ? size : 4 - size % 2;  // only a state of three or four bytes has words
        x = 0;
        for (size_t i = head; i-- > 0;) x = x << 8 | data[i];
        words = data + head, left = (size - head) / 2;
        x = (TOTAL - MANY) * (x >> PRECISION) + (x & MASK) - MANY;
        refill();
    }

    void refill() {
        if (x >= LOWEST || !left) return;
        x = x << 16 | words[0] | uint64_t(words[1]) << 8;
        words += 2, --left;
    }

    uint64_t x;
    const uint8_t *words;
    size_t left;
};

// models.Tables
struct Laws {
    Laws(Input<int64_t, 1> frequency, Input<int64_t, 1> start, Input<uint8_t, 1> symbol, Input<int64_t, 1> sizes)
        : count(sizes.shape(0)), width(count ? frequency.shape(0) / count : 0), symbols(count * (width + 1)),
          first(count << (PRECISION - COARSE)), sizes(sizes.data(), sizes.data() + count) {
        if (!count || !width || width > 255 || frequency.shape(0) != count * width || start.shape(0) != count * width ||
            symbol.shape(0) != count << PRECISION)
            throw std::invalid_argument("StateStreams: shapes differ");
        for (size_t law = 0; law < count; ++law) {
            for (size_t i = 0; i < width; ++i)
                symbols[law * (width + 1) + i] = {uint32_t(frequency.data()[law * width + i]), uint32_t(start.data()[law * width + i])};
            symbols[law * (width + 1) + width] = {0, uint32_t(TOTAL)};
        }
        for (size_t i = 0; i < first.size(); ++i) first[i] = symbol.data()[i << COARSE];
    }

    size_t next(State &from, size_t law) const {
        const uint32_t slot = uint32_t(from.x & MASK);
        const Symbol *of = symbols.data() + law * (width + 1), *found = of + first[law << (PRECISION - COARSE) | slot >> COARSE];
        while (found[1].start <= slot) ++found;
        from.x = uint64_t(found->frequency) * (from.x >> PRECISION) + slot - found->start;
        from.refill();
        return size_t(found - of);
    }

    struct Symbol {
        uint32_t frequency, start;
    };

    static constexpr int COARSE = 6;  // a table gives the first symbol of 64 slots; a search finds the symbol
    size_t count, width;
    std::vector<Symbol> symbols;  // of each law, with an extra one at the end
    std::vector<uint8_t> first;
    std::vector<int64_t> sizes;
};

// choice.kept
inline size_t kept(size_t extent, size_t symbol) { return std::max<size_t>(1, (extent * (symbol + 1) + 31) / 32); }

// Tables of choice.parameter_tables, laws of models.family for one ladder, models.usual_law, MIXTURES.
class StateStreams {
public:
    using Numbers = Input<int64_t, 1>;

    StateStreams(Numbers usual_law, Input<int64_t, 2> mixtures, bool long_ladder)
        : usual_law_(usual_law.data(), usual_law.data() + usual_law.shape(0)), long_ladder_(long_ladder) {
        if (mixtures.shape(0) != MIXTURES || mixtures.shape(1) != NEIGHBOURS || !usual_law.shape(0))
            throw std::invalid_argument("StateStreams: shapes differ");
        std::copy_n(mixtures.data(), MIXTURES * NEIGHBOURS, &mixtures_[0][0]);
    }

    // Add first the tables of parameters, then the laws of each shape; the last law of a shape codes the excess of escapes.
    void add(Numbers frequency, Numbers start, Input<uint8_t, 1> symbol, Numbers sizes) {
        tables_.emplace_back(frequency, start, symbol, sizes);
    }

    // Whether a stream uses the long ladder of laws.
    bool has_long_ladder(const uint8_t *data, size_t size) const {
        if (size < 2) return false;
        State state(data, size);
        size_t fields[FIELDS];
        for (size_t i = 0; i < FIELDS; ++i) fields[i] = tables_.at(0).next(state, i);
        return fields[5] != 0;
    }

    // Decodes bytes to integers (steps, lanes); false for streams with the other ladder of laws or hints, and for damaged ones.
    bool read(const uint8_t *data, size_t size, size_t steps, size_t lanes, size_t most, int64_t *out) const {
        if (!steps || !lanes || size < 2 || ((data[0] | data[1] << 8) & MASK) < MANY) return false;
        State state(data, size);
        return read(state, steps, lanes, most, out);
    }

    // Decodes integers (steps, lanes). None for streams with the other ladder or hints, and for damaged streams.
    std::optional<Output<int64_t>> unpack(nb::bytes data, size_t steps, size_t lanes, size_t most) const {
        if (tables_.size() != 1 + SHAPES || tables_[0].count != FIELDS) throw std::invalid_argument("StateStreams: wrong tables");
        Fresh<int64_t> out(steps * lanes);
        bool whole = false;
        {
            nb::gil_scoped_release release;
            whole = read(static_cast<const uint8_t *>(data.data()), data.size(), steps, lanes, most, out.data.get());
        }
        if (!whole) return std::nullopt;
        return out.give({steps, lanes});
    }

private:
    bool read(State &state, size_t steps, size_t lanes, size_t most, int64_t *out) const {
        size_t fields[FIELDS];
        for (size_t i = 0; i < FIELDS; ++i) fields[i] = tables_[0].next(state, i);
        const auto [mixture, shape, zero_law, offset, order, long_ladder, rows, columns] = fields;
        const size_t n = kept(steps, rows), m = kept(lanes, columns);
        if (mixture >= WITHOUT_HINTS || bool(long_ladder) != long_ladder_ || shape >= SHAPES || n > steps || m > lanes || n * m > most) return false;
        const Laws &laws = tables_[1 + shape];
        std::vector<uint8_t> ladder(usual_law_.size());
        for (size_t i = 0; i < ladder.size(); ++i)
            ladder[i] = uint8_t(std::clamp<int64_t>(usual_law_[i] + int64_t(offset) - int64_t(OFFSETS / 2), 0, int64_t(laws.count) - 2));
        ladder[0] = uint8_t(zero_law);
        if (zero_law + 1 >= laws.count) return false;
        std::vector<uint8_t> token(n * m);
        auto next = [&](size_t law) {
            const size_t found = laws.next(state, law);
            const bool escapes = int64_t(found) == laws.sizes[law] - 1;
            return int64_t(escapes ? std::min<size_t>(found + laws.next(state, laws.count - 1), 255) : found);
        };
        const int64_t *weights = mixtures_[mixture];
        if (!decode_tokens(weights, ladder.data(), ladder.size(), nullptr, n, m, next, token.data())) return false;
        std::vector<int64_t> coded(n * m);
        if (!read_values(state, token, coded.data())) return false;
        std::fill_n(out, steps * lanes, 0);
        for (size_t step = 0; step < n; ++step) std::copy_n(coded.data() + step * m, m, out + step * lanes);
        for (size_t again = 0; again < order; ++again)
            for (size_t i = lanes; i < steps * lanes; ++i) out[i] = int64_t(uint64_t(out[i]) + uint64_t(out[i - lanes]));
        return true;
    }

    // one_state.StateDecoder.raw, coder._unpack_one: reads signs and mantissas from the low end of the state, last first.
    static bool read_values(State &state, const std::vector<uint8_t> &token, int64_t *out) {
        size_t total = 0;
        for (uint8_t t : token) {
            if (t >= TOKENS) return false;
            if (t) total += mantissa_bits(t) + 1;
        }
        if (total > 16 * state.left + 32) return false;
        std::vector<uint8_t> bytes(total / 8 + 1 + WINDOW, 0);
        for (size_t i = 0; i <= total / 8; ++i) {
            const unsigned width = i < total / 8 ? 8 : unsigned(total % 8);
            bytes[total / 8 - i] = uint8_t(state.x & ((1u << width) - 1));
            state.x >>= width;
            state.refill();
        }
        if (state.x != 1 || state.left) return false;
        size_t at = 8 - total % 8;
        auto take = [&](unsigned width) {  // at most 57 bits
            uint64_t window = 0;
            for (size_t i = 0; i < WINDOW; ++i) window = window << 8 | bytes[at / 8 + i];
            window <<= at % 8;
            at += width;
            return window >> (64 - width);
        };
        for (size_t i = 0; i < token.size(); ++i) {
            const unsigned t = token[i], width = mantissa_bits(t);
            if (!t) {
                out[i] = 0;
                continue;
            }
            const bool negative = take(1) != 0;
            const uint64_t high = width > 32 ? take(width - 32) << 32 : 0;
            const int64_t magnitude = token_floor(t) | int64_t(width ? high | take(std::min(width, 32u)) : 0);
            out[i] = negative ? -magnitude : magnitude;
        }
        return true;
    }

    std::vector<Laws> tables_;
    std::vector<int64_t> usual_law_;
    bool long_ladder_;
    int64_t mixtures_[MIXTURES][NEIGHBOURS];
};

}  // namespace state_streams
