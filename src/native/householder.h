// Orthonormal bases from rounded entries, by Householder reflections: stages/basis.py.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "vectors.h"

namespace householder {

constexpr size_t WIDTH = 16;  // columns reflected together: their sums fit into registers

// basis._mirror for rows i … n − 1 of column i of `entries` (n, k). All sums run from the first row to the last, as in
// NumPy: bytes depend on them.
inline void mirror_of(const int64_t *entries, size_t n, size_t k, size_t i, double *u) {
    double squares = 0;
    for (size_t r = i; r < n; ++r) {
        u[r] = double(entries[r * k + i]);
        squares += u[r] * u[r];
    }
    double norm = std::sqrt(squares);
    if (norm == 0 || u[i] > 0) {
        std::fill(u + i, u + n, 0.0);
        norm = 1.0;
        u[i] = -1.0;
    }
    for (size_t r = i; r < n; ++r) u[r] /= norm;
    u[i] -= 1;
    squares = 0;
    for (size_t r = i; r < n; ++r) squares += u[r] * u[r];
    norm = std::sqrt(squares);
    for (size_t r = i; r < n; ++r) u[r] /= norm;
}

// A row of a panel of columns, in registers.
struct Row {
    Four a, b, c, d;
};

ALWAYS_INLINE void clear(Row &row) { row.a = row.b = row.c = row.d = Four{} * 0.0; }

ALWAYS_INLINE void read(Row &row, const double *from) {
    load(row.a, from), load(row.b, from + 4), load(row.c, from + 8), load(row.d, from + 12);
}

ALWAYS_INLINE void write(const Row &row, double *to) {
    store(row.a, to), store(row.b, to + 4), store(row.c, to + 8), store(row.d, to + 12);
}

ALWAYS_INLINE void add(Row &sum, const Row &row, double times) {
    sum.a += row.a * times, sum.b += row.b * times, sum.c += row.c * times, sum.d += row.d * times;
}

ALWAYS_INLINE void subtract(Row &from, const Row &row, double times) {
    from.a = from.a - row.a * times, from.b = from.b - row.b * times;
    from.c = from.c - row.c * times, from.d = from.d - row.d * times;
}

// sums = uᵀ · rows i … n − 1 of a panel (n, WIDTH).
ALWAYS_INLINE void sums_along(const double *u, size_t i, size_t n, const double *panel, Row &sums) {
    Row row;
    clear(sums);
    for (size_t r = i; r < n; ++r) read(row, panel + r * WIDTH), add(sums, row, u[r]);
}

// Multiplies rows i … n − 1 by I − 2uuᵀ. along: uᵀ · these rows.
ALWAYS_INLINE void reflect(const double *u, size_t i, size_t n, const Row &along, double *panel) {
    Row row;
    for (size_t r = i; r < n; ++r) {
        read(row, panel + r * WIDTH);
        subtract(row, along, 2 * u[r]);
        write(row, panel + r * WIDTH);
    }
}

// Reflects a panel by mirrors (k, n), from 0 up to count or from count down to 0. One pass over the rows reflects them
// and computes the sums of the next reflection.
ALWAYS_INLINE void reflect_all(const double *mirrors, size_t n, size_t count, bool downwards, double *panel) {
    if (!count) return;
    size_t i = downwards ? count - 1 : 0;
    Row along, next, row;
    sums_along(mirrors + i * n, i, n, panel, along);
    for (size_t left = count - 1; left--;) {
        const double *const u = mirrors + i * n, *const v = downwards ? u - n : u + n;
        clear(next);
        if (downwards) {
            read(row, panel + (i - 1) * WIDTH), add(next, row, v[i - 1]);
        } else {
            read(row, panel + i * WIDTH), subtract(row, along, 2 * u[i]), write(row, panel + i * WIDTH);
        }
        for (size_t r = downwards ? i : i + 1; r < n; ++r) {
            read(row, panel + r * WIDTH);
            subtract(row, along, 2 * u[r]);
            write(row, panel + r * WIDTH);
            add(next, row, v[r]);
        }
        along = next;
        i = downwards ? i - 1 : i + 1;
    }
    reflect(mirrors + i * n, i, n, along, panel);
}

// Copies columns first … of a matrix (n, k) to a panel, and back.
inline void read_panel(const double *matrix, size_t n, size_t k, size_t first, double *panel) {
    const size_t count = std::min(WIDTH, k - first);
    for (size_t r = 0; r < n; ++r) std::copy_n(matrix + r * k + first, count, panel + r * WIDTH);
}

inline void write_panel(const double *panel, size_t n, size_t k, size_t first, double *matrix) {
    const size_t count = std::min(WIDTH, k - first);
    for (size_t r = 0; r < n; ++r) std::copy_n(panel + r * WIDTH, count, matrix + r * k + first);
}

// basis._compose for k ≤ n columns. A mirror does not change earlier columns of the identity.
ALWAYS_INLINE void compose(const int64_t *entries, size_t n, size_t k, double *basis) {
    std::vector<double> mirrors(n * k), panel(n * WIDTH);
    for (size_t i = 0; i < k; ++i) mirror_of(entries, n, k, i, mirrors.data() + i * n);
    for (size_t first = 0; first < k; first += WIDTH) {
        const size_t last = std::min(k, first + WIDTH);
        std::fill(panel.begin(), panel.end(), 0.0);
        for (size_t i = first; i < last; ++i) panel[i * WIDTH + i - first] = 1.0;
        reflect_all(mirrors.data(), n, last, true, panel.data());
        write_panel(panel.data(), n, k, first, basis);
    }
}

#ifdef HAS_AVX2_TWIN
WITH_AVX2 inline void compose_with_avx2(const int64_t *entries, size_t n, size_t k, double *basis) { compose(entries, n, k, basis); }

inline bool has_avx2() {
    static const bool found = processor_has_avx2();
    return found;
}
#endif

// The orthonormal basis (n, k) of rounded entries (n, k).
inline void compose_basis(const int64_t *entries, size_t n, size_t k, double *basis) {
#ifdef HAS_AVX2_TWIN
    if (has_avx2()) return compose_with_avx2(entries, n, k, basis);
#endif
    compose(entries, n, k, basis);
}

// basis._sum_differences: adds to rows of values (n, k), in place, the earlier rows `alike`; −1: none.
inline void sum_differences(int64_t *values, size_t n, size_t k, const int64_t *alike, size_t leading) {
    for (size_t r = 0; r < n; ++r) {
        if (alike[r] < 0) continue;
        uint64_t *to = reinterpret_cast<uint64_t *>(values) + r * k;  // sums may wrap around
        const int64_t *other = values + size_t(alike[r]) * k;
        for (size_t c = 0; c < leading; ++c) to[c] += uint64_t(other[c]);
    }
}

}  // namespace householder
