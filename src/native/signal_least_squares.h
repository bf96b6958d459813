// Least squares for the predictors of signals (signals/fitting.py). Float operations have the order of the NumPy code,
// with sums from the first row to the last.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

namespace signals {

using Floats = std::vector<double>;

// fitting.py has the same constants and explains them.
constexpr size_t BLOCK = 32, FIRST_ORDER = 8, REFERENCE_TAPS = 3;
constexpr size_t TILE = 4, GRAM_ROWS = 64;  // side of a tile of sums in registers; rows of a block
constexpr size_t ORDERS[] = {0, 1, 2, 4, 8, 16};
constexpr double RIDGE = 1e-13, LEAST_PIVOT = 1e-14, TAP_BITS = 12.0, TINY = 1e-300;

// fitting._log2
inline double log2_of(double value) {
    int exponent;
    const double m = std::frexp(value, &exponent);
    return ((1.2556887796 * m + -4.1961258395) * m + 6.0966363124) * m + -3.1560362794 + exponent;
}

// fitting._code_bits of `count` residuals of sizes at(t).
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

// fitting._weights
inline Floats weights_of(const Floats &residuals) {
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

// Integers (channels, samples) of a chunk.
struct Samples {
    const int64_t *data;
    size_t count;

    const int64_t *line(size_t channel) const { return data + channel * count; }
};

// fitting._pursuit_in_numpy: each sum takes one pass over the rows, all channels of a row together.
inline std::vector<size_t> pursuit(const Samples &samples, size_t target, const std::vector<size_t> &candidates,
                                   const std::vector<size_t> &rows, double least, size_t most) {
    const size_t count = rows.size(), width = candidates.size();
    const auto difference = [&](size_t channel, size_t i) {
        const int64_t *line = samples.line(channel);
        const size_t t = rows[i];
        return double(line[t] - line[t ? t - 1 : 0]);
    };
    Floats left(count), others(count * width), start(width), sizes, products(width), direction(count);
    for (size_t i = 0; i < count; ++i) left[i] = difference(target, i);
    const Floats weights = weights_of(left);
    for (size_t i = 0; i < count; ++i) left[i] *= weights[i];
    for (size_t j = 0; j < width; ++j)
        for (size_t i = 0; i < count; ++i)
            others[i * width + j] = difference(candidates[j], i) * weights[i];
    for (size_t i = 0; i < count; ++i)
        for (size_t j = 0; j < width; ++j) start[j] += others[i * width + j] * others[i * width + j];
    sizes = start;
    double floor = 0;
    for (double x : left) floor += x * x;
    floor *= 1e-13;
    std::vector<size_t> chosen;
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
        chosen.push_back(candidates[best]);
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

// A design matrix (rows, width). Its last column is the target of the fit.
struct Matrix {
    size_t width;
    Floats data;

    size_t rows() const { return data.size() / width; }
    const double *row(size_t i) const { return data.data() + i * width; }
};

// Indices of columns; the last is the target.
using Columns = std::vector<size_t>;

// Adds the products of columns [j, j + 4) and [k, k + 4) of some rows to `sums`, from the first row to the last.
inline void add_products(const double *rows, size_t count, size_t stride, size_t j, size_t k, double *sums) {
    double tile[TILE][TILE];
    for (size_t a = 0; a < TILE; ++a)
        for (size_t b = 0; b < TILE; ++b) tile[a][b] = sums[(j + a) * stride + k + b];
    for (const double *row = rows; row != rows + count * stride; row += stride)
        for (size_t a = 0; a < TILE; ++a)
            for (size_t b = 0; b < TILE; ++b) tile[a][b] += row[j + a] * row[k + b];
    for (size_t a = 0; a < TILE; ++a)
        for (size_t b = 0; b < TILE; ++b) sums[(j + a) * stride + k + b] = tile[a][b];
}

// fitting._gram of columns: the lower triangle. weights: of the rows, or empty. Blocks of rows fit into the cache.
inline Floats gram_of(const Matrix &matrix, const Columns &columns, const Floats &weights) {
    const size_t width = columns.size(), stride = (width + TILE - 1) / TILE * TILE;
    Floats sums(stride * stride), block(GRAM_ROWS * stride);
    for (size_t start = 0; start < matrix.rows(); start += GRAM_ROWS) {
        const size_t count = std::min(GRAM_ROWS, matrix.rows() - start);
        for (size_t i = 0; i < count; ++i) {
            const double *row = matrix.row(start + i), weight = weights.empty() ? 1.0 : weights[start + i];
            for (size_t j = 0; j < width; ++j) block[i * stride + j] = row[columns[j]] * weight;
        }
        for (size_t j = 0; j < stride; j += TILE)
            for (size_t k = 0; k <= j; k += TILE) add_products(block.data(), count, stride, j, k, sums.data());
    }
    Floats result(width * width);
    for (size_t j = 0; j < width; ++j)
        for (size_t k = 0; k <= j; ++k) result[j * width + k] = sums[j * stride + k];
    return result;
}

struct Triangle {
    size_t width;
    Floats lower, scale;
};

// fitting._cholesky, from the lower triangle of the Gram matrix.
inline Triangle cholesky(const Floats &gram, size_t width) {
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
inline Floats taps_of(const Triangle &of, size_t size) {
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
inline size_t best_size(const Triangle &of, size_t fixed, size_t order, size_t count) {
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

// fitting._left: residuals of the last column after prediction with the taps.
inline Floats left_of(const Matrix &matrix, const Columns &columns, const Floats &taps) {
    Floats left(matrix.rows());
    for (size_t i = 0; i < left.size(); ++i) {
        const double *row = matrix.row(i);
        double sum = 0;
        for (size_t j = 0; j < taps.size(); ++j) sum += row[columns[j]] * taps[j];
        left[i] = row[columns.back()] - sum;
    }
    return left;
}

}  // namespace signals
