// The encoder's choice of predictors (signals/fitting.py): which channels explain another, and least squares. Floats,
// in the order of the NumPy code: sums from the first row to the last.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include "arrays.h"

namespace {

using Numbers = Input<int64_t, 1>;
using Floats = std::vector<double>;

// fitting.py has the same constants and the reasons.
constexpr size_t BLOCK = 32, FIRST_ORDER = 8, REFERENCE_TAPS = 3;
constexpr size_t ORDERS[] = {0, 1, 2, 4, 8, 16};
constexpr double RIDGE = 1e-13, LEAST_PIVOT = 1e-14, TAP_BITS = 12.0, TINY = 1e-300;

// fitting._log2
double log2_of(double value) {
    int exponent;
    const double m = std::frexp(value, &exponent);
    return ((1.2556887796 * m + -4.1961258395) * m + 6.0966363124) * m + -3.1560362794 + exponent;
}

// fitting._code_bits: sizes at(t) of `count` residuals.
template <class At>
double code_bits(size_t count, At at) {
    double bits = 0;
    for (size_t start = 0; start < count; start += BLOCK) {
        const size_t end = std::min(count, start + BLOCK);
        double sum = 0;
        for (size_t t = start; t < end; ++t) sum += at(t);
        const double length = double(end - start);
        bits += length * log2_of(sum / length + 0.3);
    }
    return bits;
}

double signals_code_bits(Numbers residuals) {
    return code_bits(residuals.shape(0), [&](size_t t) { return std::abs(double(residuals.data()[t])); });
}

// fitting._weights
Floats weights_of(const Floats &residuals) {
    const size_t count = residuals.size(), blocks = (count + BLOCK - 1) / BLOCK;
    Floats means(blocks), weights(count);
    double usual = 0;
    for (size_t b = 0; b < blocks; ++b) {
        const size_t end = std::min(count, (b + 1) * BLOCK);
        double sum = 0;
        for (size_t t = b * BLOCK; t < end; ++t) sum += std::abs(residuals[t]);
        means[b] = sum / double(end - b * BLOCK);
        usual += means[b];
    }
    usual /= double(blocks);
    for (size_t b = 0; b < blocks; ++b) {
        const double smooth = (means[b ? b - 1 : 0] + means[b] + means[std::min(b + 1, blocks - 1)]) / 3;
        const double weight = 1.0 / (smooth + 0.3 + 1e-3 * usual);
        std::fill(weights.begin() + std::ptrdiff_t(b * BLOCK),
                  weights.begin() + std::ptrdiff_t(std::min(count, (b + 1) * BLOCK)), weight);
    }
    return weights;
}

// fitting._pursuit_in_numpy. One pass over the rows for each sum, all channels of a row at a time.
nb::list signals_pursuit(Input<int64_t, 2> samples, size_t target, Numbers candidates, Numbers rows, double least,
                         size_t most) {
    const size_t count = rows.shape(0), width = candidates.shape(0), length = samples.shape(1);
    if (target >= samples.shape(0) || !count || !width) throw std::invalid_argument("signals_pursuit: nothing to fit");
    for (size_t i = 0; i < count; ++i)
        if (uint64_t(rows.data()[i]) >= length) throw std::invalid_argument("signals_pursuit: a row out of range");
    for (size_t j = 0; j < width; ++j)
        if (uint64_t(candidates.data()[j]) >= samples.shape(0))
            throw std::invalid_argument("signals_pursuit: a channel out of range");
    const auto difference = [&](size_t channel, size_t i) {
        const int64_t *line = samples.data() + channel * length, t = rows.data()[i];
        return double(line[t] - line[std::max<int64_t>(t - 1, 0)]);
    };
    Floats left(count), others(count * width), start(width), sizes, products(width), direction(count);
    for (size_t i = 0; i < count; ++i) left[i] = difference(target, i);
    const Floats weights = weights_of(left);
    for (size_t i = 0; i < count; ++i) left[i] *= weights[i];
    for (size_t j = 0; j < width; ++j)
        for (size_t i = 0; i < count; ++i)
            others[i * width + j] = difference(size_t(candidates.data()[j]), i) * weights[i];
    for (size_t i = 0; i < count; ++i)
        for (size_t j = 0; j < width; ++j) start[j] += others[i * width + j] * others[i * width + j];
    sizes = start;
    double floor = 0;
    for (double x : left) floor += x * x;
    floor *= 1e-13;
    nb::list chosen;
    while (chosen.size() < most) {
        double energy = 0, best_gain = -1;
        size_t best = 0;
        std::fill(products.begin(), products.end(), 0.0);
        for (size_t i = 0; i < count; ++i) {
            energy += left[i] * left[i];
            for (size_t j = 0; j < width; ++j) products[j] += others[i * width + j] * left[i];
        }
        for (size_t j = 0; j < width; ++j) {
            const double gain =
                sizes[j] > 1e-9 * start[j] ? products[j] * products[j] / std::max(sizes[j], TINY) : 0.0;
            if (gain > best_gain) best_gain = gain, best = j;
        }
        const double after = std::max(std::max(energy - best_gain, floor), TINY);
        if (energy <= floor || log2_of(energy / after) < least) break;
        chosen.append(candidates.data()[best]);
        const double size = std::sqrt(sizes[best]);
        double along = 0;
        std::fill(products.begin(), products.end(), 0.0);
        for (size_t i = 0; i < count; ++i) {
            direction[i] = others[i * width + best] / size;
            along += left[i] * direction[i];
            for (size_t j = 0; j < width; ++j) products[j] += others[i * width + j] * direction[i];
        }
        std::fill(sizes.begin(), sizes.end(), 0.0);
        for (size_t i = 0; i < count; ++i) {
            left[i] -= along * direction[i];
            for (size_t j = 0; j < width; ++j) {
                double &x = others[i * width + j];
                x -= products[j] * direction[i];
                sizes[j] += x * x;
            }
        }
    }
    return chosen;
}

// Columns of a design matrix (rows, width), the last of which the others sum up to.
struct Matrix {
    size_t width;
    Floats data;

    size_t rows() const { return data.size() / width; }
    const double *row(size_t i) const { return data.data() + i * width; }
};

// fitting._gram, the lower triangle. weights: of the rows, or none.
Floats gram_of(const Matrix &matrix, const Floats &weights) {
    const size_t width = matrix.width;
    Floats sums(width * width), row(width);
    for (size_t i = 0; i < matrix.rows(); ++i) {
        for (size_t j = 0; j < width; ++j) row[j] = weights.empty() ? matrix.row(i)[j] : matrix.row(i)[j] * weights[i];
        for (size_t j = 0; j < width; ++j) {
            const double x = row[j];
            double *line = sums.data() + j * width;
            for (size_t k = 0; k <= j; ++k) line[k] += x * row[k];
        }
    }
    return sums;
}

struct Triangle {
    size_t width;
    Floats lower, scale;
};

// fitting._cholesky, from the lower triangle of the Gram matrix.
Triangle cholesky(const Floats &gram, size_t width) {
    Triangle result{width, Floats(width * width), Floats(width)};
    Floats &lower = result.lower, &scale = result.scale, left(width * width);
    for (size_t j = 0; j < width; ++j) scale[j] = 1.0 / std::sqrt(std::max(gram[j * width + j], TINY));
    for (size_t j = 0; j < width; ++j)
        for (size_t k = 0; k <= j; ++k) left[j * width + k] = gram[j * width + k] * scale[j] * scale[k];
    for (size_t j = 0; j + 1 < width; ++j) left[j * width + j] += RIDGE;
    Floats column(width);
    for (size_t k = 0; k + 1 < width; ++k) {
        const double pivot = std::sqrt(std::max(left[k * width + k], LEAST_PIVOT));
        for (size_t j = k; j < width; ++j) lower[j * width + k] = column[j] = left[j * width + k] / pivot;
        for (size_t j = k + 1; j < width; ++j)
            for (size_t i = k + 1; i <= j; ++i) left[j * width + i] -= column[j] * column[i];
    }
    return result;
}

// fitting._taps
Floats taps_of(const Triangle &of, size_t size) {
    const size_t width = of.width;
    Floats taps(of.lower.end() - std::ptrdiff_t(width), of.lower.end() - std::ptrdiff_t(width - size));
    for (size_t k = size; k-- > 0;) {
        taps[k] /= of.lower[k * width + k];
        for (size_t j = 0; j < k; ++j) taps[j] -= of.lower[k * width + j] * taps[k];
    }
    for (size_t k = 0; k < size; ++k) taps[k] = taps[k] * of.scale[k] / of.scale[width - 1];
    return taps;
}

// fitting._best_size
size_t best_size(const Triangle &of, size_t fixed, size_t order, size_t count) {
    const double *last = of.lower.data() + (of.width - 1) * of.width;
    size_t best = fixed;
    double least = HUGE_VAL, error = 1;
    for (size_t size = 0; size <= fixed + order; ++size) {
        if (size >= fixed && std::count(std::begin(ORDERS), std::end(ORDERS), size - fixed)) {
            const double bits =
                double(count) / 2 * log2_of(std::max(error, 1e-12)) + TAP_BITS * double(size - fixed);
            if (bits < least) least = bits, best = size;
        }
        if (size < fixed + order) error -= last[size] * last[size];
    }
    return best;
}

// fitting._left
Floats left_of(const Matrix &matrix, const Floats &taps) {
    Floats left(matrix.rows());
    for (size_t i = 0; i < left.size(); ++i) {
        const double *row = matrix.row(i);
        double sum = 0;
        for (size_t j = 0; j < taps.size(); ++j) sum += row[j] * taps[j];
        left[i] = row[matrix.width - 1] - sum;
    }
    return left;
}

nb::tuple fit(const Matrix &matrix, const Floats &gram, size_t order, size_t count) {
    const Triangle of = cholesky(gram, matrix.width);
    const Floats taps = taps_of(of, best_size(of, matrix.width - 1 - order, order, count));
    const Floats left = left_of(matrix, taps);
    double largest = 1;
    for (size_t i = 0; i < matrix.rows(); ++i) {
        for (size_t j = 1; j < taps.size(); ++j) largest = std::max(largest, std::abs(matrix.row(i)[j]));
        largest = std::max(largest, std::abs(matrix.row(i)[matrix.width - 1]));
    }
    const double bits = code_bits(left.size(), [&](size_t t) { return std::abs(left[t]); }) / double(left.size());
    Fresh<double> out(taps.size());
    std::copy(taps.begin(), taps.end(), out.data.get());
    return nb::make_tuple(out.give({taps.size()}), bits, largest);
}

// The matrix without columns [begin, end), and likewise of its Gram matrix.
Matrix without(const Matrix &matrix, size_t begin, size_t end) {
    Matrix result{matrix.width - (end - begin), {}};
    result.data.reserve(matrix.rows() * result.width);
    for (size_t i = 0; i < matrix.rows(); ++i)
        for (size_t j = 0; j < matrix.width; ++j)
            if (j < begin || j >= end) result.data.push_back(matrix.row(i)[j]);
    return result;
}

Matrix design(Numbers own, Numbers places, Input<int64_t, 2> others, Numbers rows, size_t order) {
    const size_t count = rows.shape(0), channels = others.shape(0), length = others.shape(1);
    Matrix matrix{2 + REFERENCE_TAPS * channels + order, Floats(count * (2 + REFERENCE_TAPS * channels + order))};
    const int64_t *samples = own.data(), first = samples[0];
    for (size_t i = 0; i < count; ++i) {
        const int64_t t = rows.data()[i];
        if (uint64_t(t) >= own.shape(0) || (channels && uint64_t(places.data()[t]) >= length))
            throw std::invalid_argument("signals_fit: a row out of range");
        double *out = matrix.data.data() + i * matrix.width;
        *out++ = 1;
        for (size_t channel = 0; channel < channels; ++channel)
            for (size_t j = 0; j < REFERENCE_TAPS; ++j) {
                const int64_t *line = others.data() + channel * length;
                *out++ = double(line[std::max<int64_t>(places.data()[t] - int64_t(j), 0)] - line[0]);
            }
        for (size_t j = 1; j <= order; ++j) *out++ = t >= int64_t(j) ? double(samples[t - int64_t(j)] - first) : 0.0;
        *out = double(samples[t] - first);
    }
    return matrix;
}

// fitting._fits_in_numpy
nb::list signals_fit(Numbers own, Numbers places, Input<int64_t, 2> others, Numbers rows, size_t order) {
    if (!own.shape(0) || !rows.shape(0) || places.shape(0) != own.shape(0) || order > 32)
        throw std::invalid_argument("signals_fit: nothing to fit");
    const Matrix matrix = design(own, places, others, rows, order);
    const size_t past = 1 + REFERENCE_TAPS * others.shape(0), last = matrix.width - 1;
    const Matrix alone = without(matrix, 1, past);
    const size_t short_order = std::min(FIRST_ORDER, order);
    const Matrix shorter = without(alone, 1 + short_order, alone.width - 1);
    const Triangle of = cholesky(gram_of(shorter, {}), shorter.width);
    const Floats gram = gram_of(matrix, weights_of(left_of(shorter, taps_of(of, shorter.width - 1))));
    nb::list result;
    result.append(fit(matrix, gram, order, own.shape(0)));
    Floats inside;
    for (size_t j = 0; j <= last; ++j)
        for (size_t k = 0; k <= last; ++k)
            if ((j < 1 || j >= past) && (k < 1 || k >= past)) inside.push_back(gram[j * matrix.width + k]);
    if (others.shape(0)) result.append(fit(alone, inside, order, own.shape(0)));
    return result;
}

}  // namespace

void bind_signal_fitting(nb::module_ &m) {
    m.def("signals_code_bits", &signals_code_bits);
    m.def("signals_pursuit", &signals_pursuit);
    m.def("signals_fit", &signals_fit);
}
