// Vectors of 3, quaternions and 3 × 3 matrices for one frame (double) or four at a time (Four), with the same
// operations in the same order and so equal bits.
#pragma once

#include "vectors.h"

#include <cmath>

namespace joint_solver {

constexpr double TINY = 1e-12;

// Applies a function of one number, lane by lane.
template <class F>
ALWAYS_INLINE double each(F f, double x) { return f(x); }
template <class F>
ALWAYS_INLINE double each(F f, double x, double y) { return f(x, y); }
ALWAYS_INLINE double where_above(double x, double limit, double yes, double no) { return x > limit ? yes : no; }
ALWAYS_INLINE double lane(double x, size_t) { return x; }
ALWAYS_INLINE void set_lane(double &x, size_t, double value) { x = value; }
#if defined(__GNUC__)
template <class F>
ALWAYS_INLINE Four each(F f, const Four &x) { return Four{f(x[0]), f(x[1]), f(x[2]), f(x[3])}; }
template <class F>
ALWAYS_INLINE Four each(F f, const Four &x, const Four &y) {
    return Four{f(x[0], y[0]), f(x[1], y[1]), f(x[2], y[2]), f(x[3], y[3])};
}
ALWAYS_INLINE Four where_above(const Four &x, double limit, const Four &yes, const Four &no) {
    return x > limit ? yes : no;
}
ALWAYS_INLINE double lane(const Four &x, size_t i) { return x[i]; }
ALWAYS_INLINE void set_lane(Four &x, size_t i, double value) { x[i] = value; }
#endif

template <class T>
ALWAYS_INLINE T root(const T &x) { return each([](double y) { return std::sqrt(y); }, x); }
template <class T>
ALWAYS_INLINE T sine(const T &x) { return each([](double y) { return std::sin(y); }, x); }
template <class T>
ALWAYS_INLINE T cosine(const T &x) { return each([](double y) { return std::cos(y); }, x); }
template <class T>
ALWAYS_INLINE T arctangent(const T &y, const T &x) {
    return each([](double a, double b) { return std::atan2(a, b); }, y, x);
}

// Vectors of 3; U, V: constants (double) or T.

template <class T, class U, class V>
ALWAYS_INLINE T inner(const U *u, const V *v) { return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]; }

template <class U, class V, class T>
ALWAYS_INLINE void crossed(const U *u, const V *v, T *out) {
    out[0] = u[1] * v[2] - u[2] * v[1];
    out[1] = u[2] * v[0] - u[0] * v[2];
    out[2] = u[0] * v[1] - u[1] * v[0];
}

// out = p q, or p qᵀ, 3 × 3.
template <class P, class Q, class T>
ALWAYS_INLINE void matrix_product(const P *p, const Q *q, T *out, bool transpose_q = false) {
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
            T sum{};
            for (int k = 0; k < 3; ++k) sum += p[3 * i + k] * (transpose_q ? q[3 * j + k] : q[3 * k + j]);
            out[3 * i + j] = sum;
        }
}

// Quaternions, w first.

template <class P, class Q, class T>
ALWAYS_INLINE void product(const P *p, const Q *q, T *out) {
    const T r[4] = {p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
                    p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
                    p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
                    p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0]};
    for (int i = 0; i < 4; ++i) out[i] = r[i];
}

template <class Q, class V, class T>
ALWAYS_INLINE void turned(const Q *q, const V *v, T *out, double sign = 1) {
    const Q u[3] = {sign * q[1], sign * q[2], sign * q[3]};
    T c[3], d[3];
    crossed(u, v, c);
    for (int i = 0; i < 3; ++i) c[i] += q[0] * v[i];
    crossed(u, c, d);
    for (int i = 0; i < 3; ++i) out[i] = v[i] + 2.0 * d[i];
}

template <class Q, class V, class T>
ALWAYS_INLINE void turned_back(const Q *q, const V *v, T *out) { turned(q, v, out, -1); }

template <int N, class T>
ALWAYS_INLINE void normalise(T *v) {
    T sum{};
    for (int i = 0; i < N; ++i) sum += v[i] * v[i];
    const T length = root(sum);
    for (int i = 0; i < N; ++i) v[i] = where_above(length, TINY, v[i] / length, T{} + (i == 0 ? 1.0 : 0.0));
}

template <class T>
ALWAYS_INLINE void about(const double *axis, const T &angle, T *out) {
    const T half = angle / 2.0, s = sine(half);
    out[0] = cosine(half);
    for (int i = 0; i < 3; ++i) out[1 + i] = s * axis[i];
}

// Matrix of a quaternion, which need not be a unit quaternion.
template <class T>
ALWAYS_INLINE void matrix_of(const T *q, T *m) {
    const T w = q[0], x = q[1], y = q[2], z = q[3];
    const T rows[9] = {1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z),       2.0 * (x * z + w * y),
                       2.0 * (x * y + w * z),       1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x),
                       2.0 * (x * z - w * y),       2.0 * (y * z + w * x),       1.0 - 2.0 * (x * x + y * y)};
    for (int i = 0; i < 9; ++i) m[i] = rows[i];
}

template <class T>
ALWAYS_INLINE void quaternion_of(const T *m, T *q) {
    const T trace = m[0] + m[4] + m[8];
    const T squares[4] = {1.0 + trace, 1.0 - trace + 2.0 * m[0], 1.0 - trace + 2.0 * m[4], 1.0 - trace + 2.0 * m[8]};
    const T a[4][4] = {{squares[0], m[7] - m[5], m[2] - m[6], m[3] - m[1]},
                       {m[7] - m[5], squares[1], m[1] + m[3], m[2] + m[6]},
                       {m[2] - m[6], m[1] + m[3], squares[2], m[5] + m[7]},
                       {m[3] - m[1], m[2] + m[6], m[5] + m[7], squares[3]}};
    for (size_t l = 0; l < sizeof(T) / sizeof(double); ++l) {
        int best = 0;
        for (int i = 1; i < 4; ++i) best = lane(squares[i], l) > lane(squares[best], l) ? i : best;
        for (int i = 0; i < 4; ++i) set_lane(q[i], l, lane(a[best][i], l));
    }
    normalise<4>(q);
}

// A frame of columns: along a; in the plane of a and b; normal to both.
template <class T>
ALWAYS_INLINE void pair_frame(const T *a, const T *b, T *m) {
    T x[3] = {a[0], a[1], a[2]}, y[3], z[3];
    normalise<3>(x);
    crossed(x, b, z);
    normalise<3>(z);
    crossed(z, x, y);
    for (int i = 0; i < 3; ++i) m[3 * i] = x[i], m[3 * i + 1] = y[i], m[3 * i + 2] = z[i];
}

}  // namespace joint_solver
