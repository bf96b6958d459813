// Natural cubic splines, for stages/spline.py.

#include <algorithm>
#include <stdexcept>
#include <vector>

#include "arrays.h"

namespace {

// spline.interpolate: through values (keys, k) at ascending key frames, at frames in any order, (at, k). The same
// operations in the same order as there: LAPACK's ptsv for the curvature, then the cubic of each interval.
Output<double> spline_interpolate(Input<int64_t, 1> keyframes, Input<double, 2> values, Input<int64_t, 1> at) {
    const size_t keys = keyframes.shape(0), k = values.shape(1), count = at.shape(0);
    if (keys < 2 || values.shape(0) != keys) throw std::invalid_argument("spline_interpolate: shapes differ");
    const int64_t *key = keyframes.data();
    const double *value = values.data();
    std::vector<double> width(keys - 1), curvature(keys * k, 0.0);
    for (size_t i = 0; i + 1 < keys; ++i) {
        if (key[i + 1] <= key[i]) throw std::invalid_argument("spline_interpolate: key frames that do not ascend");
        width[i] = double(key[i + 1] - key[i]);
    }
    if (keys > 2 && k) {
        const size_t inner = keys - 2;
        std::vector<double> diagonal(inner), beside(inner);
        for (size_t i = 0; i < inner; ++i) {
            diagonal[i] = (width[i] + width[i + 1]) / 3;
            beside[i] = width[i + 1] / 6;
        }
        for (size_t i = 0; i + 1 < inner; ++i) {  // pttrf: L D Lᵀ
            const double e = beside[i];
            beside[i] = e / diagonal[i];
            diagonal[i + 1] -= beside[i] * e;
        }
        double *right = curvature.data() + k;
        for (size_t i = 0; i < inner; ++i)
            for (size_t c = 0; c < k; ++c)
                right[i * k + c] = (value[(i + 2) * k + c] - value[(i + 1) * k + c]) / width[i + 1] -
                                   (value[(i + 1) * k + c] - value[i * k + c]) / width[i];
        for (size_t i = 1; i < inner; ++i)  // pttrs: forwards, then back
            for (size_t c = 0; c < k; ++c) right[i * k + c] -= right[(i - 1) * k + c] * beside[i - 1];
        for (size_t c = 0; c < k; ++c) right[(inner - 1) * k + c] /= diagonal[inner - 1];
        for (size_t i = inner - 1; i-- > 0;)
            for (size_t c = 0; c < k; ++c)
                right[i * k + c] = right[i * k + c] / diagonal[i] - right[(i + 1) * k + c] * beside[i];
    }
    Fresh<double> out(count * k);
    size_t left = 0;
    for (size_t j = 0; j < count; ++j) {
        const int64_t t = at.data()[j];
        if (t < key[left] || t >= key[left + 1])  // frames mostly ascend
            left = std::clamp<size_t>(size_t(std::upper_bound(key, key + keys, t) - key), 1, keys - 1) - 1;
        const double b = double(t - key[left]) / width[left], a = 1.0 - b, bend = width[left] * width[left] / 6;
        const double of_left = (a * a * a - a) * bend, of_right = (b * b * b - b) * bend;
        const double *v = value + left * k, *c = curvature.data() + left * k;
        for (size_t i = 0; i < k; ++i)
            out.data[j * k + i] = a * v[i] + b * v[k + i] + of_left * c[i] + of_right * c[k + i];
    }
    return out.give({count, k});
}

}  // namespace

void bind_splines(nb::module_ &m) { m.def("spline_interpolate", &spline_interpolate); }
