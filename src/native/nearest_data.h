// The data points nearest to template points: searched once, then chosen among a few while the template moves little.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "algebra3.h"
#include "kd_tree.h"

// Remembers for each template row the last query and the data points near it. A query moves in place only, by at most the
// distance of the two places. So every point that is not remembered keeps a distance that the last search has shown.
class NearestData {
  public:
    explicit NearestData(size_t rows) : known(rows) {}

    // The data point nearest to a template row, with a squared distance below `limit`; −1: none. Sets `limit` to its
    // squared distance. query: place and colour of the row, as `KdTree::nearest`.
    int64_t find(const KdTree &data, size_t row, const double *query, double &limit) {
        Known &last = known[row];
        if (last.tree != data.serial) last = Known{}, last.tree = data.serial;
        const double moved = last.count ? std::sqrt(squared_distance(query, last.place)) : FAR_M;
        int64_t best = -1;
        double square = limit;
        for (size_t k = 0; k < last.count; ++k) {
            const double other = data.squared_distance_from(size_t(last.rows[k]), query);
            if (other < square) square = other, best = last.rows[k];
        }
        const double shown = last.beyond - moved - ROUNDING_M;  // all others are farther than this
        if (shown > 0 && square < squared(shown)) return limit = square, best;
        std::copy_n(query, 3, last.place);
        if (moved < LIST_M) {
            KdTree::Several<KEPT> found(limit);
            data.search(query, found);
            last.count = found.count;
            for (size_t k = 0; k < found.count; ++k) last.rows[k] = int32_t(found.rows[k]);
            last.beyond = std::sqrt(found.limit());
            if (!found.count) return -1;
            return limit = found.squares[0], found.rows[0];
        }
        KdTree::Nearest found{square, best};
        data.search(query, found);
        last.count = found.row >= 0;
        last.rows[0] = int32_t(found.row);
        last.beyond = 0;
        limit = found.square;
        return found.row;
    }

  private:
    static constexpr size_t KEPT = 3;             // data points kept for a row, at most
    static constexpr double LIST_M = 0.01;        // a row that has moved farther keeps only the nearest point
    static constexpr double FAR_M = 1e9;          // stands for the movement of a row without a former query
    static constexpr double ROUNDING_M = 1e-9;

    // place: of the last query. rows: data points near it. beyond: all others were at least this far away, metres.
    struct alignas(64) Known {
        double place[3] = {0, 0, 0}, beyond = 0;
        uint64_t tree = 0;
        size_t count = 0;
        std::array<int32_t, KEPT> rows{};
    };

    std::vector<Known> known;
};
