// ICP (iterative closest point) of rigid parts against clustered data points, for geometry/icp.py and
// geometry/articulated_icp.py; normals, for geometry/normals.py.
//
//     model points ──nearest of the allowed clusters──► data points ──rigid──► model points, again

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "clustered_points.h"
#include "neighbour_cells.h"

namespace {

constexpr size_t CANDIDATES = 5;  // cached nearest points of a model point, searched while the part moves little
constexpr int SWEEPS = 30;  // most sweeps of Jacobi rotations; five are typical

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

// icp.ClusteredTree: data points; a query matches only within its allowed clusters.
class ClusteredPoints {
public:
    ClusteredPoints(Input<double, 2> points, Input<uint8_t, 1> clusters) : tree_(points, clusters) {}

    // icp.icp_many. points (n, 3): model points, part by part; sizes: of the parts; allowed (n): bit mask of a point's
    // clusters; pivots (parts, 3), NaN for a free part. Returns R (parts, 3, 3), t (parts, 3) and the errors of each part.
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
            const double *pivot = pivots.data() + 3 * p;
            const std::vector<double> found = fit(moved, allowed.data() + first, std::isnan(pivot[0]) ? nullptr : pivot, iterations,
                                                  tolerance, &r.data[9 * p], &t.data[3 * p]);
            nb::list own;
            for (double error : found) own.append(error);
            errors.append(own);
            first += size;
        }
        return nb::make_tuple(r.give({parts, 3, 3}), t.give({parts, 3}), errors);
    }

    // articulated_icp.ArticpTracker._fit_links for links (m), parents first. Updates a (links, 3, 3) and b (links, 3)
    // in place. points (n, 3), allowed (n): of the model, link by link, with first indices starts (links + 1). origins
    // (links, 3): joints in the canonical pose; is_free (links): whether they may move; subtrees (links, links).
    void fit_links(InPlace<double, 3> a, InPlace<double, 2> b, Input<int64_t, 1> links, Input<double, 2> points,
                   Input<int64_t, 1> starts, Input<uint64_t, 1> allowed, Input<double, 2> origins, Input<uint8_t, 1> is_free,
                   Input<uint8_t, 2> subtrees, int iterations, double tolerance) const {
        const size_t count = a.shape(0), n = points.shape(0);
        if (a.shape(1) != 3 || a.shape(2) != 3 || b.shape(0) != count || b.shape(1) != 3 || points.shape(1) != 3 ||
            starts.shape(0) != count + 1 || allowed.shape(0) != n || origins.shape(0) != count || origins.shape(1) != 3 ||
            is_free.shape(0) != count || subtrees.shape(0) != count || subtrees.shape(1) != count || starts.data()[0] != 0 ||
            size_t(starts.data()[count]) != n || !std::is_sorted(starts.data(), starts.data() + count + 1))
            throw std::invalid_argument("ClusteredPoints.fit_links: shapes differ");
        for (size_t i = 0; i < links.shape(0); ++i) {
            const size_t link = size_t(links.data()[i]);
            if (link >= count) throw std::invalid_argument("ClusteredPoints.fit_links: no such link");
            const size_t first = size_t(starts.data()[link]), size = size_t(starts.data()[link + 1]) - first;
            if (!size) continue;
            std::vector<double> moved(3 * size);
            for (size_t p = 0; p < size; ++p) posed(a, b, link, points.data() + 3 * (first + p), &moved[3 * p]);
            double pivot[3], r[9], t[3], turned[9], shifted[3];
            posed(a, b, link, origins.data() + 3 * link, pivot);
            fit(moved, allowed.data() + first, is_free.data()[link] ? nullptr : pivot, iterations, tolerance, r, t);
            for (size_t below = 0; below < count; ++below) {
                if (!subtrees.data()[link * count + below]) continue;
                multiply(r, a.data() + 9 * below, turned);
                std::copy_n(turned, 9, a.data() + 9 * below);
                transform(r, b.data() + 3 * below, shifted);
                for (size_t d = 0; d < 3; ++d) b.data()[3 * below + d] = shifted[d] + t[d];
            }
        }
    }

private:
    static void posed(const InPlace<double, 3> &a, const InPlace<double, 2> &b, size_t link, const double *point, double *out) {
        transform(a.data() + 9 * link, point, out);
        for (size_t d = 0; d < 3; ++d) out[d] += b.data()[3 * link + d];
    }

    // Cached candidates for matching a model point: the nearest points at the time of the last search.
    struct Candidates {
        std::array<double, 3> from;
        double reach = -1;  // distance from `from` to the farthest candidate; other allowed points are farther
        std::array<int32_t, CANDIDATES> numbers;
        size_t count = 0;
    };

    // The allowed point nearest to a place, and its squared distance.
    std::pair<int32_t, double> match(const double *place, uint64_t allowed, Candidates &own, PointTree::Nearest &nearest) const {
        int32_t found = -1;
        double best = PointTree::INFINITE;
        for (size_t i = 0; i < own.count; ++i) {
            const double square = squared_distance(place, tree_.at(own.numbers[i]));
            if (square < best) best = square, found = own.numbers[i];
        }
        // a candidate is nearest while its distance plus the motion since the search is less than `reach`
        if (found >= 0 && std::sqrt(best) + std::sqrt(squared_distance(place, own.from.data())) <
                              (1 - PointTree::ROUNDING) * own.reach)
            return {found, best};
        tree_.search(place, allowed, CANDIDATES, PointTree::INFINITE, nearest);
        std::copy_n(place, 3, own.from.begin());
        own.reach = std::sqrt(nearest.back().first);
        own.count = 0;
        for (const auto &[square, number] : nearest)
            if (number >= 0) own.numbers[own.count++] = number;
        return {nearest[0].second, nearest[0].first};
    }

    // ICP of one part; moves its points. pivot: null for a free part. Returns the mean squared error before each step.
    std::vector<double> fit(std::vector<double> &moved, const uint64_t *allowed, const double *pivot, int iterations,
                            double tolerance, double *r, double *t) const {
        const size_t n = moved.size() / 3;
        std::vector<int32_t> matched(n);
        std::vector<Candidates> candidates(n);
        PointTree::Nearest nearest;
        std::vector<double> errors;
        double last = PointTree::INFINITE;
        const double identity[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
        std::copy_n(identity, 9, r);
        std::fill_n(t, 3, 0.0);
        for (int iteration = 0; iteration < iterations; ++iteration) {
            double sum = 0;
            for (size_t i = 0; i < n; ++i) {
                const auto [number, square] = match(&moved[3 * i], allowed[i], candidates[i], nearest);
                if (number < 0) throw std::invalid_argument("ClusteredPoints.icp: a point has no data to match");
                matched[i] = number;
                sum += square;
            }
            errors.push_back(sum / double(n));
            const double root = std::sqrt(errors.back());
            if (!(last - root >= tolerance)) break;
            last = root;
            step(moved, matched, pivot, r, t);
        }
        return errors;
    }

    // Finds the rigid transform of the points onto their matches, and applies it to the points, R and t.
    void step(std::vector<double> &moved, const std::vector<int32_t> &matched, const double *pivot, double *r, double *t) const {
        const size_t n = matched.size();
        double centre_p[3] = {0, 0, 0}, centre_q[3] = {0, 0, 0}, covariance[9] = {};
        for (size_t i = 0; i < n && !pivot; ++i)
            for (size_t d = 0; d < 3; ++d) {
                centre_p[d] += moved[3 * i + d];
                centre_q[d] += tree_.at(matched[i])[d];
            }
        for (size_t d = 0; d < 3; ++d) {
            centre_p[d] = pivot ? pivot[d] : centre_p[d] / double(n);
            centre_q[d] = pivot ? pivot[d] : centre_q[d] / double(n);
        }
        for (size_t i = 0; i < n; ++i)
            for (size_t j = 0; j < 3; ++j)
                for (size_t k = 0; k < 3; ++k)
                    covariance[3 * j + k] += (moved[3 * i + j] - centre_p[j]) * (tree_.at(matched[i])[k] - centre_q[k]);
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

    const PointTree tree_;
};

// out (3) = surface normal at a place: the direction of least variance of the points around it.
template <class Point>
void normal_at(const double *place, size_t count, const Point &point, double *out) {
    double mean[3] = {0, 0, 0}, sums[9] = {};
    for (size_t i = 0; i < count; ++i)
        for (size_t d = 0; d < 3; ++d) mean[d] += (point(i)[d] - place[d]) / double(count);
    for (size_t i = 0; i < count; ++i) {
        double off[3];
        for (size_t d = 0; d < 3; ++d) off[d] = point(i)[d] - place[d] - mean[d];
        for (int j = 0; j < 3; ++j)
            for (int k = 0; k < 3; ++k) sums[3 * j + k] += off[j] * off[k];
    }
    smallest_eigenvector(sums, out);
}

// normals.estimate: unit normals (n, 3) at places (n, 3), each from its nearest `neighbours` among points (m, 3).
Output<double> surface_normals(Input<double, 2> places, Input<double, 2> points, size_t neighbours) {
    const size_t n = places.shape(0), m = points.shape(0);
    if (places.shape(1) != 3 || points.shape(1) != 3 || !m || neighbours < 1)
        throw std::invalid_argument("surface_normals: shapes differ");
    neighbours = std::min(neighbours, m);
    for (const auto *array : {&places, &points})
        for (size_t i = 0; i < array->size(); ++i)
            if (!std::isfinite(array->data()[i])) throw std::invalid_argument("surface_normals: a coordinate is not finite");
    Fresh<double> out(3 * n);
    const NeighbourCells cells(points.data(), m);
    if (cells.is_fast()) {
        NeighbourCells::Nearest nearest;
        for (size_t i = 0; i < n; ++i) {
            const double *place = places.data() + 3 * i;
            cells.find(place, neighbours, nearest);
            normal_at(place, neighbours, [&](size_t k) { return nearest[k].second.data(); }, &out.data[3 * i]);
        }
        return out.give({n, 3});
    }
    const PointTree tree(points.data(), m);
    PointTree::Nearest nearest;
    for (size_t i = 0; i < n; ++i) {
        const double *place = places.data() + 3 * i;
        tree.search(place, PointTree::ALL, neighbours, PointTree::INFINITE, nearest);
        normal_at(place, neighbours, [&](size_t k) { return tree.at(nearest[k].second); }, &out.data[3 * i]);
    }
    return out.give({n, 3});
}

}  // namespace

void bind_clustered_icp(nb::module_ &m) {
    nb::class_<ClusteredPoints>(m, "ClusteredPoints")
        .def(nb::init<Input<double, 2>, Input<uint8_t, 1>>())
        .def("icp", &ClusteredPoints::icp)
        .def("fit_links", &ClusteredPoints::fit_links, nb::arg().noconvert(), nb::arg().noconvert(), nb::arg(), nb::arg(),
             nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg());
    m.def("surface_normals", &surface_normals);
}
