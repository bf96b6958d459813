// Neighbours of points and of cells of a grid, for geometry/neighbours.py and skinning.py.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <utility>
#include <vector>

#include "algebra3.h"
#include "arrays.h"
#include "kd_nodes.h"

namespace {

// Points in a k-d tree that is searched for several nearest points.
class NearestPoints {
  public:
    using Found = std::vector<std::pair<double, int64_t>>;  // squared distances and rows, nearest first

    // points (count, 3)
    NearestPoints(const double *points, size_t count) {
        tree_.build<3>(count, LEAF, [&](size_t row, int axis) { return points[3 * row + size_t(axis)]; });
        for (size_t row : tree_.order) sorted_.push_back({points[3 * row], points[3 * row + 1], points[3 * row + 2]});
    }

    // The `wanted` points nearest to a place.
    void find(const double *place, size_t wanted, Found &found) const {
        found.assign(wanted, {std::numeric_limits<double>::infinity(), -1});
        double away[3] = {0, 0, 0};
        visit(0, place, found, 0, away);
    }

  private:
    static constexpr size_t LEAF = 12;  // most points of a leaf

    // box: squared distance of the place from the node's box; away: its distance along each axis.
    void visit(size_t at, const double *place, Found &found, double box, double *away) const {
        const KdNode<double> &node = tree_.nodes[at];
        if (node.axis < 0) {
            for (size_t i = node.first; i < node.last; ++i) {
                const double square = squared_distance(place, sorted_[i].data());
                if (square >= found.back().first) continue;
                size_t to = found.size() - 1;
                for (; to && found[to - 1].first > square; --to) found[to] = found[to - 1];
                found[to] = {square, int64_t(tree_.order[i])};
            }
            return;
        }
        const double x = place[node.axis];
        const bool first_is_nearer = x - node.low < node.high - x;
        visit(first_is_nearer ? at + 1 : node.second, place, found, box, away);
        const double before = away[node.axis];
        const double now = std::max({0.0, before, first_is_nearer ? node.high - x : x - node.low});
        const double beyond = box - squared(before) + squared(now);
        if (beyond >= found.back().first) return;
        away[node.axis] = now;
        visit(first_is_nearer ? node.second : at + 1, place, found, beyond, away);
        away[node.axis] = before;
    }

    KdNodes<double> tree_;
    std::vector<std::array<double, 3>> sorted_;  // points in leaf order
};

// neighbours.nearest: distances and rows (n, wanted) of the points (m, 3) nearest to places (n, 3), nearest first.
nb::tuple nearest_points(Input<double, 2> places, Input<double, 2> points, size_t wanted) {
    const size_t n = places.shape(0), m = points.shape(0);
    if (places.shape(1) != 3 || points.shape(1) != 3 || !wanted || wanted > m)
        throw std::invalid_argument("nearest_points: shapes differ");
    const NearestPoints tree(points.data(), m);
    NearestPoints::Found found;
    Fresh<double> distance(n * wanted);
    Fresh<int64_t> row(n * wanted);
    for (size_t i = 0; i < n; ++i) {
        tree.find(places.data() + 3 * i, wanted, found);
        for (size_t k = 0; k < wanted; ++k) {
            if (found[k].second < 0) throw std::invalid_argument("nearest_points: a coordinate is not finite");
            distance.data[i * wanted + k] = std::sqrt(found[k].first);
            row.data[i * wanted + k] = found[k].second;
        }
    }
    return nb::make_tuple(distance.give({n, wanted}), row.give({n, wanted}));
}

// neighbours.groups: the group (n) of each of distinct cells (n, 3), numbered in the order of their first cells; cells are
// connected up to this squared distance.
Output<int64_t> cell_groups(Input<int64_t, 2> cells, int64_t square) {
    using Cell = std::array<int64_t, 3>;
    const size_t n = cells.shape(0);
    if (cells.shape(1) != 3) throw std::invalid_argument("cell_groups: shapes differ");
    const auto cell_at = [&](size_t i) { return Cell{cells.data()[3 * i], cells.data()[3 * i + 1], cells.data()[3 * i + 2]}; };
    std::vector<std::pair<Cell, size_t>> sorted;
    for (size_t i = 0; i < n; ++i) sorted.push_back({cell_at(i), i});
    std::sort(sorted.begin(), sorted.end());
    std::vector<size_t> first(n);  // a cell of the same group, the group's first one in the end
    std::iota(first.begin(), first.end(), 0);
    const auto root = [&](size_t i) {
        while (first[i] != i) i = first[i] = first[first[i]];
        return i;
    };
    const int64_t reach = int64_t(std::sqrt(double(square)));
    for (int64_t dx = 0; dx <= reach; ++dx)
        for (int64_t dy = -reach; dy <= reach; ++dy)
            for (int64_t dz = -reach; dz <= reach; ++dz) {
                if (dx * dx + dy * dy + dz * dz > square || Cell{dx, dy, dz} <= Cell{0, 0, 0}) continue;
                size_t at = 0;  // the shifted cells come in the same order
                for (const auto &[cell, row] : sorted) {
                    const Cell wanted{cell[0] + dx, cell[1] + dy, cell[2] + dz};
                    while (at < n && sorted[at].first < wanted) ++at;
                    if (at == n || sorted[at].first != wanted) continue;
                    const size_t one = root(row), other = root(sorted[at].second);
                    first[std::max(one, other)] = std::min(one, other);
                }
            }
    Fresh<int64_t> group(n);
    int64_t groups = 0;
    for (size_t i = 0; i < n; ++i) {
        const size_t own = root(i);
        group.data[i] = own == i ? groups++ : group.data[own];
    }
    return group.give({n});
}

// Replaces squared distances along a line of a grid, n values `stride` apart, by the least of value + (distance along the
// line)²: the lower envelope of parabolas (Felzenszwalb and Huttenlocher 2012). centres, borders: memory of n + 1 values.
void lower_to_envelope(double *values, size_t n, size_t stride, std::vector<size_t> &centres, std::vector<double> &borders,
                       std::vector<double> &heights) {
    size_t count = 0;
    for (size_t i = 0; i < n; ++i) {
        heights[i] = values[i * stride];
        if (std::isinf(heights[i])) continue;
        double border = -std::numeric_limits<double>::infinity();
        while (count) {
            const size_t last = centres[count - 1];
            border = (heights[i] - heights[last] + double(i * i) - double(last * last)) / (2 * double(i - last));
            if (border > borders[count - 1]) break;
            --count;
        }
        if (!count) border = -std::numeric_limits<double>::infinity();
        centres[count] = i, borders[count++] = border;
    }
    if (!count) return;
    for (size_t i = 0, at = 0; i < n; ++i) {
        while (at + 1 < count && borders[at + 1] < double(i)) ++at;
        const double along = double(i) - double(centres[at]);
        values[i * stride] = heights[centres[at]] + along * along;
    }
}

// neighbours.cell_distances: the distance of each cell of a grid (x, y, z) from the nearest filled one, in cells.
Output<double> cell_distances(Input<bool, 3> filled) {
    const size_t nx = filled.shape(0), ny = filled.shape(1), nz = filled.shape(2), cells = nx * ny * nz;
    Fresh<double> out(cells);
    for (size_t i = 0; i < cells; ++i) out.data[i] = filled.data()[i] ? 0 : std::numeric_limits<double>::infinity();
    const size_t longest = std::max({nx, ny, nz});
    std::vector<size_t> centres(longest + 1);
    std::vector<double> borders(longest + 1), heights(longest);
    const auto along = [&](size_t start, size_t n, size_t stride) {
        lower_to_envelope(&out.data[start], n, stride, centres, borders, heights);
    };
    for (size_t line = 0; line < nx * ny; ++line) along(line * nz, nz, 1);
    for (size_t x = 0; x < nx; ++x)
        for (size_t z = 0; z < nz; ++z) along(x * ny * nz + z, ny, nz);
    for (size_t line = 0; line < ny * nz; ++line) along(line, nx, ny * nz);
    for (size_t i = 0; i < cells; ++i) out.data[i] = std::sqrt(out.data[i]);
    return out.give({nx, ny, nz});
}

// Points in the cells of a grid of this edge or more.
class PointCells {
  public:
    PointCells(const double *points, size_t count, double edge) : edge_(edge) {
        double high[3];
        for (size_t d = 0; d < 3; ++d) low_[d] = high[d] = points[d];
        for (size_t i = 0; i < count; ++i)
            for (size_t d = 0; d < 3; ++d) {
                if (!std::isfinite(points[3 * i + d])) throw std::invalid_argument("a coordinate is not finite");
                low_[d] = std::min(low_[d], points[3 * i + d]), high[d] = std::max(high[d], points[3 * i + d]);
            }
        for (double cells = MOST_CELLS + 1; cells > MOST_CELLS; edge_ *= 1.5) {
            cells = 1;
            for (size_t d = 0; d < 3; ++d) cells *= std::floor((high[d] - low_[d]) / edge_) + 1;
            if (cells <= MOST_CELLS) break;
        }
        for (size_t d = 0; d < 3; ++d) size_[d] = int64_t((high[d] - low_[d]) / edge_) + 1;
        starts_.assign(size_t(size_[0] * size_[1] * size_[2]) + 2, 0);
        for (size_t i = 0; i < count; ++i) ++starts_[cell(points + 3 * i) + 2];
        for (size_t c = 2; c < starts_.size(); ++c) starts_[c] += starts_[c - 1];
        rows_.resize(count);
        for (size_t i = 0; i < count; ++i) rows_[starts_[cell(points + 3 * i) + 1]++] = i;
    }

    // Calls use(row) for all points in the cells around a place.
    template <class Use>
    void around(const double *place, const Use &use) const {
        int64_t first[3], last[3];
        for (size_t d = 0; d < 3; ++d) {
            const int64_t at = along(place, d);
            first[d] = std::max<int64_t>(at - 1, 0), last[d] = std::min(at + 1, size_[d] - 1);
        }
        for (int64_t x = first[0]; x <= last[0]; ++x)
            for (int64_t y = first[1]; y <= last[1]; ++y) {
                const size_t line = size_t((x * size_[1] + y) * size_[2]);
                for (size_t i = starts_[line + size_t(first[2])]; i < starts_[line + size_t(last[2]) + 1]; ++i) use(rows_[i]);
            }
    }

  private:
    static constexpr double MOST_CELLS = 1 << 20;

    int64_t along(const double *place, size_t axis) const {
        return std::clamp(int64_t((place[axis] - low_[axis]) / edge_), int64_t(0), size_[axis] - 1);
    }

    size_t cell(const double *place) const {
        return size_t((along(place, 0) * size_[1] + along(place, 1)) * size_[2] + along(place, 2));
    }

    double low_[3], edge_;
    int64_t size_[3];
    std::vector<size_t> starts_, rows_;  // first point of each cell, z fastest; points by cells
};

// skinning.averaged: means (n, k) of values (n, k) over the neighbourhoods of points (n, 3) with normals (n, 3).
Output<double> neighbourhood_means(Input<double, 2> points, Input<double, 2> normals, Input<double, 2> values, double radius) {
    const size_t n = points.shape(0), k = values.shape(1);
    if (points.shape(1) != 3 || normals.shape(0) != n || normals.shape(1) != 3 || values.shape(0) != n || !(radius > 0))
        throw std::invalid_argument("neighbourhood_means: shapes differ");
    Fresh<double> out(n * k);
    if (!n) return out.give({n, k});
    const PointCells cells(points.data(), n, radius);
    for (size_t i = 0; i < n; ++i) {
        const double *place = points.data() + 3 * i, *normal = normals.data() + 3 * i;
        double *mean = &out.data[i * k], total = 1;
        std::copy_n(values.data() + i * k, k, mean);
        cells.around(place, [&](size_t j) {
            const double share = 1 - squared_distance(place, points.data() + 3 * j) / (radius * radius);
            if (share <= 0 || j == i) return;
            const double weight = share * share * std::max(dot(normal, normals.data() + 3 * j), 0.0);
            const double *value = values.data() + j * k;
            total += weight;
            for (size_t c = 0; c < k; ++c) mean[c] += weight * value[c];
        });
        for (size_t c = 0; c < k; ++c) mean[c] /= total;
    }
    return out.give({n, k});
}

}  // namespace

void bind_neighbours(nb::module_ &m) {
    m.def("nearest_points", &nearest_points);
    m.def("cell_groups", &cell_groups);
    m.def("cell_distances", &cell_distances);
    m.def("neighbourhood_means", &neighbourhood_means);
}
