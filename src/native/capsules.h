// Distances of points from bodies made of capsules, for geometry/capsules.py. Single precision and no branches let
// compilers vectorise over four points.
#pragma once

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "arrays.h"

// Points relative to their mean, metres, axis by axis: single precision is accurate near it.
struct CentredPoints {
    explicit CentredPoints(const Input<double, 2> &points) : count(points.shape(0)), places(3 * count) {
        if (points.shape(1) != 3) throw std::invalid_argument("points are not (n, 3)");
        for (size_t i = 0; i < count; ++i)
            for (size_t d = 0; d < 3; ++d) centre[d] += points.data()[3 * i + d] / double(count);
        for (size_t i = 0; i < count; ++i)
            for (size_t d = 0; d < 3; ++d) places[d * count + i] = float(points.data()[3 * i + d] - centre[d]);
    }

    // Lowers the distances `nearest` of points `begin` to `end` − 1 to those from a capsule's surface; is_first: sets them.
    // ends of its axis (2, 3), radius (2): metres.
    template <bool is_first>
    void lower(float *nearest, size_t begin, size_t end, const double *ends, const double *radius) const {
        const float *x = places.data(), *y = x + count, *z = y + count;
        float p[3], along[3], square = 0;
        for (size_t d = 0; d < 3; ++d) {
            p[d] = float(ends[d] - centre[d]), along[d] = float(ends[3 + d] - ends[d]);
            square += along[d] * along[d];
        }
        const float inverse = 1 / std::max(square, 1e-6f), near = float(radius[0]), wider = float(radius[1]) - near;
        for (size_t i = begin; i < end; ++i) {
            const float dx = x[i] - p[0], dy = y[i] - p[1], dz = z[i] - p[2];
            const float foot = (dx * along[0] + dy * along[1] + dz * along[2]) * inverse;
            const float share = 0.5f * (std::abs(foot) - std::abs(foot - 1) + 1);  // foot, clamped to 0 … 1
            const float ox = dx - share * along[0], oy = dy - share * along[1], oz = dz - share * along[2];
            const float here = std::abs(std::sqrt(ox * ox + oy * oy + oz * oz) - (near + share * wider));
            nearest[i] = is_first ? here : 0.5f * (nearest[i] + here - std::abs(nearest[i] - here));  // the minimum
        }
    }

    // Sets the distances `nearest` of the first n points from the nearest of some capsules. ends (capsules, 2, 3), radii
    // (capsules, 2): metres.
    void set_nearest(float *nearest, size_t n, size_t capsules, const double *ends, const double *radii) const {
        lower<true>(nearest, 0, n, ends, radii);
        for (size_t c = 1; c < capsules; ++c) lower<false>(nearest, 0, n, ends + 6 * c, radii + 2 * c);
    }

    const size_t count;

  private:
    double centre[3] = {0, 0, 0};
    std::vector<float> places;
};

// capsules.surface_distances: distances (bodies, n) of points (n, 3) from the nearest capsule surface of each body.
// ends (bodies, capsules, 2, 3), radii (bodies, capsules, 2): metres.
inline Output<float> capsule_surfaces(Input<double, 2> points, Input<double, 4> ends, Input<double, 3> radii) {
    const size_t n = points.shape(0), bodies = ends.shape(0), capsules = ends.shape(1);
    if (ends.shape(2) != 2 || ends.shape(3) != 3 || radii.shape(0) != bodies || radii.shape(1) != capsules ||
        radii.shape(2) != 2 || !capsules)
        throw std::invalid_argument("capsule_surfaces: shapes differ");
    const CentredPoints centred(points);
    Fresh<float> out(bodies * n);
    for (size_t b = 0; b < bodies; ++b)
        centred.set_nearest(&out.data[b * n], n, capsules, ends.data() + 6 * b * capsules, radii.data() + 2 * b * capsules);
    return out.give({bodies, n});
}
