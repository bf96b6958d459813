// Solution of normal equations whose unknowns are the joints of a tree, for normal_equations.h and capsule_fitter.h.
#pragma once

#include <cmath>
#include <cstddef>
#include <vector>

// Replaces g by the solution x of h x = g, with a Cholesky decomposition from the last unknown to the first: a joint then
// couples only to its ancestors, and to few others. h (n, n) is symmetric, and overwritten. False if h is not positive
// definite.
inline bool solve_symmetric(std::vector<double> &h, std::vector<double> &g) {
    const size_t n = g.size();
    std::vector<size_t> coupled;
    coupled.reserve(n);
    for (size_t j = n; j-- > 0;) {
        double *row = &h[j * n];
        if (!(row[j] > 0)) return false;
        const double scale = 1 / std::sqrt(row[j]);
        coupled.clear();
        for (size_t k = 0; k < j; ++k)
            if (row[k] != 0) row[k] *= scale, coupled.push_back(k);
        row[j] *= scale;
        g[j] *= scale;
        for (size_t i : coupled) {
            double *other = &h[i * n];
            for (size_t k : coupled) {
                if (k > i) break;
                other[k] -= row[i] * row[k];
            }
            g[i] -= row[i] * g[j];
        }
    }
    for (size_t i = 0; i < n; ++i) {
        double sum = g[i];
        for (size_t k = 0; k < i; ++k) sum -= h[i * n + k] * g[k];
        g[i] = sum / h[i * n + i];
    }
    return true;
}
