// A chunk of codecs/tempo from its bytes to integers: codecs/tempo/coding/coefficients.py, unpack. Integers only.
//
// Whatever is wrong with the bytes ends the work; Python then finds out what it is, and raises the error.
#pragma once

#include <algorithm>
#include <map>
#include <memory>
#include <mutex>
#include <vector>

#include "contexts.h"

namespace chunks {

using namespace contexts;

// coding/coefficients.py, coding/plan.py, coding/corrections.py
constexpr int64_t MAX_STEP = 2048, LARGEST_THRESHOLD = 4096, THRESHOLD_UNIT = 16, LISTED_PER_BYTE = 64;
constexpr int64_t CLASSES = 56, LIST_TABLES = 2 * CLASSES;
constexpr int LANE_CODE = 7, HAS_LISTS = 8, THRESHOLD_SHIFT = 4;
constexpr size_t LANES[] = {1, 2, 4, 8, 12, 16, 24, 32}, MOST_LANES = 32;
constexpr size_t FIELDS = 5, SIGNED_FIELDS = 3;
constexpr int64_t GROUPS[][2] = {{0, 1}, {16, 2}, {64, 4}, {128, 8}};  // first frequency, size: contexts.GROUPS
constexpr size_t STEPS_KEPT = 32;  // steps whose contexts are kept

// Big-endian bits behind one another; zeros follow the last.
class Bits {
public:
    Bits(const uint8_t *data, size_t bytes) : data_(data), bytes_(bytes) {}

    uint64_t get(int width) {
        uint64_t value = 0;
        while (width > 0) {
            const int inside = int(at_ & 7), taken = std::min(8 - inside, width);
            const uint64_t byte = (at_ >> 3) < bytes_ ? data_[at_ >> 3] : 0;
            value = value << taken | ((byte >> (8 - inside - taken)) & ((1u << taken) - 1));
            at_ += size_t(taken), width -= taken;
        }
        return value;
    }

    size_t at() const { return at_; }

    // Whether no bit is set from here on.
    bool rest_is_zero() {
        if (at_ & 7 && get(8 - int(at_ & 7))) return false;
        return std::all_of(data_ + std::min(at_ >> 3, bytes_), data_ + bytes_, [](uint8_t b) { return b == 0; });
    }

private:
    const uint8_t *data_;
    size_t bytes_, at_ = 0;
};

// Tables of coding/contexts.py, and the model's tables of symbols: `starts` (tables, symbols + 1) has their first slots.
struct Tables {
    std::vector<uint16_t> starts;
    std::vector<int16_t> numerator_logs;
    std::vector<uint8_t> class_of;
    std::vector<int32_t> exp2;  // contexts._EXP, from a logarithm of −512 on
    int64_t first_class;
    size_t symbols;
};

struct Coefficient {
    uint32_t frequency, row;
    int64_t value;
};

// A chunk's integers: coefficients that are not zero, frequency by frequency; lists (fields, n).
struct Integers {
    int64_t step = 0;
    std::vector<Coefficient> coefficients;
    std::vector<int64_t> lists;
};

// What is known of all chunks of one length: expected magnitudes, and contexts of the steps in use.
class Expectations {
public:
    // expected (frames, rows): Model.expected with a step of 0.
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

    // False for bytes that no encoder writes.
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
        Lanes lanes{LANES[first & LANE_CODE], {}, data, data, 0, 0};
        if (!frequencies && !n) return at == size;
        if (!read_states(data, size, at, lanes)) return false;
        lanes.words = data + at;
        lanes.count = (size - at) / 2;
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

    struct Lanes {
        size_t count_of_lanes;
        uint32_t state[MOST_LANES];
        const uint8_t *words, *unused;
        size_t count, used;
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

    // contexts.zone: how many frequencies of each row are coded.
    std::vector<size_t> zone(int64_t step, int64_t threshold) const {
        std::vector<size_t> reach(rows);
        for (size_t r = 0; r < rows; ++r) {
            const int64_t least = threshold + (r ? step : 0);  // the heading has a step of its own
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

    // Σ w |neighbour| of rows [0, wanted) from magnitudes 1 to 7 frequencies below.
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
        size_t pitch;
        std::vector<int32_t> values;

        Field(size_t frequencies, size_t rows)
            : pitch(rows + 2 * BORDER), values((frequencies + DEPTH) * pitch + 2 * BORDER, 0) {}

        int32_t *row(size_t frequency) { return values.data() + (frequency + DEPTH) * pitch + BORDER; }

        void below(size_t frequency, const int32_t **out) {
            for (size_t by = 1; by <= DEPTH; ++by) out[by] = row(frequency) - by * pitch;
        }
    };

    int16_t log_of(int32_t sum) const {
        return tables_->numerator_logs[std::min<size_t>(size_t(sum), tables_->numerator_logs.size() - 1)];
    }

    // Logarithms of what is around the rows [0, wanted), less the first class's.
    void logs_of(Field &field, size_t start, size_t wanted, std::vector<int16_t> &logs) const {
        const int32_t *below[DEPTH + 1];
        field.below(start, below);
        neighbourhood(below, wanted, [&](size_t r, int32_t sum) { logs[r] = int16_t(log_of(sum) - tables_->first_class); });
    }

    // The first table of a frequency's shape: contexts.SHAPE_STARTS.
    static size_t shape_of(size_t f) { return size_t(CLASSES) * (f == 0 ? 0 : f < 4 ? 1 : 2); }

    // contexts.base of at least the lowest `wanted` frequencies; what lies far beyond the classes is clipped.
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

    int take(Lanes &lanes, size_t lane, size_t table) const {
        uint32_t x = lanes.state[lane];
        const uint32_t slot = x & (TOTAL - 1);
        const uint16_t *starts = tables_->starts.data() + table * (tables_->symbols + 1);
        int symbol = 0;
        while (slot >= starts[symbol + 1]) ++symbol;
        x = (x >> PRECISION) * uint32_t(starts[symbol + 1] - starts[symbol]) + slot - starts[symbol];
        if (x < LOWEST) {
            const uint8_t *word = lanes.words + 2 * lanes.used;
            x = x << 16 | (lanes.used < lanes.count ? uint32_t(word[0]) | uint32_t(word[1]) << 8 : 0);
            ++lanes.used;
        }
        lanes.state[lane] = x;
        return symbol;
    }

    // Places of the coefficients that are not zero, and their symbols.
    void coefficients(const std::vector<size_t> &reach, size_t frequencies, const Base &base, Lanes &lanes,
                      std::vector<Coefficient> &places, std::vector<uint8_t> &symbols) const {
        Field field(frequencies, rows);
        std::vector<int16_t> logs(rows);
        const uint8_t *class_of = tables_->class_of.data();
        const int64_t last_class = int64_t(tables_->class_of.size()) - 1;
        const int16_t none = int16_t(log_of(0) - tables_->first_class);
        size_t quiet_since = 0;  // no coefficient is set from this frequency on
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
                const int16_t *of_base = base.data() + f * rows;
                int32_t *magnitudes = field.row(f);
                const size_t shape = shape_of(f);
                for (size_t r = 0; r < wanted; ++r) {
                    if (f >= reach[r]) continue;
                    const int64_t place = std::clamp<int64_t>(int64_t(logs[r]) + of_base[r], 0, last_class);
                    const int symbol = take(lanes, lane, class_of[place] + shape);
                    lane = lane + 1 == lanes.count_of_lanes ? 0 : lane + 1;
                    if (!symbol) continue;
                    magnitudes[r] = int32_t(std::min<int64_t>(first_of(symbol), CEILING));
                    places.push_back({uint32_t(f), uint32_t(r), 0});
                    symbols.push_back(uint8_t(symbol));
                    quiet_since = f + 1;
                }
            }
        }
    }

    void lists(size_t n, const int64_t *classes, Lanes &lanes, std::vector<uint8_t> &listed) const {
        for (size_t i = 0; i < listed.size(); ++i)
            listed[i] = uint8_t(take(lanes, i % lanes.count_of_lanes, size_t(LIST_TABLES + classes[i / n])));
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

    // The values of symbols: what is left of each magnitude, then the signs of the first `with_sign` that are not zero.
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
    std::vector<int32_t> expected_, highest_;  // (frames, rows): expected, and the highest from a frequency on
    std::vector<size_t> starts_;               // of the groups, and the number of frames
    mutable std::mutex lock_;
    mutable std::map<int64_t, std::shared_ptr<const Base>> bases_;
};

}  // namespace chunks
