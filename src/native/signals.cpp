// The serial loops of signals/: the adaptive coder of prediction residuals, and linear prediction. Integers only.

#include <algorithm>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "arrays.h"

namespace {

using Numbers = Input<int64_t, 1>;

// residuals.py has the same constants and the reasons.
constexpr int CONTEXTS = 44, FIRST_SCALED = 40;
constexpr int HIGH = 16, LOW = 4, HALF = 32;
constexpr int64_t TOTAL = 1 << 15, LIMIT = int64_t(1) << 30;
constexpr uint32_t LOWEST = 1u << 16;

// The place of the highest bit of x > 0.
int top_bit(uint64_t x) {
#if defined(__GNUC__) || defined(__clang__)
    return 63 - __builtin_clzll(x);
#else
    int place = 0;
    for (int step = 32; step; step >>= 1)
        if (x >> step) x >>= step, place += step;
    return place;
#endif
}

// Where adaptation moves the starts of a table to after each symbol, with `floor` left for every other symbol.
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
    uint8_t seen_high[CONTEXTS], seen_low[CONTEXTS][HIGH];
    int64_t fast, slow;

    Model(const int16_t *high_start, const int16_t *low_start, int64_t start) : fast(start), slow(start) {
        std::memcpy(high, high_start, sizeof high);
        std::memcpy(low, low_start, sizeof low);
        std::memset(seen_high, 0, sizeof seen_high);
        std::memset(seen_low, 0, sizeof seen_low);
    }

    // residuals._context: the shift and the context of the next residual.
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

template <int N>
void adapt(int16_t *starts, int symbol, uint8_t &seen, const Targets<N> &targets) {
    const int rate = 7 + (seen >> 6 != 0);
    seen += seen < 64;
    const int16_t *target = targets.of[symbol];
    for (int i = 0; i < N; ++i) starts[i] = int16_t(starts[i] + (int16_t(target[i] - starts[i]) >> rate));
}

// The symbol whose interval holds the lowest 15 bits of the state.
template <int N>
int find(const int16_t *starts, uint32_t state) {
    const int16_t slot = int16_t(state & (TOTAL - 1));
    int16_t found = -1;
    for (int i = 0; i < N; ++i) found = int16_t(found + (starts[i] <= slot));
    return found;
}

template <int N>
uint32_t frequency(const int16_t *starts, int symbol) {
    return uint32_t((symbol == N - 1 ? int(TOTAL) : starts[symbol + 1]) - starts[symbol]);
}

struct Interval {
    uint16_t frequency, start;  // frequency 0 stands for 2^15
};

// residuals.encode for one lane: intervals of the symbols, and raw bits as numbers and widths.
void model_lane(const int64_t *residuals, size_t count, Model &model, std::vector<Interval> &intervals,
                std::vector<int64_t> &raw, std::vector<int64_t> &widths) {
    for (size_t t = 0; t < count; ++t) {
        int shift, c;
        model.context(shift, c);
        const int64_t place = (residuals[t] >> shift) + HALF;
        const int high = place < LOW ? 0 : place >= 2 * HALF - LOW ? HIGH - 1 : int(place >> 2);
        intervals.push_back({uint16_t(frequency<HIGH>(model.high[c], high)), uint16_t(model.high[c][high])});
        adapt<HIGH>(model.high[c], high, model.seen_high[c], HIGH_TARGETS);
        if (high == 0 || high == HIGH - 1) {
            const int64_t beyond = high ? place - (2 * HALF - LOW) + 1 : LOW - place;
            raw.push_back(beyond);
            widths.push_back(2 * top_bit(uint64_t(beyond)) + 1);
        } else {
            const int low = int(place & 3);
            int16_t *starts = model.low[c][high];
            intervals.push_back({uint16_t(frequency<LOW>(starts, low)), uint16_t(starts[low])});
            adapt<LOW>(starts, low, model.seen_low[c][high], LOW_TARGETS);
        }
        if (shift) {
            raw.push_back(residuals[t] & ((int64_t(1) << shift) - 1));
            widths.push_back(shift);
        }
        model.observe(residuals[t]);
    }
}

void check_tables(const Input<int16_t, 2> &high, const Input<int16_t, 3> &low) {
    if (high.shape(0) != CONTEXTS || high.shape(1) != HIGH || low.shape(0) != CONTEXTS || low.shape(1) != HIGH ||
        low.shape(2) != LOW)
        throw std::invalid_argument("signals: tables of another size");
}

// residuals.encode: the final state, words in the order of the decoder, raw bits packed in bytes.
nb::tuple signals_encode(Numbers residuals, int64_t start, Input<int16_t, 2> high, Input<int16_t, 3> low) {
    check_tables(high, low);
    Model model(high.data(), low.data(), start);
    std::vector<Interval> intervals;
    std::vector<int64_t> raw, widths;
    intervals.reserve(2 * residuals.shape(0));
    model_lane(residuals.data(), residuals.shape(0), model, intervals, raw, widths);
    std::vector<uint16_t> words;
    uint32_t state = LOWEST;
    for (size_t i = intervals.size(); i-- > 0;) {
        const uint32_t f = intervals[i].frequency;
        if (uint64_t(state) >= uint64_t(f) << 17) {
            words.push_back(uint16_t(state));
            state >>= 16;
        }
        state = (state / f << 15) + state % f + intervals[i].start;
    }
    Fresh<uint16_t> out(words.size());
    std::reverse_copy(words.begin(), words.end(), out.data.get());
    size_t total = 0;
    for (int64_t width : widths) total += size_t(width);
    Fresh<uint8_t> bits((total + 7) / 8);
    std::memset(bits.data.get(), 0, (total + 7) / 8);
    size_t at = 0;
    for (size_t i = 0; i < raw.size(); ++i)
        for (int64_t place = widths[i]; place-- > 0; ++at)
            bits.data[at >> 3] |= uint8_t((raw[i] >> place & 1) << (7 - (at & 7)));
    return nb::make_tuple(uint32_t(state), out.give({words.size()}), bits.give({(total + 7) / 8}));
}

struct BitReader {
    const uint8_t *bytes;
    size_t size, at = 0;

    int64_t get(int width) {
        uint64_t window = 0;
        const size_t first = at >> 3;
        if (first + 8 <= size)
            for (size_t i = 0; i < 8; ++i) window = window << 8 | bytes[first + i];  // one load
        else
            for (size_t i = 0; i < 8; ++i) window = window << 8 | (first + i < size ? bytes[first + i] : 0);
        const int skip = int(at & 7);
        at += size_t(width);
        if (width == 0) return 0;
        return int64_t(window << skip >> (64 - width));  // widths are at most 56
    }
};

// residuals.decode for one lane, a residual at a time.
struct LaneDecoder {
    Model model;
    int64_t *out;
    uint32_t state;
    const uint16_t *words;
    size_t word_count, used = 0;
    BitReader bits;
    bool is_lane = true;

    void pull(const int16_t *starts, int symbol, uint32_t f) {
        const uint32_t x = f * (state >> 15) + (state & (TOTAL - 1)) - uint32_t(starts[symbol]);
        const bool is_short = x < LOWEST;
        const uint32_t word = words[used < word_count ? used : 0];  // there is one word at least, see signals_decode
        state = is_short ? x << 16 | word : x;
        used += is_short;
    }

    void step() {
        int shift, c;
        model.context(shift, c);
        int16_t *starts = model.high[c];
        const int high = find<HIGH>(starts, state);
        pull(starts, high, frequency<HIGH>(starts, high));
        adapt<HIGH>(starts, high, model.seen_high[c], HIGH_TARGETS);
        int64_t value;
        if (high == 0 || high == HIGH - 1) {
            int zeros = 0;
            while (zeros < 31 && !bits.get(1)) ++zeros;
            if (zeros == 31) is_lane = false, zeros = 0;
            const int64_t beyond = int64_t(1) << zeros | bits.get(zeros);
            value = high ? beyond - 1 + HALF - LOW : LOW - HALF - beyond;
        } else {
            starts = model.low[c][high];
            const int low = find<LOW>(starts, state);
            pull(starts, low, frequency<LOW>(starts, low));
            adapt<LOW>(starts, low, model.seen_low[c][high], LOW_TARGETS);
            value = (high << 2 | low) - HALF;
        }
        const int64_t residual = value * (int64_t(1) << shift) + (shift ? bits.get(shift) : 0);
        *out++ = residual;
        model.observe(residual);
    }

    // Whether everything was used up exactly.
    bool is_done() const {
        return is_lane && state == LOWEST && used == word_count && (bits.at + 7) / 8 == bits.size;
    }
};

// residuals.decode: the residuals of each lane, or nothing if the bytes of one are no lane of this many. Two lanes
// advance in turn, since the processor computes what does not depend on each other at the same time.
nb::object signals_decode(nb::list lanes, Input<int16_t, 2> high, Input<int16_t, 3> low) {
    check_tables(high, low);
    nb::list result;
    std::vector<LaneDecoder> decoders;
    std::vector<size_t> counts;
    std::vector<Input<uint16_t, 1>> all_words;  // hold the arrays while their memory is read
    std::vector<Input<uint8_t, 1>> all_bits;
    static const uint16_t no_word = 0;
    for (nb::handle lane : lanes) {
        const nb::tuple fields = nb::cast<nb::tuple>(lane);
        const auto count = nb::cast<size_t>(fields[0]);
        const auto &words = all_words.emplace_back(nb::cast<Input<uint16_t, 1>>(fields[3]));
        const auto &bits = all_bits.emplace_back(nb::cast<Input<uint8_t, 1>>(fields[4]));
        Fresh<int64_t> out(count);
        decoders.push_back({Model(high.data(), low.data(), nb::cast<int64_t>(fields[1])), out.data.get(),
                            nb::cast<uint32_t>(fields[2]), words.shape(0) ? words.data() : &no_word, words.shape(0), 0,
                            BitReader{bits.data(), bits.shape(0)}});
        counts.push_back(count);
        result.append(out.give({count}));
    }
    for (size_t i = 0; i < decoders.size(); i += 2) {
        LaneDecoder &one = decoders[i], &other = decoders[std::min(i + 1, decoders.size() - 1)];
        const size_t both = i + 1 < decoders.size() ? std::min(counts[i], counts[i + 1]) : 0;
        for (size_t t = 0; t < both; ++t) one.step(), other.step();
        for (size_t t = both; t < counts[i]; ++t) one.step();
        if (i + 1 < decoders.size())
            for (size_t t = both; t < counts[i + 1]; ++t) other.step();
    }
    for (const LaneDecoder &decoder : decoders)
        if (!decoder.is_done()) return nb::none();
    return result;
}

int64_t clamp_prediction(uint64_t sum, int64_t shift) {
    return std::clamp<int64_t>(int64_t(sum) >> shift, -LIMIT / 2, LIMIT / 2);
}

// prediction.restore: samples from residuals; `base` is the part of the prediction that is known before.
Output<int64_t> signals_restore(Numbers residuals, Numbers base, Numbers own, int64_t shift, int64_t first) {
    const size_t count = residuals.shape(0), order = own.shape(0);
    if (base.shape(0) != count) throw std::invalid_argument("signals_restore: shapes differ");
    std::vector<int64_t> past(count + order, first);  // `order` samples before the first
    std::vector<int64_t> taps(own.data(), own.data() + order);
    std::reverse(taps.begin(), taps.end());
    for (size_t t = 0; t < count; ++t) {
        uint64_t sum = uint64_t(base.data()[t]);
        const int64_t *before = past.data() + t;
        for (size_t i = 0; i < order; ++i) sum += uint64_t(taps[i]) * uint64_t(before[i]);
        past[t + order] = residuals.data()[t] + clamp_prediction(sum, shift);
    }
    Fresh<int64_t> out(count);
    std::copy(past.begin() + std::ptrdiff_t(order), past.end(), out.data.get());
    return out.give({count});
}

// prediction._add_taps: sums[t] += taps[i] · samples[t − delay − i], the first sample before the first.
void signals_add_taps(InPlace<int64_t, 1> sums, Numbers samples, Numbers taps, size_t delay) {
    const size_t count = sums.shape(0), order = taps.shape(0);
    if (samples.shape(0) != count) throw std::invalid_argument("signals_add_taps: shapes differ");
    if (count == 0) return;
    std::vector<int64_t> past(count + order + delay, samples.data()[0]);
    std::copy(samples.data(), samples.data() + count, past.begin() + std::ptrdiff_t(order + delay));
    std::vector<int64_t> reversed(taps.data(), taps.data() + order);
    std::reverse(reversed.begin(), reversed.end());
    for (size_t t = 0; t < count; ++t) {
        uint64_t sum = uint64_t(sums.data()[t]);
        const int64_t *before = past.data() + t + 1;
        for (size_t i = 0; i < order; ++i) sum += uint64_t(reversed[i]) * uint64_t(before[i]);
        sums.data()[t] = int64_t(sum);
    }
}

}  // namespace

void bind_signals(nb::module_ &m) {
    m.def("signals_encode", &signals_encode);
    m.def("signals_decode", &signals_decode);
    m.def("signals_restore", &signals_restore);
    m.def("signals_add_taps", &signals_add_taps, nb::arg("sums").noconvert(), nb::arg("samples"), nb::arg("taps"),
          nb::arg("delay"));
}
