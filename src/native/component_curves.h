// Curves of many columns from few components (models/model.py, synthesise). If few components have most of the
// frequencies, the inverse DCT of these components costs less than that of all columns:
//
//   components of few frequencies ─basis─► spectrum of columns ─inverse DCT─► curves ──┐
//   all others, heading, place ─inverse DCT─► curves of components ─basis─► curves ────┴─ + ─► curves (frames, columns)
#pragma once

#include <algorithm>
#include <vector>

#include "chunk_symbols.h"

namespace chunks {

constexpr size_t MANY_COLUMNS = 256;  // with fewer columns, the inverse DCT is fast

// The coefficients of a chunk, divided: `few`: of components with at most `frequencies` frequencies; `many`: all others.
struct Division {
    std::vector<size_t> rows, place;  // rows of `many`; index of each row among them
    std::vector<Coefficient> few, many;
    size_t frequencies = 0;

    // False if dividing saves nothing. Costs are in products of half of the frames and all columns.
    bool divide(const std::vector<Coefficient> &all, size_t known, size_t columns) {
        if (columns < MANY_COLUMNS || !known) return false;
        size_t last_row = POSE;
        for (const Coefficient &each : all) last_row = std::max<size_t>(last_row, each.row);
        reach_.assign(last_row + 1, 0);
        for (const Coefficient &each : all) reach_[each.row] = each.frequency + 1;  // `all` is sorted by frequency
        rows_of_.assign(known + 1, 0);
        for (size_t r = POSE; r <= last_row; ++r) ++rows_of_[reach_[r]];
        size_t least = known, beyond = POSE;
        frequencies = known;
        for (size_t f = known; f-- > 0;) {
            beyond += rows_of_[f + 1];
            if (f + 2 * beyond < least) least = f + 2 * beyond, frequencies = f;
        }
        if (frequencies == known) return false;
        rows.clear(), few.clear(), many.clear();
        place.assign(last_row + 1, 0);
        for (size_t r = 0; r <= last_row; ++r)
            if (has_many(r)) place[r] = rows.size(), rows.push_back(r);
        for (const Coefficient &each : all) (has_many(each.row) ? many : few).push_back(each);
        return true;
    }

private:
    bool has_many(size_t row) const { return row < POSE || reach_[row] > frequencies; }

    std::vector<size_t> reach_, rows_of_;  // number of frequencies of each row; number of rows by number of frequencies
};

}  // namespace chunks
