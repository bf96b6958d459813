// Chooses neighbours of points, with the bits of stages/lattice.py.

#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "arrays.h"

namespace {

using Near = Input<int64_t, 2>;

void require_points(const Near &near, size_t points) {
    for (size_t i = 0; i < near.size(); ++i)
        if (near.data()[i] < 0 || size_t(near.data()[i]) >= points)
            throw std::invalid_argument("lattice: a candidate is not a point");
}

// lattice._pairs: sums over frames for a point and all its candidates.
struct Pairs {
    const double *some;
    size_t frames, points, count;
    std::vector<double> distances, squares, before;

    void of_point(size_t p, const int64_t *others, double least, double *rigidity, double *likeness) {
        distances.assign(frames * count, 0.0);
        squares.assign(count, 0.0);
        before.assign(3 * count, 0.0);
        std::vector<double> mean(count, 0.0), moved(count, 0.0);
        for (size_t t = 0; t < frames; ++t) {
            const double *pose = some + t * points * 3, *own = pose + 3 * p;
            for (size_t q = 0; q < count; ++q) {
                const double *other = pose + 3 * size_t(others[q]);
                const double apart[3] = {other[0] - own[0], other[1] - own[1], other[2] - own[2]};
                const double length = std::sqrt((apart[0] * apart[0] + apart[1] * apart[1]) + apart[2] * apart[2]);
                distances[t * count + q] = length;
                mean[q] += length;
                double step[3];
                for (int k = 0; k < 3; ++k) {
                    step[k] = apart[k] - before[3 * q + size_t(k)];
                    before[3 * q + size_t(k)] = apart[k];
                }
                if (t) moved[q] += (step[0] * step[0] + step[1] * step[1]) + step[2] * step[2];
            }
        }
        for (size_t q = 0; q < count; ++q) mean[q] /= double(frames);
        for (size_t t = 0; t < frames; ++t)
            for (size_t q = 0; q < count; ++q) {
                const double off = distances[t * count + q] - mean[q];
                squares[q] += off * off;
            }
        for (size_t q = 0; q < count; ++q) {
            rigidity[q] = std::sqrt(squares[q] / double(frames)) + (mean[q] < least ? 1e6 : 1e-6 * mean[q]);
            likeness[q] = frames > 1 ? std::sqrt(moved[q] / double(frames - 1)) : mean[q];
        }
    }
};

nb::tuple lattice_pairs(Input<double, 3> some, Near near, double least) {
    const size_t frames = some.shape(0), points = some.shape(1), count = near.shape(1);
    if (!frames || some.shape(2) != 3 || near.shape(0) != points) throw std::invalid_argument("lattice: shapes differ");
    require_points(near, points);
    Fresh<double> rigidity(points * count), likeness(points * count);
    {
        nb::gil_scoped_release release;
        Pairs pairs{some.data(), frames, points, count, {}, {}, {}};
        for (size_t p = 0; p < points; ++p)
            pairs.of_point(p, near.data() + p * count, least, rigidity.data.get() + p * count, likeness.data.get() + p * count);
    }
    return nb::make_tuple(rigidity.give({points, count}), likeness.give({points, count}));
}

// lattice._tree, for at least one point.
nb::tuple lattice_tree(Near near, Input<double, 2> rigidity, size_t first) {
    const size_t points = near.shape(0), count = near.shape(1);
    if (first >= points || rigidity.shape(0) != points || rigidity.shape(1) != count)
        throw std::invalid_argument("lattice: shapes differ");
    require_points(near, points);
    Fresh<int64_t> order(points), partner(points);
    {
        nb::gil_scoped_release release;
        struct Edge {
            size_t to;
            double value;
        };
        std::vector<std::vector<Edge>> edges(points);
        for (size_t p = 0; p < points; ++p)
            for (size_t i = 0; i < count; ++i) {
                const size_t q = size_t(near.data()[p * count + i]);
                edges[p].push_back({q, rigidity.data()[p * count + i]});
                edges[q].push_back({p, rigidity.data()[p * count + i]});
            }
        std::vector<double> cost(points, std::numeric_limits<double>::infinity());
        std::vector<char> done(points);
        std::fill_n(partner.data.get(), points, 0);
        size_t last = first;
        for (size_t placed = 0; placed < points; ++placed) {
            order.data[placed] = int64_t(last);
            done[last] = 1;
            for (const Edge &edge : edges[last])
                if (!done[edge.to] && edge.value < cost[edge.to]) {
                    cost[edge.to] = edge.value;
                    partner.data[edge.to] = int64_t(last);
                }
            size_t following = points;
            for (size_t p = 0; p < points; ++p)
                if (!done[p] && (following == points || cost[p] < cost[following])) following = p;
            if (following == points) break;
            if (std::isinf(cost[following])) partner.data[following] = int64_t(last);
            last = following;
        }
    }
    return nb::make_tuple(order.give({points}), partner.give({points}));
}

}  // namespace

void bind_lattice_neighbours(nb::module_ &m) {
    m.def("lattice_pairs", &lattice_pairs);
    m.def("lattice_tree", &lattice_tree);
}
