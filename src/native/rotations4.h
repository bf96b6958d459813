// codecs/tempo/pose/rotations.py for four frames at a time: the same operations in the same order.
#pragma once

#include <algorithm>
#include <cmath>

#include "vectors.h"

namespace rotations4 {

constexpr double LARGEST_SERIES_ANGLE_2 = 10;

// SinCos.of: sin a / a, cos a, (1 − cos a) / a² of squared angles.
ALWAYS_INLINE void sin_cos(const Four &squared, Four &sine, Four &cosine, Four &versed) {
    constexpr double S[] = {1.0,          1.0 / 6,          1.0 / 120,          1.0 / 5040,
                            1.0 / 362880, 1.0 / 39916800.0, 1.0 / 6227020800.0, 1.0 / 1307674368000.0};
    constexpr double C[] = {1.0,           1.0 / 2,           1.0 / 24,           1.0 / 720,           1.0 / 40320,
                            1.0 / 3628800, 1.0 / 479001600.0, 1.0 / 87178291200.0, 1.0 / 20922789888000.0};
    Four share, half;
    if (squared[0] <= LARGEST_SERIES_ANGLE_2 && squared[1] <= LARGEST_SERIES_ANGLE_2 &&
        squared[2] <= LARGEST_SERIES_ANGLE_2 && squared[3] <= LARGEST_SERIES_ANGLE_2) {
        const Four quarter = squared * (-1.0 / 16);
        share = quarter * S[7], half = quarter * C[8];
        for (int i = 6; i > 0; --i) share = (share + S[i]) * quarter;
        for (int i = 7; i > 0; --i) half = (half + C[i]) * quarter;
        share += S[0], half += C[0];
        share *= half;
        half = half * half * 2.0 - 1.0;
    } else {
        for (int i = 0; i < 4; ++i) {
            const double angle = std::max(std::sqrt(squared[i]) * 0.5, 1e-150);
            share[i] = std::sin(angle) / angle, half[i] = std::cos(angle);
        }
    }
    versed = share * share * 0.5;
    sine = share * half;
    cosine = 1.0 - versed * squared;
}

// arctan2(y, x) for y ≥ 0; y_2 = y². Halves the angle twice; then a rational function
// (Cephes, atan.c) is exact up to rounding.
ALWAYS_INLINE Four angle_of(const Four &y, const Four &y_2, const Four &x) {
    constexpr double PI = 3.14159265358979323846;
    constexpr double P[] = {-8.750608600031904122785e-1, -1.615753718733365076637e1, -7.500855792314704667340e1,
                            -1.228866684490136173410e2, -6.485021904942025371773e1};
    constexpr double Q[] = {2.485846490142306297962e1, 1.650270098316988542046e2, 4.328810604912902668951e2,
                            4.853903996359136964868e2, 1.945506571482613964425e2};
    const Four length = root(x * x + y_2);
    const Four half = y / at_least(length + magnitude(x), 1e-300);
    const Four t = half / (root(half * half + 1.0) + 1.0);
    const Four z = t * t;
    Four p = z * P[0], q = z + Q[0];
    for (int i = 1; i < 4; ++i) p = (p + P[i]) * z;
    p = (p + P[4]) * z;
    for (int i = 1; i < 5; ++i) q = q * z + Q[i];
    const Four angle = (t + t * (p / q)) * 4.0;
    return where_less(x, 0, PI - angle, angle);
}

// out = frame · vector; a frame is stored as its three axes.
template <class Frame>
ALWAYS_INLINE void out_of(const Frame *frame, const Four *vector, Four *out) {
    for (size_t a = 0; a < 3; ++a) out[a] = frame[a] * vector[0] + frame[3 + a] * vector[1] + frame[6 + a] * vector[2];
}

// out = frame⁻¹ · vector.
template <class Frame>
ALWAYS_INLINE void into(const Frame *frame, const Four *vector, Four *out) {
    for (size_t a = 0; a < 3; ++a)
        out[a] = frame[3 * a] * vector[0] + frame[3 * a + 1] * vector[1] + frame[3 * a + 2] * vector[2];
}

// frames_of: the frame of a rotation vector.
ALWAYS_INLINE void frame_of(const Four *vector, Four *out) {
    constexpr size_t PLUS[] = {5, 6, 1}, MINUS[] = {7, 2, 3};
    Four sine, cosine, versed;
    sin_cos(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2], sine, cosine, versed);
    for (size_t a = 0; a < 3; ++a)
        for (size_t b = 0; b < 3; ++b) out[3 * a + b] = vector[a] * (vector[b] * versed);
    for (size_t a = 0; a < 3; ++a) {
        const Four across = vector[a] * sine;
        out[4 * a] += cosine;
        out[PLUS[a]] += across;
        out[MINUS[a]] -= across;
    }
}

// tilted_directions: direction of a bone after a tilt, `out` (3,).
ALWAYS_INLINE void tilted_direction(const double *rest, const Four &x, const Four &y, Four *out) {
    Four sine, cosine, versed;
    sin_cos(x * x + y * y, sine, cosine, versed);
    for (size_t a = 0; a < 3; ++a) out[a] = (x * rest[a] + y * rest[3 + a]) * sine + cosine * rest[6 + a];
}

// tilted_frames: all three axes of a bone after a tilt; the third is its direction.
ALWAYS_INLINE void tilted_frame(const double *rest, const Four &x, const Four &y, Four *out) {
    Four sine, cosine, versed;
    sin_cos(x * x + y * y, sine, cosine, versed);
    for (size_t a = 0; a < 3; ++a) {
        Four tilt = x * rest[a] + y * rest[3 + a];
        out[6 + a] = tilt * sine + cosine * rest[6 + a];
        tilt = tilt * versed + sine * rest[6 + a];
        out[a] = rest[a] - x * tilt;
        out[3 + a] = rest[3 + a] - y * tilt;
    }
}

}  // namespace rotations4
