// Vectors of 3 numbers and 3 × 3 matrices (row by row) as plain arrays; rotations and rotation vectors.
#pragma once

#include <algorithm>
#include <cmath>

constexpr double PI = 3.14159265358979323846;

inline double squared(double x) { return x * x; }

inline double dot(const double *u, const double *v) { return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]; }

inline double squared_distance(const double *u, const double *v) {
    return squared(u[0] - v[0]) + squared(u[1] - v[1]) + squared(u[2] - v[2]);
}

inline void cross(const double *u, const double *v, double *out) {
    out[0] = u[1] * v[2] - u[2] * v[1];
    out[1] = u[2] * v[0] - u[0] * v[2];
    out[2] = u[0] * v[1] - u[1] * v[0];
}

// out = m v.
inline void transform(const double *m, const double *v, double *out) {
    for (int i = 0; i < 3; ++i) out[i] = dot(m + 3 * i, v);
}

// out = mᵀ v: the inverse of `transform` if m is a rotation.
inline void transform_back(const double *m, const double *v, double *out) {
    for (int i = 0; i < 3; ++i) out[i] = m[i] * v[0] + m[3 + i] * v[1] + m[6 + i] * v[2];
}

// out = p q, or p qᵀ.
inline void multiply(const double *p, const double *q, double *out, bool transpose_q = false) {
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
            double sum = 0;
            for (int k = 0; k < 3; ++k) sum += p[3 * i + k] * (transpose_q ? q[3 * j + k] : q[3 * k + j]);
            out[3 * i + j] = sum;
        }
}

// Rotation matrix of a rotation vector, radians, by Rodrigues' formula: articulation.exp.
inline void exponential(const double *vector, double *out) {
    const double angle = std::sqrt(dot(vector, vector));
    const bool small = angle < 1e-6;
    const double s = small ? 1.0 : std::sin(angle) / angle;
    const double c = small ? 0.5 : (1 - std::cos(angle)) / (angle * angle);
    const double x = vector[0], y = vector[1], z = vector[2];
    const double k[9] = {0, -z, y, z, 0, -x, -y, x, 0};
    double kk[9];
    multiply(k, k, kk);
    for (int i = 0; i < 9; ++i) out[i] = (i % 4 == 0) + s * k[i] + c * kk[i];
}

// Rotation vector of a rotation matrix, through the largest quaternion component: articulation.log.
inline void logarithm(const double *m, double *out) {
    const double trace = m[0] + m[4] + m[8];
    const double squares[4] = {1 + trace, 1 - trace + 2 * m[0], 1 - trace + 2 * m[4], 1 - trace + 2 * m[8]};
    const double w[4] = {squares[0], m[7] - m[5], m[2] - m[6], m[3] - m[1]};
    const double x[4] = {w[1], squares[1], m[1] + m[3], m[2] + m[6]};
    const double y[4] = {w[2], x[2], squares[2], m[5] + m[7]};
    const double z[4] = {w[3], x[3], y[3], squares[3]};
    const double *const multiples[4] = {w, x, y, z};  // multiples of one quaternion
    const double *best = multiples[std::max_element(squares, squares + 4) - squares];
    const double norm = std::sqrt(best[0] * best[0] + dot(best + 1, best + 1)) * (best[0] < 0 ? -1 : 1);
    const double q[4] = {best[0] / norm, best[1] / norm, best[2] / norm, best[3] / norm};
    const double sine = std::sqrt(dot(q + 1, q + 1));
    const double factor = sine > 1e-12 ? 2 * std::atan2(sine, q[0]) / sine : 2.0;
    for (int i = 0; i < 3; ++i) out[i] = q[1 + i] * factor;
}

// Rotation matrix about a coordinate axis (0, 1 or 2) by an angle in radians.
inline void rotation_about(int axis, double angle, double *out) {
    const int i = (axis + 1) % 3, j = (axis + 2) % 3;
    std::fill_n(out, 9, 0.0);
    out[4 * axis] = 1;
    out[4 * i] = out[4 * j] = std::cos(angle);
    out[3 * j + i] = std::sin(angle);
    out[3 * i + j] = -out[3 * j + i];
}
