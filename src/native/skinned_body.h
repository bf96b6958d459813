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

// Prefetches memory: tables and template do not fit into the fast cache.
inline void prefetch([[maybe_unused]] const void *memory) {
#if defined(__GNUC__)
    __builtin_prefetch(memory);
#endif
}

// A template point in the canonical pose, its normal, its two links, and the weight of the first. It is one cache line,
// since a correspondence needs all of it.
struct alignas(64) TemplatePoint {
    double at[3], normal[3], weight;
    int32_t first, second;
};

// Linear blend skinning: the current pose moves a canonical point x of link l to A_l x + b_l; a template point is the
// weighted mean over its two links.
class SkinnedBody {
  public:
    // Arrays of geometry/body_matching.py. Body: parents (links,), origins (links, 3), lengths (links,). Template:
    // points (rows, 3), links (rows, 2), weights (rows,), normals (rows, 3), colours (rows, 3) or (0, 3). Grids of the
    // links, end to end: nearest rows, corners (links, 3), sizes (links, 3), starts (links,); edge of a cell, and
    // margin of a grid around its link's points, metres.
    SkinnedBody(Input<int64_t, 1> parents, Input<double, 2> origins, Input<double, 1> lengths, Input<double, 2> points,
                Input<int64_t, 2> links, Input<double, 1> weights, Input<double, 2> normals, Input<double, 2> colours,
                Input<int32_t, 1> nearest, Input<double, 2> low, Input<int32_t, 2> size, Input<int64_t, 1> start,
                double cell, double margin)
        : count(parents.shape(0)), rows(points.shape(0)), coloured(colours.shape(0) > 0), cell_size(cell), margin(margin),
          parents(copy(parents)), origins(copy(origins)), lengths(copy(lengths)), given_rows(spatial_order(points)),
          colours(ordered(colours)) {
        const bool same = origins.shape(0) == count && lengths.shape(0) == count && links.shape(0) == rows &&
                          links.shape(1) == 2 && weights.shape(0) == rows && normals.shape(0) == rows &&
                          low.shape(0) == count && size.shape(0) == count && start.shape(0) == count &&
                          (!coloured || colours.shape(0) == rows);
        const bool three = origins.shape(1) == 3 && points.shape(1) == 3 && normals.shape(1) == 3 &&
                           low.shape(1) == 3 && size.shape(1) == 3 && (!coloured || colours.shape(1) == 3);
        if (!same || !three || !count || !rows) throw std::invalid_argument("BodyMatcher: shapes differ");
        own_rows.resize(rows);
        for (size_t row = 0; row < rows; ++row) own_rows[given_rows[row]] = int64_t(row);
        for (size_t row : given_rows) {
            const double *at = points.data() + 3 * row, *n = normals.data() + 3 * row;
            const int64_t *link = links.data() + 2 * row;
            for (size_t k = 0; k < 2; ++k)
                if (link[k] < 0 || link[k] >= int64_t(count)) throw std::invalid_argument("BodyMatcher: a link beyond the body");
            this->points.push_back({{at[0], at[1], at[2]}, {n[0], n[1], n[2]}, weights.data()[row], int32_t(link[0]), int32_t(link[1])});
        }
        for (size_t l = 0; l < count; ++l) {
            const int32_t *s = size.data() + 3 * l;
            if (this->parents[l] >= int64_t(l))
                throw std::invalid_argument("BodyMatcher: a link comes before its parent");
            const int64_t first = start.data()[l];
            if (s[0] < 1 || s[1] < 1 || s[2] < 1 || first < 0 ||
                uint64_t(first) + uint64_t(s[0]) * s[1] * s[2] > nearest.size())
                throw std::invalid_argument("BodyMatcher: a grid is beyond the end of its array");
            has_points.push_back(nearest.data()[first] >= 0);
            add_grid(low.data() + 3 * l, s, nearest.data() + first);
            add_capsule(l);
        }
    }

    void set_pose(const double *new_rotations, const double *new_root) {
        rotations.assign(new_rotations, new_rotations + 9 * count);
        root.assign(new_root, new_root + 3);
        update_transforms();
    }

    // Updates A and b of every link, and the ends of the capsules, from `rotations` and `root`.
    void update_transforms() {
        a.resize(9 * count);
        b.resize(3 * count);
        world_ends.resize(6 * count);
        world_axes.resize(3 * count);
        for (size_t link = 0; link < count; ++link) {
            update_transform(int64_t(link));
            for (size_t end = 2 * link; end < 2 * link + 2; ++end) place(link, &ends[3 * end], &world_ends[3 * end]);
            for (size_t d = 0; d < 3; ++d) world_axes[3 * link + d] = world_ends[6 * link + 3 + d] - world_ends[6 * link + d];
        }
    }

    // Updates A and b of one link from its own rotation and its parent's transform.
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

    // out = A x + b: a link's canonical point, in world coordinates.
    void place(size_t link, const double *point, double *out) const {
        transform(&a[9 * link], point, out);
        for (int d = 0; d < 3; ++d) out[d] += b[3 * link + d];
    }

    // out = a vector of the frame of a link's parent, in world coordinates.
    void to_world(size_t link, const double *vector, double *out) const {
        if (parents[link] >= 0)
            transform(&a[9 * parents[link]], vector, out);
        else
            std::copy_n(vector, 3, out);
    }

    // out = a world place, in a link's canonical coordinates.
    void to_local(int64_t link, const double *place, double *out) const {
        const double *shift = &b[3 * link];
        const double offset[3] = {place[0] - shift[0], place[1] - shift[1], place[2] - shift[2]};
        transform_back(&a[9 * link], offset, out);
    }

    // out = a template point in the current pose.
    void pose_point(int64_t row, double *out) const {
        const TemplatePoint &point = points[size_t(row)];
        place(size_t(point.first), point.at, out);
        if (point.first == point.second) return;
        double other[3];
        place(size_t(point.second), point.at, other);
        for (int d = 0; d < 3; ++d) out[d] = point.weight * out[d] + (1 - point.weight) * other[d];
    }

    // out = query of a template point in a tree of data points: its place and, if the tree has colours, its colour.
    void query_of(const KdTree &data, int64_t row, double *out) const {
        pose_point(row, out);
        if (data.coloured) std::copy_n(&colours[3 * row], 3, out + 3);
    }

    // The grid cell that names the template point nearest to a place, in the link's canonical coordinates.
    const uint16_t *cell_at(int64_t link, const double *local) const {
        const Grid &grid = grids[size_t(link)];
        size_t cell[3];
        for (int d = 0; d < 3; ++d)
            cell[d] = size_t(int32_t(std::min(std::max((local[d] - grid.low[d]) * (1 / cell_size), 0.0), grid.last[d])));
        return &nearest[grid.first_brick + grid.brick_of(cell)].rows[row_in_brick(cell)];
    }

    // Look-up of the template point of one link nearest to a world place, in steps that many places take together, so
    // that their memory accesses overlap.
    struct LookUp {
        double local[3];
        const uint16_t *cell;
        const TemplatePoint *found;
        int64_t row;
        double square;  // squared distance

        void start(const SkinnedBody &body, int64_t link, const double *place) {
            body.to_local(link, place, local);
            prefetch(cell = body.cell_at(link, local));
        }
        void follow(const SkinnedBody &body) { prefetch(found = &body.points[size_t(row = *cell)]); }
        void finish() { square = squared_distance(local, found->at); }
        void run(const SkinnedBody &body, int64_t link, const double *place) {
            start(body, link, place);
            follow(body);
            finish();
        }
    };

    // Whether the link's capsule shows that no template point is nearer to a world place than `reach`.
    bool is_beyond(int64_t link, const double *place, double reach) const {
        const double *axis = &world_axes[3 * link];
        double from[3];
        for (int d = 0; d < 3; ++d) from[d] = place[d] - world_ends[6 * link + d];
        const double share = std::min(std::max(dot(from, axis) * inverse_squares[link], 0.0), 1.0);
        for (int d = 0; d < 3; ++d) from[d] -= share * axis[d];
        return dot(from, from) >= squared(radii[link] + reach);
    }

    // Squared distance of a place, in a link's coordinates, from the bounding box of the link's template points: a
    // lower bound of its distance from the points.
    double box_distance(int64_t link, const double *local) const {
        const Grid &grid = grids[size_t(link)];
        double sum = 0;
        for (int d = 0; d < 3; ++d)
            sum += squared(std::max(0.0, std::max(grid.box_low[d] - local[d], local[d] - grid.box_high[d])));
        return sum;
    }

    const size_t count, rows;  // number of links, of template points
    const bool coloured;
    const double cell_size, margin;
    const std::vector<int64_t> parents;
    const Doubles origins, lengths;
    const std::vector<size_t> given_rows;  // input rows of the template, in storage order: neighbours in
                                           // space are neighbours in memory
    std::vector<int64_t> own_rows;         // storage index of each input row
    std::vector<TemplatePoint> points;
    const Doubles colours;
    std::vector<char> has_points;
    Doubles ends, radii;                      // capsules around the links' template points: (links, 2, 3) canonical
    Doubles inverse_squares;                  // one over the squared distance of a capsule's ends
    Doubles rotations, root;                  // the current pose
    Doubles a, b, world_ends, world_axes;     // computed from the pose; axes: from one end of a capsule to the other

  private:
    static std::vector<size_t> spatial_order(Input<double, 2> points) {
        KdNodes<double> tree;
        if (points.shape(1) == 3)
            tree.build<3>(points.shape(0), 1, [&](size_t row, int axis) { return points.data()[3 * row + size_t(axis)]; });
        return tree.order;
    }

    // The rows of an array in the order of `given_rows`; empty if the number of rows differs.
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

    // 4 × 4 × 2 neighbouring cells of a grid, 16 bits each: one cache line.
    struct alignas(64) Brick {
        uint16_t rows[32];
    };

    // Position of a link's grid in its canonical coordinates, and in `nearest`.
    struct Grid {
        double low[3], last[3];          // its corner, and its last cells
        double box_low[3], box_high[3];  // the bounding box of the link's template points
        size_t first_brick, bricks_y, bricks_z;

        size_t brick_of(const size_t *cell) const {
            return ((cell[0] / 4) * bricks_y + cell[1] / 4) * bricks_z + cell[2] / 2;
        }
    };

    static size_t row_in_brick(const size_t *cell) { return cell[0] % 4 * 8 + cell[1] % 4 * 2 + cell[2] % 2; }

    // Adds a link's grid. low: its corner; given: rows, cell by cell, last axis fastest.
    void add_grid(const double *low, const int32_t *size, const int32_t *given) {
        Grid grid{{}, {}, {}, {}, nearest.size(), (size_t(size[1]) + 3) / 4, (size_t(size[2]) + 1) / 2};
        size_t last[3];
        for (int d = 0; d < 3; ++d) {
            last[d] = size_t(size[d]) - 1;
            grid.low[d] = low[d], grid.last[d] = double(last[d]);
            grid.box_low[d] = low[d] + margin, grid.box_high[d] = low[d] + cell_size * size[d] - margin;
        }
        grids.push_back(grid);
        Brick empty;
        std::fill_n(empty.rows, 32, NO_ROW);
        nearest.resize(nearest.size() + grid.brick_of(last) + 1, empty);
        size_t cell[3];
        for (cell[0] = 0; cell[0] <= last[0]; ++cell[0])
            for (cell[1] = 0; cell[1] <= last[1]; ++cell[1])
                for (cell[2] = 0; cell[2] <= last[2]; ++cell[2]) {
                    const int32_t row = *given++;
                    if (row < -1 || row >= int64_t(rows) || row >= NO_ROW)
                        throw std::invalid_argument("BodyMatcher: a row beyond the template");
                    const size_t at = grid.first_brick + grid.brick_of(cell);
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

    // Adds a capsule (a segment and a radius) around all template points of a link. The segment connects two distant
    // points, shortened so that the capsule is smallest.
    void add_capsule(size_t link) {
        std::vector<char> is_own(rows, 0);
        for (size_t brick = grids[link].first_brick; has_points[link] && brick < nearest.size(); ++brick)
            for (uint16_t row : nearest[brick].rows)
                if (row < rows) is_own[row] = 1;
        std::vector<const double *> own;
        for (size_t row = 0; row < rows; ++row)
            if (is_own[row]) own.push_back(points[row].at);
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
        inverse_squares.push_back(1 / std::max(squared_distance(&best[0], &best[3]), 1e-12));
    }

    std::vector<Grid> grids;
    std::vector<Brick> nearest;  // of all links
};
