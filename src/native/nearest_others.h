// The points nearest to each point of a set: a k-d tree over integers, exact, equal distances by row.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <numeric>
#include <utility>
#include <vector>

class NearestOthers {
public:
    using Place = std::array<int64_t, 3>;

    // points: coordinates below 2^30 in magnitude. They must outlive this.
    explicit NearestOthers(const std::vector<Place> &points) : points_(points), order_(points.size()) {
        std::iota(order_.begin(), order_.end(), 0);
        if (!points.empty()) build(0, points.size());
        for (size_t row : order_) sorted_.push_back(points[row]);
    }

    // rows (m, COUNT): the others nearest to each point, nearest first; there must be more than COUNT points.
    template <size_t COUNT>
    void find(int64_t *rows) const {
        for (size_t i = 0; i < order_.size(); ++i) {
            Found<COUNT> found{sorted_[i], int64_t(order_[i]), {}};
            found.best.fill({std::numeric_limits<int64_t>::max(), -1});
            int64_t away[3] = {0, 0, 0};
            visit(0, found, 0, away);
            for (size_t k = 0; k < COUNT; ++k) rows[order_[i] * COUNT + k] = found.best[k].second;
        }
    }

private:
    static constexpr size_t LEAF = 8;  // points of a leaf, at most

    struct Node {
        size_t first, last;  // rows order_[first] to order_[last − 1]
        int axis = -1;       // that the node is split along; −1 for a leaf
        int64_t low, high;   // the greatest coordinate of the first child along the axis, the least of the second
        size_t second;       // the second child; the first follows its parent
    };

    // What a search has found so far: squared distances with rows, in order.
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

    size_t build(size_t first, size_t last) {
        const size_t here = nodes_.size();
        nodes_.push_back({first, last, -1, 0, 0, 0});
        if (last - first <= LEAF) return here;
        int64_t widest = 0;
        int axis = -1;
        for (int d = 0; d < 3; ++d) {
            int64_t least = std::numeric_limits<int64_t>::max(), most = std::numeric_limits<int64_t>::min();
            for (size_t i = first; i < last; ++i) {
                least = std::min(least, points_[order_[i]][size_t(d)]);
                most = std::max(most, points_[order_[i]][size_t(d)]);
            }
            if (most - least > widest) widest = most - least, axis = d;
        }
        if (axis < 0) return here;
        const auto value = [&](size_t row) { return points_[row][size_t(axis)]; };
        const size_t middle = (first + last) / 2;
        std::nth_element(order_.begin() + int64_t(first), order_.begin() + int64_t(middle), order_.begin() + int64_t(last),
                         [&](size_t i, size_t j) { return value(i) < value(j); });
        int64_t low = std::numeric_limits<int64_t>::min();
        for (size_t i = first; i < middle; ++i) low = std::max(low, value(order_[i]));
        const int64_t high = value(order_[middle]);
        build(first, middle);
        const size_t second = build(middle, last);
        nodes_[here].axis = axis;
        nodes_[here].low = low;
        nodes_[here].high = high;
        nodes_[here].second = second;
        return here;
    }

    // box: squared distance of the query from the node's box; away: its distance along each axis.
    template <size_t COUNT>
    void visit(size_t at, Found<COUNT> &found, int64_t box, int64_t *away) const {
        const Node &node = nodes_[at];
        if (node.axis < 0) {
            for (size_t i = node.first; i < node.last; ++i) {
                int64_t square = 0;
                for (size_t d = 0; d < 3; ++d) {
                    const int64_t apart = sorted_[i][d] - found.query[d];
                    square += apart * apart;
                }
                found.offer(square, int64_t(order_[i]));
            }
            return;
        }
        const int64_t x = found.query[size_t(node.axis)];
        const bool first_is_nearer = x - node.low < node.high - x;
        visit(first_is_nearer ? at + 1 : node.second, found, box, away);
        const int64_t before = away[node.axis];
        const int64_t now = std::max<int64_t>({0, before, first_is_nearer ? node.high - x : x - node.low});
        const int64_t beyond = box - before * before + now * now;
        if (beyond > found.best.back().first) return;  // as near ones may have lower rows
        away[node.axis] = now;
        visit(first_is_nearer ? node.second : at + 1, found, beyond, away);
        away[node.axis] = before;
    }

    const std::vector<Place> &points_;
    std::vector<size_t> order_;
    std::vector<Place> sorted_;
    std::vector<Node> nodes_;
};
