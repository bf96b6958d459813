// Chooses lattice points for the points of a frame, for codecs/bodycast/point_choice.py, which defines the results.
//
//     points ─► candidates, cells ─► classes of the cells' distances from the surface ─► how many points have each class
//     costs of classes, errors of candidates ─► points change cells ─► cells open for several ─► codes of the chosen cells

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <stdexcept>
#include <vector>

#include "key_order.h"
#include "point_moves.h"
#include "rounding.h"
#include "samples_of_points.h"

namespace {

using point_moves::Cell;
using point_moves::FINE_BITS;
using point_octree::NEIGHBOURS;
using point_octree::NOWHERE;
using point_octree::Surface;

constexpr int32_t UNIT = 1 << FINE_BITS;
constexpr int64_t SUBUNIT = UNIT >> point_octree::SUBUNIT_BITS;
constexpr size_t CLASSES = 64;
constexpr int64_t CLASSES_PER_DEVIATION = 8, PRIOR_COUNT = 2;

// The lattice points within reach of points, grouped by the cell that they are.
struct Candidates {
    std::vector<int32_t> starts;           // (n + 1): point i has candidates starts[i] … starts[i + 1] − 1
    std::vector<int32_t> nearest;          // (n): the candidate nearest to each point
    std::vector<Cell> places;              // (k)
    std::vector<int32_t> squares;          // (k): squared distances from the point, 2^-2 FINE_BITS units
    std::vector<int32_t> point, cell_of;   // (k): the point of each; the number of its cell
    std::vector<uint64_t> codes;           // (c): of the distinct cells, in order
    std::vector<int32_t> first, members;   // (c + 1), (k): cell c has candidates members[first[c]] … in their order

    // points: 2^-FINE_BITS units. reach: in that unit. depth: of the octree.
    Candidates(const std::vector<Cell> &points, int64_t reach, int depth)
        : most_(int32_t(std::min<int64_t>(reach * reach, OUTSIDE - 1))), end_(1 << depth) {
        starts.reserve(points.size() + 1);
        nearest.reserve(points.size());
        starts.push_back(0);
        for (size_t i = 0; i < points.size(); ++i) {
            add(points[i], int32_t(i));
            nearest.push_back(int32_t(std::min_element(squares.begin() + starts.back(), squares.end()) - squares.begin()));
            starts.push_back(int32_t(squares.size()));
        }
        group();
    }

    int32_t count(size_t i) const { return starts[i + 1] - starts[i]; }
    const Cell &place_of_cell(size_t c) const { return places[size_t(members[size_t(first[c])])]; }

private:
    static constexpr int32_t OUTSIDE = 1 << 28;  // squared distance of lattice points outside the octree

    // The two coordinates of a parity that are nearest along an axis, and their squared distances.
    struct Axis {
        std::array<int32_t, 2> at, squares;
    };

    Axis axis_of(int32_t place, int32_t parity) const {
        const int32_t base = 2 * ((place - parity * UNIT + UNIT) >> (FINE_BITS + 1)) + parity;
        const int32_t away = place - base * UNIT, rest = 2 * UNIT - std::abs(away);
        const int32_t next = base + (away < 0 ? -2 : 2);
        const auto square = [&](int32_t at, int32_t apart) { return at >= 0 && at < end_ ? apart * apart : OUTSIDE; };
        return {{base, next}, {square(base, away), square(next, rest)}};
    }

    // Adds the lattice points of a point that are within reach and within the octree; at least the nearest.
    void add(const Cell &place, int32_t number) {
        std::array<std::array<Axis, 3>, 2> axes;
        int32_t least = OUTSIDE;
        for (size_t parity = 0; parity < 2; ++parity) {
            int32_t square = 0;
            for (size_t d = 0; d < 3; ++d) {
                axes[parity][d] = axis_of(place[d], int32_t(parity));
                square += std::min(axes[parity][d].squares[0], axes[parity][d].squares[1]);
            }
            least = std::min(least, square);
        }
        if (least >= OUTSIDE) throw std::invalid_argument("PointChoice: a point outside the octree");
        const int32_t most = std::max(most_, least);
        for (const auto &[x, y, z] : axes) {
            std::array<int32_t, 8> sums;
            unsigned within = 0;
            for (unsigned k = 0; k < 8; ++k) {
                sums[k] = x.squares[k & 1] + y.squares[k >> 1 & 1] + z.squares[k >> 2];
                within |= unsigned(sums[k] <= most) << k;
            }
            for (; within; within &= within - 1) {
                const unsigned k = unsigned(lowest_bit(within));
                places.push_back({x.at[k & 1], y.at[k >> 1 & 1], z.at[k >> 2]});
                squares.push_back(sums[k]);
                point.push_back(number);
            }
        }
    }

    void group() {
        const size_t k = places.size();
        if (k > size_t(std::numeric_limits<int32_t>::max())) throw std::invalid_argument("PointChoice: too many points");
        std::vector<KeyOfRow> sorted(k);
        for (size_t j = 0; j < k; ++j) sorted[j] = {point_octree::morton_code(places[j][0], places[j][1], places[j][2]), uint32_t(j)};
        sort_keys(sorted);
        cell_of.resize(k);
        members.resize(k);
        for (size_t j = 0; j < k; ++j) {
            if (!j || sorted[j].key != sorted[j - 1].key) {
                codes.push_back(sorted[j].key);
                first.push_back(int32_t(j));
            }
            members[j] = int32_t(sorted[j].row);
            cell_of[sorted[j].row] = int32_t(codes.size()) - 1;
        }
        first.push_back(int32_t(k));
    }

    const int32_t most_, end_;
};

// _PointsAndCells: which candidate each point has, while points and cells change.
class Choice {
public:
    // errors (k): of candidates; costs (c): of cells.
    Choice(const Candidates &of, const std::vector<int32_t> &errors, const std::vector<int64_t> &costs)
        : of_(of), errors_(errors), costs_(costs), chosen_(of.nearest), users_(of.codes.size(), 0) {
        for (size_t i = 0; i < chosen_.size(); ++i) ++users_[cell(i)];
    }

    // Moves each point to its cheapest candidate while the other points stay. Returns whether any point changed.
    bool change_points() {
        bool changed = false;
        for (size_t i = 0; i < chosen_.size(); ++i) {
            if (of_.count(i) < 2) continue;
            const int32_t own = chosen_[i];
            const size_t own_cell = cell(i);
            int32_t best = own;
            int64_t least = errors_[size_t(own)] + (users_[own_cell] == 1 ? costs_[own_cell] : 0);
            for (int32_t k = of_.starts[i]; k < of_.starts[i + 1]; ++k) {
                const size_t other = size_t(of_.cell_of[size_t(k)]);
                if (other == own_cell) continue;
                const int64_t total = errors_[size_t(k)] + (users_[other] ? 0 : costs_[other]);
                if (total < least) least = total, best = k;
            }
            if (best == own) continue;
            move(i, best);
            changed = true;
        }
        return changed;
    }

    // Moves all points that gain by it to a cell, if together they gain more than the cell costs. Returns whether any
    // changed.
    bool open_cells() {
        bool changed = false;
        std::vector<int32_t> taken;
        for (size_t c = 0; c < users_.size(); ++c) {
            if (of_.first[c + 1] - of_.first[c] < 2) continue;
            int64_t gain = users_[c] ? 0 : -costs_[c];
            taken.clear();
            for (int32_t at = of_.first[c]; at < of_.first[c + 1]; ++at) {
                const int32_t k = of_.members[size_t(at)], own = chosen_[size_t(of_.point[size_t(k)])];
                if (own == k) continue;
                const size_t own_cell = size_t(of_.cell_of[size_t(own)]);
                const int64_t closed = users_[own_cell] == 1 ? costs_[own_cell] : 0;
                const int64_t saved = errors_[size_t(own)] - errors_[size_t(k)] + closed;
                if (saved <= 0) continue;
                gain += saved;
                --users_[own_cell];  // the last point that leaves a cell closes it
                taken.push_back(k);
            }
            for (int32_t k : taken) ++users_[cell(size_t(of_.point[size_t(k)]))];
            if (gain <= 0 || taken.empty()) continue;
            for (int32_t k : taken) move(size_t(of_.point[size_t(k)]), k);
            changed = true;
        }
        return changed;
    }

    // The cell of a point.
    size_t cell(size_t point) const { return size_t(of_.cell_of[size_t(chosen_[point])]); }
    const std::vector<int32_t> &users() const { return users_; }

private:
    void move(size_t point, int32_t candidate) {
        --users_[cell(point)];
        chosen_[point] = candidate;
        ++users_[cell(point)];
    }

    const Candidates &of_;
    const std::vector<int32_t> &errors_;
    const std::vector<int64_t> &costs_;
    std::vector<int32_t> chosen_, users_;
};

// The lattice points that points have before the choice, with the sample near each.
struct UsedPoints {
    std::vector<int32_t> of_point;  // (n): which of them each point has
    std::vector<Cell> cells;
    std::vector<int32_t> samples;
};

// _errors: squared distances of points from their candidates as they are decoded while other lattice points are used.
class CandidateErrors {
public:
    // samples (n): near points. reach: of points, 2^-FINE_BITS units. stay_cost: of a candidate that does not keep the
    // bound where it moves.
    CandidateErrors(const std::vector<Cell> &points, const Candidates &of, const std::vector<int32_t> &samples, const UsedPoints &used,
                    const Surface &surface, int64_t spacing, int64_t reach, int64_t stay_cost, std::vector<int32_t> &errors)
        : points_(points), of_(of), samples_(samples), used_(used), surface_(surface), reach_(reach * reach), stay_cost_(stay_cost),
          errors_(errors), references_(used.samples.data(), used.samples.size(), surface.size()),
          near_(references_, used.cells, surface, spacing), around_(used.cells, surface, spacing) {}

    void find() {
        const size_t n = samples_.size(), m = surface_.size();
        point_moves::PointsOfSamples points(samples_.data(), n, m);
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
            if (samples_[i] < 0 && has_choice(i))
                std::copy_n(of_.squares.begin() + of_.starts[i], of_.count(i), errors_.begin() + of_.starts[i]);
    }

private:
    struct MoveOfCell {
        Cell cell;
        int64_t length;
    };

    bool has_choice(size_t point) const { return of_.count(point) > 1; }
    int32_t own_of(int32_t point) const { return used_.of_point[size_t(point)]; }

    void gather(size_t sample) {
        sample_ = sample;
        is_near_ = near_.is_usable;
        if (is_near_)
            near_.gather(sample);
        else
            around_.gather(references_, sample);
    }

    // The lattice point that the points that follow have: its move is not compared with itself.
    void take_own(int32_t own) {
        own_ = own;
        known_.clear();
        if (!is_near_) return;
        near_.count_all();
        near_.leave_out(used_.cells[size_t(own)]);
    }

    // The length of the move at a cell. Points of one lattice point share most candidates.
    int64_t move_at(const Cell &cell) {
        for (const MoveOfCell &known : known_)
            if (cell == known.cell) return known.length;
        known_.push_back({cell, found_move(cell)});
        return known_.back().length;
    }

    int64_t found_move(const Cell &cell) {
        point_moves::Move move;
        if (is_near_ && near_.move(cell, move)) return move.length;
        if (is_near_) around_.gather(references_, sample_);
        is_near_ = false;
        return around_.move_at(cell, own_).length;
    }

    void find_errors(size_t point, size_t sample) {
        const point_octree::Place &normal = surface_.normal(int32_t(sample));
        for (int32_t k = of_.starts[point]; k < of_.starts[point + 1]; ++k) {
            const Cell &cell = of_.places[size_t(k)];
            const int64_t length = move_at(cell);
            int64_t moved = 0;
            for (size_t d = 0; d < 3; ++d) {
                const int64_t apart = cell[d] * UNIT + point_moves::shift_of_move(length, normal[d]) - points_[point][d];
                moved += apart * apart;
            }
            errors_[size_t(k)] = int32_t(moved <= reach_ ? moved : of_.squares[size_t(k)] + (length ? stay_cost_ : 0));
        }
    }

    const std::vector<Cell> &points_;
    const Candidates &of_;
    const std::vector<int32_t> &samples_;
    const UsedPoints &used_;
    const Surface &surface_;
    const int64_t reach_, stay_cost_;
    std::vector<int32_t> &errors_;
    point_moves::PointsOfSamples references_;
    point_moves::ShortNeighbourhood near_;
    point_moves::Neighbourhood around_;
    size_t sample_ = 0;
    int32_t own_ = 0;
    bool is_near_ = false;
    std::vector<MoveOfCell> known_;
};

template <class Function>
auto without_interpreter(const Function &function) {
    nb::gil_scoped_release release;
    return function();
}

// The choice for a frame. The costs of classes are found between the constructor and `choose`.
class PointChoice {
public:
    // originals (n, 3): metres. step: of the lattice; corner (3): of the octree, in that unit. codes: sorted distinct lattice
    // points; rows (n): which of them is nearest to each point. reach: of points, 2^-FINE_BITS units; near: the largest
    // distance of a lattice point from its sample, subunits.
    PointChoice(Surface &surface, Input<double, 2> originals, double step, Input<int64_t, 1> corner, Input<uint64_t, 1> codes,
                Input<int64_t, 1> rows, int64_t reach, int64_t near)
        : surface_(surface), reach_(reach), points_(fine_places(originals, step, corner)),
          of_(without_interpreter([&] { return Candidates(points_, require_reach(reach), surface.depth()); })),
          samples_(samples_near(codes, rows, near)) {
        find_used();
        find_classes();
    }

    // The width of the classes, 2^-FINE_BITS units; 0 if no point has a sample.
    int64_t width() const { return width_; }

    // How many of the lattice points that points have before the choice are in each class (CLASSES).
    Output<int64_t> frequencies() const {
        Fresh<int64_t> counts(CLASSES);
        std::fill_n(counts.data.get(), CLASSES, 0);
        for (size_t c = 0; c < classes_.size(); ++c)
            if (is_used_[c] && classes_[c] < CLASSES) ++counts.data[classes_[c]];
        return counts.give({CLASSES});
    }

    // (codes, rows): the sorted distinct lattice points of the points after some rounds, and which of them each point has.
    // costs (CLASSES + 1): of a lattice point of each class. spacing: between samples, subunits.
    nb::tuple choose(Input<int64_t, 1> costs, int64_t spacing, int64_t stay_cost, int rounds) const {
        if (costs.shape(0) != CLASSES + 1 || spacing < 1 || spacing > LARGEST_SPACING || stay_cost < 0 || stay_cost > LARGEST_COST)
            throw std::invalid_argument("PointChoice: costs of another shape, or out of range");
        std::vector<int64_t> of_cells(classes_.size());
        for (size_t c = 0; c < of_cells.size(); ++c) of_cells[c] = costs.data()[classes_[c]];
        std::vector<int32_t> errors(of_.places.size(), 0);
        const size_t n = points_.size();
        Fresh<int64_t> rows(n);
        std::vector<uint64_t> codes;
        {
            nb::gil_scoped_release release;
            CandidateErrors(points_, of_, samples_, used_, surface_, spacing, reach_, stay_cost, errors).find();
            Choice choice(of_, errors, of_cells);
            for (int round = 0; round < rounds; ++round) {
                const bool moved = choice.change_points();
                if (!choice.open_cells() && !moved) break;
            }
            std::vector<int64_t> row_of_cell(of_cells.size());
            for (size_t c = 0; c < of_cells.size(); ++c) {
                row_of_cell[c] = int64_t(codes.size());
                if (choice.users()[c]) codes.push_back(of_.codes[c]);
            }
            for (size_t i = 0; i < n; ++i) rows.data[i] = row_of_cell[choice.cell(i)];
        }
        Fresh<int64_t> found(codes.size());
        std::copy(codes.begin(), codes.end(), found.data.get());
        return nb::make_tuple(found.give({codes.size()}), rows.give({n}));
    }

private:
    static constexpr int64_t LARGEST_REACH = 1 << 20, LARGEST_SPACING = 1 << 16, LARGEST_COST = 1 << 29;
    static constexpr double LARGEST_PLACE = 1 << 29;

    static int64_t require_reach(int64_t reach) {
        if (reach < 0 || reach > LARGEST_REACH) throw std::invalid_argument("PointChoice: a reach out of range");
        return reach;
    }

    // Points in 2^-FINE_BITS units from the octree's corner.
    static std::vector<Cell> fine_places(Input<double, 2> originals, double step, Input<int64_t, 1> corner) {
        std::vector<Cell> places(originals.shape(0));
        if (originals.shape(1) != 3 || corner.shape(0) != 3) throw std::invalid_argument("PointChoice: shapes differ");
        for (size_t i = 0; i < places.size(); ++i)
            for (size_t d = 0; d < 3; ++d) {
                const double place = rounded((originals.data()[3 * i + d] / step - double(corner.data()[d])) * UNIT);
                if (!(std::abs(place) < LARGEST_PLACE)) throw std::invalid_argument("PointChoice: a point outside the octree");
                places[i][d] = int32_t(place);
            }
        return places;
    }

    // The sample near the lattice point of each point, NOWHERE if it is farther than `near` subunits.
    std::vector<int32_t> samples_near(Input<uint64_t, 1> codes, Input<int64_t, 1> rows, int64_t near) const {
        const size_t count = codes.shape(0), n = rows.shape(0);
        if (n != points_.size()) throw std::invalid_argument("PointChoice: shapes differ");
        std::vector<int32_t> nearest = without_interpreter([&] { return samples_of_points(surface_, codes.data(), count); }), samples(n);
        for (size_t c = 0; c < count; ++c) {
            if (nearest[c] < 0) continue;
            const Cell cell = point_octree::place_of_code(codes.data()[c]);
            int64_t square = 0;
            for (size_t d = 0; d < 3; ++d) {
                const int64_t apart = (int64_t(cell[d]) << point_octree::SUBUNIT_BITS) - surface_.place(nearest[c])[d];
                square += apart * apart;
            }
            if (square > near * near) nearest[c] = NOWHERE;
        }
        for (size_t i = 0; i < n; ++i) {
            const int64_t row = rows.data()[i];
            if (row < 0 || size_t(row) >= count) throw std::invalid_argument("PointChoice: a row beyond the codes");
            samples[i] = nearest[size_t(row)];
        }
        return samples;
    }

    void find_used() {
        is_used_.assign(of_.codes.size(), 0);
        for (int32_t k : of_.nearest) is_used_[size_t(of_.cell_of[size_t(k)])] = 1;
        std::vector<int32_t> row_of_cell(is_used_.size());
        for (size_t c = 0; c < is_used_.size(); ++c) {
            row_of_cell[c] = int32_t(used_.cells.size());
            if (is_used_[c]) used_.cells.push_back(of_.place_of_cell(c));
        }
        used_.samples.resize(used_.cells.size());
        used_.of_point.resize(points_.size());
        for (size_t i = 0; i < points_.size(); ++i) {
            used_.of_point[i] = row_of_cell[size_t(of_.cell_of[size_t(of_.nearest[i])])];
            used_.samples[size_t(used_.of_point[i])] = samples_[i];
        }
    }

    // The distance of a place, 2^-FINE_BITS units, from the tangent plane of a sample, as _distances.
    int64_t distance(int64_t x, int64_t y, int64_t z, int32_t row) const {
        const point_octree::Place &sample = surface_.place(row), &normal = surface_.normal(row);
        return ((x - sample[0] * SUBUNIT) * normal[0] + (y - sample[1] * SUBUNIT) * normal[1] + (z - sample[2] * SUBUNIT) * normal[2]) >>
               point_octree::NORMAL_BITS;
    }

    // The distances of points with a sample from its tangent plane.
    std::vector<int64_t> distances_of_points() const {
        std::vector<int64_t> distances(points_.size(), 0);
        for (size_t i = 0; i < points_.size(); ++i)
            if (samples_[i] >= 0) distances[i] = distance(points_[i][0], points_[i][1], points_[i][2], samples_[i]);
        return distances;
    }

    // For each sample with points, the mean distance of the points around it.
    std::vector<int64_t> offsets_of_samples(const std::vector<int64_t> &distances) const {
        const size_t m = surface_.size();
        std::vector<int64_t> total(m, 0), offsets(m, 0);
        std::vector<int32_t> count(m, 0);
        for (size_t i = 0; i < points_.size(); ++i) {
            if (samples_[i] < 0) continue;
            total[size_t(samples_[i])] += distances[i];
            ++count[size_t(samples_[i])];
        }
        for (size_t s = 0; s < m; ++s) {
            if (!count[s]) continue;
            const int32_t *around = surface_.around(int32_t(s));
            int64_t sum = total[s], points = count[s] + PRIOR_COUNT;
            for (size_t k = 0; k < NEIGHBOURS; ++k) sum += total[size_t(around[k])], points += count[size_t(around[k])];
            offsets[s] = floor_quotient(sum, points);
        }
        return offsets;
    }

    // _classes of all cells.
    void find_classes() {
        const std::vector<int64_t> distances = distances_of_points(), offsets = offsets_of_samples(distances);
        int64_t away = 0, known = 0;
        for (size_t i = 0; i < points_.size(); ++i) {
            if (samples_[i] < 0) continue;
            away += std::abs(distances[i] - offsets[size_t(samples_[i])]);
            ++known;
        }
        classes_.assign(of_.codes.size(), uint8_t(CLASSES));
        if (!known) return;
        width_ = std::max<int64_t>(int64_t(double(away) / double(known)) / CLASSES_PER_DEVIATION, 1);
        for (size_t c = 0; c < classes_.size(); ++c) {
            const int32_t candidate = of_.members[size_t(of_.first[c])], sample = samples_[size_t(of_.point[size_t(candidate)])];
            if (sample < 0) continue;
            const Cell &cell = of_.places[size_t(candidate)];
            const int64_t apart = distance(int64_t(cell[0]) * UNIT, int64_t(cell[1]) * UNIT, int64_t(cell[2]) * UNIT, sample);
            classes_[c] = uint8_t(std::min<int64_t>(floor_quotient(std::abs(apart - offsets[size_t(sample)]), width_), CLASSES - 1));
        }
    }

    Surface &surface_;
    const int64_t reach_;
    const std::vector<Cell> points_;
    const Candidates of_;
    const std::vector<int32_t> samples_;  // (n): near each point
    UsedPoints used_;
    std::vector<uint8_t> is_used_, classes_;  // of cells
    int64_t width_ = 0;
};

}  // namespace

void bind_point_choice(nb::module_ &m) {
    nb::class_<PointChoice>(m, "PointChoice")
        .def(nb::init<Surface &, Input<double, 2>, double, Input<int64_t, 1>, Input<uint64_t, 1>, Input<int64_t, 1>, int64_t,
                      int64_t>(),
             nb::keep_alive<1, 2>())
        .def_prop_ro("width", &PointChoice::width)
        .def("frequencies", &PointChoice::frequencies)
        .def("choose", &PointChoice::choose);
}
