// Search for a cut by probabilistic PCA, for stages/segment.py. Sums, directions and distances agree up to rounding.

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>
#include <vector>

#include "arrays.h"
#include "vectors.h"

namespace {

constexpr size_t ROWS = 4, COLUMNS = 8;  // rows and columns of a block of a product

size_t padded(size_t n) { return (n + COLUMNS - 1) / COLUMNS * COLUMNS; }

// A matrix with rows padded with zeros to a multiple of COLUMNS.
struct Matrix {
    Matrix(size_t rows, size_t columns) : stride(padded(columns)), of(padded(rows) * stride, 0.0) {}
    double *operator[](size_t row) { return of.data() + row * stride; }
    const double *operator[](size_t row) const { return of.data() + row * stride; }

    size_t stride;
    std::vector<double> of;
};

// A view of a matrix (rows, count), possibly transposed, with strides to the next row and column.
struct Left {
    const double *data;
    size_t to_row, to_column;
};

Left rows_of(const Matrix &matrix) { return {matrix.of.data(), matrix.stride, 1}; }
Left columns_of(const Matrix &matrix) { return {matrix.of.data(), 1, matrix.stride}; }

// to (rows, columns) = left right; += if `keep`.
ALWAYS_INLINE void multiply(const Left &left, const Matrix &right, size_t count, size_t rows, Matrix &to, bool keep) {
    const size_t columns = right.stride;
    const Four zero = Four{} * 0.0;
    for (size_t row = 0; row < rows; row += ROWS)
        for (size_t column = 0; column < columns; column += COLUMNS) {
            Four a[ROWS], b[ROWS];
            for (size_t i = 0; i < ROWS; ++i) {
                double *at = to[row + i] + column;
                if (keep) load(a[i], at), load(b[i], at + 4);
                else a[i] = zero, b[i] = zero;
            }
            for (size_t f = 0; f < count; ++f) {
                Four x, y;
                load(x, right[f] + column), load(y, right[f] + column + 4);
                const double *factor = left.data + row * left.to_row + f * left.to_column;
                for (size_t i = 0; i < ROWS; ++i) a[i] += x * factor[i * left.to_row], b[i] += y * factor[i * left.to_row];
            }
            for (size_t i = 0; i < ROWS; ++i) {
                double *at = to[row + i] + column;
                store(a[i], at), store(b[i], at + 4);
            }
        }
}

void multiply_anywhere(const Left &left, const Matrix &right, size_t count, size_t rows, Matrix &to, bool keep) {
    multiply(left, right, count, rows, to, keep);
}

#ifdef HAS_AVX2_TWIN
WITH_AVX2 void multiply_with_avx2(const Left &left, const Matrix &right, size_t count, size_t rows, Matrix &to, bool keep) {
    multiply(left, right, count, rows, to, keep);
}
#endif

void product(const Left &left, const Matrix &right, size_t count, size_t rows, Matrix &to, bool keep = false) {
#ifdef HAS_AVX2_TWIN
    static const bool has_avx2 = processor_has_avx2();
    if (has_avx2) return multiply_with_avx2(left, right, count, rows, to, keep);
#endif
    multiply_anywhere(left, right, count, rows, to, keep);
}

// Rotates two rows: p ← c p − s q, q ← s p + c q.
ALWAYS_INLINE void turn_rows(double *p, double *q, size_t stride, double c, double s) {
    for (size_t i = 0; i < stride; i += 4) {
        Four x, y;
        load(x, p + i), load(y, q + i);
        store(x * c - y * s, p + i), store(x * s + y * c, q + i);
    }
}

// Diagonalises a symmetric matrix (n, n) by cyclic Jacobi rotations: eigenvalues on its diagonal, eigenvectors in the rows
// of `vectors`. An almost diagonal matrix takes one or two sweeps.
ALWAYS_INLINE void diagonalise(Matrix &matrix, Matrix &vectors, size_t n) {
    constexpr int SWEEPS = 40;
    constexpr double RELATIVE = 1e-10, ABSOLUTE = 1e-17;
    std::fill(vectors.of.begin(), vectors.of.end(), 0.0);
    for (size_t i = 0; i < n; ++i) vectors[i][i] = 1.0;
    for (int sweep = 0; sweep < SWEEPS; ++sweep) {
        double largest = 0;
        for (size_t i = 0; i < n; ++i) largest = std::max(largest, std::abs(matrix[i][i]));
        bool turned = false;
        for (size_t p = 0; p + 1 < n; ++p)
            for (size_t q = p + 1; q < n; ++q) {
                const double off = matrix[p][q], a = matrix[p][p], b = matrix[q][q];
                if (std::abs(off) <= ABSOLUTE * largest || off * off <= RELATIVE * RELATIVE * std::abs(a * b)) continue;
                turned = true;
                const double gap = b - a, t = std::copysign(2, gap) * off / (std::abs(gap) + std::sqrt(gap * gap + 4 * off * off));
                const double c = 1 / std::sqrt(t * t + 1), s = t * c;
                turn_rows(matrix[p], matrix[q], matrix.stride, c, s);
                turn_rows(vectors[p], vectors[q], vectors.stride, c, s);
                matrix[p][p] = a - t * off, matrix[q][q] = b + t * off, matrix[p][q] = matrix[q][p] = 0;
                for (size_t i = 0; i < n; ++i) matrix[i][p] = matrix[p][i], matrix[i][q] = matrix[q][i];
            }
        if (!turned) return;
    }
}

void diagonalise_anywhere(Matrix &matrix, Matrix &vectors, size_t n) { diagonalise(matrix, vectors, n); }

#ifdef HAS_AVX2_TWIN
WITH_AVX2 void diagonalise_with_avx2(Matrix &matrix, Matrix &vectors, size_t n) { diagonalise(matrix, vectors, n); }
#endif

void find_eigenvectors(Matrix &matrix, Matrix &vectors, size_t n) {
#ifdef HAS_AVX2_TWIN
    static const bool has_avx2 = processor_has_avx2();
    if (has_avx2) return diagonalise_with_avx2(matrix, vectors, n);
#endif
    diagonalise_anywhere(matrix, vectors, n);
}

// The squared length of a row of a matrix.
double square(const double *row, size_t stride) {
    Four sums[2] = {Four{} * 0.0, Four{} * 0.0};
    for (size_t i = 0; i < stride; i += COLUMNS)
        for (size_t j = 0; j < 2; ++j) {
            Four part;
            load(part, row + i + 4 * j);
            sums[j] += part * part;
        }
    const Four sum = sums[0] + sums[1];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

// segment._search from one start.
class Search {
public:
    Search(const Input<double, 2> &poses, size_t leading, double still, nb::callable decompose)
        : dimensions_(poses.shape(1)), leading_(leading), still_(still * still), decompose_(decompose),
          poses_(poses.data()), squares_(dimensions_, dimensions_),
          directions_(dimensions_, leading), image_(dimensions_, leading),
          gram_(leading, leading), vectors_(leading, leading), turn_(leading, leading), away_(0, dimensions_),
          total_(dimensions_, 0.0), mean_(dimensions_, 0.0) {}

    // Adds frames [from, to) to the model, which then has `count` frames.
    void grow(size_t from, size_t to, size_t count) {
        Matrix rows(to - from, dimensions_);
        std::vector<double> sum(dimensions_, 0.0);  // of the new rows; the mean has NumPy's bits, which show still poses
        for (size_t t = from; t < to; ++t) {
            std::copy_n(poses_ + t * dimensions_, dimensions_, rows[t - from]);
            for (size_t i = 0; i < dimensions_; ++i) sum[i] += rows[t - from][i];
        }
        for (size_t i = 0; i < dimensions_; ++i) total_[i] += sum[i];
        product(columns_of(rows), rows, to - from, dimensions_, squares_, true);
        trace_ = 0, count_ = double(count);
        for (size_t i = 0; i < dimensions_; ++i) mean_[i] = total_[i] / count_, trace_ += squares_[i][i] / count_ - mean_[i] * mean_[i];
    }

    // segment._leading.
    void find_directions() {
        if (trace_ <= double(dimensions_) * still_) variances_.clear();
        else if (variances_.size() < leading_) decompose();
        else follow();
    }

    // segment._distance of the frames [from, to).
    double distance(size_t from, size_t to, double kept) {
        size_t p = 0;
        double sum = 0;
        while (p < variances_.size() && sum + variances_[p] < kept * trace_) sum += variances_[p++];
        p = std::min({p + 1, variances_.size(), std::max<size_t>(dimensions_ - 1, 1)});
        sum = std::accumulate(variances_.begin(), variances_.begin() + long(p), 0.0);
        const double rest = (trace_ - sum) / double(std::max<size_t>(dimensions_ - p, 1));
        Matrix &away = away_;  // rows are zero after their dimensions
        if (away.of.size() < padded(to - from) * away.stride) away = Matrix(to - from, dimensions_);
        double energy = 0;
        for (size_t t = from; t < to; ++t) {
            double *off = away[t - from];
            for (size_t i = 0; i < dimensions_; ++i) off[i] = poses_[t * dimensions_ + i] - mean_[i];
            energy += square(off, away.stride);
        }
        double along = 0, within = 0;
        if (p) {
            Matrix some(dimensions_, p), projected(to - from, p);
            for (size_t i = 0; i < dimensions_; ++i) std::copy_n(directions_[i], p, some[i]);
            product(rows_of(away), some, dimensions_, to - from, projected);
            for (size_t k = 0; k < p; ++k) {
                double square = 0;
                for (size_t t = 0; t < to - from; ++t) square += projected[t][k] * projected[t][k];
                along += square, within += square / std::max(variances_[k], still_);
            }
        }
        return (within + std::max(energy - along, 0.0) / std::max(rest, still_)) / double(to - from);
    }

private:
    void decompose() {
        Fresh<double> copy(dimensions_ * dimensions_);
        for (size_t i = 0; i < dimensions_; ++i)
            for (size_t j = 0; j < dimensions_; ++j) copy.data[i * dimensions_ + j] = squares_[i][j] / count_ - mean_[i] * mean_[j];
        nb::object found = decompose_(copy.give({dimensions_, dimensions_}));
        const auto variances = nb::cast<Input<double, 1>>(found[0]);
        const auto directions = nb::cast<Input<double, 2>>(found[1]);
        const size_t count = variances.shape(0);
        if (count > leading_ || directions.shape(0) != dimensions_ || directions.shape(1) != count)
            throw std::invalid_argument("ppca_search: shapes differ");
        variances_.assign(variances.data(), variances.data() + count);
        std::fill(directions_.of.begin(), directions_.of.end(), 0.0);
        for (size_t i = 0; i < dimensions_; ++i) std::copy_n(directions.data() + i * count, count, directions_[i]);
    }

    // One step of subspace iteration from the last model's directions; covariance = squares / count − mean meanᵀ.
    void follow() {
        product(rows_of(squares_), directions_, dimensions_, dimensions_, image_);
        along_mean_.assign(image_.stride, 0.0);
        for (size_t i = 0; i < dimensions_; ++i)
            for (size_t k = 0; k < image_.stride; ++k) along_mean_[k] += mean_[i] * directions_[i][k];
        for (size_t i = 0; i < dimensions_; ++i)
            for (size_t k = 0; k < image_.stride; ++k) image_[i][k] = image_[i][k] / count_ - mean_[i] * along_mean_[k];
        product(columns_of(image_), image_, dimensions_, leading_, gram_);
        find_eigenvectors(gram_, vectors_, leading_);
        std::vector<size_t> order(leading_);
        std::iota(order.begin(), order.end(), size_t(0));
        std::sort(order.begin(), order.end(), [&](size_t a, size_t b) { return gram_[a][a] > gram_[b][b]; });
        const double least = 1e-14 * gram_[order[0]][order[0]];
        std::fill(turn_.of.begin(), turn_.of.end(), 0.0);
        variances_.clear();
        for (size_t k = 0; k < leading_; ++k) {
            const double squared = gram_[order[k]][order[k]];
            if (!(squared > least)) break;
            variances_.push_back(std::sqrt(squared));
            for (size_t i = 0; i < leading_; ++i) turn_[i][k] = vectors_[order[k]][i] / variances_[k];
        }
        product(rows_of(image_), turn_, leading_, dimensions_, directions_);
    }

    const size_t dimensions_, leading_;
    const double still_;
    nb::callable decompose_;
    const double *poses_;
    Matrix squares_, directions_, image_, gram_, vectors_, turn_, away_;
    std::vector<double> total_, mean_, variances_, along_mean_;
    double trace_ = 0, count_ = 0;
};

// segment._search in poses (frames, dimensions) from frame 0. Returns H after each growth, and the index of the growth
// before which to cut, or −1. decompose(covariance): leading variances and their directions.
nb::tuple ppca_search(Input<double, 2> poses, size_t initial, size_t ahead, size_t step, double kept, double rise, size_t leading,
                      double still, nb::callable decompose) {
    const size_t frames = poses.shape(0);
    if (!poses.shape(1) || !initial || !ahead || !step || !leading || frames < initial + ahead)
        throw std::invalid_argument("ppca_search: shapes differ");
    Search search(poses, leading, still, decompose);
    std::vector<double> distances;
    double valley = INFINITY;
    int64_t cut = -1;
    for (size_t end = initial, from = 0; end + ahead <= frames; from = end, end += step) {
        search.grow(from, end, end);
        search.find_directions();
        distances.push_back(search.distance(end, end + ahead, kept));
        const size_t i = distances.size() - 1;
        if (i < 2) continue;
        const double before = distances[i - 2], here = distances[i - 1], after = distances[i];
        if (before >= here && here <= after) valley = std::min(valley, here);
        else if (before < here && here >= after && here - valley > rise) {
            cut = int64_t(i) - 1;
            break;
        }
    }
    Fresh<double> out(distances.size());
    std::copy(distances.begin(), distances.end(), out.data.get());
    return nb::make_tuple(out.give({distances.size()}), cut);
}

}  // namespace

void bind_ppca(nb::module_ &m) { m.def("ppca_search", &ppca_search); }
