// Long arrays of tokens as diagonals, and tokens expected from their neighbours: entropy/layout.py, entropy/bulk.py.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "tokens.h"

namespace bulk {

// layout.Layout: maps an array (rows, columns) to diagonals of segments in one flat array.
struct Layout {
    static constexpr int64_t LANES = 64, STEPS = 128, WIDE = 4096;

    Layout(int64_t rows, int64_t columns) : transposed(columns > rows) {
        length = transposed ? columns : rows, breadth = transposed ? rows : columns;
        const int64_t groups = (breadth + LANES - 1) / LANES;
        lanes = (breadth + groups - 1) / groups;
        pieces = std::max<int64_t>(1, std::min(WIDE / breadth, length / STEPS));
        steps = (length + pieces - 1) / pieces;
        pieces = (length + steps - 1) / steps;
        segments = groups * pieces;
        full_groups = breadth - groups * (lanes - 1);  // other groups have one lane less
        row = (lanes + 2) * segments;
        width = std::min(steps, lanes) * segments;
    }

    int64_t places() const { return (steps + lanes + 1) * row; }
    int64_t diagonals() const { return steps + lanes - 1; }

    // Layout.diagonals: the range of diagonal i in the flat array; empty if all its segments lack a lane.
    void diagonal(int64_t i, int64_t &begin, int64_t &end) const {
        const int64_t low = std::max<int64_t>(0, i - steps + 1), high = std::min(lanes, i + 1);
        const int64_t missing = high == lanes ? segments - full_groups * pieces : 0;
        begin = (i + 2) * row + (low + 2) * segments;
        end = begin + std::max<int64_t>(0, (high - low) * segments - missing);
    }

    // Calls visit(place in the flat array, place in the array (rows, columns)) for every integer.
    template <class Visit>
    void each(Visit visit) const {
        const int64_t full = full_groups * lanes, stride = transposed ? 1 : breadth;
        for (int64_t line = 0; line < breadth; ++line) {
            const int64_t group = line < full ? line / lanes : full_groups + (line - full) / (lanes - 1);
            const int64_t lane = line < full ? line % lanes : (line - full) % (lanes - 1);
            int64_t to = transposed ? line * length : line;
            for (int64_t piece = 0; piece < pieces; ++piece) {
                int64_t place = 2 * row + 2 * segments + lane * (row + segments) + group * pieces + piece;
                for (int64_t left = std::min(steps, length - piece * steps); left > 0; --left, place += row, to += stride)
                    visit(place, to);
            }
        }
    }

    bool transposed;
    int64_t length, breadth, lanes, steps, pieces, segments, full_groups, row, width;
};

// bulk._DiagonalContexts: expected tokens of diagonals
class Contexts {
public:
    Contexts(const Layout &layout, uint16_t *tokens, const uint16_t *weights, const uint16_t *hints)
        : of_(layout), tokens_(tokens), weights_(weights), hints_(hints), mean_(size_t(layout.lanes * layout.segments), 0) {}

    void expected(int64_t i, int64_t begin, int64_t end, uint16_t *out) const {
        const int64_t row = of_.row, k = of_.segments, count = end - begin;
        const int64_t offsets[] = {row, 2 * row, row + k, 2 * row + 2 * k, 2 * row + k};
        std::fill_n(out, count, uint16_t(0));
        for (int n = 0; n < 5; ++n) {
            const uint16_t weight = weights_[n], *near = tokens_ + begin - offsets[n];
            for (int64_t j = 0; weight && j < count; ++j) out[j] = uint16_t(out[j] + near[j] * weight);
        }
        const uint16_t of_mean = weights_[5], of_hint = hints_ ? weights_[6] : uint16_t(0);
        const uint16_t *means = mean_.data() + first(i, begin);
        for (int64_t j = 0; of_mean && j < count; ++j)
            out[j] = uint16_t(out[j] + (uint16_t((means[j] >> 4) * of_mean) >> 4));
        for (int64_t j = 0; of_hint && j < count; ++j) out[j] = uint16_t(out[j] + hints_[begin + j] * of_hint);
    }

    void update(int64_t i, int64_t begin, int64_t end) {
        const int64_t k = of_.segments, left = (i + 2) * of_.row;
        if (i < of_.steps) {
            std::copy_n(tokens_ + left + 2 * k, k, tokens_ + left + k);
            std::copy_n(tokens_ + left + 2 * k, k, tokens_ + left);
        }
        if (weights_[5]) {
            uint16_t *means = mean_.data() + first(i, begin);
            const uint16_t *newest = tokens_ + begin;
            int64_t age = i - std::max<int64_t>(0, i - of_.steps + 1);
            for (int64_t lane = 0; lane < end - begin; lane += k, --age) {
                const int speed = tokens::mean_shift(age), count = int(std::min(k, end - begin - lane));
                for (int j = 0; j < count; ++j)
                    means[lane + j] = uint16_t(means[lane + j] - (means[lane + j] >> speed) + (newest[lane + j] << (8 - speed)));
            }
        }
        if (i + 1 < of_.lanes) {
            const int64_t ours = left + (i + 2) * k;
            for (int64_t j = 0; j < k; ++j) {
                const uint16_t newest = tokens_[ours + j];
                tokens_[ours + k + j] = tokens_[ours + k - of_.row + j] = newest;
                mean_[size_t((i + 1) * k + j)] = uint16_t(newest << 8);
            }
        }
    }

private:
    int64_t first(int64_t i, int64_t begin) const { return begin - (i + 2) * of_.row - 2 * of_.segments; }

    const Layout of_;
    uint16_t *tokens_;
    const uint16_t *weights_, *hints_;
    std::vector<uint16_t> mean_;
};

}  // namespace bulk
