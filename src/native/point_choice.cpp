// Chooses lattice points for the points of a frame, for codecs/bodycast/point_choice.py, which defines the results.
//
//     candidates of each point, errors, costs of cells ─► points change cells ─► cells open for several ─► choices

#include <algorithm>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <vector>

#include "key_order.h"
#include "octree_surface.h"
#include "point_moves.h"

namespace {

using point_moves::Numbers;

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
    {
        nb::gil_scoped_release release;
        for (int round = 0; round < rounds; ++round) {
            const bool moved = choice.change_points();
            if (!choice.open_cells() && !moved) break;
        }
    }
    Fresh<int64_t> result(n);
    for (size_t i = 0; i < n; ++i) result.data[i] = choice.chosen()[i];
    return result.give({n});
}

constexpr int FINE_BITS = point_moves::FINE_BITS;
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
    if (k > std::numeric_limits<uint32_t>::max()) throw std::invalid_argument("lattice_candidates: too many points");
    starts.data[n] = int64_t(k);
    Fresh<int64_t> point(k), cells(3 * k), squares(k), cell_of(k);
    std::vector<KeyOfRow> sorted(k);
    for (size_t j = 0; j < k; ++j) {
        const Candidate &own = found[j];
        point.data[j] = own.point, squares.data[j] = own.square;
        std::copy(own.cell.begin(), own.cell.end(), cells.data.get() + 3 * j);
        sorted[j] = {point_octree::morton_code(own.cell[0], own.cell[1], own.cell[2]), uint32_t(j)};
    }
    sort_keys(sorted);
    std::vector<int64_t> firsts;
    for (size_t j = 0; j < k; ++j) {
        if (!j || sorted[j].key != sorted[j - 1].key) firsts.push_back(sorted[j].row);
        cell_of.data[sorted[j].row] = int64_t(firsts.size()) - 1;
    }
    Fresh<int64_t> first(firsts.size());
    std::copy(firsts.begin(), firsts.end(), first.data.get());
    return nb::make_tuple(starts.give({n + 1}), point.give({k}), cells.give({k, 3}), squares.give({k}), cell_of.give({k}),
                          first.give({firsts.size()}), nearest.give({n}));
}

constexpr int64_t CLASSES = 64, CLASSES_PER_DEVIATION = 8, PRIOR_COUNT = 2, SUBUNIT = UNIT >> point_octree::SUBUNIT_BITS;

// The distance of a place from the tangent plane of a sample, as _distances.
int64_t distance_from(const int64_t *place, const int64_t *sample, const int64_t *normal) {
    int64_t sum = 0;
    for (size_t d = 0; d < 3; ++d) sum += (place[d] - sample[d] * SUBUNIT) * normal[d];
    return sum >> point_moves::NORMAL_BITS;
}

// _classes: (classes of cells (c), their width). points (n, 3) with samples (n); candidates: point (k), cells (k, 3); first (c): of
// the candidates of each cell; sampled (m, 3): samples.
nb::tuple cell_classes(Numbers points, Rows samples, Rows point, Numbers cells, Rows first, Numbers sampled, Numbers normals,
                       Numbers neighbours) {
    const size_t n = samples.shape(0), k = point.shape(0), m = sampled.shape(0), count = first.shape(0);
    point_moves::require_shapes(points, samples, normals, neighbours, 1);
    bool good = sampled.shape(1) == 3 && normals.shape(0) == m && cells.shape(0) == k && cells.shape(1) == 3;
    for (size_t j = 0; good && j < k; ++j) good = point.data()[j] >= 0 && size_t(point.data()[j]) < n;
    for (size_t c = 0; good && c < count; ++c) good = first.data()[c] >= 0 && size_t(first.data()[c]) < k;
    if (!good) throw std::invalid_argument("cell_classes: shapes differ, or a row is not there");
    const auto distance = [&](const int64_t *place, int64_t s) {
        return distance_from(place, sampled.data() + 3 * s, normals.data() + 3 * s);
    };
    std::vector<int64_t> distances(n), total(m, 0), members(m, 0), offsets(m);
    int64_t known = 0;
    for (size_t i = 0; i < n; ++i) {
        const int64_t s = samples.data()[i];
        if (s < 0) continue;
        distances[i] = distance(points.data() + 3 * i, s);
        total[size_t(s)] += distances[i];
        ++members[size_t(s)];
        ++known;
    }
    for (size_t s = 0; s < m; ++s) {
        int64_t sum = total[s], points_around = members[s] + PRIOR_COUNT;
        for (size_t j = 0; j < neighbours.shape(1); ++j) {
            const size_t other = size_t(neighbours.data()[s * neighbours.shape(1) + j]);
            sum += total[other], points_around += members[other];
        }
        offsets[s] = floor_quotient(sum, points_around);
    }
    int64_t away = 0;
    for (size_t i = 0; i < n; ++i)
        if (samples.data()[i] >= 0) away += std::abs(distances[i] - offsets[size_t(samples.data()[i])]);
    const int64_t width = std::max<int64_t>(int64_t(double(away) / double(std::max<int64_t>(known, 1))) / CLASSES_PER_DEVIATION, 1);
    Fresh<int64_t> classes(count);
    for (size_t c = 0; c < count; ++c) {
        const size_t candidate = size_t(first.data()[c]);
        const int64_t s = samples.data()[point.data()[candidate]];
        classes.data[c] = CLASSES;
        if (s < 0) continue;
        int64_t place[3];
        for (size_t d = 0; d < 3; ++d) place[d] = cells.data()[3 * candidate + d] * UNIT;
        classes.data[c] = std::min(std::abs(distance(place, s) - offsets[size_t(s)]) / width, CLASSES - 1);
    }
    return nb::make_tuple(classes.give({count}), width);
}

// The points of a frame with a choice, the lattice points that are used, and the samples near both, as _errors has them.
struct ChoicesOfPoints {
    Numbers points;
    Rows starts;
    Numbers cells;
    Rows squares, samples, own;
    Numbers used;
    Rows sample_of_used;
};

// _errors: squared distances of points from their candidates as they are decoded while other lattice points are used.
class CandidateErrors {
public:
    // reach: of points, 2^-FINE_BITS units. stay_cost: of a candidate that does not keep the bound where it moves.
    CandidateErrors(const ChoicesOfPoints &of, const Numbers &normals, const Numbers &neighbours, int64_t spacing, int64_t reach,
                    int64_t stay_cost, int64_t *errors)
        : of_(of), normals_(normals), reach_(reach * reach), stay_cost_(stay_cost), errors_(errors),
          used_(of.sample_of_used.data(), of.sample_of_used.shape(0), normals.shape(0)),
          near_(used_, of.used, normals, neighbours, spacing), around_(of.used, normals, neighbours, spacing) {}

    void find() {
        const size_t n = of_.samples.shape(0), m = normals_.shape(0);
        point_moves::PointsOfSamples points(of_.samples.data(), n, m);
        for (size_t s = 0; s < m; ++s) {
            const auto first = points.points.begin() + points.first[s], last = points.points.begin() + points.first[s + 1];
            const auto end = std::remove_if(first, last, [&](int32_t i) { return !has_choice(size_t(i)); });
            if (first == end) continue;
            std::sort(first, end, [&](int32_t a, int32_t b) { return own_of(a) < own_of(b); });
            gather(s);
            for (auto i = first; i != end; ++i) {
                if (i == first || own_of(*i) != own_of(i[-1])) take_own(own_of(*i));
                find_errors(size_t(*i), s);
            }
        }
        for (size_t i = 0; i < n; ++i)  // without a sample nothing moves
            if (of_.samples.data()[i] < 0 && has_choice(i))
                std::copy_n(of_.squares.data() + of_.starts.data()[i], candidates(i), errors_ + of_.starts.data()[i]);
    }

private:
    struct MoveOfCell {
        const int64_t *cell;
        int64_t length;
    };

    int64_t candidates(size_t point) const { return of_.starts.data()[point + 1] - of_.starts.data()[point]; }
    bool has_choice(size_t point) const { return candidates(point) > 1; }
    int64_t own_of(int32_t point) const { return of_.own.data()[point]; }

    void gather(size_t sample) {
        sample_ = sample;
        is_near_ = near_.is_usable;
        if (is_near_)
            near_.gather(sample);
        else
            around_.gather(used_, sample);
    }

    // The lattice point that the points that follow have: its move is not compared with itself.
    void take_own(int64_t own) {
        own_ = own;
        known_.clear();
        if (!is_near_) return;
        near_.count_all();
        near_.leave_out(of_.used.data() + 3 * own);
    }

    // The length of the move at a cell. Points of one lattice point share most candidates.
    int64_t move_at(const int64_t *cell) {
        for (const MoveOfCell &known : known_)
            if (std::equal(cell, cell + 3, known.cell)) return known.length;
        known_.push_back({cell, found_move(cell)});
        return known_.back().length;
    }

    int64_t found_move(const int64_t *cell) {
        point_moves::Move move;
        if (is_near_ && near_.move(cell, move)) return move.length;
        if (is_near_) around_.gather(used_, sample_);
        is_near_ = false;
        return around_.move_at(cell, int32_t(own_)).length;
    }

    void find_errors(size_t point, size_t sample) {
        const int64_t *place = of_.points.data() + 3 * point, *normal = normals_.data() + 3 * sample;
        for (int64_t k = of_.starts.data()[point]; k < of_.starts.data()[point + 1]; ++k) {
            const int64_t *cell = of_.cells.data() + 3 * k;
            const int64_t length = move_at(cell);
            int64_t moved = 0;
            for (size_t d = 0; d < 3; ++d) {
                const int64_t apart = cell[d] * UNIT + point_moves::shift_of_move(length, normal[d]) - place[d];
                moved += apart * apart;
            }
            errors_[k] = moved <= reach_ ? moved : of_.squares.data()[k] + (length ? stay_cost_ : 0);
        }
    }

    const ChoicesOfPoints &of_;
    const Numbers &normals_;
    const int64_t reach_, stay_cost_;
    int64_t *errors_;
    point_moves::PointsOfSamples used_;
    point_moves::ShortNeighbourhood near_;
    point_moves::Neighbourhood around_;
    size_t sample_ = 0;
    int64_t own_ = 0;
    bool is_near_ = false;
    std::vector<MoveOfCell> known_;
};

// (k): _errors of points (n, 3) with candidates as lattice_candidates gives them. samples (n): near points. own (n): the row of
// the lattice point of each among those that are used (c, 3), whose samples are sample_of_used (c).
Output<int64_t> candidate_errors(Numbers points, Rows starts, Numbers cells, Rows squares, Rows samples, Rows own, Numbers used,
                                 Rows sample_of_used, Numbers normals, Numbers neighbours, int64_t spacing, int64_t reach,
                                 int64_t stay_cost) {
    const ChoicesOfPoints of{points, starts, cells, squares, samples, own, used, sample_of_used};
    point_moves::require_shapes(points, samples, normals, neighbours, spacing);
    point_moves::require_shapes(used, sample_of_used, normals, neighbours, spacing);
    const size_t n = samples.shape(0), k = squares.shape(0);
    bool good = starts.shape(0) == n + 1 && own.shape(0) == n && cells.shape(0) == k && cells.shape(1) == 3 && starts.data()[0] == 0 &&
                starts.data()[n] == int64_t(k);
    for (size_t i = 0; good && i < n; ++i)
        good = starts.data()[i] <= starts.data()[i + 1] && own.data()[i] >= 0 && size_t(own.data()[i]) < used.shape(0);
    if (!good) throw std::invalid_argument("candidate_errors: shapes differ, or a row is not there");
    Fresh<int64_t> errors(k);
    std::fill_n(errors.data.get(), k, 0);
    {
        nb::gil_scoped_release release;
        CandidateErrors(of, normals, neighbours, spacing, reach, stay_cost, errors.data.get()).find();
    }
    return errors.give({k});
}

}  // namespace

void bind_point_choice(nb::module_ &m) {
    m.def("lattice_candidates", &lattice_candidates);
    m.def("choose_candidates", &choose_candidates);
    m.def("candidate_errors", &candidate_errors);
    m.def("cell_classes", &cell_classes);
}
