// Quantises a chunk's coefficients with a step: codecs/tempo/coding/quantise.py. Integers equal NumPy's, since both do
// the same operations in the same order.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "chunk_symbols.h"

namespace chunks {

struct Quantised {
    int64_t threshold = 0;
    double bits = 0;
    size_t frequencies = 0;  // in the coded zone
    Integers integers;       // step, coefficients
};

// Parameters of a trial. heading_size, size: steps of the heading, radians, and of other rows, metres; prices:
// quantise.prices.
struct Quantisation {
    int64_t step;
    double heading_size, size, slope, inward;
    const double *prices;
    size_t free;  // first row with rate–distortion optimised integers
};

class Quantiser {
public:
    explicit Quantiser(const Expectations &of) : of_(of), rows_(of.rows), memory_(Memory::of_thread()) {}

    void run(const double *spectrum, const Quantisation &in, Quantised &out) {
        out.integers.step = in.step;
        find_choices(spectrum, in);
        const auto base = of_.contexts_of(in.step, frequencies_);
        const int64_t top = highest_threshold(in.step);
        out.threshold = top + 1;
        if (!choices_.empty()) {
            choose(*base, in);
            threshold(in, top, out);
            for (const Choice &c : choices_)
                if (const int64_t value = c.chosen(); value && heights_[c.at] >= out.threshold)
                    out.integers.coefficients.push_back({uint32_t(c.at / rows_), uint32_t(c.at % rows_), c.negative ? -value : value});
        }
        const std::vector<size_t> reach = of_.zone(in.step, out.threshold * THRESHOLD_UNIT);
        out.frequencies = *std::max_element(reach.begin(), reach.end());
    }

private:
    struct Choice {
        size_t at;
        double size, low_error, high_error, down, up;
        int64_t low, high;
        int low_symbol, high_symbol;
        bool free, lower, negative;

        int64_t chosen() const { return lower ? low : high; }
    };

    // Memory kept for a thread's next chunk: many points need megabytes, and fresh memory costs time to clear.
    struct Memory {
        std::vector<Choice> choices;
        std::vector<int16_t> logs;
        std::vector<uint16_t> tables;
        std::vector<int32_t> heights;
        Expectations::Field field;

        static Memory &of_thread() {
            static thread_local Memory memory;
            return memory;
        }
    };

    static double error(double size, int64_t magnitude, double inward) {
        const double off = size - (double(magnitude) - (magnitude > 0 ? inward : 0.0));
        return off * off;
    }

    static constexpr size_t EIGHT = 8;

    // Whether none of eight magnitudes exceeds a limit.
    static bool none_beyond(const double *of, double limit) {
        unsigned beyond = 0;
        for (size_t i = 0; i < EIGHT; ++i) beyond |= unsigned(std::fabs(of[i]) > limit);
        return !beyond;
    }

    // Finds the coefficients with a nonzero nearest integer; sets `frequencies_` to 1 + their last frequency.
    void find_choices(const double *spectrum, const Quantisation &in) {
        choices_.clear();
        const double limit = 0.4999 * in.size;  // most are far smaller than a step; this avoids slow divisions
        for (size_t f = 0; f < of_.frames; ++f) {
            const double *of = spectrum + f * rows_;
            add_choice(f, 0, of[0], in.heading_size, in);
            for (size_t first = 1; first < rows_; first += EIGHT) {
                const size_t end = std::min(rows_, first + EIGHT);
                if (end == first + EIGHT && none_beyond(of + first, limit)) continue;
                for (size_t r = first; r < end; ++r)
                    if (std::fabs(of[r]) > limit) add_choice(f, r, of[r], in.size, in);
            }
        }
        frequencies_ = choices_.empty() ? 0 : choices_.back().at / rows_ + 1;
    }

    // Adds the choice of a coefficient, unless its nearest integer is zero.
    void add_choice(size_t f, size_t r, double coefficient, double step, const Quantisation &in) {
        const double scaled = coefficient / step, size = std::fabs(scaled);
        if (!(size > 0.5)) return;
        Choice c{};
        c.at = f * rows_ + r, c.size = size, c.high = int64_t(std::nearbyint(size));
        c.negative = scaled < 0;
        c.free = r >= in.free;
        c.low = c.high - (c.free && size < double(c.high));
        c.high_symbol = symbol_of(c.high), c.low_symbol = symbol_of(c.low);
        c.high_error = error(size, c.high, in.inward), c.low_error = error(size, c.low, in.inward);
        choices_.push_back(c);
    }

    static_assert(THRESHOLD_UNIT == 16, "logarithms are shifted by 4");

    // The highest threshold whose coded zone includes the first frequency of some row.
    int64_t highest_threshold(int64_t step) const {
        int64_t top = INT64_MIN;
        for (size_t r = 0; r < rows_; ++r) top = std::max(top, (of_.highest_[r] - (r ? step : 0)) >> 4);
        return top;
    }

    // contexts.all_tables, as offsets in `prices`.
    void tables(Expectations::Field &field, const Expectations::Base &base) {
        const uint8_t *class_of = of_.tables_->class_of.data();
        const int64_t last = int64_t(of_.tables_->class_of.size()) - 1;
        logs_.resize(rows_);
        for (size_t g = 0; g + 1 < of_.starts_.size() && of_.starts_[g] < frequencies_; ++g) {
            const size_t start = of_.starts_[g], end = std::min(of_.starts_[g + 1], frequencies_);
            of_.logs_of(field, start, rows_, logs_);
            for (size_t f = start; f < end; ++f) {
                const size_t shape = Expectations::shape_of(f);
                for (size_t r = 0; r < rows_; ++r) {
                    const int64_t place = std::clamp<int64_t>(int64_t(logs_[r]) + base[f * rows_ + r], 0, last);
                    tables_[f * rows_ + r] = uint16_t((class_of[place] + shape) * SYMBOLS);
                }
            }
        }
    }

    // The two passes of quantise._quantise.
    void choose(const Expectations::Base &base, const Quantisation &in) {
        Expectations::Field &field = memory_.field;
        field.clear(frequencies_, rows_);
        auto set = [&](const Choice &c, int symbol) {
            field.row(c.at / rows_)[c.at % rows_] = int32_t(std::min<int64_t>(first_of(symbol), CEILING));
        };
        for (const Choice &c : choices_) set(c, c.high_symbol);
        tables_.resize(frequencies_ * rows_);
        for (bool last : {false, true}) {
            tables(field, base);
            for (Choice &c : choices_) {
                const double *price = in.prices + tables_[c.at];
                c.up = price[c.high_symbol], c.down = price[c.low_symbol];
                c.lower = c.low_error + in.slope * c.down < c.high_error + in.slope * c.up;
                if (!last) set(c, c.lower ? c.low_symbol : c.high_symbol);
            }
        }
    }

    // Finds the threshold of the coded zone with the least rate–distortion cost, and its bits.
    void threshold(const Quantisation &in, int64_t top, Quantised &out) {
        const size_t count = frequencies_ * rows_;
        heights_.resize(count);
        const int32_t *highest_from = of_.highest_.data(), step = int32_t(in.step);
        for (size_t at = 0; at < count; ++at) heights_[at] = (highest_from[at] - step) >> 4;
        for (size_t at = 0; at < count; at += rows_) heights_[at] = highest_from[at] >> 4;  // the heading has its own step
        int64_t highest = top;
        for (const Choice &c : choices_)
            if (!c.free && c.chosen() > 0) highest = std::min<int64_t>(highest, heights_[c.at]);
        int64_t lowest = highest;
        for (const Choice &c : choices_)
            if (c.chosen() > 0) lowest = std::min<int64_t>(lowest, heights_[c.at]);
        worth_.assign(size_t(top - lowest + 2), 0.0), spent_.assign(worth_.size(), 0.0);
        auto choice = choices_.begin();
        for (size_t at = 0; at < count; ++at) {
            const size_t bin = size_t(std::max<int64_t>(heights_[at] - (lowest - 1), 0));
            double bits = in.prices[tables_[at]], gain = 0;
            if (choice != choices_.end() && choice->at == at) {
                bits = choice->lower ? choice->down : choice->up;
                gain = choice->size * choice->size - (choice->lower ? choice->low_error : choice->high_error);
                ++choice;
            }
            worth_[bin] += bits * -in.slope + gain;
            spent_[bin] += bits;
        }
        for (size_t bin = worth_.size() - 1; bin-- > 0;) worth_[bin] += worth_[bin + 1], spent_[bin] += spent_[bin + 1];
        worth_[1] = worth_[0];
        const auto best = std::max_element(worth_.begin() + 1, worth_.begin() + (highest - lowest + 2));
        out.threshold = lowest + (best - worth_.begin() - 1);
        out.bits = spent_[size_t(out.threshold - lowest + 1)];
    }

    const Expectations &of_;
    const size_t rows_;
    size_t frequencies_ = 0;
    Memory &memory_;
    std::vector<Choice> &choices_ = memory_.choices;
    std::vector<int16_t> &logs_ = memory_.logs;
    std::vector<uint16_t> &tables_ = memory_.tables;
    std::vector<int32_t> &heights_ = memory_.heights;
    std::vector<double> worth_, spent_;
};

}  // namespace chunks
