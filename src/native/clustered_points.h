// Data points in a k-d tree, for geometry/icp.py and geometry/normals.py. Each node has the clusters of its points, so
// that a query skips nodes without allowed points.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <vector>

#include "algebra3.h"
#include "arrays.h"

class PointTree {
public:
    static constexpr double INFINITE = std::numeric_limits<double>::infinity();
    static constexpr uint64_t ALL = ~uint64_t(0);
    static constexpr double ROUNDING = 1e-12;

    // Points nearest to a place, nearest first: squared distances and indices in tree order.
    using Nearest = std::vector<std::pair<double, int32_t>>;

    // points (n, 3), metres; clusters (n), each below 64.
    PointTree(Input<double, 2> points, Input<uint8_t, 1> clusters) {
        const size_t n = points.shape(0);
        if (points.shape(1) != 3 || clusters.shape(0) != n || !n) throw std::invalid_argument("ClusteredPoints: shapes differ");
        for (size_t i = 0; i < 3 * n; ++i)
            if (!std::isfinite(points.data()[i])) throw std::invalid_argument("ClusteredPoints: a coordinate is not finite");
        for (size_t i = 0; i < n; ++i)
            if (clusters.data()[i] >= 64) throw std::invalid_argument("ClusteredPoints: a cluster beyond 63");
        build(points.data(), n, clusters.data());
    }

    // points (n, 3), finite, of one cluster.
    PointTree(const double *points, size_t n) { build(points, n, nullptr); }

    const double *at(int32_t number) const { return points_[size_t(number)].at.data(); }

    // Finds the up to `wanted` nearest allowed points with squared distances below `limit`; unused entries are at ∞.
    void search(const double *place, uint64_t allowed, size_t wanted, double limit, Nearest &nearest) const {
        nearest.assign(wanted, {limit, -1});
        std::pair<int32_t, double> stack[128];
        int waiting = 0;
        stack[waiting++] = {0, box_distance(nodes_[0], place)};
        while (waiting) {
            auto [number, distance] = stack[--waiting];
            while (distance < nearest.back().first) {
                const Node &node = nodes_[size_t(number)];
                if (node.left < 0) {
                    for (size_t i = node.first; i < node.last; ++i) {
                        const double square = squared_distance(place, points_[i].at.data());
                        if (square >= nearest.back().first || !(points_[i].cluster & allowed)) continue;
                        size_t at = wanted - 1;
                        for (; at && nearest[at - 1].first > square; --at) nearest[at] = nearest[at - 1];
                        nearest[at] = {square, int32_t(i)};
                    }
                    break;
                }
                const Node &one = nodes_[size_t(node.left)], &two = nodes_[size_t(node.right)];
                const double d1 = one.clusters & allowed ? box_distance(one, place) : INFINITE;
                const double d2 = two.clusters & allowed ? box_distance(two, place) : INFINITE;
                const bool first_is_nearer = d1 <= d2;
                const double far = first_is_nearer ? d2 : d1;
                if (far < nearest.back().first) stack[waiting++] = {first_is_nearer ? node.right : node.left, far};
                number = first_is_nearer ? node.left : node.right;
                distance = first_is_nearer ? d1 : d2;
            }
        }
        for (auto &[square, number] : nearest)
            if (number < 0) square = INFINITE;
    }

private:
    static constexpr size_t LEAF = 14;  // most points of a leaf

    struct Point {
        std::array<double, 3> at;
        uint64_t cluster;
    };

    struct Node {
        std::array<double, 3> low, high;
        uint64_t clusters = 0;
        size_t first, last;
        int32_t left = -1, right = -1;
    };

    void build(const double *points, size_t n, const uint8_t *clusters) {
        points_.resize(n);
        for (size_t i = 0; i < n; ++i) {
            std::copy_n(points + 3 * i, 3, points_[i].at.begin());
            points_[i].cluster = uint64_t(1) << (clusters ? clusters[i] : 0);
        }
        nodes_.reserve(4 * (n / LEAF + 1));
        split(0, n);
    }

    int32_t split(size_t first, size_t last) {
        const int32_t own = int32_t(nodes_.size());
        nodes_.emplace_back();
        Node node;
        node.first = first, node.last = last;
        node.low = node.high = points_[first].at;
        for (size_t i = first; i < last; ++i) {
            node.clusters |= points_[i].cluster;
            for (size_t d = 0; d < 3; ++d) {
                node.low[d] = std::min(node.low[d], points_[i].at[d]);
                node.high[d] = std::max(node.high[d], points_[i].at[d]);
            }
        }
        if (last - first > LEAF) {
            size_t axis = 0;
            for (size_t d = 1; d < 3; ++d)
                if (node.high[d] - node.low[d] > node.high[axis] - node.low[axis]) axis = d;
            const size_t middle = (first + last) / 2;
            std::nth_element(points_.begin() + long(first), points_.begin() + long(middle), points_.begin() + long(last),
                             [axis](const Point &a, const Point &b) { return a.at[axis] < b.at[axis]; });
            node.left = split(first, middle);
            node.right = split(middle, last);
        }
        nodes_[size_t(own)] = node;
        return own;
    }

    static double box_distance(const Node &node, const double *place) {
        double sum = 0;
        for (size_t d = 0; d < 3; ++d)
            sum += squared(std::max(0.0, std::max(node.low[d] - place[d], place[d] - node.high[d])));
        return sum;
    }

    std::vector<Point> points_;  // in the order of the leaves: neighbours in space are neighbours here
    std::vector<Node> nodes_;
};
