// Orthonormal bases stored as Householder reflections, for stages/basis.py.

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "arrays.h"
#include "householder.h"

namespace {

using namespace householder;

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

#ifdef HAS_AVX2_TWIN
WITH_AVX2 void decompose_with_avx2(const double *basis, const double *scales, size_t n, size_t k, int64_t *entries) {
    decompose(basis, scales, n, k, entries);
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
        compose_basis(entries.data(), n, k, out.data.get());
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
    if (std::any_of(alike.data(), alike.data() + n, [=](int64_t row) { return row >= int64_t(n); }))
        throw std::invalid_argument("basis_sum_differences: no such row");
    sum_differences(values.data(), n, k, alike.data(), leading);
}

}  // namespace

void bind_householder(nb::module_ &m) {
    m.def("basis_compose", &basis_compose);
    m.def("basis_decompose", &basis_decompose);
    m.def("basis_signs", &basis_signs);
    m.def("basis_sum_differences", &basis_sum_differences, nb::arg().noconvert(), nb::arg(), nb::arg());
}
