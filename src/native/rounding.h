// Rounding of floats, as NumPy's rint.
#pragma once

#include <cmath>

// Rounds to the nearest integer, halves to even: adding 1.5 · 2^52 leaves no bits below 1.
inline double rounded(double value) {
    constexpr double ALIGNED = 6755399441055744.0;
    return std::abs(value) < 1e15 ? (value + ALIGNED) - ALIGNED : std::nearbyint(value);
}
