// Geometry of the lattice engine: axes of a residual, and nearby points of the body-centred cubic lattice (three even
// or three odd coordinates, in half steps).
#pragma once

#include <cmath>
#include <cstdint>

#include "least_squares.h"

namespace lattice {

constexpr double RADIUS_2 = 1.25;  // squared covering radius of the lattice, half steps

// Adds two axes at right angles to the first.
inline void complete_axes(Vec (&axes)[3]) {
    const Vec u = axes[0];
    const double a = std::fabs(u[0]), b = std::fabs(u[1]), c = std::fabs(u[2]);
    const int least = a < b ? (a < c ? 0 : 2) : (b < c ? 1 : 2);
    Vec v;
    for (int k = 0; k < 3; ++k) v[k] = (k == least ? 1.0 : 0.0) - u[least] * u[k];
    const double length = std::sqrt(square(v));
    for (int k = 0; k < 3; ++k) v[k] /= length;
    axes[1] = v;
    axes[2][0] = u[1] * v[2] - u[2] * v[1];
    axes[2][1] = u[2] * v[0] - u[0] * v[2];
    axes[2][2] = u[0] * v[1] - u[1] * v[0];
}

struct Candidate {
    int64_t z[3];
    double square;  // squared distance from the residual
    int odd;
};

inline void nearest(const double *residual, int64_t *z) {
    double even[3], odd[3], even2 = 0, odd2 = 0;
    for (int k = 0; k < 3; ++k) {
        even[k] = std::floor(residual[k] / 2 + 0.5) * 2;
        odd[k] = std::floor(residual[k] / 2) * 2 + 1;
        even2 += (residual[k] - even[k]) * (residual[k] - even[k]);
        odd2 += (residual[k] - odd[k]) * (residual[k] - odd[k]);
    }
    for (int k = 0; k < 3; ++k) z[k] = int64_t(even2 <= odd2 ? even[k] : odd[k]);
}

// Finds the points within the covering radius, at most 16. Returns their number, which rounding may make 0.
inline int candidates(const double *residual, Candidate *within) {
    int count = 0;
    for (int odd = 0; odd < 2; ++odd) {
        int64_t low[3];
        double squares[3][2];
        for (int k = 0; k < 3; ++k) {
            low[k] = int64_t(std::floor((residual[k] - odd) / 2)) * 2 + odd;
            for (int up = 0; up < 2; ++up) {
                const double off = residual[k] - double(low[k] + 2 * up);
                squares[k][up] = off * off;
            }
        }
        for (int corner = 0; corner < 8; ++corner) {
            const int up[3] = {corner & 1, corner >> 1 & 1, corner >> 2};
            const double square = squares[0][up[0]] + squares[1][up[1]] + squares[2][up[2]];
            if (square > RADIUS_2) continue;
            Candidate &found = within[count++];
            for (int k = 0; k < 3; ++k) found.z[k] = low[k] + 2 * up[k];
            found.square = square;
            found.odd = odd;
        }
    }
    return count;
}

}  // namespace lattice
