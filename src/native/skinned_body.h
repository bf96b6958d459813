// A body's links and surface template: skinning, poses, and each link's grid of nearest template points.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <type_traits>
#include <vector>

#include "algebra3.h"
#include "arrays.h"
#include "kd_tree.h"

using Doubles = std::vector<double>;

template <class Array>
auto copy(const Array &array) {
    return std::vector<std::remove_const_t<typename Array::Scalar>>(array.data(), array.data() + array.size());
}

// A point x of link l in the canonical pose is at A_l x + b_l in the current pose. A template point follows two links:
// its place is the mean of both, by its weight.
class SkinnedBody {
  public:
    // Arrays as geometry/body_matching.py has them: parents (links,), origins (links, 3), lengths (links,); template
    // points (rows, 3), links (rows, 2), weights (rows,), normals (rows, 3), colours (rows, 3) or (0, 3); and of the
    // links' grids, laid end to end: nearest rows, corners (links, 3), sizes (links, 3), starts (links,); the edge of
    // a cell, and how far a grid reaches beyond its link's points, metres.
    SkinnedBody(Input<int64_t, 1> parents, Input<double, 2> origins, Input<double, 1> lengths, Input<double, 2> points,
                Input<int64_t, 2> links, Input<double, 1> weights, Input<double, 2> normals, Input<double, 2> colours,
                Input<int32_t, 1> nearest, Input<double, 2> low, Input<int32_t, 2> size, Input<int64_t, 1> start,
                double cell, double margin)
        : count(parents.shape(0)), rows(points.shape(0)), coloured(colours.shape(0) > 0), cell_size(cell), margin(margin),
          parents(copy(parents)), origins(copy(origins)), lengths(copy(lengths)), given_rows(spatial_order(points)),
          points(ordered(points)), links(ordered(links)), weights(ordered(weights)), normals(ordered(normals)),
          colours(ordered(colours)), low(copy(low)), size(copy(size)) {
        const bool same = origins.shape(0) == count && lengths.shape(0) == count && links.shape(0) == rows &&
                          links.shape(1) == 2 && weights.shape(0) == rows && normals.shape(0) == rows &&
                          low.shape(0) == count && size.shape(0) == count && start.shape(0) == count &&
                          (!coloured || colours.shape(0) == rows);
        const bool three = origins.shape(1) == 3 && points.shape(1) == 3 && normals.shape(1) == 3 &&
                           low.shape(1) == 3 && size.shape(1) == 3 && (!coloured || colours.shape(1) == 3);
        if (!same || !three || !count || !rows) throw std::invalid_argument("BodyMatcher: shapes differ");
        own_rows.resize(rows);
        for (size_t row = 0; row < rows; ++row) own_rows[given_rows[row]] = int64_t(row);
        for (size_t l = 0; l < count; ++l) {
            const int32_t *s = &this->size[3 * l];
            if (this->parents[l] >= int64_t(l))
                throw std::invalid_argument("BodyMatcher: a link stands before its parent");
            const int64_t first = start.data()[l];
            if (s[0] < 1 || s[1] < 1 || s[2] < 1 || first < 0 ||
                uint64_t(first) + uint64_t(s[0]) * s[1] * s[2] > nearest.size())
                throw std::invalid_argument("BodyMatcher: a grid is beyond the end of its array");
            has_points.push_back(nearest.data()[first] >= 0);
            add_grid(l, nearest.data() + first);
            add_capsule(l);
        }
        for (int64_t link : this->links)
            if (link < 0 || link >= int64_t(count)) throw std::invalid_argument("BodyMatcher: a link beyond the body");
    }

    void set_pose(const double *new_rotations, const double *new_root) {
        rotations.assign(new_rotations, new_rotations + 9 * count);
        root.assign(new_root, new_root + 3);
        update_transforms();
    }

    // A and b of every link, and the ends of their capsules, from `rotations` and `root`.
    void update_transforms() {
        a.resize(9 * count);
        b.resize(3 * count);
        world_ends.resize(6 * count);
        for (size_t link = 0; link < count; ++link) {
            update_transform(int64_t(link));
            for (size_t end = 2 * link; end < 2 * link + 2; ++end) place(link, &ends[3 * end], &world_ends[3 * end]);
        }
    }

    // A and b of one link from its own rotation and its parent's transform.
    void update_transform(int64_t link) {
        const double *own = &rotations[9 * link], *origin = &origins[3 * link];
        double offset[3];
        transform(own, origin, offset);
        for (int d = 0; d < 3; ++d) offset[d] = origin[d] - offset[d];
        const int64_t parent = parents[link];
        if (parent < 0) {
            std::copy_n(own, 9, &a[9 * link]);
            for (int d = 0; d < 3; ++d) b[3 * link + d] = offset[d] + root[d];
        } else {
            multiply(&a[9 * parent], own, &a[9 * link]);
            place(size_t(parent), offset, &b[3 * link]);
        }
    }

    // out = a point of a link's canonical coordinates, in the world: A x + b.
    void place(size_t link, const double *point, double *out) const {
        transform(&a[9 * link], point, out);
        for (int d = 0; d < 3; ++d) out[d] += b[3 * link + d];
    }

    // out = a vector in the frame of a link's parent, in the world's.
    void to_world(size_t link, const double *vector, double *out) const {
        if (parents[link] >= 0)
            transform(&a[9 * parents[link]], vector, out);
        else
            std::copy_n(vector, 3, out);
    }

    // out = a place of the world in a link's canonical coordinates.
    void to_local(int64_t link, const double *place, double *out) const {
        const double *shift = &b[3 * link];
        const double offset[3] = {place[0] - shift[0], place[1] - shift[1], place[2] - shift[2]};
        transform_back(&a[9 * link], offset, out);
    }

    // out = a template point in the current pose, by linear blend skinning.
    void pose_point(int64_t row, double *out) const {
        const int64_t l0 = links[2 * row], l1 = links[2 * row + 1];
        place(size_t(l0), &points[3 * row], out);
        if (l0 == l1) return;
        const double share = weights[row];
        double other[3];
        place(size_t(l1), &points[3 * row], other);
        for (int d = 0; d < 3; ++d) out[d] = share * out[d] + (1 - share) * other[d];
    }

    // out = the coordinates of a template point in a tree of data points: its place, and its colour if the tree has some.
    void query_of(const KdTree &data, int64_t row, double *out) const {
        pose_point(row, out);
        if (data.coloured) std::copy_n(&colours[3 * row], 3, out + 3);
    }

    // The template point nearest to a place in a link's canonical coordinates, from the link's grid.
    int32_t look_up(int64_t link, const double *local) const {
        size_t cell[3];
        for (int d = 0; d < 3; ++d) {
            const int32_t most = size[3 * link + d] - 1;
            const double x = (local[d] - low[3 * link + d]) * (1 / cell_size);
            cell[d] = size_t(x <= 0 ? 0 : x >= most ? most : int32_t(x));
        }
        return nearest[bricks[link] + brick_of(link, cell)].rows[row_in_brick(cell)];
    }

    // Whether no template point of a link is nearer to a place of the world than `reach`, by its capsule.
    bool is_beyond(int64_t link, const double *place, double reach) const {
        return squared_distance_from_segment(place, &world_ends[6 * link]) >= squared(radii[link] + reach);
    }

    // Squared distance of a place in a link's coordinates from the bounding box of the link's template points: a lower
    // bound of its distance from any of them.
    double box_distance(int64_t link, const double *local) const {
        double sum = 0;
        for (int d = 0; d < 3; ++d) {
            const double from = low[3 * link + d] + margin;
            const double to = low[3 * link + d] + cell_size * size[3 * link + d] - margin;
            sum += squared(std::max(0.0, std::max(from - local[d], local[d] - to)));
        }
        return sum;
    }

    const size_t count, rows;  // of links, of template points
    const bool coloured;
    const double cell_size, margin;
    const std::vector<int64_t> parents;
    const Doubles origins, lengths;
    const std::vector<size_t> given_rows;  // the template's rows, in the order in which they stand here: neighbours in
                                           // space are neighbours in memory
    std::vector<int64_t> own_rows;         // where each of the template's rows stands here
    const Doubles points;
    const std::vector<int64_t> links;
    const Doubles weights, normals, colours;
    std::vector<char> has_points;
    Doubles ends, radii;                      // capsules that hold the links' template points: (links, 2, 3) canonical
    Doubles rotations, root;                  // the current pose
    Doubles a, b, world_ends;                 // what follows from it

  private:
    static std::vector<size_t> spatial_order(Input<double, 2> points) {
        KdNodes<double> tree;
        if (points.shape(1) == 3)
            tree.build(points.shape(0), 3, 1, [&](size_t row, int axis) { return points.data()[3 * row + size_t(axis)]; });
        return tree.order;
    }

    // The rows of an array in the order of `given_rows`; nothing if it has not so many rows.
    template <class Array>
    std::vector<std::remove_const_t<typename Array::Scalar>> ordered(const Array &array) const {
        std::vector<std::remove_const_t<typename Array::Scalar>> result;
        if (array.shape(0) != given_rows.size()) return result;
        const size_t columns = array.size() / std::max<size_t>(array.shape(0), 1);
        for (size_t row : given_rows)
            result.insert(result.end(), array.data() + row * columns, array.data() + (row + 1) * columns);
        return result;
    }

    static constexpr uint16_t NO_ROW = 0xffff;
    static constexpr int CAPSULE_CUTS = 8;

    // 4 × 4 × 2 neighbouring cells of a grid in 16 bits each: a line of the cache.
    struct alignas(64) Brick {
        uint16_t rows[32];
    };

    size_t brick_of(size_t link, const size_t *cell) const {
        const int32_t *s = &size[3 * link];
        return ((cell[0] / 4) * ((size_t(s[1]) + 3) / 4) + cell[1] / 4) * ((size_t(s[2]) + 1) / 2) + cell[2] / 2;
    }

    static size_t row_in_brick(const size_t *cell) { return cell[0] % 4 * 8 + cell[1] % 4 * 2 + cell[2] % 2; }

    // A link's grid, given cell by cell, the last axis fastest.
    void add_grid(size_t link, const int32_t *given) {
        const int32_t *s = &size[3 * link];
        bricks.push_back(nearest.size());
        const size_t last[3] = {size_t(s[0]) - 1, size_t(s[1]) - 1, size_t(s[2]) - 1};
        Brick empty;
        std::fill_n(empty.rows, 32, NO_ROW);
        nearest.resize(nearest.size() + brick_of(link, last) + 1, empty);
        size_t cell[3];
        for (cell[0] = 0; cell[0] <= last[0]; ++cell[0])
            for (cell[1] = 0; cell[1] <= last[1]; ++cell[1])
                for (cell[2] = 0; cell[2] <= last[2]; ++cell[2]) {
                    const int32_t row = *given++;
                    if (row < -1 || row >= int64_t(rows) || row >= NO_ROW)
                        throw std::invalid_argument("BodyMatcher: a row beyond the template");
                    const size_t at = bricks[link] + brick_of(link, cell);
                    nearest[at].rows[row_in_brick(cell)] = row < 0 ? NO_ROW : uint16_t(own_rows[size_t(row)]);
                }
    }

    // Squared distance of a place from the segment between two ends (2, 3).
    static double squared_distance_from_segment(const double *place, const double *ends) {
        double along[3], from[3];
        for (int d = 0; d < 3; ++d) along[d] = ends[3 + d] - ends[d], from[d] = place[d] - ends[d];
        const double share = std::clamp(dot(from, along) / std::max(dot(along, along), 1e-12), 0.0, 1.0);
        for (int d = 0; d < 3; ++d) from[d] -= share * along[d];
        return dot(from, from);
    }

    // A capsule, a segment and a radius, that holds all template points of a link. The segment lies between two points
    // far from each other, shortened as much as makes the capsule smallest.
    void add_capsule(size_t link) {
        std::vector<char> is_own(rows, 0);
        for (size_t brick = bricks[link]; has_points[link] && brick < nearest.size(); ++brick)
            for (uint16_t row : nearest[brick].rows)
                if (row < rows) is_own[row] = 1;
        std::vector<const double *> own;
        for (size_t row = 0; row < rows; ++row)
            if (is_own[row]) own.push_back(&points[3 * row]);
        std::array<double, 6> best{};
        double best_radius = 0, least = std::numeric_limits<double>::infinity();
        if (!own.empty()) {
            const auto farthest = [&](const double *from) {
                return *std::max_element(own.begin(), own.end(), [&](const double *p, const double *q) {
                    return squared_distance(p, from) < squared_distance(q, from);
                });
            };
            const double *one = farthest(own[0]), *other = farthest(one);
            for (int cut = 0; cut <= CAPSULE_CUTS; ++cut) {
                const double share = 0.5 * cut / CAPSULE_CUTS;
                std::array<double, 6> segment;
                for (int d = 0; d < 3; ++d) {
                    segment[d] = one[d] + share * (other[d] - one[d]);
                    segment[3 + d] = other[d] - share * (other[d] - one[d]);
                }
                double square = 0;
                for (const double *p : own) square = std::max(square, squared_distance_from_segment(p, segment.data()));
                const double radius = std::sqrt(square), length = std::sqrt(squared_distance(&segment[0], &segment[3]));
                const double volume = square * (length + 4.0 / 3.0 * radius);
                if (volume < least) least = volume, best = segment, best_radius = radius;
            }
        }
        ends.insert(ends.end(), best.begin(), best.end());
        radii.push_back(best_radius);
    }

    const Doubles low;
    const std::vector<int32_t> size;
    std::vector<Brick> nearest;    // of all links
    std::vector<size_t> bricks;    // the first of each link
};
