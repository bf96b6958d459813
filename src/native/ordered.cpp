// Linear algebra in a fixed order of operations, with the bits of codecs/tempo/models/ordered.py.

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "arrays.h"

namespace {

using Matrix = Input<double, 2>;

// ordered.matmul.
Output<double> ordered_matmul(Matrix a, Matrix b) {
    const size_t rows = a.shape(0), inner = a.shape(1), columns = b.shape(1);
    if (b.shape(0) != inner) throw std::invalid_argument("ordered_matmul: shapes differ");
    Fresh<double> out(rows * columns);
    {
        nb::gil_scoped_release release;
        const double *left = a.data(), *right = b.data();
        for (size_t i = 0; i < rows; ++i) {
            double *to = out.data.get() + i * columns;
            std::fill_n(to, columns, 0.0);
            for (size_t k = 0; k < inner; ++k) {
                const double factor = left[i * inner + k];
                for (size_t j = 0; j < columns; ++j) to[j] += factor * right[k * columns + j];
            }
        }
    }
    return out.give({rows, columns});
}

// ordered.sum_first_axis of (rows, width), in place: the first row becomes the sum.
void sum_rows(double *of, size_t rows, size_t width) {
    for (; rows > 1; rows /= 2) {
        const size_t half = rows / 2;
        for (size_t i = 0; i < half * width; ++i) of[i] += of[half * width + i];
        if (rows % 2)
            for (size_t i = 0; i < width; ++i) of[i] += of[(rows - 1) * width + i];
    }
}

// ordered.orthonormal: remainders of the rows, and the directions found, both as columns.
class GramSchmidt {
public:
    GramSchmidt(const double *rows, size_t count, size_t dimensions, size_t most)
        : count_(count), dimensions_(dimensions), most_(most), left_(count * dimensions),
          work_(dimensions * std::max(count, most)), size_(count), found_(dimensions * most), unit_(dimensions) {
        for (size_t r = 0; r < count; ++r)
            for (size_t d = 0; d < dimensions; ++d) left_[d * count + r] = rows[r * dimensions + d];
        measure();
    }

    const std::vector<double> &size() const { return size_; }

    // Finds directions; returns their number.
    size_t run(double floor) {
        for (size_t n = 0; n < most_; ++n) {
            const size_t longest = largest();
            if (size_[longest] < floor) return n;
            begin(longest, n);
            for (size_t d = 0; d < dimensions_; ++d) found_[d * most_ + n] = unit_[d];
            take_out();
            measure();
            size_[longest] = 0.0;
        }
        return most_;
    }

    void copy(size_t n, double *out) const {
        for (size_t i = 0; i < n; ++i)
            for (size_t d = 0; d < dimensions_; ++d) out[i * dimensions_ + d] = found_[d * most_ + i];
    }

private:
    // Index of the first largest value, or of the first NaN, as in NumPy.
    size_t largest() const {
        size_t at = 0;
        for (size_t r = 0; r < count_; ++r) {
            if (std::isnan(size_[r])) return r;
            if (size_[r] > size_[at]) at = r;
        }
        return at;
    }

    // Direction n: the longest remaining row, made orthogonal to the n earlier directions and of length 1.
    void begin(size_t longest, size_t n) {
        const double length = std::sqrt(size_[longest]);
        for (size_t d = 0; d < dimensions_; ++d) unit_[d] = left_[d * count_ + longest] / length;
        if (n) {
            for (size_t d = 0; d < dimensions_; ++d)
                for (size_t i = 0; i < n; ++i) work_[d * n + i] = found_[d * most_ + i] * unit_[d];
            sum_rows(work_.data(), dimensions_, n);
            const std::vector<double> along(work_.begin(), work_.begin() + std::ptrdiff_t(n));
            for (size_t i = 0; i < n; ++i)
                for (size_t d = 0; d < dimensions_; ++d) work_[i * dimensions_ + d] = found_[d * most_ + i] * along[i];
            sum_rows(work_.data(), n, dimensions_);
        } else {
            std::fill_n(work_.begin(), dimensions_, 0.0);
        }
        for (size_t d = 0; d < dimensions_; ++d) unit_[d] -= work_[d];
        for (size_t d = 0; d < dimensions_; ++d) work_[d] = unit_[d] * unit_[d];
        sum_rows(work_.data(), dimensions_, 1);
        const double norm = std::sqrt(work_[0]);
        for (double &value : unit_) value /= norm;
    }

    void take_out() {
        for (size_t d = 0; d < dimensions_; ++d)
            for (size_t r = 0; r < count_; ++r) work_[d * count_ + r] = left_[d * count_ + r] * unit_[d];
        sum_rows(work_.data(), dimensions_, count_);
        for (size_t d = 0; d < dimensions_; ++d)
            for (size_t r = 0; r < count_; ++r) left_[d * count_ + r] -= unit_[d] * work_[r];
    }

    void measure() {
        for (size_t i = 0; i < left_.size(); ++i) work_[i] = left_[i] * left_[i];
        sum_rows(work_.data(), dimensions_, count_);
        std::copy_n(work_.begin(), count_, size_.begin());
    }

    const size_t count_, dimensions_, most_;
    std::vector<double> left_, work_, size_, found_, unit_;
};

Output<double> ordered_orthonormal(Matrix rows, size_t most, double shortest, double faintest_share) {
    const size_t count = rows.shape(0), dimensions = rows.shape(1);
    most = std::min(most, count);
    if (!count || !dimensions) return Fresh<double>(0).give({0, dimensions});
    Fresh<double> out(most * dimensions);
    size_t found;
    {
        nb::gil_scoped_release release;
        GramSchmidt left(rows.data(), count, dimensions, most);
        double largest = 0;
        for (double size : left.size())
            if (std::isnan(size) || size > largest) largest = size;
        const double faint = largest * faintest_share;
        found = left.run(faint > shortest ? faint : shortest);
        left.copy(found, out.data.get());
    }
    return out.give({found, dimensions});
}

}  // namespace

void bind_ordered(nb::module_ &m) {
    m.def("ordered_matmul", &ordered_matmul);
    m.def("ordered_orthonormal", &ordered_orthonormal);
}
