// Decodes a chunk's bytes to integers: codecs/tempo/coding/coefficients.py, unpack. Integers only.
//
// Damaged bytes end the decoding; Python then decodes them again and raises the error.
#pragma once

#include <algorithm>
#include <map>
#include <memory>
#include <mutex>
#include <vector>

#if defined(__SSE2__)
#include <emmintrin.h>
#endif

#include "chunk_bits.h"
#include "contexts.h"
#include "vectors.h"

namespace chunks {

using namespace contexts;

// coding/coefficients.py, coding/plan.py, coding/corrections.py
constexpr int64_t MAX_STEP = 2048, LARGEST_THRESHOLD = 4096, THRESHOLD_UNIT = 16, LISTED_PER_BYTE = 64;
constexpr int64_t CLASSES = 56, LIST_TABLES = 2 * CLASSES;
constexpr int LANE_CODE = 7, HAS_LISTS = 8, THRESHOLD_SHIFT = 4;
constexpr size_t LANES[] = {1, 2, 4, 8, 12, 16, 24, 32}, MOST_LANES = 32;
constexpr size_t FIELDS = 5, SIGNED_FIELDS = 3;
constexpr int64_t GROUPS[][2] = {{0, 1}, {16, 2}, {64, 4}, {128, 8}};  // first frequency, size: contexts.GROUPS
constexpr size_t STEPS_KEPT = 32;  // cached contexts, by step
constexpr size_t SLOTS = 24, AT_ONCE = 8;  // entries of a table of first slots; number compared at once
static_assert(SYMBOLS < SLOTS, "one more entry ends the last symbol");

// Tables of coding/contexts.py, and the model's symbol tables. starts (tables, SLOTS): first slot of each symbol; TOTAL
// after the last symbol.
struct Tables {
    std::vector<uint16_t> starts;
    std::vector<int16_t> numerator_logs;
    std::vector<uint8_t> class_of;
    std::vector<int32_t> exp2;  // contexts._EXP, for logarithms from −512 on
    int64_t first_class;
    size_t symbols;
};

// Magnitudes of symbols, as contexts use them.
struct Magnitudes {
    int32_t of[SYMBOLS];

    constexpr Magnitudes() : of() {
        for (int s = 0; s < SYMBOLS; ++s) of[s] = int32_t(first_of(s) < CEILING ? first_of(s) : CEILING);
    }
};
constexpr Magnitudes MAGNITUDES;

// coding/rows.py
constexpr size_t HEADING = 0, POSE = 4;

struct Coefficient {
    uint32_t frequency, row;
    int64_t value;
};

// A chunk's integers: nonzero coefficients, frequency by frequency; lists (fields, n).
struct Integers {
    int64_t step = 0;
    std::vector<Coefficient> coefficients;
    std::vector<int64_t> lists;
};

// Facts shared by all chunks of one length: expected magnitudes, and cached contexts of steps.
class Expectations {
public:
    // expected (frames, rows): Model.expected for step 0.
    Expectations(std::shared_ptr<const Tables> tables, const int64_t *expected, size_t frames, size_t rows, size_t points)
        : frames(frames), rows(rows), points(points), tables_(std::move(tables)), expected_(frames * rows),
          highest_(frames * rows), starts_() {
        for (size_t i = 0; i < frames * rows; ++i)
            expected_[i] = int32_t(std::clamp<int64_t>(expected[i], -1000000, 1000000));
        for (size_t f = frames; f-- > 0;)
            for (size_t r = 0; r < rows; ++r) {
                const int32_t after = f + 1 < frames ? highest_[(f + 1) * rows + r] : INT32_MIN;
                highest_[f * rows + r] = std::max(expected_[f * rows + r], after);
            }
        for (size_t i = 0; i < 4; ++i) {
            const int64_t end = i < 3 ? std::min<int64_t>(GROUPS[i + 1][0], int64_t(frames)) : int64_t(frames);
            for (int64_t f = GROUPS[i][0]; f < end; f += GROUPS[i][1]) starts_.push_back(size_t(f));
        }
        starts_.push_back(frames);
    }

    // Decodes a chunk. False for bytes that no encoder writes.
    bool unpack(const uint8_t *data, size_t size, Integers &out) const {
        size_t at = 0;
        int64_t first, step, n = 0, classes[FIELDS] = {};
        if (!varint(data, size, at, first) || !varint(data, size, at, step)) return false;
        const int64_t folded = first >> THRESHOLD_SHIFT, threshold = folded & 1 ? -(folded >> 1) - 1 : folded >> 1;
        if (step > 2 * MAX_STEP || threshold > LARGEST_THRESHOLD || threshold < -LARGEST_THRESHOLD) return false;
        if (first & HAS_LISTS) {
            if (!varint(data, size, at, n)) return false;
            for (int64_t &each : classes)
                if (!varint(data, size, at, each) || each >= CLASSES) return false;
            if (n > int64_t(frames * points) || n > LISTED_PER_BYTE * int64_t(size)) return false;
        }
        out.step = step - MAX_STEP;
        const std::vector<size_t> reach = zone(out.step, threshold * THRESHOLD_UNIT);
        const size_t frequencies = *std::max_element(reach.begin(), reach.end());
        Lanes lanes{LANES[first & LANE_CODE], {}, {}, 0, 0};
        if (!frequencies && !n) return at == size;
        if (!read_states(data, size, at, lanes)) return false;
        lanes.set_words(data + at, size - at, rows + 1);  // a frequency takes at most one word for each row
        std::vector<uint8_t> listed(size_t(n) * FIELDS);
        std::vector<uint8_t> symbols;
        coefficients(reach, frequencies, *contexts_of(out.step, frequencies), lanes, out.coefficients, symbols);
        lists(size_t(n), classes, lanes, listed);
        return raw_bits(data + at, size - at, frequencies, lanes, symbols, listed, out);
    }

    const size_t frames, rows, points;

private:
    friend class Quantiser;
    friend class Packer;

    using Base = std::vector<int16_t>;

    // rANS states of lanes. words: of all lanes, then zeros.
    struct Lanes {
        size_t count_of_lanes;
        uint32_t state[MOST_LANES];
        std::vector<uint16_t> words;
        size_t count, used;

        void set_words(const uint8_t *data, size_t size, size_t zeros) {
            count = size / 2, used = 0;
            words.assign(count + zeros, 0);
            for (size_t i = 0; i < count; ++i) words[i] = uint16_t(data[2 * i] | data[2 * i + 1] << 8);
        }
    };

    struct FoundSymbol {
        uint32_t row, symbol;
    };

    static bool varint(const uint8_t *data, size_t size, size_t &at, int64_t &value) {
        value = 0;
        for (int shift = 0; shift < 63; shift += 7) {
            if (at >= size) return false;
            const uint8_t byte = data[at++];
            value |= int64_t(byte & 127) << shift;
            if (byte < 128) return byte || !shift;
        }
        return false;
    }

    // contexts.zone: number of coded frequencies in each row.
    std::vector<size_t> zone(int64_t step, int64_t threshold) const {
        std::vector<size_t> reach(rows);
        for (size_t r = 0; r < rows; ++r) {
            const int64_t least = threshold + (r ? step : 0);  // the heading has its own step
            size_t first = 0, behind = frames;
            while (first < behind) {
                const size_t middle = (first + behind) / 2;
                if (highest_[middle * rows + r] >= least) first = middle + 1;
                else behind = middle;
            }
            reach[r] = first;
        }
        return reach;
    }

    // Σ w |neighbour| for rows [0, wanted), from magnitudes 1 to 7 frequencies below.
    template <class Out>
    static void neighbourhood(const int32_t *const *below, size_t wanted, Out out) {
        const int32_t *b1 = below[1], *b2 = below[2], *b3 = below[3], *b4 = below[4];
        const int32_t *b5 = below[5], *b6 = below[6], *b7 = below[7];
        int32_t block = 0;
        for (int j = -BORDER; j < BORDER; ++j) block += b1[j] + (j > -BORDER && j < BORDER - 1 ? b2[j] : 0);
        for (size_t r = 0; r < wanted; ++r) {
            const int32_t *c1 = b1 + r, *c2 = b2 + r;
            block += c1[BORDER] + c2[BORDER - 1];
            int32_t sum = BLOCK * block + NEAR * (c1[0] + c2[0]) + BESIDE * (c1[-1] + c1[1]);
            sum += BELOW_3 * b3[r] + OLDER * (b4[r] + b5[r] + b6[r] + b7[r]);
            out(r, sum);
            block -= c1[-BORDER] + c2[1 - BORDER];
        }
    }

    // Magnitudes (frequencies, rows) with a border of zeros.
    struct Field {
        size_t pitch = 0;
        std::vector<int32_t> values;

        Field() = default;
        Field(size_t frequencies, size_t rows) { clear(frequencies, rows); }

        void clear(size_t frequencies, size_t rows) {
            pitch = rows + 2 * BORDER;
            values.assign((frequencies + DEPTH) * pitch + 2 * BORDER, 0);
        }

        int32_t *row(size_t frequency) { return values.data() + (frequency + DEPTH) * pitch + BORDER; }

        void below(size_t frequency, const int32_t **out) {
            for (size_t by = 1; by <= DEPTH; ++by) out[by] = row(frequency) - by * pitch;
        }
    };

    int16_t log_of(int32_t sum) const {
        return tables_->numerator_logs[std::min<size_t>(size_t(sum), tables_->numerator_logs.size() - 1)];
    }

    // Logarithms of the neighbourhoods of rows [0, wanted), minus the first class's.
    void logs_of(Field &field, size_t start, size_t wanted, std::vector<int16_t> &logs) const {
        const int32_t *below[DEPTH + 1];
        field.below(start, below);
        neighbourhood(below, wanted, [&](size_t r, int32_t sum) { logs[r] = int16_t(log_of(sum) - tables_->first_class); });
    }

    // The first table of a frequency's shape: contexts.SHAPE_STARTS.
    static size_t shape_of(size_t f) { return size_t(CLASSES) * (f == 0 ? 0 : f < 4 ? 1 : 2); }

    // contexts.base of at least the lowest `wanted` frequencies; values far beyond the classes are clipped.
    std::shared_ptr<const Base> contexts_of(int64_t step, size_t wanted) const {
        {
            const std::lock_guard<std::mutex> guard(lock_);
            if (auto found = bases_.find(step); found != bases_.end() && found->second->size() >= wanted * rows)
                return found->second;
        }
        const size_t known = std::min(frames, (wanted + 31) / 32 * 32);
        auto base = std::make_shared<Base>(known * rows);
        Field field(known, rows);
        std::vector<int16_t> logs(rows);
        for (size_t g = 0; g + 1 < starts_.size() && starts_[g] < known; ++g) {
            const int32_t *below[DEPTH + 1];
            field.below(starts_[g], below);
            neighbourhood(below, rows, [&](size_t r, int32_t sum) { logs[r] = log_of(sum / 16); });
            for (size_t f = starts_[g]; f < std::min(starts_[g + 1], known); ++f) {
                int32_t *magnitudes = field.row(f);
                for (size_t r = 0; r < rows; ++r) {
                    const int64_t log = expected_[f * rows + r] - (r ? step : 0);
                    magnitudes[r] = std::min<int32_t>(tables_->exp2[size_t(std::clamp<int64_t>(log, -512, 1023) + 512)],
                                                      int32_t(16 * CEILING));
                    (*base)[f * rows + r] = int16_t(std::clamp<int64_t>(log - logs[r], -16000, 16000));
                }
            }
        }
        const std::lock_guard<std::mutex> guard(lock_);
        if (bases_.size() >= STEPS_KEPT) bases_.clear();
        bases_[step] = base;
        return base;
    }

    // Number of first slots ≤ `slot`, among AT_ONCE ascending ones.
    static ALWAYS_INLINE size_t reached(const uint16_t *starts, uint32_t slot) {
#if defined(__SSE2__)
        const __m128i eight = _mm_loadu_si128(reinterpret_cast<const __m128i *>(starts));
        const int beyond = _mm_movemask_epi8(_mm_cmpgt_epi16(eight, _mm_set1_epi16(int16_t(slot))));
        return size_t(__builtin_ctz(unsigned(beyond) | 1u << 2 * AT_ONCE)) / 2;
#else
        size_t count = 0;
        for (size_t i = 0; i < AT_ONCE; ++i) count += starts[i] <= slot;
        return count;
#endif
    }

    // Decodes the next symbol of a lane. words: from index `used` on unread, then zeros.
    static ALWAYS_INLINE size_t take(uint32_t &state, const uint16_t *starts, const uint16_t *words, size_t &used) {
        uint32_t x = state;
        const uint32_t slot = x & (TOTAL - 1);
        size_t symbol = reached(starts + 1, slot);  // a linear search has unpredictable branches
        if (symbol == AT_ONCE)  // rare
            while (slot >= starts[symbol + 1]) ++symbol;
        const uint32_t start = starts[symbol];
        x = (x >> PRECISION) * (starts[symbol + 1] - start) + slot - start;
        if (x < LOWEST) x = x << 16 | words[used++];
        state = x;
        return symbol;
    }

    // Decodes places and symbols of the nonzero coefficients.
    void coefficients(const std::vector<size_t> &reach, size_t frequencies, const Base &base, Lanes &lanes,
                      std::vector<Coefficient> &places, std::vector<uint8_t> &symbols) const {
        Field field(frequencies, rows);
        std::vector<int16_t> logs(rows);
        std::vector<int16_t> places_of_classes(rows);
        std::vector<FoundSymbol> found_of_row(rows + 1);  // with one extra entry
        const uint8_t *class_of = tables_->class_of.data();
        const uint16_t *words = lanes.words.data();
        const int last_class = int(tables_->class_of.size()) - 1;
        const int16_t none = int16_t(log_of(0) - tables_->first_class);
        const size_t lanes_end = lanes.count_of_lanes;
        size_t quiet_since = 0;  // coefficients are 0 from this frequency on
        for (size_t g = 0; g + 1 < starts_.size() && starts_[g] < frequencies; ++g) {
            const size_t start = starts_[g], end = std::min(starts_[g + 1], frequencies);
            size_t wanted = rows;
            while (wanted && reach[wanted - 1] <= start) --wanted;
            if (start >= quiet_since + DEPTH) {
                std::fill_n(logs.begin(), wanted, none);
            } else {
                logs_of(field, start, wanted, logs);
            }
            size_t lane = 0;
            for (size_t f = start; f < end; ++f) {
                const uint16_t *of_shape = tables_->starts.data() + shape_of(f) * SLOTS;
                const int16_t *of_base = base.data() + f * rows, *of_logs = logs.data();
                int16_t *places_of = places_of_classes.data();
                for (size_t r = 0; r < wanted; ++r) {
                    const int place = of_logs[r] + of_base[r];
                    places_of[r] = int16_t(std::clamp(place, 0, last_class));
                }
                const size_t *of_reach = reach.data();
                int32_t *magnitudes = field.row(f);
                FoundSymbol *const first = found_of_row.data(), *into = first;
                size_t used = lanes.used;
                for (size_t r = 0; r < wanted; ++r) {
                    if (f >= of_reach[r]) continue;
                    const uint16_t *of_table = of_shape + class_of[places_of[r]] * SLOTS;
                    const size_t symbol = take(lanes.state[lane], of_table, words, used);
                    lane = lane + 1 == lanes_end ? 0 : lane + 1;
                    magnitudes[r] = MAGNITUDES.of[symbol];
                    *into = {uint32_t(r), uint32_t(symbol)};
                    into += symbol != 0;
                }
                lanes.used = used;
                if (used > lanes.count) return;  // damage
                if (into == first) continue;
                quiet_since = f + 1;
                for (const FoundSymbol *each = first; each != into; ++each) {
                    places.push_back({uint32_t(f), each->row, 0});
                    symbols.push_back(uint8_t(each->symbol));
                }
            }
        }
    }

    void lists(size_t n, const int64_t *classes, Lanes &lanes, std::vector<uint8_t> &listed) const {
        for (size_t i = 0; i < listed.size(); ++i) {
            const uint16_t *starts = tables_->starts.data() + size_t(LIST_TABLES + classes[i / n]) * SLOTS;
            uint32_t &state = lanes.state[i % lanes.count_of_lanes];
            listed[i] = uint8_t(take(state, starts, lanes.words.data(), lanes.used));
            if (lanes.used > lanes.count) return;  // damage
        }
    }

    // coefficients._read_states
    static bool read_states(const uint8_t *data, size_t size, size_t &at, Lanes &lanes) {
        const size_t count = lanes.count_of_lanes;
        Bits bits(data + at, size - at);
        int widths[MOST_LANES];
        size_t end = 4 * count;
        for (size_t i = 0; i < count; ++i) end += size_t(widths[i] = int(bits.get(4)) + 16);
        if (end > 8 * (size - at)) return false;
        for (size_t i = 0; i < count; ++i) lanes.state[i] = uint32_t(bits.get(widths[i]) | uint64_t(1) << widths[i]);
        if (end & 7 && bits.get(8 - int(end & 7))) return false;
        at += (end + 7) / 8;
        return true;
    }

    // Reads values of symbols: all mantissas, then signs of the nonzero ones among the first `with_sign`.
    template <class Symbol, class Value>
    static void values(Bits &bits, size_t n, size_t with_sign, Symbol symbol, Value value) {
        for (size_t i = 0; i < n; ++i) value(i) = first_of(symbol(i)) + int64_t(bits.get(width_of(symbol(i))));
        for (size_t i = 0; i < with_sign; ++i)
            if (symbol(i) && bits.get(1)) value(i) = -value(i);
    }

    bool raw_bits(const uint8_t *rest, size_t size, size_t frequencies, const Lanes &lanes,
                  const std::vector<uint8_t> &symbols, const std::vector<uint8_t> &listed, Integers &out) const {
        if (lanes.used > lanes.count) return false;
        std::vector<uint8_t> stream;
        if (frequencies || !listed.empty())
            for (size_t lane = 0; lane < lanes.count_of_lanes; ++lane) {
                if (lanes.state[lane] >> 17 || lanes.state[lane] < LOWEST) return false;
                stream.push_back(uint8_t(lanes.state[lane] >> 8));
                stream.push_back(uint8_t(lanes.state[lane]));
            }
        const size_t initial = 8 * stream.size();
        stream.insert(stream.end(), rest + 2 * lanes.used, rest + size);
        Bits bits(stream.data(), stream.size());
        values(bits, symbols.size(), symbols.size(), [&](size_t i) { return int(symbols[i]); },
               [&](size_t i) -> int64_t & { return out.coefficients[i].value; });
        out.lists.resize(listed.size());
        values(bits, listed.size(), SIGNED_FIELDS * (listed.size() / FIELDS), [&](size_t i) { return int(listed[i]); },
               [&](size_t i) -> int64_t & { return out.lists[i]; });
        const size_t total = bits.at(), beyond = total > initial ? total - initial : 0;
        return size == 2 * lanes.used + (beyond + 7) / 8 && bits.rest_is_zero();
    }

    std::shared_ptr<const Tables> tables_;
    std::vector<int32_t> expected_, highest_;  // (frames, rows): expected, and its maximum from a frequency on
    std::vector<size_t> starts_;               // first frequencies of the groups, then the number of frames
    mutable std::mutex lock_;
    mutable std::map<int64_t, std::shared_ptr<const Base>> bases_;
};

}  // namespace chunks
