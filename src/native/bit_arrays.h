// Codes arrays of bits with the adaptive coder of adaptive_bits.h. Kernels that code a structure bit by bit take one of
// these coders from Python and call `code`.
#pragma once

#include <stdexcept>

#include "adaptive_bits.h"
#include "arrays.h"

namespace bit_arrays {

using Table = Input<int32_t, 1>;
using Contexts = Input<uint32_t, 2>;
using Sets = Input<uint32_t, 1>;

// Owns copies of the tables, so that Python may free the arrays.
struct OwnTables {
    std::vector<int32_t> squash, stretch, rate, cost;

    OwnTables(Table a, Table b, Table c, Table d)
        : squash(a.data(), a.data() + a.shape(0)), stretch(b.data(), b.data() + b.shape(0)),
          rate(c.data(), c.data() + c.shape(0)), cost(d.data(), d.data() + d.shape(0)) {
        if (squash.size() != 4096 || stretch.size() != 4096 || cost.size() != 4096 || rate.size() <= size_t(bits::SLOWEST))
            throw std::invalid_argument("bit arrays: tables of wrong sizes");
    }

    bits::Tables pointers() const { return {squash.data(), stretch.data(), rate.data(), cost.data()}; }
};

inline size_t rows_of(const Contexts &contexts, const Sets &sets) {
    if (contexts.shape(1) != size_t(bits::INPUTS) || contexts.shape(0) != sets.shape(0))
        throw std::invalid_argument("bit arrays: shapes differ");
    return sets.shape(0);
}

class BitArrayEncoder {
public:
    BitArrayEncoder(Table squash, Table stretch, Table rate, Table cost)
        : tables_(squash, stretch, rate, cost), mixer_(tables_.pointers()) {}

    // A copy with the same learned state and output.
    BitArrayEncoder(const BitArrayEncoder &other)
        : tables_(other.tables_), mixer_(other.mixer_, tables_.pointers()), encoder_(other.encoder_) {}

    // Number of whole bytes so far.
    size_t size() const { return encoder_.size(); }

    void encode(Contexts contexts, Sets sets, Input<uint8_t, 1> values) {
        const size_t n = rows_of(contexts, sets);
        if (values.shape(0) != n) throw std::invalid_argument("bit arrays: shapes differ");
        for (size_t i = 0; i < n; ++i)
            code(contexts.data() + i * bits::INPUTS, sets.data()[i], values.data()[i] != 0);
    }

    // Fetches counters (INPUTS) of a bit to come.
    void fetch(const uint32_t *counters) { mixer_.fetch(counters); }

    // Codes one bit with counters from bits::Mixer::counters_of and a weight set; returns the bit.
    int code_with(const uint32_t *counters, uint32_t set, int bit) {
        return mixer_.code(counters, set, [&](int32_t p) {
            encoder_.bit(bit, p);
            return bit;
        });
    }

    // Codes one bit with these INPUTS contexts.
    int code(const uint32_t *contexts, uint32_t set, int bit) {
        uint32_t counters[bits::INPUTS];
        bits::Mixer::counters_of(contexts, counters);
        return code_with(counters, set, bit);
    }

    nb::bytes finish() {
        const std::vector<uint8_t> out = encoder_.finish();
        return nb::bytes(reinterpret_cast<const char *>(out.data()), out.size());
    }

private:
    OwnTables tables_;
    bits::Mixer mixer_;
    bits::Encoder encoder_;
};

class BitArrayDecoder {
public:
    BitArrayDecoder(nb::bytes data, Table squash, Table stretch, Table rate, Table cost)
        : tables_(squash, stretch, rate, cost), data_(data.c_str(), data.c_str() + data.size()), mixer_(tables_.pointers()),
          decoder_(data_.data(), data_.size()) {}

    Output<uint8_t> decode(Contexts contexts, Sets sets) {
        const size_t n = rows_of(contexts, sets);
        Fresh<uint8_t> out(n);
        for (size_t i = 0; i < n; ++i)
            out.data[i] = uint8_t(code(contexts.data() + i * bits::INPUTS, sets.data()[i], 0));
        return out.give({n});
    }

    // Fetches counters (INPUTS) of a bit to come.
    void fetch(const uint32_t *counters) { mixer_.fetch(counters); }

    // Decodes one bit; signature of BitArrayEncoder::code_with. Ignores the last argument.
    int code_with(const uint32_t *counters, uint32_t set, int) {
        return mixer_.code(counters, set, [&](int32_t p) { return decoder_.bit(p); });
    }

    // Decodes one bit with these INPUTS contexts. Ignores the last argument.
    int code(const uint32_t *contexts, uint32_t set, int) {
        uint32_t counters[bits::INPUTS];
        bits::Mixer::counters_of(contexts, counters);
        return code_with(counters, set, 0);
    }

    bool at_end() const { return decoder_.at_end(); }
    bool exhausted() const { return decoder_.exhausted(); }

private:
    OwnTables tables_;
    std::vector<uint8_t> data_;
    bits::Mixer mixer_;
    bits::Decoder decoder_;
};

// Whether the bytes ended before the bits; never in an encoder.
inline bool is_cut_off(const BitArrayEncoder &) { return false; }
inline bool is_cut_off(const BitArrayDecoder &decoder) { return decoder.exhausted(); }

}  // namespace bit_arrays
