// Nearest neighbours of each point within a set: a k-d tree over integers, exact; equal distances are sorted by row.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "kd_nodes.h"

class NearestOthers {
public:
    using Place = std::array<int64_t, 3>;

    // points: magnitudes of coordinates below 2^30.
    explicit NearestOthers(const std::vector<Place> &points) {
        tree_.build<3>(points.size(), LEAF, [&](size_t row, int axis) { return points[row][size_t(axis)]; });
        for (size_t row : tree_.order) sorted_.push_back(points[row]);
    }

    // Writes rows (m, COUNT): the nearest other points of each point, nearest first. Needs more than COUNT points.
    template <size_t COUNT>
    void find(int64_t *rows) const {
        for (size_t i = 0; i < tree_.order.size(); ++i) {
            Found<COUNT> found{sorted_[i], int64_t(tree_.order[i]), {}};
            found.best.fill({std::numeric_limits<int64_t>::max(), -1});
            int64_t away[3] = {0, 0, 0};
            visit(0, found, 0, away);
            for (size_t k = 0; k < COUNT; ++k) rows[tree_.order[i] * COUNT + k] = found.best[k].second;
        }
    }

private:
    static constexpr size_t LEAF = 8;  // most points of a leaf

    // Best squared distances of a search so far, with rows, sorted.
    template <size_t COUNT>
    struct Found {
        Place query;
        int64_t own;
        std::array<std::pair<int64_t, int64_t>, COUNT> best;

        void offer(int64_t square, int64_t row) {
            const std::pair<int64_t, int64_t> candidate{square, row};
            if (row == own || candidate >= best.back()) return;
            size_t at = COUNT - 1;
            for (; at && candidate < best[at - 1]; --at) best[at] = best[at - 1];
            best[at] = candidate;
        }
    };

    // box: squared distance of the query from the node's box; away: its distance along each axis.
    template <size_t COUNT>
    void visit(size_t at, Found<COUNT> &found, int64_t box, int64_t *away) const {
        const KdNode<int64_t> &node = tree_.nodes[at];
        if (node.axis < 0) {
            for (size_t i = node.first; i < node.last; ++i) {
                int64_t square = 0;
                for (size_t d = 0; d < 3; ++d) {
                    const int64_t apart = sorted_[i][d] - found.query[d];
                    square += apart * apart;
                }
                found.offer(square, int64_t(tree_.order[i]));
            }
            return;
        }
        const int64_t x = found.query[size_t(node.axis)];
        const bool first_is_nearer = x - node.low < node.high - x;
        visit(first_is_nearer ? at + 1 : node.second, found, box, away);
        const int64_t before = away[node.axis];
        const int64_t now = std::max<int64_t>({0, before, first_is_nearer ? node.high - x : x - node.low});
        const int64_t beyond = box - before * before + now * now;
        if (beyond > found.best.back().first) return;  // not ≥: points at equal distance may have lower rows
        away[node.axis] = now;
        visit(first_is_nearer ? node.second : at + 1, found, beyond, away);
        away[node.axis] = before;
    }

    KdNodes<int64_t> tree_;
    std::vector<Place> sorted_;  // points in leaf order
};
