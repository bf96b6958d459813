// Nodes of a k-d tree: rows split at the median of their widest axis. `kd_tree.h` and `nearest_others.h` search them.
#pragma once

#include <algorithm>
#include <cstddef>
#include <limits>
#include <numeric>
#include <vector>

template <typename Value>
struct KdNode {
    size_t first, last;  // rows order[first] to order[last − 1]
    int axis = -1;       // axis of the split; −1: leaf
    Value low, high;     // greatest coordinate of the first child along the axis, least of the second
    size_t second;       // the second child; the first child follows its parent
};

template <typename Value>
struct KdNodes {
    std::vector<size_t> order;  // all rows in the order of the leaves
    std::vector<KdNode<Value>> nodes;

    // value(row, axis): a coordinate. leaf: most points of a leaf, unless they are equal.
    template <typename Coordinate>
    void build(size_t count, int dimensions, size_t leaf, const Coordinate &value) {
        order.resize(count);
        std::iota(order.begin(), order.end(), 0);
        if (count) split(0, count, dimensions, leaf, value);
    }

  private:
    using Limits = std::numeric_limits<Value>;
    static constexpr Value GREATEST = Limits::has_infinity ? Limits::infinity() : Limits::max();
    static constexpr Value LEAST = Limits::has_infinity ? -Limits::infinity() : Limits::min();

    template <typename Coordinate>
    size_t split(size_t first, size_t last, int dimensions, size_t leaf, const Coordinate &value) {
        const size_t here = nodes.size();
        nodes.push_back({first, last, -1, 0, 0, 0});
        if (last - first <= leaf) return here;
        Value widest = 0;
        int axis = -1;
        for (int d = 0; d < dimensions; ++d) {
            Value least = GREATEST, most = LEAST;
            for (size_t i = first; i < last; ++i) {
                least = std::min(least, value(order[i], d));
                most = std::max(most, value(order[i], d));
            }
            if (most - least > widest) widest = most - least, axis = d;
        }
        if (axis < 0) return here;
        const size_t middle = (first + last) / 2;
        const auto at = [&](size_t i) { return order.begin() + std::ptrdiff_t(i); };
        std::nth_element(at(first), at(middle), at(last),
                         [&](size_t i, size_t j) { return value(i, axis) < value(j, axis); });
        Value low = LEAST;
        for (size_t i = first; i < middle; ++i) low = std::max(low, value(order[i], axis));
        const Value high = value(order[middle], axis);
        split(first, middle, dimensions, leaf, value);
        const size_t second = split(middle, last, dimensions, leaf, value);
        nodes[here].axis = axis;
        nodes[here].low = low;
        nodes[here].high = high;
        nodes[here].second = second;
        return here;
    }
};
