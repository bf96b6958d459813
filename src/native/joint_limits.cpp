#include "joint_limits.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "algebra3.h"

namespace {

constexpr int SWEEPS = 4;          // sweeps of coordinate descent over the three angles
constexpr double ROUNDING = 1e-9;  // radians beyond a range that still count as inside

// The angle, wrapped into −π … π.
double wrapped(double angle) { return angle - 2 * PI * std::nearbyint(angle / (2 * PI)); }

// The angle clamped to a range.
double clamped(double angle, double centre, double half_width) {
    return centre + std::clamp(wrapped(angle - centre), -half_width, half_width);
}

// Coordinate descent from a triple of angles: sets each angle in turn to the value within its range for which Rx Ry Rz
// is nearest to `target`, given the other two. Writes the product to `result`; returns its inner product with `target`,
// which grows as they get nearer.
double descend(const double *target, const double *centre, const double *half_width, double *angles, double *result) {
    double rotations[3][9], part[9];
    for (int d = 0; d < 3; ++d) rotation_about(d, angles[d] = clamped(angles[d], centre[d], half_width[d]), rotations[d]);
    for (int sweep = 0; sweep < SWEEPS; ++sweep)
        for (int d = 0; d < 3; ++d) {
            // n: maximising the trace of (rotation about d) n brings the product of all three nearest to the target
            double later[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, n[9];
            for (int other = d + 1; other < 3; ++other) multiply(later, rotations[other], part), std::copy_n(part, 9, later);
            multiply(later, target, n, true);
            for (int other = 0; other < d; ++other) multiply(n, rotations[other], part), std::copy_n(part, 9, n);
            const int i = (d + 1) % 3, j = (d + 2) % 3;
            const double angle = std::atan2(n[3 * i + j] - n[3 * j + i], n[4 * i] + n[4 * j]);
            rotation_about(d, angles[d] = clamped(angle, centre[d], half_width[d]), rotations[d]);
        }
    double inner_product = 0;
    multiply(rotations[0], rotations[1], part);
    multiply(part, rotations[2], result);
    for (int i = 0; i < 9; ++i) inner_product += result[i] * target[i];
    return inner_product;
}

}  // namespace

bool nearest_allowed(const double *limit, const double *rotation, double *allowed) {
    const double *before = limit, *after = limit + 9, *centre = limit + 18, *half_width = limit + 21;
    double m[9], part[9];
    multiply(before, rotation, part);
    multiply(part, after, m);
    // the two triples of angles with Rx Ry Rz = m
    double angles[2][3] = {{std::atan2(-m[5], m[8]), std::atan2(m[2], std::hypot(m[0], m[1])), std::atan2(-m[1], m[0])}};
    for (int d = 0; d < 3; ++d) angles[1][d] = PI + (d == 1 ? -1 : 1) * angles[0][d];
    for (const auto &triple : angles) {
        bool inside = true;
        for (int d = 0; d < 3; ++d) inside &= std::abs(wrapped(triple[d] - centre[d])) <= half_width[d] + ROUNDING;
        if (inside) return false;
    }
    double best = -std::numeric_limits<double>::infinity(), nearest[9], product[9];
    for (auto &triple : angles) {
        const double inner_product = descend(m, centre, half_width, triple, product);
        if (inner_product > best) best = inner_product, std::copy_n(product, 9, nearest);
    }
    // beforeᵀ · nearest · afterᵀ
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
            part[3 * i + j] = 0;
            for (int k = 0; k < 3; ++k) part[3 * i + j] += before[3 * k + i] * nearest[3 * k + j];
        }
    multiply(part, after, allowed, true);
    return true;
}
