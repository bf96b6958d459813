// Iterative closest points of several rigid parts among clustered data points, for geometry/icp.py; nearest links and
// neighbourhoods of points, for geometry/articulated_icp.py and geometry/normals.py.
//
//     model points ──nearest of the allowed clusters──► data points ──rigid──► model points, again

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

namespace {

constexpr size_t LEAF = 8;  // points of a leaf, at most
constexpr double ROUNDING = 1e-12;
constexpr int SWEEPS = 30;  // of Jacobi rotations, at most; five are usual

// out = the rotation that turns p closest to q, from Σ p qᵀ: the largest eigenvector of Horn's 4 × 4 matrix (1987).
void closest_rotation(const double *s, double *out) {
    const double scale = std::max({std::abs(s[0]), std::abs(s[1]), std::abs(s[2]), std::abs(s[3]), std::abs(s[4]),
                                   std::abs(s[5]), std::abs(s[6]), std::abs(s[7]), std::abs(s[8])});
    double m[4][4] = {
        {s[0] + s[4] + s[8], s[5] - s[7], s[6] - s[2], s[1] - s[3]},
        {s[5] - s[7], s[0] - s[4] - s[8], s[1] + s[3], s[6] + s[2]},
        {s[6] - s[2], s[1] + s[3], s[4] - s[0] - s[8], s[5] + s[7]},
        {s[1] - s[3], s[6] + s[2], s[5] + s[7], s[8] - s[0] - s[4]},
    };
    double v[4][4] = {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}};
    for (int sweep = 0; sweep < SWEEPS; ++sweep) {
        double off = 0;
        for (int i = 0; i < 4; ++i)
            for (int j = i + 1; j < 4; ++j) off = std::max(off, std::abs(m[i][j]));
        if (off <= 1e-18 * scale) break;
        for (int i = 0; i < 4; ++i)
            for (int j = i + 1; j < 4; ++j) {
                if (m[i][j] == 0) continue;
                const double theta = (m[j][j] - m[i][i]) / (2 * m[i][j]);
                const double t = (theta < 0 ? -1 : 1) / (std::abs(theta) + std::sqrt(squared(theta) + 1));
                const double c = 1 / std::sqrt(squared(t) + 1), sine = t * c;
                for (int k = 0; k < 4; ++k) {
                    const double a = m[k][i], b = m[k][j];
                    m[k][i] = c * a - sine * b, m[k][j] = sine * a + c * b;
                }
                for (int k = 0; k < 4; ++k) {
                    const double a = m[i][k], b = m[j][k];
                    m[i][k] = c * a - sine * b, m[j][k] = sine * a + c * b;
                }
                for (int k = 0; k < 4; ++k) {
                    const double a = v[k][i], b = v[k][j];
                    v[k][i] = c * a - sine * b, v[k][j] = sine * a + c * b;
                }
            }
    }
    int best = 0;
    for (int i = 1; i < 4; ++i)
        if (m[i][i] > m[best][best]) best = i;
    const double w = v[0][best], x = v[1][best], y = v[2][best], z = v[3][best];
    const double matrix[9] = {
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
        2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y),
    };
    std::copy_n(matrix, 9, out);
}

// out = the unit eigenvector of the smallest eigenvalue of a symmetric positive matrix: normals.smallest_eigenvectors.
void smallest_eigenvector(const double *covariance, double *out) {
    const double scale = std::max(covariance[0] + covariance[4] + covariance[8], 1e-30);
    double m[9], adjugate[9], square[9];
    for (int i = 0; i < 9; ++i) m[i] = covariance[i] / scale + (i % 4 ? 0 : 1e-6);
    for (int i = 0; i < 3; ++i) cross(m + 3 * ((i + 1) % 3), m + 3 * ((i + 2) % 3), adjugate + 3 * i);
    for (int round = 0; round < 4; ++round) {
        multiply(adjugate, adjugate, square);
        double most = 1e-300;
        for (double value : square) most = std::max(most, std::abs(value));
        for (int i = 0; i < 9; ++i) adjugate[i] = square[i] / most;
    }
    double longest = -1;
    int column = 0;
    for (int j = 0; j < 3; ++j) {
        const double length = squared(adjugate[j]) + squared(adjugate[3 + j]) + squared(adjugate[6 + j]);
        if (length > longest) longest = length, column = j;
    }
    const double length = std::max(std::sqrt(longest), 1e-300);
    for (int d = 0; d < 3; ++d) out[d] = adjugate[3 * d + column] / length;
}

// Data points in a k-d tree. Each node knows the clusters of its points, so that a query skips what it does not allow.
class ClusteredPoints {
public:
    // points (n, 3), metres; clusters (n), below 64.
    ClusteredPoints(Input<double, 2> points, Input<uint8_t, 1> clusters) {
        const size_t n = points.shape(0);
        if (points.shape(1) != 3 || clusters.shape(0) != n || !n) throw std::invalid_argument("ClusteredPoints: shapes differ");
        points_.resize(n);
        order_.resize(n);
        std::iota(order_.begin(), order_.end(), 0);
        for (size_t i = 0; i < n; ++i) {
            std::copy_n(points.data() + 3 * i, 3, points_[i].begin());
            for (double value : points_[i])
                if (!std::isfinite(value)) throw std::invalid_argument("ClusteredPoints: a coordinate is not finite");
            if (clusters.data()[i] >= 64) throw std::invalid_argument("ClusteredPoints: a cluster beyond 63");
        }
        build(0, n, clusters.data());
        for (size_t row : order_) {
            sorted_.push_back(points_[row]);
            masks_.push_back(uint64_t(1) << clusters.data()[row]);
        }
    }

    // icp.icp_many: model points (n, 3) of parts of these sizes, one after another; allowed (n): the clusters that each is
    // matched within, as bits; pivots (parts, 3), NaN for a free part. Returns R (parts, 3, 3), t (parts, 3) and the errors
    // of each part.
    nb::tuple icp(Input<double, 2> points, Input<uint64_t, 1> allowed, Input<int64_t, 1> sizes, Input<double, 2> pivots,
                  int iterations, double tolerance) const {
        const size_t parts = sizes.shape(0), n = points.shape(0);
        size_t total = 0;
        for (size_t p = 0; p < parts; ++p) total += sizes.data()[p] > 0 ? size_t(sizes.data()[p]) : n + 1;
        if (points.shape(1) != 3 || allowed.shape(0) != n || total != n || pivots.shape(0) != parts || pivots.shape(1) != 3)
            throw std::invalid_argument("ClusteredPoints.icp: shapes differ");
        Fresh<double> r(9 * parts), t(3 * parts);
        nb::list errors;
        for (size_t p = 0, first = 0; p < parts; ++p) {
            const size_t size = size_t(sizes.data()[p]);
            std::vector<double> moved(points.data() + 3 * first, points.data() + 3 * (first + size));
            const std::vector<double> found =
                fit(moved, allowed.data() + first, pivots.data() + 3 * p, iterations, tolerance, &r.data[9 * p], &t.data[3 * p]);
            nb::list own;
            for (double error : found) own.append(error);
            errors.append(own);
            first += size;
        }
        return nb::make_tuple(r.give({parts, 3, 3}), t.give({parts, 3}), errors);
    }

    // normals.estimate: unit normals (n, 3), the direction of least variance of the `neighbours` points nearest to each
    // place (n, 3).
    Output<double> normals(Input<double, 2> places, size_t neighbours) const {
        const size_t n = places.shape(0);
        if (places.shape(1) != 3 || neighbours < 1) throw std::invalid_argument("ClusteredPoints.normals: shapes differ");
        neighbours = std::min(neighbours, sorted_.size());
        Fresh<double> out(3 * n);
        std::vector<std::pair<double, int32_t>> nearest;
        for (size_t i = 0; i < n; ++i) {
            const double *place = places.data() + 3 * i;
            search_many(place, neighbours, nearest);
            double mean[3] = {0, 0, 0};
            for (const auto &[square, row] : nearest)
                for (size_t d = 0; d < 3; ++d) mean[d] += (sorted_[size_t(row)][d] - place[d]) / double(neighbours);
            double sums[9] = {};
            for (const auto &[square, row] : nearest) {
                double off[3];
                for (size_t d = 0; d < 3; ++d) off[d] = sorted_[size_t(row)][d] - place[d] - mean[d];
                for (int j = 0; j < 3; ++j)
                    for (int k = 0; k < 3; ++k) sums[3 * j + k] += off[j] * off[k];
            }
            smallest_eigenvector(sums, &out.data[3 * i]);
        }
        return out.give({n, 3});
    }

private:
    struct Node {
        std::array<double, 3> low, high;
        uint64_t clusters = 0;
        size_t first, last;
        int32_t left = -1, right = -1;
    };

    int32_t build(size_t first, size_t last, const uint8_t *clusters) {
        const int32_t own = int32_t(nodes_.size());
        nodes_.emplace_back();
        Node node;
        node.first = first, node.last = last;
        node.low = node.high = points_[order_[first]];
        for (size_t i = first; i < last; ++i) {
            const size_t row = order_[i];
            node.clusters |= uint64_t(1) << clusters[row];
            for (size_t d = 0; d < 3; ++d) {
                node.low[d] = std::min(node.low[d], points_[row][d]);
                node.high[d] = std::max(node.high[d], points_[row][d]);
            }
        }
        if (last - first > LEAF) {
            size_t axis = 0;
            for (size_t d = 1; d < 3; ++d)
                if (node.high[d] - node.low[d] > node.high[axis] - node.low[axis]) axis = d;
            const size_t middle = (first + last) / 2;
            std::nth_element(order_.begin() + long(first), order_.begin() + long(middle), order_.begin() + long(last),
                             [&](size_t a, size_t b) { return points_[a][axis] < points_[b][axis]; });
            node.left = build(first, middle, clusters);
            node.right = build(middle, last, clusters);
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

    // The nearest allowed point: its number in `sorted_`. `found` and `best` start with a guess and its squared distance.
    // Returns the squared distance of the second nearest.
    double search(const double *place, uint64_t allowed, int32_t &found, double &best) const {
        const size_t guess = size_t(found);
        double second = std::numeric_limits<double>::infinity();
        struct Waiting {
            int32_t node;
            double distance;
        };
        Waiting stack[128];
        int count = 0;
        stack[count++] = {0, box_distance(nodes_[0], place)};
        while (count) {
            const Waiting next = stack[--count];
            if (next.distance >= second) continue;
            const Node &node = nodes_[size_t(next.node)];
            if (node.left < 0) {
                for (size_t i = node.first; i < node.last; ++i) {
                    if (!(masks_[i] & allowed) || i == guess) continue;
                    const double square = squared_distance(place, sorted_[i].data());
                    if (square < best)
                        second = best, best = square, found = int32_t(i);
                    else
                        second = std::min(second, square);
                }
                continue;
            }
            Waiting children[2] = {{node.left, 0}, {node.right, 0}};
            for (Waiting &child : children) {
                const Node &of = nodes_[size_t(child.node)];
                child.distance = of.clusters & allowed ? box_distance(of, place) : std::numeric_limits<double>::infinity();
            }
            if (children[0].distance < children[1].distance) std::swap(children[0], children[1]);
            for (const Waiting &child : children)
                if (child.distance < second) stack[count++] = child;
        }
        return second;
    }

    // The squared distances and numbers in `sorted_` of the nearest points, nearest first.
    void search_many(const double *place, size_t wanted, std::vector<std::pair<double, int32_t>> &nearest) const {
        nearest.assign(wanted, {std::numeric_limits<double>::infinity(), 0});
        std::pair<int32_t, double> stack[128];
        int count = 0;
        stack[count++] = {0, box_distance(nodes_[0], place)};
        while (count) {
            const auto [number, distance] = stack[--count];
            if (distance >= nearest.back().first) continue;
            const Node &node = nodes_[size_t(number)];
            if (node.left < 0) {
                for (size_t i = node.first; i < node.last; ++i) {
                    const double square = squared_distance(place, sorted_[i].data());
                    if (square >= nearest.back().first) continue;
                    size_t at = wanted - 1;
                    for (; at && nearest[at - 1].first > square; --at) nearest[at] = nearest[at - 1];
                    nearest[at] = {square, int32_t(i)};
                }
                continue;
            }
            std::pair<int32_t, double> near{node.left, box_distance(nodes_[size_t(node.left)], place)};
            std::pair<int32_t, double> far{node.right, box_distance(nodes_[size_t(node.right)], place)};
            if (far.second < near.second) std::swap(near, far);
            stack[count++] = far;
            stack[count++] = near;
        }
    }

    // ICP of one part; moves its points. Returns the mean squared error before each step.
    std::vector<double> fit(std::vector<double> &moved, const uint64_t *allowed, const double *pivot, int iterations,
                            double tolerance, double *r, double *t) const {
        const size_t n = moved.size() / 3;
        const bool is_free = std::isnan(pivot[0]);
        std::vector<int32_t> nearest(n, -1);
        std::vector<std::array<double, 3>> searched(n);  // where the nearest point was searched from
        std::vector<double> second(n), errors;           // distance of the second nearest from there
        double last = std::numeric_limits<double>::infinity();
        const double identity[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
        std::copy_n(identity, 9, r);
        std::fill_n(t, 3, 0.0);
        for (int iteration = 0; iteration < iterations; ++iteration) {
            double sum = 0;
            for (size_t i = 0; i < n; ++i) {
                const double *place = &moved[3 * i];
                double best = nearest[i] < 0 ? std::numeric_limits<double>::infinity()
                                             : squared_distance(place, sorted_[size_t(nearest[i])].data());
                // no other point can be nearer while the place has moved by less than the lead of the nearest
                if (nearest[i] < 0 ||
                    std::sqrt(best) + std::sqrt(squared_distance(place, searched[i].data())) >= (1 - ROUNDING) * second[i]) {
                    second[i] = std::sqrt(search(place, allowed[i], nearest[i], best));
                    std::copy_n(place, 3, searched[i].begin());
                }
                if (nearest[i] < 0) throw std::invalid_argument("ClusteredPoints.icp: a point has no data to match");
                sum += best;
            }
            errors.push_back(sum / double(n));
            const double root = std::sqrt(errors.back());
            if (!(last - root >= tolerance)) break;
            last = root;
            step(moved, nearest, is_free ? nullptr : pivot, r, t);
        }
        return errors;
    }

    // The rigid transform of the points onto those they are matched with, applied to them and to R and t.
    void step(std::vector<double> &moved, const std::vector<int32_t> &nearest, const double *pivot, double *r, double *t) const {
        const size_t n = nearest.size();
        double centre_p[3] = {0, 0, 0}, centre_q[3] = {0, 0, 0}, covariance[9] = {};
        for (size_t i = 0; i < n && !pivot; ++i)
            for (size_t d = 0; d < 3; ++d) {
                centre_p[d] += moved[3 * i + d];
                centre_q[d] += sorted_[size_t(nearest[i])][d];
            }
        for (size_t d = 0; d < 3; ++d) {
            centre_p[d] = pivot ? pivot[d] : centre_p[d] / double(n);
            centre_q[d] = pivot ? pivot[d] : centre_q[d] / double(n);
        }
        for (size_t i = 0; i < n; ++i)
            for (size_t j = 0; j < 3; ++j)
                for (size_t k = 0; k < 3; ++k)
                    covariance[3 * j + k] += (moved[3 * i + j] - centre_p[j]) * (sorted_[size_t(nearest[i])][k] - centre_q[k]);
        for (double &value : covariance) value /= double(n);
        double turn[9], turned[9], shift[3], move[3];
        closest_rotation(covariance, turn);
        transform(turn, centre_p, shift);
        for (int d = 0; d < 3; ++d) move[d] = centre_q[d] - shift[d];
        for (size_t i = 0; i < n; ++i) {
            transform(turn, &moved[3 * i], shift);
            for (size_t d = 0; d < 3; ++d) moved[3 * i + d] = shift[d] + move[d];
        }
        multiply(turn, r, turned);
        std::copy_n(turned, 9, r);
        transform(turn, t, shift);
        for (int d = 0; d < 3; ++d) t[d] = shift[d] + move[d];
    }

    std::vector<std::array<double, 3>> points_, sorted_;
    std::vector<uint64_t> masks_;
    std::vector<size_t> order_;
    std::vector<Node> nodes_;
};

// articulated_icp.segment: the link of greatest closeness to each point. points (n, 3); normals (n, 3), or (0, 3); joints
// and axes (links, 3), lengths and radii (links), of the posed cylinders.
Output<int64_t> closest_links(Input<double, 2> points, Input<double, 2> normals, Input<double, 2> joints,
                              Input<double, 2> axes, Input<double, 1> lengths, Input<double, 1> radii) {
    const size_t n = points.shape(0), links = joints.shape(0);
    const bool has_normals = normals.shape(0) > 0;
    if (points.shape(1) != 3 || joints.shape(1) != 3 || axes.shape(1) != 3 || axes.shape(0) != links || !links ||
        lengths.shape(0) != links || radii.shape(0) != links || normals.shape(1) != 3 || (has_normals && normals.shape(0) != n))
        throw std::invalid_argument("closest_links: shapes differ");
    Fresh<int64_t> out(n);
    for (size_t i = 0; i < n; ++i) {
        const double *point = points.data() + 3 * i;
        double best = -1, best_facing = 0;  // regardless of the normal, and of links that it faces away from
        int64_t nearest = 0, facing = 0;
        for (size_t link = 0; link < links; ++link) {
            const double *axis = axes.data() + 3 * link, *joint = joints.data() + 3 * link;
            const double radius = radii.data()[link];
            double offset[3];
            for (int d = 0; d < 3; ++d) offset[d] = point[d] - joint[d];
            const double along = dot(axis, offset), foot = std::clamp(along, 0.0, lengths.data()[link]), beyond = along - foot;
            const double radial = std::sqrt(std::max(dot(offset, offset) - along * along, 0.0));
            const double over = std::max(radial - radius, 0.0), distance = std::sqrt(over * over + beyond * beyond);
            const double close = distance <= 0 ? 1 + std::max(1 - radial / radius, 0.0) : std::exp(-distance / radius);
            if (close > best) best = close, nearest = int64_t(link);
            if (!has_normals || close <= best_facing) continue;
            const double *normal = normals.data() + 3 * i;
            if (dot(offset, normal) - foot * dot(axis, normal) > 0) best_facing = close, facing = int64_t(link);
        }
        out.data[i] = best_facing > 0 ? facing : nearest;
    }
    return out.give({n});
}

}  // namespace

void bind_clustered_icp(nb::module_ &m) {
    nb::class_<ClusteredPoints>(m, "ClusteredPoints")
        .def(nb::init<Input<double, 2>, Input<uint8_t, 1>>())
        .def("icp", &ClusteredPoints::icp)
        .def("normals", &ClusteredPoints::normals);
    m.def("closest_links", &closest_links);
}
