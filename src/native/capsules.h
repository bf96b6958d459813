// Distances of points from bodies made of capsules, for geometry/capsules.py. Single precision and no branches let
// compilers vectorise over four points.
#pragma once

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "arrays.h"

// capsules.surface_distances: distances (bodies, n) of points (n, 3) from the nearest capsule surface of each body.
// ends (bodies, capsules, 2, 3), radii (bodies, capsules, 2): metres.
inline Output<float> capsule_surfaces(Input<double, 2> points, Input<double, 4> ends, Input<double, 3> radii) {
    const size_t n = points.shape(0), bodies = ends.shape(0), capsules = ends.shape(1);
    if (points.shape(1) != 3 || ends.shape(2) != 2 || ends.shape(3) != 3 || radii.shape(0) != bodies ||
        radii.shape(1) != capsules || radii.shape(2) != 2 || !capsules)
        throw std::invalid_argument("capsule_surfaces: shapes differ");
    double centre[3] = {0, 0, 0};  // as origin: single precision is accurate near it
    for (size_t i = 0; i < n; ++i)
        for (size_t d = 0; d < 3; ++d) centre[d] += points.data()[3 * i + d] / double(n);
    std::vector<float> places(3 * n);  // axis by axis
    for (size_t i = 0; i < n; ++i)
        for (size_t d = 0; d < 3; ++d) places[d * n + i] = float(points.data()[3 * i + d] - centre[d]);
    const float *x = places.data(), *y = x + n, *z = y + n;
    Fresh<float> out(bodies * n);
    for (size_t b = 0; b < bodies; ++b) {
        float *nearest = &out.data[b * n];
        for (size_t c = 0; c < capsules; ++c) {
            const double *end = ends.data() + 6 * (b * capsules + c), *radius = radii.data() + 2 * (b * capsules + c);
            float p[3], along[3], square = 0;
            for (size_t d = 0; d < 3; ++d) {
                p[d] = float(end[d] - centre[d]), along[d] = float(end[3 + d] - end[d]);
                square += along[d] * along[d];
            }
            const float inverse = 1 / std::max(square, 1e-6f), near = float(radius[0]), wider = float(radius[1]) - near;
            const auto away = [&](size_t i) {
                const float dx = x[i] - p[0], dy = y[i] - p[1], dz = z[i] - p[2];
                const float foot = (dx * along[0] + dy * along[1] + dz * along[2]) * inverse;
                const float share = 0.5f * (std::abs(foot) - std::abs(foot - 1) + 1);  // foot, clamped to 0 … 1
                const float ox = dx - share * along[0], oy = dy - share * along[1], oz = dz - share * along[2];
                return std::abs(std::sqrt(ox * ox + oy * oy + oz * oz) - (near + share * wider));
            };
            for (size_t i = 0; i < n && !c; ++i) nearest[i] = away(i);
            for (size_t i = 0; i < n && c; ++i) {
                const float here = away(i);
                nearest[i] = 0.5f * (nearest[i] + here - std::abs(nearest[i] - here));  // the minimum
            }
        }
    }
    return out.give({bodies, n});
}
