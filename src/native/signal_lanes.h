// Lanes of prediction residuals (signals/residuals.py): the adaptive model, the coder, the decoder. Integers only.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <utility>
#include <vector>

#if defined(__SSE2__)  // part of every x86-64 processor
#include <emmintrin.h>
#endif

namespace signals {

// residuals.py has the same constants and explains them.
constexpr int CONTEXTS = 44, FIRST_SCALED = 40;
constexpr int HIGH = 16, LOW = 4, HALF = 32, MAX_ZEROS = 30, START_CODES = 144;
constexpr int64_t TOTAL = 1 << 15, LIMIT = int64_t(1) << 30;
constexpr uint32_t LOWEST = 1u << 16;

// Index of the highest set bit of x > 0.
inline int top_bit(uint64_t x) {
#if defined(__GNUC__) || defined(__clang__)
    return 63 - __builtin_clzll(x);
#else
    int place = 0;
    for (int step = 32; step; step >>= 1)
        if (x >> step) x >>= step, place += step;
    return place;
#endif
}

// Index of the lowest set bit of x > 0.
inline int lowest_bit(uint32_t x) {
#if defined(__GNUC__) || defined(__clang__)
    return __builtin_ctz(x);
#else
    return top_bit(x & (0u - x));
#endif
}

// residuals.start_of: initial value of the running means.
inline int64_t start_of(int code) { return int64_t(4 + (code & 3)) << (code >> 2); }

// Targets of adaptation: the starts of a table after each symbol, with `floor` for every other symbol.
template <int N>
struct Targets {
    int16_t of[N][N];

    constexpr explicit Targets(int floor) : of() {
        for (int symbol = 0; symbol < N; ++symbol)
            for (int i = 0; i < N; ++i)
                of[symbol][i] = int16_t(i <= symbol ? i * floor : int(TOTAL) - (N - i) * floor);
    }
};
constexpr Targets<HIGH> HIGH_TARGETS(8);
constexpr Targets<LOW> LOW_TARGETS(64);

struct Model {
    int16_t high[CONTEXTS][HIGH];
    int16_t low[CONTEXTS][HIGH][LOW];
    uint16_t seen_high[CONTEXTS], seen_low[CONTEXTS][HIGH];
    int64_t fast, slow;

    Model(const int16_t *high_start, const int16_t *low_start, int64_t start) : fast(start), slow(start) {
        std::memcpy(high, high_start, sizeof high);
        std::memcpy(low, low_start, sizeof low);
        std::memset(seen_high, 0, sizeof seen_high);
        std::memset(seen_low, 0, sizeof seen_low);
    }

    // residuals._context: shift and context of the next residual.
    void context(int &shift, int &number) const {
        const uint64_t mean = uint64_t(fast + slow);
        const int place = top_bit(mean);
        const int level = 4 * place + int(mean >> (place - 2) & 3) - 36;
        shift = std::max(0, (level >> 2) - 2);
        number = shift ? FIRST_SCALED + (level & 3) : std::max(0, level + 28);
    }

    void observe(int64_t residual) {
        const int64_t size = std::min(residual < 0 ? -residual : residual, LIMIT) << 8;
        fast = std::max<int64_t>(2, fast + ((size - fast) >> 3));
        slow = std::max<int64_t>(2, slow + ((size - slow) >> 6));
    }
};

// Adaptation rate of a table, as a shift.
inline int rate_of(uint16_t &seen) {
    const int rate = 7 + (seen >> 6 != 0);
    seen = uint16_t(seen + (seen < 64));
    return rate;
}

template <int N>
uint32_t frequency(const int16_t *starts, int symbol) {
    return uint32_t((symbol == N - 1 ? int(TOTAL) : starts[symbol + 1]) - starts[symbol]);
}

#if defined(__SSE2__)

// The symbol with the interval that contains the lowest 15 bits of the state.
template <int N>
int find(const int16_t *starts, uint32_t state) {
    const __m128i slot = _mm_set1_epi16(int16_t(state & (TOTAL - 1)));
    uint32_t above;  // a bit for each symbol that starts above the slot
    if constexpr (N == HIGH) {
        const __m128i lower = _mm_loadu_si128(reinterpret_cast<const __m128i *>(starts));
        const __m128i upper = _mm_loadu_si128(reinterpret_cast<const __m128i *>(starts + 8));
        above = uint32_t(_mm_movemask_epi8(_mm_packs_epi16(_mm_cmpgt_epi16(lower, slot), _mm_cmpgt_epi16(upper, slot))));
    } else {
        const __m128i all = _mm_cmpgt_epi16(_mm_loadl_epi64(reinterpret_cast<const __m128i *>(starts)), slot);
        above = uint32_t(_mm_movemask_epi8(_mm_packs_epi16(all, all))) & 15;
    }
    return lowest_bit(above | 1u << N) - 1;
}

template <int N>
void adapt(int16_t *starts, int symbol, uint16_t &seen, const Targets<N> &targets) {
    const __m128i rate = _mm_cvtsi32_si128(rate_of(seen));
    const auto moved = [&](__m128i from, __m128i to) {
        return _mm_add_epi16(from, _mm_sra_epi16(_mm_sub_epi16(to, from), rate));
    };
    auto *at = reinterpret_cast<__m128i *>(starts);
    const auto *target = reinterpret_cast<const __m128i *>(targets.of[symbol]);
    if constexpr (N == HIGH) {
        for (int half = 0; half < 2; ++half)
            _mm_storeu_si128(at + half, moved(_mm_loadu_si128(at + half), _mm_loadu_si128(target + half)));
    } else {
        _mm_storel_epi64(at, moved(_mm_loadl_epi64(at), _mm_loadl_epi64(target)));
    }
}

#else

template <int N>
int find(const int16_t *starts, uint32_t state) {
    const int16_t slot = int16_t(state & (TOTAL - 1));
    int16_t found = -1;
    for (int i = 0; i < N; ++i) found = int16_t(found + (starts[i] <= slot));
    return found;
}

template <int N>
void adapt(int16_t *starts, int symbol, uint16_t &seen, const Targets<N> &targets) {
    const int rate = rate_of(seen);
    const int16_t *target = targets.of[symbol];
    for (int i = 0; i < N; ++i) starts[i] = int16_t(starts[i] + (int16_t(target[i] - starts[i]) >> rate));
}

#endif

// Packs numbers of different widths into bytes, highest bit first.
struct BitWriter {
    std::vector<uint8_t> bytes;
    uint64_t open = 0;  // bits of an incomplete byte
    int open_bits = 0;

    void put(uint64_t number, int width) {
        for (int left = width; left > 0;) {
            const int part = std::min(left, 32);
            left -= part;
            open = open << part | (number >> left & ((uint64_t(1) << part) - 1));
            for (open_bits += part; open_bits >= 8; open_bits -= 8) bytes.push_back(uint8_t(open >> (open_bits - 8)));
        }
    }

    void finish() {
        if (open_bits) bytes.push_back(uint8_t(open << (8 - open_bits)));
        open_bits = 0;
    }
};

struct CodedLane {
    uint32_t state;
    std::vector<uint16_t> words;  // in encoding order; the decoder starts from the last
    std::vector<uint8_t> raw;
};

// residuals.encode for one lane.
inline CodedLane encode_lane(const int64_t *residuals, size_t count, Model &model) {
    std::vector<uint32_t> intervals;  // frequency · 2^16 + start; the frequency of 2^15 fits
    BitWriter raw;
    intervals.reserve(2 * count);
    raw.bytes.reserve(count);
    for (size_t t = 0; t < count; ++t) {
        int shift, c;
        model.context(shift, c);
        const int64_t place = (residuals[t] >> shift) + HALF;
        const int high = place < LOW ? 0 : place >= 2 * HALF - LOW ? HIGH - 1 : int(place >> 2);
        intervals.push_back(frequency<HIGH>(model.high[c], high) << 16 | uint32_t(model.high[c][high]));
        adapt<HIGH>(model.high[c], high, model.seen_high[c], HIGH_TARGETS);
        if (high == 0 || high == HIGH - 1) {
            const int64_t beyond = high ? place - (2 * HALF - LOW) + 1 : LOW - place;
            raw.put(uint64_t(beyond), 2 * top_bit(uint64_t(beyond)) + 1);
        } else {
            const int low = int(place & 3);
            int16_t *starts = model.low[c][high];
            intervals.push_back(frequency<LOW>(starts, low) << 16 | uint32_t(starts[low]));
            adapt<LOW>(starts, low, model.seen_low[c][high], LOW_TARGETS);
        }
        raw.put(uint64_t(residuals[t]), shift);
        model.observe(residuals[t]);
    }
    raw.finish();
    CodedLane lane{LOWEST, {}, std::move(raw.bytes)};
    lane.words.reserve(count);
    for (size_t i = intervals.size(); i-- > 0;) {
        const uint32_t f = intervals[i] >> 16, start = intervals[i] & 0xFFFF;
        if (uint64_t(lane.state) >= uint64_t(f) << 17) {
            lane.words.push_back(uint16_t(lane.state));
            lane.state >>= 16;
        }
        lane.state = (lane.state / f << 15) + lane.state % f + start;
    }
    return lane;
}

struct BitReader {
    const uint8_t *bytes;
    size_t size, at = 0;

    // The next bits, at least 57, highest first; zeros past the end.
    uint64_t window() const {
        uint64_t window = 0;
        const size_t first = at >> 3;
        if (first + 8 <= size)
            for (size_t i = 0; i < 8; ++i) window = window << 8 | bytes[first + i];  // one load
        else
            for (size_t i = 0; i < 8; ++i) window = window << 8 | (first + i < size ? bytes[first + i] : 0);
        return window << (at & 7);
    }

    int64_t get(int width) {  // at most 56
        if (width == 0) return 0;
        const uint64_t bits = window();
        at += size_t(width);
        return int64_t(bits >> (64 - width));
    }
};

// residuals.decode for one lane, one residual at a time.
struct LaneDecoder {
    Model model;
    int64_t *out;
    uint32_t state;
    std::vector<uint16_t> words;  // with an extra word, which is read after the last
    size_t word_count, used = 0;
    BitReader bits;
    bool is_lane = true;

    // words: bytes of `word_count` words.
    LaneDecoder(const Model &model, int64_t *out, uint32_t state, const uint8_t *words, size_t word_count, BitReader bits)
        : model(model), out(out), state(state), words(word_count + 1), word_count(word_count), bits(bits) {
        for (size_t i = 0; i < word_count; ++i) this->words[i] = uint16_t(words[2 * i] | words[2 * i + 1] << 8);
    }

    // Removes the symbol's interval from the state, without a branch.
    void pull(uint32_t start, uint32_t f) {
        const uint32_t x = f * (state >> 15) + (state & (TOTAL - 1)) - start;
        const uint32_t is_short = x < LOWEST;
        state = x << (is_short << 4) | (words[used] & (0u - is_short));
        used += is_short;
        if (used > word_count) used = word_count, is_lane = false;
    }

    void step() {
        int shift, c;
        model.context(shift, c);
        int16_t *starts = model.high[c];
        const int high = find<HIGH>(starts, state);
        pull(uint32_t(starts[high]), frequency<HIGH>(starts, high));
        adapt<HIGH>(starts, high, model.seen_high[c], HIGH_TARGETS);
        int64_t value;
        if (high == 0 || high == HIGH - 1) {
            int zeros = 0;
            while (zeros <= MAX_ZEROS && !bits.get(1)) ++zeros;
            if (zeros > MAX_ZEROS) is_lane = false, zeros = 0;
            const int64_t beyond = int64_t(1) << zeros | bits.get(zeros);
            value = high ? beyond - 1 + HALF - LOW : LOW - HALF - beyond;
        } else {
            starts = model.low[c][high];
            const int low = find<LOW>(starts, state);
            pull(uint32_t(starts[low]), frequency<LOW>(starts, low));
            adapt<LOW>(starts, low, model.seen_low[c][high], LOW_TARGETS);
            value = (high << 2 | low) - HALF;
        }
        const int64_t residual = value * (int64_t(1) << shift) + bits.get(shift);
        *out++ = residual;
        model.observe(residual);
    }

    // Whether the state, the words and the bits end exactly here.
    bool is_done() const {
        return is_lane && state == LOWEST && used == word_count && (bits.at + 7) / 8 == bits.size;
    }
};

// Decodes lanes; counts: number of residuals of each. Four lanes advance in turn, so that the processor computes them
// in parallel. False if the bytes of a lane are not a lane of its length.
inline bool decode_lanes(std::vector<LaneDecoder> &lanes, const std::vector<size_t> &counts) {
    constexpr size_t WAYS = 4;
    size_t first = 0;
    for (; first + WAYS <= lanes.size(); first += WAYS) {
        LaneDecoder *some = lanes.data() + first;
        const size_t *count = counts.data() + first;
        const size_t all = *std::min_element(count, count + WAYS);
        for (size_t t = 0; t < all; ++t) some[0].step(), some[1].step(), some[2].step(), some[3].step();
        for (size_t k = 0; k < WAYS; ++k)
            for (size_t t = all; t < count[k]; ++t) some[k].step();
    }
    for (; first < lanes.size(); ++first)
        for (size_t t = 0; t < counts[first]; ++t) lanes[first].step();
    return std::all_of(lanes.begin(), lanes.end(), [](const LaneDecoder &lane) { return lane.is_done(); });
}

}  // namespace signals
