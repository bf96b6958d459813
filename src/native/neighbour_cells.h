// Nearest points to places on a surface, for normals: a grid with a few points in each cell. Faster than a tree if
// points are evenly spread, like those of a depth camera.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "algebra3.h"

class NeighbourCells {
public:
    // Neighbours of a place, nearest first: squared distances and coordinates.
    using Nearest = std::vector<std::pair<double, std::array<double, 3>>>;

    // points (count, 3), metres, finite.
    NeighbourCells(const double *points, size_t count) {
        std::array<double, 3> high;
        for (size_t d = 0; d < 3; ++d) low_[d] = high[d] = points[d];
        for (size_t i = 0; i < count; ++i)
            for (size_t d = 0; d < 3; ++d) {
                low_[d] = std::min(low_[d], points[3 * i + d]);
                high[d] = std::max(high[d], points[3 * i + d]);
            }
        for (size_t d = 0; d < 3; ++d) extent_[d] = high[d] - low_[d];
        const double widest = std::max({extent_[0], extent_[1], extent_[2]});
        if (!(widest < MOST_EXTENT)) return;
        edge_ = widest > 0 ? widest / FIRST_CELLS : 1;
        fill(points, count);
        for (int round = 0; round < ROUNDS && widest > 0; ++round) {  // on a surface, points in a cell ∝ edge²
            edge_ *= std::sqrt(WANTED / crowding_);
            fill(points, count);
        }
    }

    // Whether searches are fast: most points share their cell with few others.
    bool is_fast() const { return crowding_ < MOST; }

    // Finds the `wanted` points nearest to a place. There must be at least `wanted` points.
    void find(const double *place, size_t wanted, Nearest &nearest) const {
        std::array<int64_t, 3> at;
        for (size_t d = 0; d < 3; ++d) at[d] = cell_of(place[d], d);
        for (int64_t reach = 1;; reach *= 2) {
            nearest.assign(wanted, {std::numeric_limits<double>::infinity(), {}});
            double complete = std::numeric_limits<double>::infinity();  // all points nearer than this are found
            std::array<int64_t, 3> first, last;
            for (size_t d = 0; d < 3; ++d) {
                first[d] = std::max<int64_t>(at[d] - reach, 0), last[d] = std::min(at[d] + reach, size_[d] - 1);
                if (first[d] > 0) complete = std::min(complete, place[d] - (low_[d] + edge_ * double(first[d])));
                if (last[d] < size_[d] - 1) complete = std::min(complete, low_[d] + edge_ * double(last[d] + 1) - place[d]);
            }
            for (int64_t x = first[0]; x <= last[0]; ++x)
                for (int64_t y = first[1]; y <= last[1]; ++y) {
                    const size_t row = size_t(x * size_[1] + y) * size_t(size_[2]);
                    look(place, starts_[row + size_t(first[2])], starts_[row + size_t(last[2]) + 1], nearest);
                }
            // borders of cells are rounded
            if (nearest.back().first <= squared(std::max(0.0, (1 - 1e-9) * complete - 1e-9 * edge_))) return;
        }
    }

private:
    static constexpr double FIRST_CELLS = 64, WANTED = 5, MOST = 40;  // cells along the longest side; points in a cell
    static constexpr double MAX_CELLS = 1 << 19, MOST_EXTENT = 1e100;
    static constexpr int ROUNDS = 2;

    int64_t cell_of(double coordinate, size_t axis) const {
        return int64_t(std::clamp((coordinate - low_[axis]) / edge_, 0.0, double(size_[axis] - 1)));
    }

    // Sorts the points into cells of edge `edge_`; enlarges the cells if there were too many.
    void fill(const double *points, size_t count) {
        for (;; edge_ *= 1.5) {
            double cells = 1;
            for (size_t d = 0; d < 3; ++d) cells *= std::floor(extent_[d] / edge_) + 1;
            if (cells <= MAX_CELLS) break;
        }
        for (size_t d = 0; d < 3; ++d) size_[d] = int64_t(extent_[d] / edge_) + 1;
        std::vector<uint32_t> cell(count);
        starts_.assign(size_t(size_[0] * size_[1] * size_[2]) + 2, 0);
        for (size_t i = 0; i < count; ++i) {
            const double *p = points + 3 * i;
            cell[i] = uint32_t((cell_of(p[0], 0) * size_[1] + cell_of(p[1], 1)) * size_[2] + cell_of(p[2], 2));
            ++starts_[cell[i] + 2];
        }
        double squares = 0;
        for (size_t c = 2; c < starts_.size(); ++c) squares += squared(double(starts_[c])), starts_[c] += starts_[c - 1];
        crowding_ = squares / double(count);
        points_.resize(count);
        for (size_t i = 0; i < count; ++i)
            std::copy_n(points + 3 * i, 3, points_[starts_[cell[i] + 1]++].begin());
    }

    void look(const double *place, size_t first, size_t last, Nearest &nearest) const {
        for (size_t i = first; i < last; ++i) {
            const double square = squared_distance(place, points_[i].data());
            if (square >= nearest.back().first) continue;
            size_t at = nearest.size() - 1;
            for (; at && nearest[at - 1].first > square; --at) nearest[at] = nearest[at - 1];
            nearest[at] = {square, points_[i]};
        }
    }

    std::array<double, 3> low_, extent_;
    double edge_ = 1, crowding_ = std::numeric_limits<double>::infinity();  // edge of a cell; mean number of points in a point's cell
    std::array<int64_t, 3> size_;
    std::vector<size_t> starts_;  // first point of each cell, z fastest
    std::vector<std::array<double, 3>> points_;
};
