// Codes arrays of bits with the adaptive coder of adaptive_bits.h. Kernels that code a structure bit by bit take one of
// these coders from Python and call `code`.
#pragma once

#include <deque>
#include <optional>
#include <stdexcept>
#include <utility>

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

// A bit that an encoder coded: its counters, each counted within its input, its weight set, and the bit as the lowest digit.
struct CodedBit {
    static_assert(bits::SLOTS <= 1 << 16 && bits::MIXERS <= 1 << 15, "numbers of 16 bits");
    uint16_t slots[bits::INPUTS], set_and_bit;

    CodedBit(const uint32_t *counters, uint32_t set, int bit) : set_and_bit(uint16_t(set % bits::MIXERS << 1 | uint32_t(bit))) {
        for (int i = 0; i < bits::INPUTS; ++i) slots[i] = uint16_t(counters[i] - uint32_t(i * bits::SLOTS));
    }

    void counters(uint32_t *to) const {
        for (int i = 0; i < bits::INPUTS; ++i) to[i] = uint32_t(i * bits::SLOTS) + slots[i];
    }
    uint32_t set() const { return set_and_bit >> 1; }
    int bit() const { return set_and_bit & 1; }
};

using CodedBits = std::vector<CodedBit>;

class BitArrayEncoder {
public:
    BitArrayEncoder(Table squash, Table stretch, Table rate, Table cost)
        : tables_(squash, stretch, rate, cost), mixer_(tables_.pointers()) {}

    // A copy with the same learned state and output.
    BitArrayEncoder(const BitArrayEncoder &other)
        : tables_(other.tables_), mixer_(other.mixer_, tables_.pointers()), encoder_(other.encoder_), keeps_bits_(other.keeps_bits_),
          coded_(other.coded_) {}

    // Keeps the bits from here on, for `take_bits`.
    void keep_bits() { keeps_bits_ = true; }

    // The bits since the last call, which are kept no longer.
    CodedBits take_bits() {
        CodedBits taken = std::exchange(coded_, {});
        coded_.reserve(taken.size());
        return taken;
    }

    // The whole bytes so far, from one on.
    nb::bytes written(size_t start) const {
        const std::vector<uint8_t> &all = encoder_.written();
        start = std::min(start, all.size());
        return nb::bytes(reinterpret_cast<const char *>(all.data()) + start, all.size() - start);
    }

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
        if (keeps_bits_) coded_.emplace_back(counters, set, bit);
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
    bool keeps_bits_ = false;
    CodedBits coded_;
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

// Decodes the bytes of an encoder while it goes on, with a model of its own, and compares all bits with the coded ones. The
// contexts are the encoder's: they follow from earlier bits, which are equal up to the first difference.
class BitArrayCheck {
public:
    BitArrayCheck(Table squash, Table stretch, Table rate, Table cost)
        : tables_(squash, stretch, rate, cost), mixer_(tables_.pointers()) {}

    // Takes the next bits and the bytes written meanwhile; compares the bits that the bytes reach. Returns whether they are equal.
    bool follow(nb::bytes written, CodedBits &coded) {
        data_.insert(data_.end(), written.c_str(), written.c_str() + written.size());
        waiting_.push_back(std::exchange(coded, {}));
        nb::gil_scoped_release release;
        if (!decoder_ && data_.size() < 4) return true;
        if (!decoder_) decoder_.emplace(data_.data(), data_.size());
        decoder_->extend(data_.data(), data_.size());
        return compare([&] { return decoder_->reaches_next(); });
    }

    // Compares the remaining bits with these bytes, which must be all that the encoder has written, and end where the bits end.
    bool finish(nb::bytes all) {
        const uint8_t *begin = reinterpret_cast<const uint8_t *>(all.c_str());
        if (all.size() < data_.size() || !std::equal(data_.begin(), data_.end(), begin)) return false;
        nb::gil_scoped_release release;
        if (!decoder_) decoder_.emplace(begin, all.size());
        decoder_->extend(begin, all.size());
        const bool is_same = compare([] { return true; }) && decoder_->at_end();
        decoder_.reset();
        return is_same;
    }

private:
    static constexpr size_t FETCHED = 12;  // bits ahead whose counters are fetched

    // Compares the waiting bits while `is_next` is true.
    template <class IsNext>
    bool compare(IsNext is_next) {
        for (; !waiting_.empty(); waiting_.pop_front(), next_ = 0) {
            if (!compare_part(waiting_.front(), is_next)) return false;
            if (next_ < waiting_.front().size()) break;
        }
        return true;
    }

    // The model learns the coded bits, so that it need not wait for the decoded ones: up to a difference both are the same.
    template <class IsNext>
    bool compare_part(const CodedBits &coded, IsNext is_next) {
        uint32_t counters[bits::INPUTS];
        int difference = 0;
        for (; next_ < coded.size() && is_next(); ++next_) {
            coded[std::min(next_ + FETCHED, coded.size() - 1)].counters(counters);
            mixer_.fetch(counters);
            const CodedBit &own = coded[next_];
            own.counters(counters);
            mixer_.code(counters, own.set(), [&](int32_t p) {
                difference |= decoder_->bit(p) ^ own.bit();
                return own.bit();
            });
        }
        return !difference;
    }

    OwnTables tables_;
    bits::Mixer mixer_;
    std::vector<uint8_t> data_;
    std::optional<bits::Decoder> decoder_;
    std::deque<CodedBits> waiting_;
    size_t next_ = 0;  // of the first part that waits
};

// Whether the bytes ended before the bits; never in an encoder.
inline bool is_cut_off(const BitArrayEncoder &) { return false; }
inline bool is_cut_off(const BitArrayDecoder &decoder) { return decoder.exhausted(); }

}  // namespace bit_arrays
