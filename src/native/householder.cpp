// Orthonormal bases stored as Householder reflections, for stages/basis.py.

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "arrays.h"
#include "vectors.h"

namespace {

constexpr size_t WIDTH = 16;  // columns reflected together: their sums fit into registers

// basis._mirror for rows i … n − 1 of column i of `entries` (n, k). All sums run from the first row to the last, as in
// NumPy: bytes depend on them.
void mirror_of(const int64_t *entries, size_t n, size_t k, size_t i, double *u) {
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
void read_panel(const double *matrix, size_t n, size_t k, size_t first, double *panel) {
    const size_t count = std::min(WIDTH, k - first);
    for (size_t r = 0; r < n; ++r) std::copy_n(matrix + r * k + first, count, panel + r * WIDTH);
}

void write_panel(const double *panel, size_t n, size_t k, size_t first, double *matrix) {
    const size_t count = std::min(WIDTH, k - first);
    for (size_t r = 0; r < n; ++r) std::copy_n(panel + r * WIDTH, count, matrix + r * k + first);
}

// basis._decompose: reflects each panel by the mirrors of earlier columns, then by its own, one by one.
ALWAYS_INLINE void decompose(const double *basis, const double *scales, size_t n, size_t k, int64_t *entries) {
    std::vector<double> mirrors(n * k), panel(n * WIDTH);
    for (size_t first = 0; first < k; first += WIDTH) {
        read_panel(basis, n, k, first, panel.data());
        reflect_all(mirrors.data(), n, first, false, panel.data());
        for (size_t i = first; i < std::min(k, first + WIDTH); ++i) {
            const double *rest = panel.data() + (i - first);
            const double sign = rest[i * WIDTH] > 0 ? -1 : 1;
            for (size_t r = i; r < n; ++r) entries[r * k + i] = int64_t(std::nearbyint(sign * rest[r * WIDTH] * scales[i]));
            double *u = mirrors.data() + i * n;
            mirror_of(entries, n, k, i, u);
            Row along;  // columns up to i are not needed again
            sums_along(u, i, n, panel.data(), along);
            reflect(u, i, n, along, panel.data());
        }
    }
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
WITH_AVX2 void decompose_with_avx2(const double *basis, const double *scales, size_t n, size_t k, int64_t *entries) {
    decompose(basis, scales, n, k, entries);
}

WITH_AVX2 void compose_with_avx2(const int64_t *entries, size_t n, size_t k, double *basis) { compose(entries, n, k, basis); }

bool has_avx2() {
    static const bool found = processor_has_avx2();
    return found;
}
#endif

// basis._decompose: entries (n, k) of an orthonormal basis (n, k), rounded to multiples of 1 / scales (k).
Output<int64_t> basis_decompose(Input<double, 2> basis, Input<double, 1> scales) {
    const size_t n = basis.shape(0), k = basis.shape(1);
    if (scales.shape(0) != k || k > n) throw std::invalid_argument("basis_decompose: shapes differ");
    Fresh<int64_t> out(n * k);
    {
        nb::gil_scoped_release release;
        std::fill_n(out.data.get(), n * k, 0);
#ifdef HAS_AVX2_TWIN
        if (has_avx2()) decompose_with_avx2(basis.data(), scales.data(), n, k, out.data.get());
        else
#endif
            decompose(basis.data(), scales.data(), n, k, out.data.get());
    }
    return out.give({n, k});
}

// basis._compose
Output<double> basis_compose(Input<int64_t, 2> entries) {
    const size_t n = entries.shape(0), k = entries.shape(1);
    if (k > n) throw std::invalid_argument("basis_compose: more columns than rows");
    Fresh<double> out(n * k);
    {
        nb::gil_scoped_release release;
#ifdef HAS_AVX2_TWIN
        if (has_avx2()) compose_with_avx2(entries.data(), n, k, out.data.get());
        else
#endif
            compose(entries.data(), n, k, out.data.get());
    }
    return out.give({n, k});
}

// basis._signs_of_reflections for the corner (k, k) of orthonormal columns.
Output<double> basis_signs(Input<double, 2> corner, double zero) {
    const size_t k = corner.shape(0);
    if (corner.shape(1) != k) throw std::invalid_argument("basis_signs: the corner is not square");
    std::vector<double> left(corner.data(), corner.data() + k * k);
    Fresh<double> out(k);
    for (size_t i = 0; i < k; ++i) {
        const double *pivot = left.data() + i * k;
        const double sign = pivot[i] > (i ? -zero : zero) ? -1.0 : 1.0, by = pivot[i] - sign;
        out.data[i] = sign;
        for (size_t r = i + 1; r < k; ++r) {
            double *row = left.data() + r * k;
            const double share = row[i] / by;
            for (size_t c = i + 1; c < k; ++c) row[c] -= share * pivot[c];
        }
    }
    return out.give({k});
}

// basis._sum_differences: adds to rows of values (n, k), in place, the earlier rows `alike`; −1: none.
void basis_sum_differences(InPlace<int64_t, 2> values, Input<int64_t, 1> alike, size_t leading) {
    const size_t n = values.shape(0), k = values.shape(1);
    if (alike.shape(0) != n || leading > k) throw std::invalid_argument("basis_sum_differences: shapes differ");
    for (size_t r = 0; r < n; ++r) {
        const int64_t from = alike.data()[r];
        if (from < 0) continue;
        if (size_t(from) >= n) throw std::invalid_argument("basis_sum_differences: no such row");
        uint64_t *to = reinterpret_cast<uint64_t *>(values.data()) + r * k;  // sums may wrap around
        const int64_t *other = values.data() + size_t(from) * k;
        for (size_t c = 0; c < leading; ++c) to[c] += uint64_t(other[c]);
    }
}

}  // namespace

void bind_householder(nb::module_ &m) {
    m.def("basis_compose", &basis_compose);
    m.def("basis_decompose", &basis_decompose);
    m.def("basis_signs", &basis_signs);
    m.def("basis_sum_differences", &basis_sum_differences, nb::arg().noconvert(), nb::arg(), nb::arg());
}
