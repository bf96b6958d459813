// Adaptive binary coder: each bit has a probability mixed from several contexts. Integers only.
//
//     contexts ─counters─► probabilities ─stretch, weigh, squash─► one probability ─range coder─► bytes
//
// docs/payloads/tempo-lattice.md specifies it; entropy/adaptive_bits.py implements it in Python.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <vector>

#if defined(__SSE2__)  // part of every x86-64 processor
#include <emmintrin.h>
#endif

namespace bits {

constexpr int INPUTS = 5;             // contexts of a bit
constexpr int SLOTS = 1 << 15;        // counters of each input
constexpr int MIXERS = 1 << 11;       // sets of weights
constexpr int32_t FIRST_WEIGHT = 18350;  // 0.28 · 2^16
constexpr int32_t LARGEST_WEIGHT = 1 << 22;
constexpr int LEARNING = 3;           // rate of the weights
constexpr int SLOWEST = 250;          // bits after which a counter's rate stays constant
constexpr int HALF = 1 << 15;         // probability 1/2

// From Python: probabilities (4096) of stretched values, the inverse, counters' rates, bit costs in 1/256 bit.
struct Tables {
    const int32_t *squash, *stretch, *rate, *cost;
};

struct Counter {
    uint16_t p = HALF;
    uint16_t seen = 0;
};

// The probability p of a 1, in 2^-16, and the counters, inputs and weights that give it.
struct Mixed {
    Counter *from[INPUTS];
    int32_t stretched[INPUTS];
    int32_t *weights;
    int32_t p;
};

class Mixer {
public:
    explicit Mixer(const Tables &tables)
        : cost(tables.cost), counters_(size_t(INPUTS) * SLOTS), weights_(size_t(INPUTS) * MIXERS, FIRST_WEIGHT) {
        std::copy(tables.squash, tables.squash + 4096, squash_);
        std::copy(tables.stretch, tables.stretch + 4096, stretch_);
        std::copy(tables.rate, tables.rate + SLOWEST + 1, rate_);
    }

    // A copy of another mixer's state, with tables of the same content.
    Mixer(const Mixer &other, const Tables &tables) : Mixer(tables) {
        counters_ = other.counters_;
        weights_ = other.weights_;
    }

    // Sets the contexts of the next bits.
    void contexts(const uint32_t *c) {
        for (int i = 0; i < INPUTS; ++i) hashed_[i] = c[i] * 257u * HASH;
    }

    // Prefetches the counters of a likely next bit.
    void prefetch(uint32_t kind) const {
#if defined(__GNUC__)
        for (int i = 0; i < INPUTS; ++i) __builtin_prefetch(&counters_[slot(i, kind * HASH)], 1);
#else
        (void)kind;
#endif
    }

    // Mixes the probability of a bit. kind: of the bit; set: of weights.
    int32_t mix(Mixed &m, uint32_t kind, uint32_t set) {
        uint32_t counters[INPUTS];
        const uint32_t hashed = kind * HASH;
        for (int i = 0; i < INPUTS; ++i) counters[i] = uint32_t(slot(i, hashed));
        return mix_with(m, counters, set);
    }

    // The counters of a bit of kind 0 with these contexts.
    static void counters_of(const uint32_t *contexts, uint32_t *counters) {
        for (int i = 0; i < INPUTS; ++i) counters[i] = counter_of(i, contexts[i]);
    }

    static uint32_t counter_of(int input, uint32_t context) { return uint32_t(input * SLOTS) + (context * 257u * HASH >> 17); }

    // Prefetches counters of a likely next bit.
    void fetch(const uint32_t *counters) const {
#if defined(__GNUC__)
        for (int i = 0; i < INPUTS; ++i) __builtin_prefetch(&counters_[counters[i]], 1);
#else
        (void)counters;
#endif
    }

    // `mix` with counters from `counters_of`.
    int32_t mix_with(Mixed &m, const uint32_t *counters, uint32_t set) {
        int64_t sum = 0;
        m.weights = &weights_[(set % MIXERS) * INPUTS];
        for (int i = 0; i < INPUTS; ++i) {
            m.from[i] = &counters_[counters[i]];
            m.stretched[i] = stretch_[m.from[i]->p >> 4];
            sum += int64_t(m.weights[i]) * m.stretched[i];
        }
        m.p = squash_[std::clamp<int64_t>(sum >> 16, -2048, 2047) + 2048];
        return m.p;
    }

    void learn(Mixed &m, int bit) {
        const int32_t error = (bit << 16) - m.p, target = bit ? 65535 : 0;
        for (int i = 0; i < INPUTS; ++i) {
            const int32_t moved = m.weights[i] + (m.stretched[i] * error * LEARNING >> 16);  // below 2^31
            m.weights[i] = std::clamp(moved, -LARGEST_WEIGHT, LARGEST_WEIGHT);
            Counter c = *m.from[i];
            c.p = uint16_t(c.p + ((target - int32_t(c.p)) * rate_[c.seen] >> 16));
            c.seen = uint16_t(c.seen + (c.seen < SLOWEST));
            *m.from[i] = c;
        }
    }

    // Codes a bit: `mix_with`, then bit_of(probability of a 1) returns the bit, which is learned.
    template <class BitOf>
    int code(const uint32_t *counters, uint32_t set, BitOf bit_of) {
        Mixed mixed;
        const int bit = bit_of(mix_with(mixed, counters, set));
        const int32_t error = ((bit << 16) - mixed.p) * LEARNING;
        uint32_t above = 0;  // has high bits if a weight is out of range
        for (int i = 0; i < INPUTS; ++i) {
            mixed.weights[i] += mixed.stretched[i] * error >> 16;
            above |= uint32_t(mixed.weights[i] + LARGEST_WEIGHT);
        }
        if (above >= 2 * uint32_t(LARGEST_WEIGHT))
            for (int i = 0; i < INPUTS; ++i) mixed.weights[i] = std::clamp(mixed.weights[i], -LARGEST_WEIGHT, LARGEST_WEIGHT);
        learn_counters(mixed.from, bit);
        return bit;
    }

    const int32_t *const cost;

private:
#if defined(__SSE2__)
    // A counter is one lane: p in its lower half, the number of bits in the upper. A step towards 0 is rounded up, a
    // step towards 65535 down: the latter is the step of 65535 − p towards 0 without rounding up.
    void learn_counters(Counter *const *from, int bit) {
        static_assert(INPUTS == 5 && sizeof(Counter) == 4, "lanes of five counters");
        const auto lane = [&](int i) {
            int32_t value;
            std::memcpy(&value, from[i], sizeof value);
            return _mm_cvtsi32_si128(value);
        };
        const __m128i four = _mm_unpacklo_epi64(_mm_unpacklo_epi32(lane(0), lane(1)), _mm_unpacklo_epi32(lane(2), lane(3)));
        __m128i rates = _mm_cvtsi32_si128(rate_[from[0]->seen]);
        rates = _mm_insert_epi16(rates, rate_[from[1]->seen], 2);
        rates = _mm_insert_epi16(rates, rate_[from[2]->seen], 4);
        rates = _mm_insert_epi16(rates, rate_[from[3]->seen], 6);
        const __m128i flip = _mm_set1_epi32(-bit & 0xffff), slowest = _mm_set1_epi32(int32_t(uint32_t(SLOWEST) << 16 | 0x8000));
        const auto learned = [&](__m128i counter, __m128i rate) {
            const __m128i away = _mm_xor_si128(counter, flip);
            const __m128i is_whole = _mm_cmpeq_epi16(_mm_mullo_epi16(away, rate), _mm_setzero_si128());
            const __m128i rounding = _mm_cmpeq_epi16(_mm_or_si128(is_whole, flip), _mm_setzero_si128());  // −1 where it rounds
            const __m128i left = _mm_add_epi16(_mm_sub_epi16(away, _mm_mulhi_epu16(away, rate)), rounding);
            return _mm_sub_epi16(_mm_xor_si128(left, flip), _mm_cmpgt_epi16(slowest, counter));
        };
        const __m128i after = learned(four, rates), fifth = learned(lane(4), _mm_cvtsi32_si128(rate_[from[4]->seen]));
        const auto put = [&](int i, __m128i value) {
            const int32_t counter = _mm_cvtsi128_si32(value);
            std::memcpy(static_cast<void *>(from[i]), &counter, sizeof counter);
        };
        put(0, after);
        put(1, _mm_shuffle_epi32(after, 1));
        put(2, _mm_shuffle_epi32(after, 2));
        put(3, _mm_shuffle_epi32(after, 3));
        put(4, fifth);
    }
#else
    void learn_counters(Counter *const *from, int bit) {
        for (int i = 0; i < INPUTS; ++i) learn_counter(*from[i], bit);
    }
#endif

    void learn_counter(Counter &counter, int bit) {
        const int32_t target = bit ? 65535 : 0;
        counter.p = uint16_t(counter.p + ((target - int32_t(counter.p)) * rate_[counter.seen] >> 16));
        counter.seen = uint16_t(counter.seen + (counter.seen < SLOWEST));
    }

    static constexpr uint32_t HASH = 2654435761u;

    size_t slot(int input, uint32_t hashed_kind) const {
        return size_t(input) * SLOTS + ((hashed_[input] + hashed_kind) >> 17);
    }

    std::vector<Counter> counters_;
    std::vector<int32_t> weights_;
    uint32_t hashed_[INPUTS] = {};
    // Narrow copies, since they share the L1 cache with the counters.
    uint16_t squash_[4096], rate_[SLOWEST + 1];
    int16_t stretch_[4096];
};

// 32-bit binary range coder without carry.
class Encoder {
public:
    void bit(int bit, int32_t p) {
        const uint32_t range = high_ - low_;
        const uint32_t middle = low_ + (range >> 16) * uint32_t(p) + ((range & 0xffff) * uint32_t(p) >> 16);
        if (bit) high_ = middle; else low_ = middle + 1;
        while ((low_ ^ high_) >> 24 == 0) shift();
    }

    size_t size() const { return out_.size(); }
    const std::vector<uint8_t> &written() const { return out_; }

    // Ends with the fewest bytes that decode correctly if zeros follow.
    std::vector<uint8_t> finish() {
        for (int bytes = low_ ? 1 : 0; bytes; ++bytes) {
            const uint64_t unit = uint64_t(1) << (32 - 8 * bytes);
            const uint64_t value = (uint64_t(low_) + unit - 1) / unit * unit;
            if (value > high_) continue;
            for (int i = 0; i < bytes; ++i) out_.push_back(uint8_t(value >> (24 - 8 * i)));
            break;
        }
        return std::move(out_);
    }

private:
    void shift() {
        out_.push_back(uint8_t(high_ >> 24));
        low_ <<= 8;
        high_ = high_ << 8 | 255;
    }

    uint32_t low_ = 0, high_ = 0xffffffffu;
    std::vector<uint8_t> out_;
};

class Decoder {
public:
    Decoder(const uint8_t *data, size_t size) : data_(data), size_(size) {
        for (int i = 0; i < 4; ++i) code_ = code_ << 8 | next();
    }

    int bit(int32_t p) {
        const uint32_t range = high_ - low_;
        const uint32_t middle = low_ + (range >> 16) * uint32_t(p) + ((range & 0xffff) * uint32_t(p) >> 16);
        const int bit = code_ <= middle;
        if (bit) high_ = middle; else low_ = middle + 1;
        while ((low_ ^ high_) >> 24 == 0) {
            low_ <<= 8;
            high_ = high_ << 8 | 255;
            code_ = code_ << 8 | next();
        }
        return bit;
    }

    // Goes on with longer data that begin with the same bytes.
    void extend(const uint8_t *data, size_t size) {
        data_ = data;
        size_ = size;
    }

    // Whether the data reach for the next bit, which reads at most four bytes.
    bool reaches_next() const { return at_ + 4 <= size_; }
    // Whether all bytes were read, and at most four beyond the end, which a decoder reads ahead.
    bool at_end() const { return at_ >= size_ && at_ <= size_ + 4; }
    // Whether the stream is cut off: more than four bytes were read beyond the end.
    bool exhausted() const { return at_ > size_ + 4; }

private:
    uint32_t next() {
        const uint32_t byte = at_ < size_ ? data_[at_] : 0;
        ++at_;
        return byte;
    }

    const uint8_t *data_;
    size_t size_, at_ = 0;
    uint32_t low_ = 0, high_ = 0xffffffffu, code_ = 0;
};

}  // namespace bits
