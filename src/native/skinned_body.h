// A body's links and surface template: skinning, poses, and each link's grid of nearest template points.
#pragma once

#include <algorithm>
#include <cmath>
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
        : count(parents.shape(0)), rows(points.shape(0)), coloured(colours.shape(0) > 0), cell(cell), margin(margin),
          parents(copy(parents)), origins(copy(origins)), lengths(copy(lengths)), points(copy(points)),
          links(copy(links)), weights(copy(weights)), normals(copy(normals)), colours(copy(colours)),
          nearest(narrowed(nearest, rows)), low(copy(low)), size(copy(size)), start(copy(start)) {
        const bool same = origins.shape(0) == count && lengths.shape(0) == count && links.shape(0) == rows &&
                          links.shape(1) == 2 && weights.shape(0) == rows && normals.shape(0) == rows &&
                          low.shape(0) == count && size.shape(0) == count && start.shape(0) == count &&
                          (!coloured || colours.shape(0) == rows);
        const bool three = origins.shape(1) == 3 && points.shape(1) == 3 && normals.shape(1) == 3 &&
                           low.shape(1) == 3 && size.shape(1) == 3 && (!coloured || colours.shape(1) == 3);
        if (!same || !three || !count || !rows) throw std::invalid_argument("BodyMatcher: shapes differ");
        for (size_t l = 0; l < count; ++l) {
            const int32_t *s = &this->size[3 * l];
            if (this->parents[l] >= int64_t(l))
                throw std::invalid_argument("BodyMatcher: a link stands before its parent");
            if (s[0] < 1 || s[1] < 1 || s[2] < 1 || this->start[l] < 0 ||
                uint64_t(this->start[l]) + uint64_t(s[0]) * s[1] * s[2] > this->nearest.size())
                throw std::invalid_argument("BodyMatcher: a grid is beyond the end of its array");
            has_points.push_back(this->nearest[this->start[l]] != NO_ROW);
        }
        for (size_t l = 0; l < count; ++l) add_bounding_sphere(l);
        for (int64_t link : this->links)
            if (link < 0 || link >= int64_t(count)) throw std::invalid_argument("BodyMatcher: a link beyond the body");
    }

    void set_pose(const double *new_rotations, const double *new_root) {
        rotations.assign(new_rotations, new_rotations + 9 * count);
        root.assign(new_root, new_root + 3);
        update_transforms();
    }

    // A and b of every link, and the centres of their bounding spheres, from `rotations` and `root`.
    void update_transforms() {
        a.resize(9 * count);
        b.resize(3 * count);
        world_centres.resize(3 * count);
        for (size_t link = 0; link < count; ++link) {
            update_transform(int64_t(link));
            place(link, &centres[3 * link], &world_centres[3 * link]);
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
        int64_t index = 0;
        for (int d = 0; d < 3; ++d) {
            const int32_t most = size[3 * link + d] - 1;
            const double x = (local[d] - low[3 * link + d]) * (1 / cell);
            index = index * (most + 1) + (x <= 0 ? 0 : x >= most ? most : int32_t(x));
        }
        return nearest[start[link] + index];
    }

    // Whether no template point of a link is nearer to a place of the world than `reach`, by its bounding sphere.
    bool is_beyond(int64_t link, const double *place, double reach) const {
        return squared_distance(place, &world_centres[3 * link]) >= squared(radii[link] + reach);
    }

    // Squared distance of a place in a link's coordinates from the bounding box of the link's template points: a lower
    // bound of its distance from any of them.
    double box_distance(int64_t link, const double *local) const {
        double sum = 0;
        for (int d = 0; d < 3; ++d) {
            const double from = low[3 * link + d] + margin;
            const double to = low[3 * link + d] + cell * size[3 * link + d] - margin;
            sum += squared(std::max(0.0, std::max(from - local[d], local[d] - to)));
        }
        return sum;
    }

    const size_t count, rows;  // of links, of template points
    const bool coloured;
    const double cell, margin;
    const std::vector<int64_t> parents;
    const Doubles origins, lengths, points;
    const std::vector<int64_t> links;
    const Doubles weights, normals, colours;
    std::vector<char> has_points;
    Doubles centres, radii;                   // bounding spheres of the links' template points, canonical
    Doubles rotations, root;                  // the current pose
    Doubles a, b, world_centres;              // what follows from it

  private:
    static constexpr uint16_t NO_ROW = 0xffff;

    // Template rows in 16 bits: a link's grid then stays in the cache.
    static std::vector<uint16_t> narrowed(Input<int32_t, 1> nearest, size_t rows) {
        std::vector<uint16_t> result(nearest.size());
        for (size_t i = 0; i < nearest.size(); ++i) {
            const int32_t row = nearest.data()[i];
            if (row < -1 || row >= int64_t(rows) || row >= NO_ROW)
                throw std::invalid_argument("BodyMatcher: a row beyond the template");
            result[i] = row < 0 ? NO_ROW : uint16_t(row);
        }
        return result;
    }

    // The smallest sphere about the centre of a link's grid that holds all its template points.
    void add_bounding_sphere(size_t link) {
        const int32_t *s = &size[3 * link];
        for (int d = 0; d < 3; ++d) centres.push_back(low[3 * link + d] + cell * s[d] / 2);
        radii.push_back(0);
        if (!has_points[link]) return;
        for (int64_t at = start[link], end = at + int64_t(s[0]) * s[1] * s[2]; at < end; ++at) {
            const double away = squared_distance(&points[3 * nearest[at]], &centres[3 * link]);
            radii[link] = std::max(radii[link], std::sqrt(away));
        }
    }

    const std::vector<uint16_t> nearest;
    const Doubles low;
    const std::vector<int32_t> size;
    const std::vector<int64_t> start;
};
