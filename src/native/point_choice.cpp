// Chooses lattice points for the points of a frame, for codecs/bodycast/point_choice.py, which defines the results.
//
//     candidates of each point, errors, costs of cells ─► points change cells ─► cells open for several ─► choices

#include <algorithm>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <vector>

#include "arrays.h"
#include "octree_surface.h"

namespace {

using Rows = Input<int64_t, 1>;

class Choice {
public:
    // starts (n + 1): point i has candidates starts[i] … starts[i + 1] − 1. cell_of, errors (k): of candidates.
    Choice(const Rows &starts, const Rows &cell_of, const Rows &errors, const Rows &costs, const Rows &chosen)
        : starts_(starts.data()), cell_of_(cell_of.data()), errors_(errors.data()), costs_(costs.data()),
          points_(chosen.shape(0)), cells_(costs.shape(0)), chosen_(chosen.data(), chosen.data() + points_),
          users_(cells_, 0), first_(cells_ + 1, 0), members_(cell_of.shape(0)), point_of_(cell_of.shape(0)) {
        for (size_t i = 0; i < points_; ++i) {
            ++users_[cell(i)];
            for (int64_t k = starts_[i]; k < starts_[i + 1]; ++k) point_of_[size_t(k)] = int32_t(i);
        }
        const size_t candidates = members_.size();
        for (size_t k = 0; k < candidates; ++k) ++first_[size_t(cell_of_[k]) + 1];
        for (size_t c = 0; c < cells_; ++c) first_[c + 1] += first_[c];
        std::vector<int32_t> next(first_.begin(), first_.end() - 1);
        for (size_t k = 0; k < candidates; ++k) members_[size_t(next[size_t(cell_of_[k])]++)] = int32_t(k);
    }

    // Moves each point to its cheapest candidate while the other points stay. Returns whether any point changed.
    bool change_points() {
        bool changed = false;
        for (size_t i = 0; i < points_; ++i) {
            const int64_t own = chosen_[i];
            const int64_t own_cell = cell_of_[own];
            int64_t best = own, least = errors_[own] + (users_[size_t(own_cell)] == 1 ? costs_[own_cell] : 0);
            for (int64_t k = starts_[i]; k < starts_[i + 1]; ++k) {
                const int64_t other = cell_of_[k];
                if (other == own_cell) continue;
                const int64_t total = errors_[k] + (users_[size_t(other)] ? 0 : costs_[other]);
                if (total < least) least = total, best = k;
            }
            if (best == own) continue;
            move(i, best);
            changed = true;
        }
        return changed;
    }

    // Moves all points that gain by it to a cell, if together they gain more than the
    // cell costs. Returns whether any changed.
    bool open_cells() {
        bool changed = false;
        std::vector<int32_t> taken;
        for (size_t c = 0; c < cells_; ++c) {
            if (first_[c + 1] - first_[c] < 2) continue;
            int64_t gain = users_[c] ? 0 : -costs_[c];
            taken.clear();
            for (int32_t at = first_[c]; at < first_[c + 1]; ++at) {
                const int32_t k = members_[size_t(at)];
                const int64_t own = chosen_[size_t(point_of_[size_t(k)])];
                if (own == k) continue;
                const size_t own_cell = size_t(cell_of_[own]);
                const int64_t saved = errors_[own] - errors_[k] + (users_[own_cell] == 1 ? costs_[own_cell] : 0);
                if (saved <= 0) continue;
                gain += saved;
                --users_[own_cell];  // the last point that leaves a cell closes it
                taken.push_back(k);
            }
            for (int32_t k : taken) ++users_[size_t(cell_of_[chosen_[size_t(point_of_[size_t(k)])]])];
            if (gain <= 0 || taken.empty()) continue;
            for (int32_t k : taken) move(size_t(point_of_[size_t(k)]), k);
            changed = true;
        }
        return changed;
    }

    const std::vector<int64_t> &chosen() const { return chosen_; }

private:
    size_t cell(size_t point) const { return size_t(cell_of_[chosen_[point]]); }

    void move(size_t point, int64_t candidate) {
        --users_[cell(point)];
        chosen_[point] = candidate;
        ++users_[cell(point)];
    }

    const int64_t *starts_, *cell_of_, *errors_, *costs_;
    const size_t points_, cells_;
    std::vector<int64_t> chosen_;
    std::vector<int32_t> users_, first_, members_, point_of_;
};

// Candidates (n) of the points after some rounds. chosen (n): initial candidates.
Output<int64_t> choose_candidates(Rows starts, Rows cell_of, Rows errors, Rows costs, Rows chosen, int rounds) {
    const size_t n = chosen.shape(0), k = cell_of.shape(0);
    bool good = starts.shape(0) == n + 1 && errors.shape(0) == k && k < size_t(std::numeric_limits<int32_t>::max());
    for (size_t i = 0; good && i < n; ++i)
        good = starts.data()[i] >= 0 && starts.data()[i] <= chosen.data()[i] && chosen.data()[i] < starts.data()[i + 1] &&
               starts.data()[i + 1] <= int64_t(k);
    for (size_t i = 0; good && i < k; ++i) good = cell_of.data()[i] >= 0 && size_t(cell_of.data()[i]) < costs.shape(0);
    if (!good) throw std::invalid_argument("choose_candidates: shapes differ, or a candidate is not there");
    Choice choice(starts, cell_of, errors, costs, chosen);
    for (int round = 0; round < rounds; ++round) {
        const bool moved = choice.change_points();
        if (!choice.open_cells() && !moved) break;
    }
    Fresh<int64_t> result(n);
    for (size_t i = 0; i < n; ++i) result.data[i] = choice.chosen()[i];
    return result.give({n});
}

constexpr int FINE_BITS = 8;
constexpr int64_t UNIT = 1 << FINE_BITS;

struct Candidate {
    std::array<int64_t, 3> cell;
    int64_t square, point;
};

// Adds the lattice points within reach of a point and within 0 … end − 1 along each axis; at least the nearest.
void add_candidates(const int64_t *place, int64_t point, int64_t reach, int64_t end, std::vector<Candidate> &found) {
    Candidate inside[16];
    int count = 0;
    int64_t most = std::numeric_limits<int64_t>::max();
    for (int parity = 0; parity < 2; ++parity) {
        int64_t cells[3][2], squares[3][2];
        for (int d = 0; d < 3; ++d) {
            const int64_t base = 2 * ((place[d] - parity * UNIT + UNIT) >> (FINE_BITS + 1)) + parity;
            const int64_t away = place[d] - base * UNIT, rest = 2 * UNIT - (away < 0 ? -away : away);
            cells[d][0] = base, cells[d][1] = base + (away < 0 ? -2 : 2);
            squares[d][0] = away * away, squares[d][1] = rest * rest;
        }
        for (int corner = 0; corner < 8; ++corner) {
            const int x = corner & 1, y = corner >> 1 & 1, z = corner >> 2;
            const Candidate own{{cells[0][x], cells[1][y], cells[2][z]}, squares[0][x] + squares[1][y] + squares[2][z], point};
            if (!std::all_of(own.cell.begin(), own.cell.end(), [&](int64_t v) { return v >= 0 && v < end; })) continue;
            inside[count++] = own;
            most = std::min(most, own.square);
        }
    }
    most = std::max(most, reach * reach);
    for (int k = 0; k < count; ++k)
        if (inside[k].square <= most) found.push_back(inside[k]);
}

// Fields starts, point, cells, squares, cell_of, first, nearest of _Choices, for points (n, 3) and an octree of this depth.
nb::tuple lattice_candidates(Input<int64_t, 2> points, int64_t reach, int depth) {
    const size_t n = points.shape(0);
    if (points.shape(1) != 3 || depth < 0 || depth > 20) throw std::invalid_argument("lattice_candidates: shapes differ");
    std::vector<Candidate> found;
    found.reserve(2 * n);
    Fresh<int64_t> starts(n + 1), nearest(n);
    for (size_t i = 0; i < n; ++i) {
        starts.data[i] = int64_t(found.size());
        add_candidates(points.data() + 3 * i, int64_t(i), reach, int64_t(1) << depth, found);
        if (size_t(starts.data[i]) == found.size()) throw std::invalid_argument("lattice_candidates: a point outside the octree");
        const auto is_nearer = [](const Candidate &a, const Candidate &b) { return a.square < b.square; };
        nearest.data[i] = std::min_element(found.begin() + starts.data[i], found.end(), is_nearer) - found.begin();
    }
    const size_t k = found.size();
    starts.data[n] = int64_t(k);
    Fresh<int64_t> point(k), cells(3 * k), squares(k), cell_of(k);
    std::vector<std::pair<uint64_t, int64_t>> sorted(k);
    for (size_t j = 0; j < k; ++j) {
        const Candidate &own = found[j];
        point.data[j] = own.point, squares.data[j] = own.square;
        std::copy(own.cell.begin(), own.cell.end(), cells.data.get() + 3 * j);
        sorted[j] = {point_octree::morton_code(own.cell[0], own.cell[1], own.cell[2]), int64_t(j)};
    }
    std::sort(sorted.begin(), sorted.end());
    std::vector<int64_t> firsts;
    for (size_t j = 0; j < k; ++j) {
        if (!j || sorted[j].first != sorted[j - 1].first) firsts.push_back(sorted[j].second);
        cell_of.data[size_t(sorted[j].second)] = int64_t(firsts.size()) - 1;
    }
    Fresh<int64_t> first(firsts.size());
    std::copy(firsts.begin(), firsts.end(), first.data.get());
    return nb::make_tuple(starts.give({n + 1}), point.give({k}), cells.give({k, 3}), squares.give({k}), cell_of.give({k}),
                          first.give({firsts.size()}), nearest.give({n}));
}

}  // namespace

void bind_point_choice(nb::module_ &m) {
    m.def("lattice_candidates", &lattice_candidates);
    m.def("choose_candidates", &choose_candidates);
}
