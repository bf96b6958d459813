// Codes a chunk's integers into bytes: codecs/tempo/coding/coefficients.py, pack. The inverse of Expectations::unpack.
// Integers only, except costs of tables, which are summed in the order of the NumPy code.
#pragma once

#include <algorithm>
#include <stdexcept>
#include <vector>

#include "chunk_symbols.h"

namespace chunks {

constexpr size_t SYMBOLS_PER_LANE = 96, BITS_PER_LANE = 16;  // coding/coefficients.py

// Coding of the lists (FIELDS, n) of a chunk. bits: including raw bits.
struct ListCoding {
    int64_t classes[FIELDS] = {};
    double bits = 0;
};

// coefficients.list_coding. costs (tables, SYMBOLS): bits of each symbol.
inline ListCoding list_coding(const double *costs, const int64_t *lists, size_t n) {
    ListCoding out;
    if (!n) return out;
    size_t raw = 0;
    for (size_t field = 0; field < FIELDS; ++field) {
        int64_t counts[SYMBOLS] = {};
        for (size_t i = 0; i < n; ++i) {
            const int64_t v = lists[field * n + i];
            const int symbol = symbol_of(v < 0 ? -v : v);
            ++counts[symbol];
            raw += size_t(width_of(symbol)) + (field < SIGNED_FIELDS && symbol);
        }
        double least = 0;
        for (int64_t c = 0; c < CLASSES; ++c) {
            const double *price = costs + (LIST_TABLES + c) * SYMBOLS;
            double sum = price[0] * double(counts[0]);
            for (int s = 1; s < SYMBOLS; ++s) sum += price[s] * double(counts[s]);
            if (!c || sum < least) least = sum, out.classes[field] = c;
        }
        out.bits += least;
    }
    out.bits += double(raw);
    return out;
}

// A chunk's integers to code: values (frequencies, rows), lists (FIELDS, n).
struct Numbers {
    int64_t step, threshold;
    const int64_t *values;
    size_t frequencies;
    const int64_t *lists;
    size_t listed;
};

class Packer {
public:
    Packer(const Expectations &of, const double *costs) : of_(of), costs_(costs), rows_(of.rows) {}

    // Throws for a symbol that a table cannot code.
    std::vector<uint8_t> run(const Numbers &in) {
        const std::vector<size_t> reach = of_.zone(in.step, in.threshold * THRESHOLD_UNIT);
        const size_t zone = *std::max_element(reach.begin(), reach.end()), frequencies = std::min(zone, in.frequencies);
        const ListCoding lists = list_coding(costs_, in.lists, in.listed);
        raw_bits(in, reach, frequencies);
        size_t coded = FIELDS * in.listed;
        for (size_t r = 0; r < rows_; ++r) coded += reach[r];
        const size_t fitting = std::max<size_t>(1, std::min(raw_.count() / BITS_PER_LANE, coded / SYMBOLS_PER_LANE));
        int64_t lane_code = 7;
        while (LANES[lane_code] > fitting) --lane_code;
        head(in, lane_code, lists);
        if (zone || in.listed) streams(in, reach, zone, LANES[lane_code], lists);
        return std::move(out_);
    }

private:
    struct Slot {
        uint32_t frequency, start, lane;
    };

    static int64_t folded(int64_t v) { return v < 0 ? -2 * v - 1 : 2 * v; }

    void varint(int64_t value) {
        for (; value >= 128; value >>= 7) out_.push_back(uint8_t(value | 128));
        out_.push_back(uint8_t(value));
    }

    void head(const Numbers &in, int64_t lane_code, const ListCoding &lists) {
        varint(lane_code | (in.listed ? HAS_LISTS : 0) | folded(in.threshold) << THRESHOLD_SHIFT);
        varint(in.step + MAX_STEP);
        if (!in.listed) return;
        varint(int64_t(in.listed));
        for (const int64_t each : lists.classes) varint(each);
    }

    // Mantissas, then signs: first of the coefficients, then of the lists.
    void raw_bits(const Numbers &in, const std::vector<size_t> &reach, size_t frequencies) {
        std::vector<int64_t> known;
        for (size_t f = 0; f < frequencies; ++f)
            for (size_t r = 0; r < rows_; ++r)
                if (const int64_t v = in.values[f * rows_ + r]; v && f < reach[r]) known.push_back(v);
        raw_bits_of(known.data(), known.size(), known.size());
        raw_bits_of(in.lists, FIELDS * in.listed, SIGNED_FIELDS * in.listed);
    }

    void raw_bits_of(const int64_t *values, size_t n, size_t with_sign) {
        for (size_t i = 0; i < n; ++i) {
            const int64_t magnitude = values[i] < 0 ? -values[i] : values[i];
            const int symbol = symbol_of(magnitude);
            raw_.put(uint64_t(magnitude - first_of(symbol)), width_of(symbol));
        }
        for (size_t i = 0; i < with_sign; ++i)
            if (values[i]) raw_.put(values[i] < 0, 1);
    }

    void add(size_t table, int symbol, size_t lane) {
        const uint16_t *starts = of_.tables_->starts.data() + table * SLOTS;
        const uint32_t start = starts[symbol], frequency = starts[symbol + 1] - start;
        if (!frequency) throw std::invalid_argument("ChunksOfLength.pack: a symbol of weight zero");
        slots_.push_back({frequency, start, uint32_t(lane)});
    }

    // Symbols of the coefficients, in decoding order.
    void coefficients(const Numbers &in, const std::vector<size_t> &reach, size_t zone, size_t lanes) {
        const auto base = of_.contexts_of(in.step, zone);
        Expectations::Field field(zone, rows_);
        auto value = [&](size_t f, size_t r) {
            const int64_t v = f < in.frequencies ? in.values[f * rows_ + r] : 0;
            return v < 0 ? -v : v;
        };
        for (size_t f = 0; f < zone; ++f)
            for (size_t r = 0; r < rows_; ++r)
                if (const int64_t v = value(f, r))
                    field.row(f)[r] = int32_t(std::min<int64_t>(first_of(symbol_of(v)), CEILING));
        std::vector<int16_t> logs(rows_);
        const uint8_t *class_of = of_.tables_->class_of.data();
        const int64_t last = int64_t(of_.tables_->class_of.size()) - 1;
        for (size_t g = 0; g + 1 < of_.starts_.size() && of_.starts_[g] < zone; ++g) {
            const size_t start = of_.starts_[g], end = std::min(of_.starts_[g + 1], zone);
            size_t wanted = rows_, lane = 0;
            while (wanted && reach[wanted - 1] <= start) --wanted;
            of_.logs_of(field, start, wanted, logs);
            for (size_t f = start; f < end; ++f) {
                const size_t shape = Expectations::shape_of(f);
                for (size_t r = 0; r < wanted; ++r) {
                    if (f >= reach[r]) continue;
                    const int64_t place = std::clamp<int64_t>(int64_t(logs[r]) + (*base)[f * rows_ + r], 0, last);
                    add(class_of[place] + shape, symbol_of(value(f, r)), lane);
                    lane = lane + 1 == lanes ? 0 : lane + 1;
                }
            }
        }
    }

    // Writes the states, the words, and the raw bits that do not fit into the encoder's initial states.
    void streams(const Numbers &in, const std::vector<size_t> &reach, size_t zone, size_t lanes, const ListCoding &lists) {
        slots_.clear();
        coefficients(in, reach, zone, lanes);
        for (size_t i = 0; i < FIELDS * in.listed; ++i) {
            const int64_t v = in.lists[i];
            add(size_t(LIST_TABLES + lists.classes[i / in.listed]), symbol_of(v < 0 ? -v : v), i % lanes);
        }
        uint32_t state[MOST_LANES];
        const std::vector<uint8_t> &raw = raw_.bytes();
        auto byte = [&](size_t at) { return at < raw.size() ? uint32_t(raw[at]) : 0u; };
        for (size_t lane = 0; lane < lanes; ++lane) state[lane] = LOWEST + (byte(2 * lane) << 8 | byte(2 * lane + 1));
        std::vector<uint16_t> words;
        for (size_t i = slots_.size(); i-- > 0;) {
            const Slot slot = slots_[i];
            push(state[slot.lane], slot.frequency, slot.start, words);
        }
        write_states(state, lanes);
        for (size_t i = words.size(); i-- > 0;) {
            out_.push_back(uint8_t(words[i]));
            out_.push_back(uint8_t(words[i] >> 8));
        }
        if (raw.size() > 2 * lanes) out_.insert(out_.end(), raw.begin() + std::ptrdiff_t(2 * lanes), raw.end());
    }

    // coefficients._write_states
    void write_states(const uint32_t *state, size_t lanes) {
        int widths[MOST_LANES];
        BitsOut bits;
        for (size_t lane = 0; lane < lanes; ++lane) {
            widths[lane] = 16;
            while (uint64_t(state[lane]) >> (widths[lane] + 1)) ++widths[lane];
            bits.put(uint64_t(widths[lane] - 16), 4);
        }
        for (size_t lane = 0; lane < lanes; ++lane) bits.put(state[lane], widths[lane]);
        out_.insert(out_.end(), bits.bytes().begin(), bits.bytes().end());
    }

    const Expectations &of_;
    const double *costs_;
    const size_t rows_;
    BitsOut raw_;
    std::vector<Slot> slots_;
    std::vector<uint8_t> out_;
};

}  // namespace chunks
