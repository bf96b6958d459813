// Matching of a skinned body to points, and the Gauss–Newton iterations on it: what geometry/body_matching.py does in NumPy,
// which defines the result. Sums run in another order there, so that the two agree to rounding, not to the last bit.

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <type_traits>
#include <vector>

#include "arrays.h"

namespace {

using Doubles = std::vector<double>;

template <class Array>
auto copy(const Array &array) {
    return std::vector<std::remove_const_t<typename Array::Scalar>>(array.data(), array.data() + array.size());
}

double squared(double x) { return x * x; }

double dot(const double *u, const double *v) { return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]; }

void cross(const double *u, const double *v, double *out) {
    out[0] = u[1] * v[2] - u[2] * v[1];
    out[1] = u[2] * v[0] - u[0] * v[2];
    out[2] = u[0] * v[1] - u[1] * v[0];
}

// out = m v, of a 3 × 3 matrix by rows.
void turn(const double *m, const double *v, double *out) {
    for (int i = 0; i < 3; ++i) out[i] = dot(m + 3 * i, v);
}

void turn_back(const double *m, const double *v, double *out) {
    for (int i = 0; i < 3; ++i) out[i] = m[i] * v[0] + m[3 + i] * v[1] + m[6 + i] * v[2];
}

// out = p q, or p qᵀ.
void product(const double *p, const double *q, double *out, bool transposed = false) {
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
            double sum = 0;
            for (int k = 0; k < 3; ++k) sum += p[3 * i + k] * (transposed ? q[3 * j + k] : q[3 * k + j]);
            out[3 * i + j] = sum;
        }
}

void exponential(const double *vector, double *out) {
    const double angle = std::sqrt(dot(vector, vector));
    const bool small = angle < 1e-6;
    const double s = small ? 1.0 : std::sin(angle) / angle;
    const double c = small ? 0.5 : (1 - std::cos(angle)) / (angle * angle);
    const double x = vector[0], y = vector[1], z = vector[2];
    const double k[9] = {0, -z, y, z, 0, -x, -y, x, 0};
    double kk[9];
    product(k, k, kk);
    for (int i = 0; i < 9; ++i) out[i] = (i % 4 == 0) + s * k[i] + c * kk[i];
}

void logarithm(const double *m, double *out) {
    const double trace = m[0] + m[4] + m[8];
    const double squares[4] = {1 + trace, 1 - trace + 2 * m[0], 1 - trace + 2 * m[4], 1 - trace + 2 * m[8]};
    const double w[4] = {squares[0], m[7] - m[5], m[2] - m[6], m[3] - m[1]};
    const double x[4] = {w[1], squares[1], m[1] + m[3], m[2] + m[6]};
    const double y[4] = {w[2], x[2], squares[2], m[5] + m[7]};
    const double z[4] = {w[3], x[3], y[3], squares[3]};
    const double *const all[4] = {w, x, y, z};
    const double *best = all[std::max_element(squares, squares + 4) - squares];
    const double norm = std::sqrt(best[0] * best[0] + dot(best + 1, best + 1)) * (best[0] < 0 ? -1 : 1);
    const double q[4] = {best[0] / norm, best[1] / norm, best[2] / norm, best[3] / norm};
    const double sine = std::sqrt(dot(q + 1, q + 1));
    const double factor = sine > 1e-12 ? 2 * std::atan2(sine, q[0]) / sine : 2.0;
    for (int i = 0; i < 3; ++i) out[i] = q[1 + i] * factor;
}

constexpr double PI = 3.14159265358979323846;

double wrapped(double angle) { return angle - 2 * PI * std::nearbyint(angle / (2 * PI)); }

double clamped(double angle, double middle, double half) {
    return middle + std::clamp(wrapped(angle - middle), -half, half);
}

// Rotation about one of the axes.
void about(int axis, double angle, double *out) {
    const int i = (axis + 1) % 3, j = (axis + 2) % 3;
    std::fill_n(out, 9, 0.0);
    out[4 * axis] = 1;
    out[4 * i] = out[4 * j] = std::cos(angle);
    out[3 * j + i] = std::sin(angle);
    out[3 * i + j] = -out[3 * j + i];
}

// Numbers that say which rotations of a link are allowed: those before and after it that make its angles about x, y and
// z, the middle of each angle's range, and half its width.
constexpr size_t LIMIT = 24;
constexpr int SWEEPS = 4;
constexpr double ROUNDING = 1e-9;

// Whether a link's own rotation is beyond its limits; and then the nearest that is not (geometry/joint_limits.py).
bool nearest_allowed(const double *limit, const double *own, double *allowed) {
    const double *before = limit, *after = limit + 9, *middle = limit + 18, *half = limit + 21;
    double m[9], part[9], best = -std::numeric_limits<double>::infinity(), made[9];
    product(before, own, part);
    product(part, after, m);
    double angles[2][3] = {{std::atan2(-m[5], m[8]), std::atan2(m[2], std::hypot(m[0], m[1])), std::atan2(-m[1], m[0])}};
    for (int d = 0; d < 3; ++d) angles[1][d] = PI + (d == 1 ? -1 : 1) * angles[0][d];
    for (const auto &triple : angles) {
        bool inside = true;
        for (int d = 0; d < 3; ++d) inside &= std::abs(wrapped(triple[d] - middle[d])) <= half[d] + ROUNDING;
        if (inside) return false;
    }
    for (auto &triple : angles) {
        double turns[3][9];
        for (int d = 0; d < 3; ++d) about(d, triple[d] = clamped(triple[d], middle[d], half[d]), turns[d]);
        for (int sweep = 0; sweep < SWEEPS; ++sweep)
            for (int d = 0; d < 3; ++d) {
                // the trace of (rotation about d) n is greatest where the whole is nearest to m
                double later[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, n[9];
                for (int other = d + 1; other < 3; ++other) product(later, turns[other], part), std::copy_n(part, 9, later);
                product(later, m, n, true);
                for (int other = 0; other < d; ++other) product(n, turns[other], part), std::copy_n(part, 9, n);
                const int i = (d + 1) % 3, j = (d + 2) % 3;
                const double angle = std::atan2(n[3 * i + j] - n[3 * j + i], n[4 * i] + n[4 * j]);
                about(d, triple[d] = clamped(angle, middle[d], half[d]), turns[d]);
            }
        double whole[9], likeness = 0;
        product(turns[0], turns[1], part);
        product(part, turns[2], whole);
        for (int i = 0; i < 9; ++i) likeness += whole[i] * m[i];
        if (likeness > best) best = likeness, std::copy_n(whole, 9, made);
    }
    // beforeᵀ · made · afterᵀ
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
            part[3 * i + j] = 0;
            for (int k = 0; k < 3; ++k) part[3 * i + j] += before[3 * k + i] * made[3 * k + j];
        }
    product(part, after, allowed, true);
    return true;
}

// Points of a frame, with their colours as three more coordinates where they have them, in a k-d tree.
class Cloud {
  public:
    Cloud(Input<double, 2> points, Input<double, 2> shades)
        : count(points.shape(0)), coloured(shades.shape(0) > 0), width(coloured ? 6 : 3), values(count * width) {
        if (points.shape(1) != 3 || (coloured && (shades.shape(0) != count || shades.shape(1) != 3)))
            throw std::invalid_argument("BodyPoints: shapes differ");
        for (size_t i = 0; i < count; ++i)
            for (int d = 0; d < 3; ++d) {
                values[i * width + d] = points.data()[3 * i + d];
                if (coloured) values[i * width + 3 + d] = shades.data()[3 * i + d];
            }
        order.resize(count);
        std::iota(order.begin(), order.end(), 0);
        if (count) grow(0, count);
        sorted.resize(count * width);
        for (size_t i = 0; i < count; ++i) std::copy_n(&values[order[i] * width], width, &sorted[i * width]);
    }

    const double *point(size_t row) const { return &values[row * width]; }

    // All rows, those of points that lie together together.
    const std::vector<size_t> &together() const { return order; }

    // The row nearest to a place of `width` coordinates, nearer than the square root of `limit`; −1 where none is.
    // `limit` becomes its squared distance.
    int64_t nearest(const double *place, double &limit) const {
        int64_t found = -1;
        double offsets[6] = {0, 0, 0, 0, 0, 0};
        if (count) visit(0, place, limit, found, 0.0, offsets);
        return found;
    }

    // As `nearest`, given a row that is likely to be near, or −1.
    int64_t nearest_from(int64_t guess, const double *place, double &limit) const {
        if (guess >= 0) {
            double sum = 0;
            for (int d = 0; d < width; ++d) sum += squared(place[d] - values[guess * width + d]);
            if (sum < limit)
                limit = sum;
            else
                guess = -1;
        }
        const int64_t found = nearest(place, limit);
        return found < 0 ? guess : found;
    }

    // As SciPy's KDTree: (n,) distances, ∞ where none is nearer than `within`, and rows, `count` there.
    nb::tuple query(Input<double, 2> places, double within) const {
        if (places.shape(1) != size_t(width)) throw std::invalid_argument("BodyPoints.query: shapes differ");
        const size_t n = places.shape(0);
        Fresh<double> distance(n);
        Fresh<int64_t> row(n);
        for (size_t i = 0; i < n; ++i) {
            double limit = squared(within);
            const int64_t found = nearest(places.data() + i * width, limit);
            distance.data[i] = found < 0 ? std::numeric_limits<double>::infinity() : std::sqrt(limit);
            row.data[i] = found < 0 ? int64_t(count) : found;
        }
        return nb::make_tuple(distance.give({n}), row.give({n}));
    }

    // The row nearest to the middle of each cell of a grid, z fastest.
    Output<int32_t> grid(Input<double, 1> low, Input<int32_t, 1> size, double cell) const {
        if (width != 3 || low.shape(0) != 3 || size.shape(0) != 3 || !count || size.data()[0] < 1 ||
            size.data()[1] < 1 || size.data()[2] < 1)
            throw std::invalid_argument("BodyPoints.grid: shapes differ");
        const size_t nx = size.data()[0], ny = size.data()[1], nz = size.data()[2];
        Fresh<int32_t> rows(nx * ny * nz);
        size_t at = 0;
        for (size_t x = 0; x < nx; ++x)
            for (size_t y = 0; y < ny; ++y)
                for (size_t z = 0; z < nz; ++z, ++at) {
                    const size_t index[3] = {x, y, z};
                    double place[3], limit = std::numeric_limits<double>::infinity();
                    for (int d = 0; d < 3; ++d) place[d] = low.data()[d] + cell * (double(index[d]) + 0.5);
                    if (z) {  // the neighbour's row is a good guess
                        const double *guess = point(size_t(rows.data[at - 1]));
                        limit = 0;
                        for (int d = 0; d < 3; ++d) limit += squared(place[d] - guess[d]);
                    }
                    const int64_t found = nearest(place, limit);
                    rows.data[at] = found < 0 ? rows.data[at - 1] : int32_t(found);
                }
        return rows.give({rows.size});
    }

    const size_t count;
    const bool coloured;
    const int width;

  private:
    static constexpr size_t LEAF = 12;

    struct Node {
        size_t first, last;
        int axis = -1;
        double low, high;  // the greatest value of the first child along the axis, the least of the second
        size_t second;     // the first child follows its parent
    };

    size_t grow(size_t first, size_t last) {
        const size_t here = nodes.size();
        nodes.push_back({first, last, -1, 0, 0, 0});
        if (last - first <= LEAF) return here;
        double widest = -1;
        int axis = 0;
        for (int d = 0; d < width; ++d) {
            double least = std::numeric_limits<double>::infinity(), most = -least;
            for (size_t i = first; i < last; ++i) {
                const double value = values[order[i] * width + d];
                least = std::min(least, value);
                most = std::max(most, value);
            }
            if (most - least > widest) widest = most - least, axis = d;
        }
        if (!(widest > 0)) return here;
        const size_t middle = (first + last) / 2;
        std::nth_element(order.begin() + first, order.begin() + middle, order.begin() + last, [&](size_t i, size_t j) {
            return values[i * width + axis] < values[j * width + axis];
        });
        double low = -std::numeric_limits<double>::infinity();
        for (size_t i = first; i < middle; ++i) low = std::max(low, values[order[i] * width + axis]);
        const double high = values[order[middle] * width + axis];
        grow(first, middle);
        const size_t second = grow(middle, last);
        nodes[here].axis = axis;
        nodes[here].low = low;
        nodes[here].high = high;
        nodes[here].second = second;
        return here;
    }

    // least: squared distance of the place from the node's box; offsets: by axes.
    void visit(size_t at, const double *place, double &limit, int64_t &found, double least, double *offsets) const {
        const Node &node = nodes[at];
        if (node.axis < 0) {
            for (size_t i = node.first; i < node.last; ++i) {
                const double *other = &sorted[i * width];
                double sum = squared(place[0] - other[0]) + squared(place[1] - other[1]) + squared(place[2] - other[2]);
                if (sum >= limit) continue;
                for (int d = 3; d < width; ++d) sum += squared(place[d] - other[d]);
                if (sum < limit) limit = sum, found = int64_t(order[i]);
            }
            return;
        }
        const double x = place[node.axis];
        const bool left = x - node.low < node.high - x;
        visit(left ? at + 1 : node.second, place, limit, found, least, offsets);
        const double away = std::max(0.0, left ? node.high - x : x - node.low), before = offsets[node.axis];
        const double beyond = least - squared(before) + squared(std::max(away, before));
        if (beyond >= limit) return;
        offsets[node.axis] = std::max(away, before);
        visit(left ? node.second : at + 1, place, limit, found, beyond, offsets);
        offsets[node.axis] = before;
    }

    Doubles values, sorted;
    std::vector<size_t> order;
    std::vector<Node> nodes;
};

constexpr uint16_t NONE = 0xffff;

// Rows of a template in half the memory: a table of them then stays in the cache.
std::vector<uint16_t> narrow(Input<int32_t, 1> nearest, size_t rows) {
    std::vector<uint16_t> result(nearest.size());
    for (size_t i = 0; i < nearest.size(); ++i) {
        const int32_t row = nearest.data()[i];
        if (row < -1 || row >= int64_t(rows) || row >= NONE)
            throw std::invalid_argument("BodyMatcher: a row beyond the template");
        result[i] = row < 0 ? NONE : uint16_t(row);
    }
    return result;
}

// Symmetric sums of one pair of links that a point may follow: of f fᵀ by shares first², first · second and second², and
// of f times the residual by shares.
struct Sums {
    double square[3][21];
    double right[2][6];
};

// What draws a template row: where it is, the sum of weights, and of weights times how far away targets are.
struct Pull {
    double at[3] = {0, 0, 0}, weight = 0, gap[3] = {0, 0, 0};
    bool is_posed = false;
};

class Body {
  public:
    Body(Input<int64_t, 1> parents, Input<double, 2> origins, Input<double, 1> lengths, Input<double, 2> points, Input<int64_t, 2> links,
         Input<double, 1> weights, Input<double, 2> normals, Input<double, 2> shades, Input<int32_t, 1> nearest,
         Input<double, 2> low, Input<int32_t, 2> size, Input<int64_t, 1> start, double cell, double margin)
        : count(parents.shape(0)), rows(points.shape(0)), coloured(shades.shape(0) > 0), cell(cell), margin(margin),
          parents(copy(parents)), origins(copy(origins)), lengths(copy(lengths)), points(copy(points)), links(copy(links)),
          weights(copy(weights)), normals(copy(normals)), shades(copy(shades)), nearest(narrow(nearest, rows)), low(copy(low)),
          size(copy(size)), start(copy(start)), pair(rows) {
        const bool same = origins.shape(0) == count && lengths.shape(0) == count && links.shape(0) == rows && links.shape(1) == 2 &&
                          weights.shape(0) == rows && normals.shape(0) == rows && low.shape(0) == count &&
                          size.shape(0) == count && start.shape(0) == count && (!coloured || shades.shape(0) == rows);
        const bool three = origins.shape(1) == 3 && points.shape(1) == 3 && normals.shape(1) == 3 &&
                           low.shape(1) == 3 && size.shape(1) == 3 && (!coloured || shades.shape(1) == 3);
        if (!same || !three || !count || !rows) throw std::invalid_argument("BodyMatcher: shapes differ");
        for (size_t l = 0; l < count; ++l) {
            const int32_t *s = &this->size[3 * l];
            if (this->parents[l] >= int64_t(l) || s[0] < 1 || s[1] < 1 || s[2] < 1 || this->start[l] < 0 ||
                uint64_t(this->start[l]) + uint64_t(s[0]) * s[1] * s[2] > this->nearest.size())
                throw std::invalid_argument("BodyMatcher: not a tree, or a table beyond its end");
            filled.push_back(this->nearest[this->start[l]] != NONE);
        }
        for (size_t l = 0; l < count; ++l) enclose(l);
        for (int64_t link : this->links)
            if (link < 0 || link >= int64_t(count)) throw std::invalid_argument("BodyMatcher: a link beyond the body");
        std::vector<int64_t> numbers(count * count, -1);
        for (size_t row = 0; row < rows; ++row) {
            const int64_t key = this->links[2 * row] * int64_t(count) + this->links[2 * row + 1];
            if (numbers[key] < 0) numbers[key] = int64_t(pairs.size()), pairs.push_back(key);
            pair[row] = numbers[key];
        }
    }

    // Gauss–Newton: one step for each row of `steps`, its width, how many of the data's points and how many rows of
    // `some` it looks at; the pose that it ends with. After a step that moves nothing by more than `calm`, others are
    // left out until the width is down to `ease` times its own, if that is more than `fine`.
    nb::tuple solve(const Cloud &cloud, Input<double, 3> rotations, Input<double, 1> root, Input<double, 2> widths,
                    Input<int64_t, 1> some, Input<bool, 1> allowed, Input<double, 3> held, Input<double, 2> strengths,
                    Input<int64_t, 1> limited, Input<double, 2> limits, double beyond, double loose, double pull,
                    double noise, double reach, double calm, double ease, double fine) {
        require(rotations, root, allowed, some);
        require(cloud);
        if (held.shape(0) != count || strengths.shape(0) != 2 || strengths.shape(1) != count || widths.shape(1) != 3)
            throw std::invalid_argument("BodyMatcher.solve: shapes differ");
        if (limits.shape(0) != limited.shape(0) || limits.shape(1) != LIMIT)
            throw std::invalid_argument("BodyMatcher.solve: shapes differ");
        for (size_t k = 0; k < limited.shape(0); ++k)
            if (limited.data()[k] < 0 || limited.data()[k] >= int64_t(count))
                throw std::invalid_argument("BodyMatcher.solve: a link beyond the body");
        const Doubles expected(rotations.data(), rotations.data() + 9 * count);
        const double expected_root[3] = {root.data()[0], root.data()[1], root.data()[2]};
        turns = expected;
        place.assign(expected_root, expected_root + 3);
        transform();
        candidates.clear();
        std::vector<int64_t> found(some.shape(0), -1);
        const size_t unknowns = 3 + 3 * count;
        Doubles h, g, resisted(3 * limited.shape(0));
        size_t since = 0;  // steps since links were chosen anew
        double calm_at = std::numeric_limits<double>::infinity();  // the width of a calm step
        for (size_t step = 0; step < widths.shape(0); ++step) {
            const double width = widths.data()[3 * step];
            if (width > std::max(fine, ease * calm_at)) continue;
            const size_t here = std::min(cloud.count, size_t(widths.data()[3 * step + 1]));
            const size_t looked = std::min(some.shape(0), size_t(widths.data()[3 * step + 2]));
            if (++since > REFRESH && std::isinf(calm_at)) candidates_from(cloud, 0, here, allowed.data()), since = 1;
            candidates_from(cloud, candidates.size() / CANDIDATES, here, allowed.data());
            pulls.assign(rows, Pull{});
            for (size_t i : cloud.together()) {
                if (i >= here) continue;
                int64_t link;
                const int64_t row = match(cloud, i, &candidates[i * CANDIDATES], link);
                if (row >= 0) draw(row, cloud.point(i), width, noise);
            }
            for (size_t k = 0; k < looked; ++k) {
                const int64_t row = some.data()[k];
                double at[6], limit = squared(reach * width);
                seen(cloud, row, at);
                found[k] = cloud.nearest_from(found[k], at, limit);
                if (found[k] >= 0) draw(row, cloud.point(found[k]), width, noise);
            }
            sums.assign(pairs.size(), Sums{});
            for (size_t row = 0; row < rows; ++row)
                if (pulls[row].weight > 0) add(int64_t(row), pulls[row], pull);
            equations(h, g);
            priors(expected, expected_root, held.data(), strengths.data(), loose, h, g);
            for (size_t k = 0; k < limited.shape(0); ++k)
                pull_back(size_t(limited.data()[k]), limits.data() + LIMIT * k, beyond, &resisted[3 * k], h, g);
            if (!solve_symmetric(h, g, unknowns)) throw std::runtime_error("BodyMatcher.solve: no solution");
            calm_at = move(g) < calm ? width : std::numeric_limits<double>::infinity();
        }
        Fresh<double> out(9 * count), out_root(3);
        std::copy(turns.begin(), turns.end(), out.data.get());
        std::copy(place.begin(), place.end(), out_root.data.get());
        return nb::make_tuple(out.give({count, 3, 3}), out_root.give({3}));
    }

    // For each data point the template row and link that explain it, −1 where none may, and how far it is away; for
    // each template row of `some` how far the data point nearest in place and colour is away in place (`within`, where
    // none is nearer); and the mean squares of both distances, with colours, none beyond `most`. solved: this pose
    // and cloud are those of the last call of `solve`, so that the links that points are matched to are known.
    nb::tuple assess(const Cloud &cloud, Input<double, 3> rotations, Input<double, 1> root, Input<int64_t, 1> some,
                     Input<bool, 1> allowed, bool solved, double within, double most) {
        require(rotations, root, allowed, some);
        require(cloud);
        turns.assign(rotations.data(), rotations.data() + 9 * count);
        place.assign(root.data(), root.data() + 3);
        transform();
        if (!solved || candidates.size() != cloud.count * CANDIDATES) {
            candidates.clear();
            candidates_from(cloud, 0, cloud.count, allowed.data());
        }
        const size_t n = cloud.count, k = some.shape(0);
        Fresh<int64_t> row(n), link(n);
        Fresh<double> away(n), gap(k);
        double there = 0, back = 0;
        for (size_t i = 0; i < n; ++i) {
            double y[3] = {0, 0, 0};
            row.data[i] = match(cloud, i, &candidates[i * CANDIDATES], link.data[i]);
            if (row.data[i] >= 0) posed(row.data[i], y);
            const double *x = cloud.point(i);
            double square = squared(x[0] - y[0]) + squared(x[1] - y[1]) + squared(x[2] - y[2]);
            away.data[i] = std::sqrt(square);
            if (cloud.coloured && row.data[i] >= 0)
                for (int d = 0; d < 3; ++d) square += squared(x[3 + d] - shades[3 * row.data[i] + d]);
            there += std::min(square, most * most);
        }
        for (size_t i = 0; i < k; ++i) {
            double at[6], limit = squared(within);
            seen(cloud, some.data()[i], at);
            const int64_t found = cloud.nearest(at, limit);
            gap.data[i] = within;
            if (found >= 0) {
                const double *x = cloud.point(size_t(found));
                gap.data[i] = std::sqrt(squared(x[0] - at[0]) + squared(x[1] - at[1]) + squared(x[2] - at[2]));
            }
            back += std::min(limit, most * most);
        }
        const double cost = there / double(std::max<size_t>(n, 1)) + back / double(std::max<size_t>(k, 1));
        return nb::make_tuple(away.give({n}), row.give({n}), link.give({n}), gap.give({k}), cost);
    }

    // (draws,): mean squared distance of template rows from the nearest points of a cloud without colours, and of points
    // `wanted` from those rows, none beyond `most`, where each draw turns the links of a limb by its own rotations
    // (draws, links of the limb, 3, 3).
    Output<double> distances(const Cloud &cloud, Input<double, 2> wanted, Input<double, 3> rotations,
                             Input<double, 1> root, Input<int64_t, 1> limb, Input<double, 4> draws,
                             Input<int64_t, 1> some, double most) {
        require(rotations, root, limb, some);
        if (cloud.width != 3 || draws.shape(1) != limb.shape(0) || wanted.shape(1) != 3)
            throw std::invalid_argument("BodyMatcher.distances: shapes differ");
        for (size_t i = 0; i < limb.shape(0); ++i)
            if (limb.data()[i] < 0 || limb.data()[i] >= int64_t(count))
                throw std::invalid_argument("BodyMatcher.distances: a link beyond the body");
        turns.assign(rotations.data(), rotations.data() + 9 * count);
        place.assign(root.data(), root.data() + 3);
        transform();
        const size_t n = draws.shape(0), of = limb.shape(0), k = some.shape(0), w = wanted.shape(0);
        Fresh<double> score(n);
        Doubles at(3 * k);
        for (size_t draw = 0; draw < n; ++draw) {
            for (size_t i = 0; i < of; ++i) {
                const int64_t link = limb.data()[i];
                std::copy_n(draws.data() + 9 * (draw * of + i), 9, &turns[9 * link]);
                transform(link);
            }
            double there = 0, back = 0;
            for (size_t i = 0; i < k; ++i) {
                const int64_t row = some.data()[i], link = links[2 * row];
                turn(&a[9 * link], &points[3 * row], &at[3 * i]);
                for (int d = 0; d < 3; ++d) at[3 * i + d] += b[3 * link + d];
                double limit = squared(most);
                cloud.nearest(&at[3 * i], limit);
                there += limit;
            }
            for (size_t j = 0; j < w; ++j) {
                const double *x = wanted.data() + 3 * j;
                double least = squared(most);
                for (size_t i = 0; i < k; ++i) {
                    const double *y = &at[3 * i];
                    least = std::min(least, squared(x[0] - y[0]) + squared(x[1] - y[1]) + squared(x[2] - y[2]));
                }
                back += least;
            }
            score.data[draw] = there / double(std::max<size_t>(k, 1)) + back / double(std::max<size_t>(w, 1));
        }
        return score.give({n});
    }

  private:
    static constexpr size_t CANDIDATES = 3;
    static constexpr size_t REFRESH = 3;
    static constexpr double RIVAL = 0.08;
    static constexpr float SLACK = 1e-4f;  // metres: more than single precision errs by, near a body

    // The sphere about the box of a link's points that holds them all.
    void enclose(size_t link) {
        const int32_t *s = &size[3 * link];
        for (int d = 0; d < 3; ++d) centres.push_back(low[3 * link + d] + cell * s[d] / 2);
        radii.push_back(0);
        if (!filled[link]) return;
        for (int64_t at = start[link], end = at + int64_t(s[0]) * s[1] * s[2]; at < end; ++at) {
            const double *y = &points[3 * nearest[at]], *m = &centres[3 * link];
            const double away = squared(y[0] - m[0]) + squared(y[1] - m[1]) + squared(y[2] - m[2]);
            radii[link] = std::max(radii[link], std::sqrt(away));
        }
    }

    template <class Mask>
    void require(const Input<double, 3> &rotations, const Input<double, 1> &root, const Mask &allowed,
                 const Input<int64_t, 1> &some) const {
        if (rotations.shape(0) != count || rotations.shape(1) != 3 || rotations.shape(2) != 3 || root.shape(0) != 3)
            throw std::invalid_argument("BodyMatcher: a pose of another body");
        if constexpr (std::is_same_v<Mask, Input<bool, 1>>)
            if (allowed.shape(0) != count) throw std::invalid_argument("BodyMatcher: links of another body");
        for (size_t k = 0; k < some.shape(0); ++k)
            if (some.data()[k] < 0 || some.data()[k] >= int64_t(rows))
                throw std::invalid_argument("BodyMatcher: a row beyond the template");
    }

    // A and b of every link from its own turn and its parent's.
    void transform() {
        a.resize(9 * count);
        b.resize(3 * count);
        middles.resize(3 * count);
        for (size_t link = 0; link < count; ++link) {
            transform(int64_t(link));
            turn(&a[9 * link], &centres[3 * link], &middles[3 * link]);
            for (int d = 0; d < 3; ++d) middles[3 * link + d] += b[3 * link + d];
        }
    }

    void transform(int64_t link) {
        const double *own = &turns[9 * link], *origin = &origins[3 * link];
        double offset[3];
        turn(own, origin, offset);
        for (int d = 0; d < 3; ++d) offset[d] = origin[d] - offset[d];
        const int64_t parent = parents[link];
        if (parent < 0) {
            std::copy_n(own, 9, &a[9 * link]);
            for (int d = 0; d < 3; ++d) b[3 * link + d] = offset[d] + place[d];
        } else {
            product(&a[9 * parent], own, &a[9 * link]);
            turn(&a[9 * parent], offset, &b[3 * link]);
            for (int d = 0; d < 3; ++d) b[3 * link + d] += b[3 * parent + d];
        }
    }

    void posed(int64_t row, double *out) const {
        const int64_t l0 = links[2 * row], l1 = links[2 * row + 1];
        const double share = weights[row];
        double first[3], second[3];
        turn(&a[9 * l0], &points[3 * row], first);
        if (l0 == l1) {
            for (int d = 0; d < 3; ++d) out[d] = first[d] + b[3 * l0 + d];
            return;
        }
        turn(&a[9 * l1], &points[3 * row], second);
        for (int d = 0; d < 3; ++d)
            out[d] = share * (first[d] + b[3 * l0 + d]) + (1 - share) * (second[d] + b[3 * l1 + d]);
    }

    // A template point where it is posed, and its colour where the cloud has them.
    void seen(const Cloud &cloud, int64_t row, double *at) const {
        posed(row, at);
        if (cloud.coloured) std::copy_n(&shades[3 * row], 3, at + 3);
    }

    void require(const Cloud &cloud) const {
        if (cloud.coloured && !coloured) throw std::invalid_argument("BodyMatcher: colours for a template without");
    }

    int32_t look_up(int64_t link, const double *local) const {
        int64_t index = 0;
        for (int d = 0; d < 3; ++d) {
            const int32_t most = size[3 * link + d] - 1;
            const double x = (local[d] - low[3 * link + d]) * (1 / cell);
            index = index * (most + 1) + (x <= 0 ? 0 : x >= most ? most : int32_t(x));
        }
        return nearest[start[link] + index];
    }

    // The links whose points are nearest to each of the points from one to another, nearest first, and none that is
    // farther than the nearest by RIVAL. Those that were so before are looked at first: few others are near enough then to
    // be looked at.
    void candidates_from(const Cloud &cloud, size_t from, size_t here, const bool *allowed) {
        if (from >= here) return;
        const std::vector<int64_t> before(candidates.begin() + from * CANDIDATES, candidates.end());
        candidates.resize(from * CANDIDATES);
        candidates.resize(here * CANDIDATES, -1);
        std::vector<int64_t> usable;
        for (size_t link = 0; link < count; ++link)
            if (filled[link] && allowed[link]) usable.push_back(int64_t(link));
        const size_t width = usable.size();
        std::vector<float> spheres(4 * width), away(width);  // middles by axes, then radii; squared distances of them
        for (size_t u = 0; u < width; ++u) {
            for (int d = 0; d < 3; ++d) spheres[d * width + u] = float(middles[3 * usable[u] + d]);
            spheres[3 * width + u] = float(radii[usable[u]]) + SLACK;
        }
        const float *mx = &spheres[0], *my = mx + width, *mz = my + width, *radius = mz + width;
        std::vector<char> seen(count, 0);
        std::array<int64_t, CANDIDATES> last;  // those of the point before, which lies near
        last.fill(-1);
        for (size_t i : cloud.together()) {
            if (i < from || i >= here) continue;
            const double *x = cloud.point(i);
            double best[CANDIDATES];
            double reach = std::numeric_limits<double>::infinity();  // how far the last of them may be
            std::fill_n(best, CANDIDATES, std::numeric_limits<double>::infinity());
            int64_t *found = &candidates[i * CANDIDATES];
            const auto look = [&](int64_t link) {
                const double *shift = &b[3 * link];
                const double offset[3] = {x[0] - shift[0], x[1] - shift[1], x[2] - shift[2]};
                double local[3];
                turn_back(&a[9 * link], offset, local);
                if (outside(link, local) >= squared(reach)) return;
                const double *y = &points[3 * look_up(link, local)];
                const double distance =
                    squared(local[0] - y[0]) + squared(local[1] - y[1]) + squared(local[2] - y[2]);
                size_t at = CANDIDATES;
                while (at > 0 && distance < best[at - 1]) --at;
                if (at == CANDIDATES) return;
                for (size_t k = CANDIDATES - 1; k > at; --k) best[k] = best[k - 1], found[k] = found[k - 1];
                best[at] = distance;
                found[at] = link;
                reach = std::min(std::sqrt(best[CANDIDATES - 1]), std::sqrt(best[0]) + RIVAL);
            };
            const bool is_known = (i - from + 1) * CANDIDATES <= before.size();
            std::array<int64_t, CANDIDATES> known = last;
            if (is_known) std::copy_n(&before[(i - from) * CANDIDATES], CANDIDATES, known.begin());
            for (int64_t link : known)
                if (link >= 0 && allowed[link]) look(link), seen[link] = 1;
            const float px = float(x[0]), py = float(x[1]), pz = float(x[2]);
            for (size_t u = 0; u < width; ++u)
                away[u] = (px - mx[u]) * (px - mx[u]) + (py - my[u]) * (py - my[u]) + (pz - mz[u]) * (pz - mz[u]);
            for (size_t u = 0; u < width; ++u) {
                const float most = radius[u] + float(reach);
                if (away[u] < most * most && !seen[usable[u]]) look(usable[u]);
            }
            for (int64_t link : known)
                if (link >= 0) seen[link] = 0;
            for (size_t k = 1; k < CANDIDATES; ++k)
                if (best[k] > squared(std::sqrt(best[0]) + RIVAL)) found[k] = -1;
            std::copy_n(found, CANDIDATES, last.begin());
        }
    }

    // Whether no point of a link is nearer to a place than `reach`, by the sphere about them.
    bool is_beyond(int64_t link, const double *x, double reach) const {
        const double *m = &middles[3 * link];
        return squared(x[0] - m[0]) + squared(x[1] - m[1]) + squared(x[2] - m[2]) >= squared(radii[link] + reach);
    }

    // Squared distance of a place in a link's coordinates from the box of its points: no point of it is nearer.
    double outside(int64_t link, const double *local) const {
        double sum = 0;
        for (int d = 0; d < 3; ++d) {
            const double from = low[3 * link + d] + margin;
            const double to = low[3 * link + d] + cell * size[3 * link + d] - margin;
            sum += squared(std::max(0.0, std::max(from - local[d], local[d] - to)));
        }
        return sum;
    }

    int64_t match(const Cloud &cloud, size_t i, const int64_t *candidates, int64_t &link) const {
        const double *x = cloud.point(i);
        int64_t row = -1;
        link = -1;
        double distance = std::numeric_limits<double>::infinity(), reach = distance;
        for (size_t k = 0; k < CANDIDATES && candidates[k] >= 0; ++k) {
            if (k && is_beyond(candidates[k], x, reach)) continue;
            const double *shift = &b[3 * candidates[k]];
            const double offset[3] = {x[0] - shift[0], x[1] - shift[1], x[2] - shift[2]};
            double local[3];
            turn_back(&a[9 * candidates[k]], offset, local);
            if (k && outside(candidates[k], local) >= distance) continue;
            const int32_t here = look_up(candidates[k], local);
            const double *y = &points[3 * here];
            double sum = squared(local[0] - y[0]) + squared(local[1] - y[1]) + squared(local[2] - y[2]);
            if (coloured && cloud.coloured) {
                double shade = 0;
                for (int d = 0; d < 3; ++d) shade += squared(x[3 + d] - shades[3 * here + d]);
                sum += std::min(shade, SHADE);
            }
            if (sum < distance) distance = sum, reach = std::sqrt(sum), row = here, link = candidates[k];
        }
        return row;
    }

    // A pair of a template row and the place that it should come to.
    void draw(int64_t row, const double *target, double width, double noise) {
        Pull &sum = pulls[row];
        if (!sum.is_posed) posed(row, sum.at), sum.is_posed = true;
        const double gap[3] = {target[0] - sum.at[0], target[1] - sum.at[1], target[2] - sum.at[2]};
        const double weight = squared(width * width / (width * width + dot(gap, gap))) / squared(noise);
        sum.weight += weight;
        for (int d = 0; d < 3; ++d) sum.gap[d] += weight * gap[d];
    }

    // All that draws a template row, in the sums of its links.
    void add(int64_t row, const Pull &drawn, double pull) {
        double n[3], f[6];
        const double *y = drawn.at, *gap = drawn.gap;
        turn(&a[9 * links[2 * row]], &normals[3 * row], n);
        std::copy_n(n, 3, f);
        cross(y, n, f + 3);
        double outer[21], right[6], turned[3];
        int at = 0;
        for (int i = 0; i < 6; ++i)
            for (int j = i; j < 6; ++j) outer[at++] = f[i] * f[j];
        // (I, −[y]×)ᵀ (I, −[y]×): the distance along the surface too, weakly
        const double square = dot(y, y);
        outer[0] += pull;
        outer[6] += pull;
        outer[11] += pull;
        outer[4] += pull * y[2];
        outer[5] -= pull * y[1];
        outer[8] -= pull * y[2];
        outer[10] += pull * y[0];
        outer[12] += pull * y[1];
        outer[13] -= pull * y[0];
        outer[15] += pull * (square - y[0] * y[0]);
        outer[18] += pull * (square - y[1] * y[1]);
        outer[20] += pull * (square - y[2] * y[2]);
        outer[16] -= pull * y[0] * y[1];
        outer[17] -= pull * y[0] * y[2];
        outer[19] -= pull * y[1] * y[2];
        cross(y, gap, turned);
        const double across = dot(n, gap);
        for (int d = 0; d < 3; ++d) {
            right[d] = f[d] * across + pull * gap[d];
            right[3 + d] = f[3 + d] * across + pull * turned[d];
        }
        Sums &sum = sums[pair[row]];
        const double first = weights[row], second = 1 - first;
        const double weight = drawn.weight;
        const double shares[3] = {weight * first * first, weight * first * second, weight * second * second};
        if (second == 0) {
            for (int i = 0; i < 21; ++i) sum.square[0][i] += shares[0] * outer[i];
            for (int i = 0; i < 6; ++i) sum.right[0][i] += right[i];
            return;
        }
        for (int s = 0; s < 3; ++s)
            for (int i = 0; i < 21; ++i) sum.square[s][i] += shares[s] * outer[i];
        for (int i = 0; i < 6; ++i) {
            sum.right[0][i] += first * right[i];
            sum.right[1][i] += second * right[i];
        }
    }

    // h (unknowns, unknowns) and g of the root's translation and the joints' turns, in the world, from the pairs' sums.
    // A joint moves every link below it alike, so that sums over subtrees of the links' 6 × 6 blocks give its rows.
    void equations(Doubles &h, Doubles &g) {
        blocks.assign(count * count * 36, 0.0);
        vectors.assign(count * 6, 0.0);
        for (size_t p = 0; p < pairs.size(); ++p) {
            const size_t l0 = size_t(pairs[p]) / count, l1 = size_t(pairs[p]) % count;
            const size_t where[4][2] = {{l0, l0}, {l0, l1}, {l1, l0}, {l1, l1}};
            const int which[4] = {0, 1, 1, 2};
            for (int k = 0; k < 4; ++k) {
                double *block = &blocks[(where[k][0] * count + where[k][1]) * 36];
                int at = 0;
                for (int i = 0; i < 6; ++i)
                    for (int j = i; j < 6; ++j, ++at) {
                        block[6 * i + j] += sums[p].square[which[k]][at];
                        if (i != j) block[6 * j + i] += sums[p].square[which[k]][at];
                    }
            }
            for (int i = 0; i < 6; ++i) vectors[6 * l0 + i] += sums[p].right[0][i];
            for (int i = 0; i < 6; ++i) vectors[6 * l1 + i] += sums[p].right[1][i];
        }
        for (size_t link = count; link-- > 1;) {  // rows, then columns, up the tree
            const int64_t parent = parents[link];
            if (parent < 0) continue;
            for (size_t i = 0; i < count * 36; ++i) blocks[parent * count * 36 + i] += blocks[link * count * 36 + i];
            for (int i = 0; i < 6; ++i) vectors[6 * parent + i] += vectors[6 * link + i];
        }
        for (size_t row = 0; row < count; ++row)
            for (size_t link = count; link-- > 1;) {
                const int64_t parent = parents[link];
                if (parent < 0) continue;
                for (int i = 0; i < 36; ++i)
                    blocks[(row * count + parent) * 36 + i] += blocks[(row * count + link) * 36 + i];
            }
        const size_t unknowns = 3 + 3 * count;
        h.assign(unknowns * unknowns, 0.0);
        g.assign(unknowns, 0.0);
        // motions (6, 3) of what hangs on a joint as it turns: [p]× above I; of the root's translation: I above 0
        Doubles motion(18 * (count + 1), 0.0);
        std::vector<size_t> carrier(count + 1, 0);
        for (int d = 0; d < 3; ++d) motion[3 * d + d] = 1;
        for (size_t link = 0; link < count; ++link) {
            double p[3];
            turn(&a[9 * link], &origins[3 * link], p);
            for (int d = 0; d < 3; ++d) p[d] += b[3 * link + d];
            double *m = &motion[18 * (link + 1)];
            m[1] = -p[2], m[2] = p[1], m[3] = p[2], m[5] = -p[0], m[6] = -p[1], m[7] = p[0];
            m[9] = m[13] = m[17] = 1;
            carrier[link + 1] = link;
        }
        for (size_t i = 0; i <= count; ++i) {
            const double *left = &motion[18 * i];
            for (size_t j = i; j <= count; ++j) {
                const double *block = &blocks[(carrier[i] * count + carrier[j]) * 36], *right = &motion[18 * j];
                if (std::all_of(block, block + 36, [](double x) { return x == 0; })) continue;
                double half[18] = {};
                for (int r = 0; r < 6; ++r)
                    for (int k = 0; k < 6; ++k)
                        for (int c = 0; c < 3; ++c) half[3 * r + c] += block[6 * r + k] * right[3 * k + c];
                for (int r = 0; r < 3; ++r)
                    for (int c = 0; c < 3; ++c) {
                        double sum = 0;
                        for (int k = 0; k < 6; ++k) sum += left[3 * k + r] * half[3 * k + c];
                        h[(3 * i + r) * unknowns + 3 * j + c] = sum;
                        h[(3 * j + c) * unknowns + 3 * i + r] = sum;
                    }
            }
            for (int r = 0; r < 3; ++r)
                for (int k = 0; k < 6; ++k) g[3 * i + r] += left[3 * k + r] * vectors[6 * carrier[i] + k];
        }
    }

    void priors(const Doubles &expected, const double *expected_root, const double *held, const double *strengths,
                double loose, Doubles &h, Doubles &g) const {
        const size_t unknowns = 3 + 3 * count;
        for (int d = 0; d < 3; ++d) {
            g[d] -= (place[d] - expected_root[d]) * loose;
            h[d * (unknowns + 1)] += loose;
        }
        for (size_t link = 0; link < count; ++link) {
            double difference[9], off[3], turned[3];
            for (int which = 0; which < 2; ++which) {
                const double strength = strengths[which * count + link];
                if (strength == 0) continue;
                product(&turns[9 * link], which ? held + 9 * link : &expected[9 * link], difference, true);
                logarithm(difference, off);
                if (parents[link] >= 0)
                    turn(&a[9 * parents[link]], off, turned);
                else
                    std::copy_n(off, 3, turned);
                for (int d = 0; d < 3; ++d) {
                    g[3 + 3 * link + d] -= strength * turned[d];
                    h[(3 + 3 * link + d) * (unknowns + 1)] += strength;
                }
            }
        }
    }

    // Towards the nearest rotation that is allowed, where a link is beyond its limits. resisted: the axis of the turn that
    // led there, which later steps are to resist too.
    void pull_back(size_t link, const double *limit, double strength, double *resisted, Doubles &h, Doubles &g) const {
        double allowed[9], difference[9], off[3], world[3];
        const double *own = &turns[9 * link];
        const auto in_world = [&](const double *vector) {
            if (parents[link] >= 0)
                turn(&a[9 * parents[link]], vector, world);
            else
                std::copy_n(vector, 3, world);
        };
        if (nearest_allowed(limit, own, allowed)) {
            product(own, allowed, difference, true);
            logarithm(difference, off);
            in_world(off);
            const double length = std::max(std::sqrt(dot(off, off)), 1e-12);
            for (int i = 0; i < 3; ++i) g[3 + 3 * link + i] -= strength * world[i], resisted[i] = off[i] / length;
        }
        if (dot(resisted, resisted) == 0) return;
        in_world(resisted);
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j)
                h[(3 + 3 * link + i) * (3 + 3 * count) + 3 + 3 * link + j] += strength * world[i] * world[j];
    }

    // g becomes the solution of h x = g, by Cholesky from the last unknown on: a joint then meets only those above it,
    // and the few whose skin it shares. False where h is not positive definite.
    static bool solve_symmetric(Doubles &h, Doubles &g, size_t n) {
        std::vector<size_t> met;
        met.reserve(n);
        for (size_t j = n; j-- > 0;) {
            double *row = &h[j * n];
            if (!(row[j] > 0)) return false;
            const double scale = 1 / std::sqrt(row[j]);
            met.clear();
            for (size_t k = 0; k < j; ++k)
                if (row[k] != 0) row[k] *= scale, met.push_back(k);
            row[j] *= scale;
            g[j] *= scale;
            for (size_t i : met) {
                double *other = &h[i * n];
                for (size_t k : met) {
                    if (k > i) break;
                    other[k] -= row[i] * row[k];
                }
                g[i] -= row[i] * g[j];
            }
        }
        for (size_t i = 0; i < n; ++i) {
            double sum = g[i];
            for (size_t k = 0; k < i; ++k) sum -= h[i * n + k] * g[k];
            g[i] = sum / h[i * n + i];
        }
        return true;
    }

    // The pose after a step, of which no joint turns by more than 0.7 radians; how far it moves the root, or the far end
    // of a link by its own turn, at most.
    double move(const Doubles &step) {
        double most = std::sqrt(dot(&step[0], &step[0]));
        for (size_t link = 0; link < count; ++link)
            most = std::max(most, lengths[link] * std::sqrt(dot(&step[3 + 3 * link], &step[3 + 3 * link])));
        for (int d = 0; d < 3; ++d) place[d] += step[d];
        for (size_t link = 0; link < count; ++link) {
            double vector[3], own[3], rotation[9], turned[9];
            std::copy_n(&step[3 + 3 * link], 3, vector);
            const double angle = std::sqrt(dot(vector, vector)), share = std::min(1.0, 0.7 / std::max(angle, 1e-9));
            for (double &x : vector) x *= share;
            if (parents[link] >= 0)
                turn_back(&a[9 * parents[link]], vector, own);
            else
                std::copy_n(vector, 3, own);
            exponential(own, rotation);
            product(rotation, &turns[9 * link], turned);
            std::copy_n(turned, 9, &turns[9 * link]);
        }
        transform();
        return most;
    }

    static constexpr double SHADE = 0.04 * 0.04;

    const size_t count, rows;
    const bool coloured;
    const double cell, margin;
    const std::vector<int64_t> parents;
    const Doubles origins, lengths, points;
    const std::vector<int64_t> links;
    const Doubles weights, normals, shades;
    const std::vector<uint16_t> nearest;
    const Doubles low;
    const std::vector<int32_t> size;
    const std::vector<int64_t> start;
    std::vector<char> filled;
    Doubles centres, radii;  // of spheres about the links' points
    std::vector<int64_t> pair, pairs, candidates;
    Doubles turns, place, a, b, middles, blocks, vectors;  // of the pose that a call looks at
    std::vector<Sums> sums;
    std::vector<Pull> pulls;
};

}  // namespace

void bind_matching(nb::module_ &m) {
    nb::class_<Cloud>(m, "BodyPoints")
        .def(nb::init<Input<double, 2>, Input<double, 2>>())
        .def("grid", &Cloud::grid)
        .def("query", &Cloud::query, nb::arg(), nb::arg("distance_upper_bound"));
    nb::class_<Body>(m, "BodyMatcher")
        .def(nb::init<Input<int64_t, 1>, Input<double, 2>, Input<double, 1>, Input<double, 2>, Input<int64_t, 2>, Input<double, 1>,
                      Input<double, 2>, Input<double, 2>, Input<int32_t, 1>, Input<double, 2>, Input<int32_t, 2>,
                      Input<int64_t, 1>, double, double>())
        .def("solve", &Body::solve)
        .def("assess", &Body::assess)
        .def("distances", &Body::distances);
}
