// Orthonormal bases stored as Householder reflections, for stages/basis.py.

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "arrays.h"

namespace {

// basis._mirror, of rows i … n − 1 of column i of `entries` (n, k).
void mirror_of(const int64_t *entries, size_t n, size_t k, size_t i, std::vector<double> &u) {
    double squares = 0;
    for (size_t r = i; r < n; ++r) {
        u[r] = double(entries[r * k + i]);
        squares += u[r] * u[r];
    }
    double norm = std::sqrt(squares);
    if (norm == 0 || u[i] > 0) {
        std::fill(u.begin() + long(i), u.end(), 0.0);
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

// basis._decompose: rounded entries (n, k) of an orthonormal basis (n, k) in multiples of 1 / scales (k). Sums are from the first
// row to the last, as there: bytes depend on them.
Output<int64_t> basis_decompose(Input<double, 2> basis, Input<double, 1> scales) {
    const size_t n = basis.shape(0), k = basis.shape(1);
    if (scales.shape(0) != k || k > n) throw std::invalid_argument("basis_decompose: shapes differ");
    std::vector<double> rest(basis.data(), basis.data() + n * k), u(n), along(k);
    Fresh<int64_t> out(n * k);
    std::fill_n(out.data.get(), n * k, 0);
    for (size_t i = 0; i < k; ++i) {
        const double sign = rest[i * k + i] > 0 ? -1 : 1;
        for (size_t r = i; r < n; ++r) out.data[r * k + i] = int64_t(std::nearbyint(sign * rest[r * k + i] * scales.data()[i]));
        mirror_of(out.data.get(), n, k, i, u);
        std::fill(along.begin(), along.end(), 0.0);
        for (size_t r = i; r < n; ++r)
            for (size_t c = i + 1; c < k; ++c) along[c] += u[r] * rest[r * k + c];
        for (size_t r = i; r < n; ++r)
            for (size_t c = i + 1; c < k; ++c) rest[r * k + c] -= 2 * u[r] * along[c];
    }
    return out.give({n, k});
}

// basis._compose
Output<double> basis_compose(Input<int64_t, 2> entries) {
    const size_t n = entries.shape(0), k = entries.shape(1);
    Fresh<double> out(n * k);
    double *basis = out.data.get();
    std::fill_n(basis, n * k, 0.0);
    for (size_t i = 0; i < std::min(n, k); ++i) basis[i * k + i] = 1.0;
    std::vector<double> u(n), along(k);
    for (size_t i = std::min(n, k); i-- > 0;) {
        mirror_of(entries.data(), n, k, i, u);
        std::fill(along.begin(), along.end(), 0.0);
        for (size_t r = i; r < n; ++r)
            for (size_t c = i; c < k; ++c) along[c] += u[r] * basis[r * k + c];
        for (size_t r = i; r < n; ++r)
            for (size_t c = i; c < k; ++c) basis[r * k + c] -= 2 * u[r] * along[c];
    }
    return out.give({n, k});
}

// basis._signs_of_reflections, of the corner (k, k) of orthonormal columns.
Output<double> basis_signs(Input<double, 2> corner, double zero) {
    const size_t k = corner.shape(0);
    if (corner.shape(1) != k) throw std::invalid_argument("basis_signs: a corner that is not square");
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

// basis._sum_differences: rows of values (n, k), in place, from their differences from earlier rows, −1 for none.
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
