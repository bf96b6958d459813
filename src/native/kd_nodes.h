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
    template <int DIMENSIONS, typename Coordinate>
    void build(size_t count, size_t leaf, const Coordinate &value) {
        order.resize(count);
        std::iota(order.begin(), order.end(), 0);
        keys.resize(count);
        if (count) split<DIMENSIONS>(0, count, leaf, value);
        keys = {};
    }

  private:
    using Limits = std::numeric_limits<Value>;
    static constexpr Value GREATEST = Limits::has_infinity ? Limits::infinity() : Limits::max();
    static constexpr Value LEAST = Limits::has_infinity ? -Limits::infinity() : Limits::min();

    // A row and its coordinate along the axis of a split.
    struct Key {
        Value value;
        size_t row;
    };

    template <int DIMENSIONS, typename Coordinate>
    size_t split(size_t first, size_t last, size_t leaf, const Coordinate &value) {
        const size_t here = nodes.size();
        nodes.push_back({first, last, -1, 0, 0, 0});
        if (last - first <= leaf) return here;
        const int axis = widest_axis<DIMENSIONS>(first, last, value);
        if (axis < 0) return here;
        const size_t middle = (first + last) / 2;
        const auto at = [&](size_t i) { return keys.begin() + std::ptrdiff_t(i); };
        for (size_t i = first; i < last; ++i) keys[i] = {value(order[i], axis), order[i]};
        std::nth_element(at(first), at(middle), at(last), [](const Key &i, const Key &j) { return i.value < j.value; });
        for (size_t i = first; i < last; ++i) order[i] = keys[i].row;
        Value low = LEAST;
        for (size_t i = first; i < middle; ++i) low = std::max(low, keys[i].value);
        const Value high = keys[middle].value;
        split<DIMENSIONS>(first, middle, leaf, value);
        const size_t second = split<DIMENSIONS>(middle, last, leaf, value);
        nodes[here].axis = axis;
        nodes[here].low = low;
        nodes[here].high = high;
        nodes[here].second = second;
        return here;
    }

    // The axis along which the rows order[first] to order[last − 1] extend farthest; −1: they are equal.
    template <int DIMENSIONS, typename Coordinate>
    int widest_axis(size_t first, size_t last, const Coordinate &value) const {
        Value least[DIMENSIONS], most[DIMENSIONS], widest = 0;
        std::fill_n(least, DIMENSIONS, GREATEST);
        std::fill_n(most, DIMENSIONS, LEAST);
        for (size_t i = first; i < last; ++i)
            for (int d = 0; d < DIMENSIONS; ++d) {
                const Value here = value(order[i], d);
                least[d] = std::min(least[d], here);
                most[d] = std::max(most[d], here);
            }
        int axis = -1;
        for (int d = 0; d < DIMENSIONS; ++d)
            if (most[d] - least[d] > widest) widest = most[d] - least[d], axis = d;
        return axis;
    }

    std::vector<Key> keys;
};
