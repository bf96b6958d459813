// A k-d tree over the points of a frame. Colours, if any, are three more coordinates.
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <vector>

#include "algebra3.h"
#include "arrays.h"
#include "kd_nodes.h"

class KdTree {
  public:
    // points (n, 3), metres; colours (n, 3), scaled to metres, or (0, 3): none.
    KdTree(Input<double, 2> points, Input<double, 2> colours)
        : count(points.shape(0)), coloured(colours.shape(0) > 0), dimensions(coloured ? 6 : 3), values(count * dimensions) {
        if (points.shape(1) != 3 || (coloured && (colours.shape(0) != count || colours.shape(1) != 3)))
            throw std::invalid_argument("KdTree: shapes differ: points (n, 3) and colours (n, 3) or (0, 3) are expected");
        for (size_t i = 0; i < count; ++i)
            for (int d = 0; d < 3; ++d) {
                values[i * dimensions + d] = points.data()[3 * i + d];
                if (coloured) values[i * dimensions + 3 + d] = colours.data()[3 * i + d];
            }
        if (coloured)
            tree.build<6>(count, LEAF, [this](size_t row, int axis) { return values[row * 6 + size_t(axis)]; });
        else
            tree.build<3>(count, LEAF, [this](size_t row, int axis) { return values[row * 3 + size_t(axis)]; });
        sorted.resize(count * dimensions);
        for (size_t i = 0; i < count; ++i)
            std::copy_n(&values[tree.order[i] * dimensions], dimensions, &sorted[i * dimensions]);
    }

    const double *point(size_t row) const { return &values[row * dimensions]; }

    // All rows in the order of the leaves: neighbours in space are neighbours in this order.
    const std::vector<size_t> &spatial_order() const { return tree.order; }

    // The nearest row with a squared distance below `square`; −1: none.
    struct Nearest {
        double square;
        int64_t row;

        double limit() const { return square; }
        void offer(double other, int64_t other_row) { square = other, row = other_row; }
    };

    // The COUNT nearest rows with squared distances below a limit, sorted.
    template <size_t COUNT>
    struct Several {
        explicit Several(double limit) { squares.fill(limit); }

        double limit() const { return squares[COUNT - 1]; }
        void offer(double square, int64_t row) {
            count = std::min(count + 1, COUNT);
            size_t at = count - 1;
            for (; at && square < squares[at - 1]; --at) squares[at] = squares[at - 1], rows[at] = rows[at - 1];
            squares[at] = square, rows[at] = row;
        }

        size_t count = 0;
        std::array<double, COUNT> squares;
        std::array<int64_t, COUNT> rows;
    };

    // Offers rows to `found` that are nearer to a query of `dimensions` coordinates than its limit.
    template <class Found>
    void search(const double *query, Found &found) const {
        double offsets[6] = {0, 0, 0, 0, 0, 0};
        if (!count) return;
        if (coloured)
            visit<6>(0, query, found, 0.0, offsets);
        else
            visit<3>(0, query, found, 0.0, offsets);
    }

    // The row nearest to a query, with a squared distance below `limit`; −1: none. Sets `limit` to its squared distance.
    int64_t nearest(const double *query, double &limit) const {
        Nearest found{limit, -1};
        search(query, found);
        limit = found.square;
        return found.row;
    }

    // `nearest`, but faster if row `guess` is near the query; −1: no guess.
    int64_t nearest_from(int64_t guess, const double *query, double &limit) const {
        Nearest found{limit, -1};
        if (guess >= 0)
            if (const double square = squared_distance_from(size_t(guess), query); square < limit) found.offer(square, guess);
        search(query, found);
        limit = found.square;
        return found.row;
    }

    double squared_distance_from(size_t row, const double *query) const {
        return coloured ? squared_distance_in<6>(query, point(row)) : squared_distance_in<3>(query, point(row));
    }

    // SciPy's KDTree.query: (n,) distances and rows; ∞ and `count` if no point is nearer than `limit`.
    nb::tuple query(Input<double, 2> queries, double limit) const {
        if (queries.shape(1) != size_t(dimensions)) throw std::invalid_argument("KdTree.query: shapes differ");
        const size_t n = queries.shape(0);
        Fresh<double> distance(n);
        Fresh<int64_t> row(n);
        for (size_t i = 0; i < n; ++i) {
            double square = squared(limit);
            const int64_t found = nearest(queries.data() + i * dimensions, square);
            distance.data[i] = found < 0 ? std::numeric_limits<double>::infinity() : std::sqrt(square);
            row.data[i] = found < 0 ? int64_t(count) : found;
        }
        return nb::make_tuple(distance.give({n}), row.give({n}));
    }

    // The row nearest to the centre of each cell of a grid, z fastest. low (3,): corner of the grid; size (3,): cells.
    Output<int32_t> grid(Input<double, 1> low, Input<int32_t, 1> size, double cell) const {
        if (coloured || low.shape(0) != 3 || size.shape(0) != 3 || !count || size.data()[0] < 1 ||
            size.data()[1] < 1 || size.data()[2] < 1)
            throw std::invalid_argument("KdTree.grid: shapes differ");
        const size_t nx = size.data()[0], ny = size.data()[1], nz = size.data()[2];
        Fresh<int32_t> rows(nx * ny * nz);
        size_t at = 0;
        for (size_t x = 0; x < nx; ++x)
            for (size_t y = 0; y < ny; ++y)
                for (size_t z = 0; z < nz; ++z, ++at) {
                    const size_t index[3] = {x, y, z};
                    double centre[3], limit = std::numeric_limits<double>::infinity();
                    for (int d = 0; d < 3; ++d) centre[d] = low.data()[d] + cell * (double(index[d]) + 0.5);
                    if (z) {  // the previous cell's row gives a good upper bound
                        const double *guess = point(size_t(rows.data[at - 1]));
                        limit = 0;
                        for (int d = 0; d < 3; ++d) limit += squared(centre[d] - guess[d]);
                    }
                    Nearest found{limit, -1};
                    double offsets[3] = {0, 0, 0};
                    visit<3>(0, centre, found, 0.0, offsets);
                    rows.data[at] = found.row < 0 ? rows.data[at - 1] : int32_t(found.row);
                }
        return rows.give({rows.size});
    }

    const size_t count;
    const bool coloured;
    const int dimensions;
    const uint64_t serial = next_serial();  // differs from that of every other tree, and from 0

  private:
    static uint64_t next_serial() {
        static std::atomic<uint64_t> last{0};
        return ++last;
    }

    static constexpr size_t LEAF = 12;  // most points of a leaf

    template <int DIMENSIONS>
    static double squared_distance_in(const double *query, const double *other) {
        double sum = squared_distance(query, other);
        for (int d = 3; d < DIMENSIONS; ++d) sum += squared(query[d] - other[d]);
        return sum;
    }

    // box_distance: squared distance of the query from the node's box; offsets: its distance along each axis.
    template <int DIMENSIONS, class Found>
    void visit(size_t at, const double *query, Found &found, double box_distance, double *offsets) const {
        const KdNode<double> &node = tree.nodes[at];
        if (node.axis < 0) {
            for (size_t i = node.first; i < node.last; ++i) {
                const double square = squared_distance_in<DIMENSIONS>(query, &sorted[i * DIMENSIONS]);
                if (square < found.limit()) found.offer(square, int64_t(tree.order[i]));
            }
            return;
        }
        const double x = query[node.axis];
        const bool first_is_nearer = x - node.low < node.high - x;
        visit<DIMENSIONS>(first_is_nearer ? at + 1 : node.second, query, found, box_distance, offsets);
        const double away = std::max(0.0, first_is_nearer ? node.high - x : x - node.low), before = offsets[node.axis];
        const double beyond = box_distance - squared(before) + squared(std::max(away, before));
        if (beyond >= found.limit()) return;
        offsets[node.axis] = std::max(away, before);
        visit<DIMENSIONS>(first_is_nearer ? node.second : at + 1, query, found, beyond, offsets);
        offsets[node.axis] = before;
    }

    std::vector<double> values, sorted;  // coordinates in row order, and in leaf order
    KdNodes<double> tree;
};
