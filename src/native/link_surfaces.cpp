// Points around the cylinders of links, for geometry/articulated_icp.py: closest links, outward normals, moments, nearest
// surfaces; and skinned points in the canonical pose, for geometry/skinning.py.

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "algebra3.h"
#include "arrays.h"
#include "capsules.h"

namespace {

// Posed cylinders: joints and axes (links, 3), lengths and radii (links), metres.
struct Cylinders {
    Cylinders(const Input<double, 2> &joints, const Input<double, 2> &axes, const Input<double, 1> &lengths,
              const Input<double, 1> &radii)
        : count(joints.shape(0)), joints(joints.data()), axes(axes.data()), lengths(lengths.data()), radii(radii.data()) {
        if (joints.shape(1) != 3 || axes.shape(1) != 3 || axes.shape(0) != count || !count || lengths.shape(0) != count ||
            radii.shape(0) != count)
            throw std::invalid_argument("cylinders of links: shapes differ");
    }

    // Place of a point relative to a link. offset: from its joint; radial: distance from the axis line; foot: closest
    // place along the axis; beyond: distance beyond the ends.
    struct Place {
        double offset[3], radial, foot, beyond;
    };

    Place place(size_t link, const double *point) const {
        Place at;
        for (int d = 0; d < 3; ++d) at.offset[d] = point[d] - joints[3 * link + d];
        const double along = dot(axes + 3 * link, at.offset);
        at.foot = std::clamp(along, 0.0, lengths[link]);
        at.beyond = along - at.foot;
        at.radial = std::sqrt(std::max(dot(at.offset, at.offset) - along * along, 0.0));
        return at;
    }

    // Positive if a direction at this place points away from the axis.
    double facing(size_t link, const Place &at, const double *direction) const {
        return dot(at.offset, direction) - at.foot * dot(axes + 3 * link, direction);
    }

    const size_t count;
    const double *joints, *axes, *lengths, *radii;
};

constexpr double FARTHEST = -745;  // logarithm of the closeness that underflows to zero

// Increases with articulated_icp.closeness: its logarithm outside the cylinder, the closeness itself inside.
double closeness_order(double radial, double beyond, double radius) {
    const double over = std::max(radial - radius, 0.0), distance = std::sqrt(over * over + beyond * beyond);
    return distance <= 0 ? 1 + std::max(1 - radial / radius, 0.0) : std::max(-distance / radius, FARTHEST);
}

// articulated_icp.segment: the link with the greatest closeness to each point. points (n, 3); normals (n, 3), or (0, 3).
Output<int64_t> closest_links(Input<double, 2> points, Input<double, 2> normals, Input<double, 2> joints,
                              Input<double, 2> axes, Input<double, 1> lengths, Input<double, 1> radii) {
    const size_t n = points.shape(0);
    const bool has_normals = normals.shape(0) > 0;
    const Cylinders links(joints, axes, lengths, radii);
    if (points.shape(1) != 3 || normals.shape(1) != 3 || (has_normals && normals.shape(0) != n))
        throw std::invalid_argument("closest_links: shapes differ");
    Fresh<int64_t> out(n);
    for (size_t i = 0; i < n; ++i) {
        double best = -std::numeric_limits<double>::infinity(), best_facing = FARTHEST;  // ignoring the normal, and with it
        int64_t nearest = 0, facing = -1;
        for (size_t link = 0; link < links.count; ++link) {
            const Cylinders::Place at = links.place(link, points.data() + 3 * i);
            const double close = closeness_order(at.radial, at.beyond, links.radii[link]);
            if (close > best) best = close, nearest = int64_t(link);
            if (!has_normals || close <= best_facing) continue;
            if (links.facing(link, at, normals.data() + 3 * i) > 0) best_facing = close, facing = int64_t(link);
        }
        out.data[i] = facing < 0 ? nearest : facing;
    }
    return out.give({n});
}

// articulated_icp.outward_normals: normals (n, 3) turned away from the axis of the link with the nearest surface.
Output<double> turned_outward(Input<double, 2> points, Input<double, 2> normals, Input<double, 2> joints, Input<double, 2> axes,
                              Input<double, 1> lengths, Input<double, 1> radii) {
    const size_t n = points.shape(0);
    const Cylinders links(joints, axes, lengths, radii);
    if (points.shape(1) != 3 || normals.shape(1) != 3 || normals.shape(0) != n)
        throw std::invalid_argument("turned_outward: shapes differ");
    Fresh<double> out(3 * n);
    for (size_t i = 0; i < n; ++i) {
        const double *normal = normals.data() + 3 * i;
        double best = std::numeric_limits<double>::infinity(), facing = 0;
        for (size_t link = 0; link < links.count; ++link) {
            const Cylinders::Place at = links.place(link, points.data() + 3 * i);
            const double distance = std::sqrt(at.radial * at.radial + at.beyond * at.beyond) - links.radii[link];
            if (distance < best) best = distance, facing = links.facing(link, at, normal);
        }
        for (int d = 0; d < 3; ++d) out.data[3 * i + d] = facing < 0 ? -normal[d] : normal[d];
    }
    return out.give({n, 3});
}

// articulated_icp.third_moments (count, 3, 3, 3) of points (n, 3). links (n): link of each point, below `count`.
Output<double> third_moments(Input<double, 2> points, Input<int64_t, 1> links, size_t count) {
    const size_t n = points.shape(0);
    if (points.shape(1) != 3 || links.shape(0) != n) throw std::invalid_argument("third_moments: shapes differ");
    std::vector<double> sums(10 * count, 0.0);
    std::vector<size_t> of_link(count, 0);
    for (size_t p = 0; p < n; ++p) {
        const size_t link = size_t(links.data()[p]);
        if (link >= count) throw std::invalid_argument("third_moments: no such link");
        ++of_link[link];
        const double *x = points.data() + 3 * p;
        size_t at = 10 * link;
        for (size_t i = 0; i < 3; ++i)
            for (size_t j = i; j < 3; ++j)
                for (size_t k = j; k < 3; ++k) sums[at++] += x[i] * x[j] * x[k];
    }
    Fresh<double> out(27 * count);
    for (size_t link = 0; link < count; ++link) {
        size_t at = 10 * link;
        for (size_t i = 0; i < 3; ++i)
            for (size_t j = i; j < 3; ++j)
                for (size_t k = j; k < 3; ++k, ++at) {
                    const double mean = sums[at] / double(std::max<size_t>(of_link[link], 1));
                    const size_t orders[6][3] = {{i, j, k}, {i, k, j}, {j, i, k}, {j, k, i}, {k, i, j}, {k, j, i}};
                    for (const auto &o : orders) out.data[27 * link + 9 * o[0] + 3 * o[1] + o[2]] = mean;
                }
    }
    return out.give({count, 3, 3, 3});
}

// Distance of a link's surface from its axis, as harmonics around and along it: articulated_icp.surface_shapes.
class LinkShape {
  public:
    static constexpr size_t HARMONICS = 10;

    // axis (3), a unit vector; length: of the link, metres; coefficients (HARMONICS).
    LinkShape(const double *axis, double length, const double *coefficients) : length_(length), coefficients_(coefficients) {
        const double across[3] = {std::abs(axis[0]) < 0.9 ? 1.0 : 0.0, std::abs(axis[0]) < 0.9 ? 0.0 : 1.0, 0.0};
        cross(axis, across, side_);
        const double norm = std::sqrt(dot(side_, side_));
        for (double &x : side_) x /= norm;
        cross(axis, side_, other_);
        for (size_t k = 0; k < HARMONICS; ++k) most_ += std::abs(coefficients[k]);
    }

    // No distance of the surface is larger.
    double most() const { return most_; }

    // The distance of the surface in the direction of an offset from the link's origin, `along` its axis, metres.
    double radius(const double *offset, double along) const {
        const double x = dot(offset, side_), y = dot(offset, other_), radial = std::sqrt(x * x + y * y);
        const double cosine = radial > 0 ? x / radial : 1, sine = radial > 0 ? y / radial : 0;
        const double share = std::clamp(along / length_, 0.0, 1.0) * 2 - 1;
        const double around[5] = {1, cosine, sine, cosine * cosine - sine * sine, 2 * sine * cosine};
        double sum = 0;
        for (size_t k = 0; k < 5; ++k) sum += (coefficients_[k] + share * coefficients_[5 + k]) * around[k];
        return sum;
    }

  private:
    double side_[3], other_[3], length_, most_ = 0;
    const double *coefficients_;
};

// articulated_icp.nearest_surface: the link with the nearest surface to each of points (n, 3) with normals (n, 3). shapes
// (links, 10), or (0, 10) for cylinders. Weights: of the distance beyond an end, and of a surface across the normal, metres.
Output<int64_t> nearest_surfaces(Input<double, 2> points, Input<double, 2> normals, Input<double, 2> joints,
                                 Input<double, 2> axes, Input<double, 1> lengths, Input<double, 1> radii,
                                 Input<double, 2> shapes, double beyond_weight, double across_m) {
    const size_t n = points.shape(0);
    const Cylinders links(joints, axes, lengths, radii);
    if (points.shape(1) != 3 || normals.shape(1) != 3 || normals.shape(0) != n || shapes.shape(1) != LinkShape::HARMONICS ||
        (shapes.shape(0) && shapes.shape(0) != links.count))
        throw std::invalid_argument("nearest_surfaces: shapes differ");
    std::vector<LinkShape> of_links;
    for (size_t link = 0; link < shapes.shape(0); ++link)
        of_links.emplace_back(axes.data() + 3 * link, lengths.data()[link], shapes.data() + LinkShape::HARMONICS * link);
    Fresh<int64_t> out(n);
    for (size_t i = 0; i < n; ++i) {
        const double *normal = normals.data() + 3 * i;
        double best = std::numeric_limits<double>::infinity();
        out.data[i] = 0;
        for (size_t link = 0; link < links.count; ++link) {
            const double *axis = axes.data() + 3 * link;
            double offset[3], away[3];
            for (size_t d = 0; d < 3; ++d) offset[d] = points.data()[3 * i + d] - joints.data()[3 * link + d];
            const double along = dot(offset, axis), foot = std::clamp(along, 0.0, lengths.data()[link]);
            for (size_t d = 0; d < 3; ++d) away[d] = offset[d] - foot * axis[d];
            const double distance = std::sqrt(dot(away, away)), beyond = beyond_weight * std::abs(along - foot);
            const double most = of_links.empty() ? radii.data()[link] : of_links[link].most();
            if (distance - most + beyond >= best) continue;
            const double radius = of_links.empty() ? radii.data()[link] : of_links[link].radius(offset, along);
            const double facing = std::abs(dot(away, normal)) / std::max(distance, 1e-6);
            const double cost = std::abs(distance - radius) + beyond + across_m * (1 - facing);
            if (cost < best) best = cost, out.data[i] = int64_t(link);
        }
    }
    return out.give({n});
}

// skinning.Skin.unposed: places (n, 3) of posed points in the canonical pose. a (links, 3, 3), b (links, 3): transforms;
// pairs (n, 2): links of each point; weights (n): of the first.
Output<double> unposed_places(Input<double, 3> a, Input<double, 2> b, Input<int64_t, 2> pairs, Input<double, 1> weights,
                              Input<double, 2> places) {
    const size_t n = places.shape(0), links = a.shape(0);
    if (a.shape(1) != 3 || a.shape(2) != 3 || b.shape(0) != links || b.shape(1) != 3 || pairs.shape(0) != n ||
        pairs.shape(1) != 2 || weights.shape(0) != n || places.shape(1) != 3)
        throw std::invalid_argument("unposed_places: shapes differ");
    Fresh<double> out(3 * n);
    for (size_t i = 0; i < n; ++i) {
        double m[9], right[3];
        const double share = weights.data()[i];
        const int64_t *pair = pairs.data() + 2 * i;
        for (int k = 0; k < 2; ++k)
            if (pair[k] < 0 || pair[k] >= int64_t(links)) throw std::invalid_argument("unposed_places: a link beyond the body");
        const double *one = a.data() + 9 * pair[0], *other = a.data() + 9 * pair[1];
        for (int k = 0; k < 9; ++k) m[k] = share * one[k] + (1 - share) * other[k];
        for (int d = 0; d < 3; ++d)
            right[d] = places.data()[3 * i + d] - (share * b.data()[3 * pair[0] + d] + (1 - share) * b.data()[3 * pair[1] + d]);
        double rows[3][3];  // of the adjugate, transposed
        cross(m + 3, m + 6, rows[0]), cross(m + 6, m, rows[1]), cross(m, m + 3, rows[2]);
        const double determinant = dot(m, rows[0]);
        for (int d = 0; d < 3; ++d)
            out.data[3 * i + d] = (rows[0][d] * right[0] + rows[1][d] * right[1] + rows[2][d] * right[2]) / determinant;
    }
    return out.give({n, 3});
}

}  // namespace

void bind_link_surfaces(nb::module_ &m) {
    m.def("capsule_surfaces", &capsule_surfaces);
    m.def("closest_links", &closest_links);
    m.def("turned_outward", &turned_outward);
    m.def("third_moments", &third_moments);
    m.def("nearest_surfaces", &nearest_surfaces);
    m.def("unposed_places", &unposed_places);
}
