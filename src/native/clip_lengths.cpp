// Finds the clip length with the fewest bits, up to rounding, for codecs/hou2014/clip_segmentation.py, best_equal_length.

#include <nanobind/stl/optional.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <stdexcept>
#include <vector>

#include "arrays.h"
#include "cosine_series.h"

namespace {

using cosine_series::PANEL;
using cosine_series::Series;

constexpr size_t TERMS = 16;  // factors of a product
constexpr size_t LONGEST = 1 << 20;  // longest curve, frames
constexpr double LARGEST = 1e6;  // largest curve value, in steps: products of TERMS squared coefficients must not overflow

// Σ log₂, computed from products, for each column.
class Logarithms {
public:
    ALWAYS_INLINE void add(const double *row, double scale) {
        for (size_t i = 0; i < 2; ++i) {
            Four value;
            load(value, row + 4 * i);
            value *= scale;
            value *= value;
            products_[i] *= value + 1.0;
        }
        if (++terms_ == TERMS) take();
    }

    double sum() {
        take();
        return sum_;
    }

private:
    void take() {
        for (Four &each : products_)
            for (size_t j = 0; j < 4; ++j) sum_ += std::log2(each[j]), each[j] = 1.0;
        terms_ = 0;
    }

    Four products_[2] = {Four{} * 0.0 + 1.0, Four{} * 0.0 + 1.0};
    double sum_ = 0;
    size_t terms_ = 0;
};

// Σ log₂(1 + c²) over the coefficients c of one clip, for the first `width` ≤ PANEL columns of curves (frames, columns).
ALWAYS_INLINE double logarithms(const Series &series, const double *curves, size_t columns, size_t width, double *from, double *other) {
    Logarithms found;
    const double *spectrum = series.transposed(from, other, curves, columns, width);
    for (size_t k = 0; k < series.known(); ++k) found.add(spectrum + k * PANEL, series.scale(k));
    return found.sum();
}

double logarithms_anywhere(const Series &series, const double *curves, size_t columns, size_t width, double *from, double *other) {
    return logarithms(series, curves, columns, width, from, other);
}

#ifdef HAS_AVX2_TWIN
WITH_AVX2 double logarithms_with_avx2(const Series &series, const double *curves, size_t columns, size_t width, double *from, double *other) {
    return logarithms(series, curves, columns, width, from, other);
}
#endif

// Clips of one length, the last one shorter, for curves of `frames` frames.
class Clips {
public:
    Clips(size_t frames, size_t length, double bits) : bits(bits), frames_(frames), length_(length) {
        series_.emplace_back(length, length, true);
        if (frames % length) series_.emplace_back(frames % length, frames % length, true);
    }

    // clip_segmentation.bits_of_spectra for the first `width` columns.
    double bits_of(const double *curves, size_t columns, size_t width) {
        double sum = 0;
        for (size_t start = 0; start < frames_; start += length_) {
            const Series &series = start + length_ <= frames_ ? series_.front() : series_.back();
            double *from = from_.of(series.buffer()), *other = other_.of(series.buffer());
            const double *clip = curves + start * columns;
#ifdef HAS_AVX2_TWIN
            static const bool has_avx2 = processor_has_avx2();
            if (has_avx2) {
                sum += logarithms_with_avx2(series, clip, columns, width, from, other);
                continue;
            }
#endif
            sum += logarithms_anywhere(series, clip, columns, width, from, other);
        }
        return 0.5 * sum;
    }

    double bits;  // for the clips, and all columns so far

private:
    size_t frames_, length_;
    std::vector<Series> series_;
    cosine_series::Rows from_, other_;
};

// clip_segmentation.best_equal_length: index of the best length. curves (frames, columns), in steps; leads (columns): lead in
// bits that no length makes up after each column. Nothing for curves that are too large.
std::optional<size_t> best_length(Input<double, 2> curves, Input<int64_t, 1> lengths, double bits_per_clip, Input<double, 1> leads) {
    const size_t frames = curves.shape(0), columns = curves.shape(1);
    if (!frames || !lengths.shape(0) || leads.shape(0) != columns) throw std::invalid_argument("best_length: shapes differ");
    nb::gil_scoped_release release;
    const double *end = curves.data() + frames * columns;
    if (frames > LONGEST || !std::all_of(curves.data(), end, [](double value) { return std::abs(value) < LARGEST; })) return std::nullopt;
    std::vector<Clips> left;
    std::vector<size_t> which;
    for (size_t i = 0; i < lengths.shape(0); ++i) {
        const int64_t length = lengths.data()[i];
        if (length < 1 || size_t(length) > frames) throw std::invalid_argument("best_length: no such length");
        left.emplace_back(frames, size_t(length), bits_per_clip * std::ceil(double(frames) / double(length)));
        which.push_back(i);
    }
    auto fewest = [&] { return std::min_element(left.begin(), left.end(), [](const Clips &a, const Clips &b) { return a.bits < b.bits; }); };
    for (size_t column = 0; column < columns && left.size() > 1; column += PANEL) {
        const size_t width = std::min(PANEL, columns - column);
        for (Clips &each : left) each.bits += each.bits_of(curves.data() + column, columns, width);
        const double most = fewest()->bits + leads.data()[column + width - 1];
        for (size_t i = left.size(); i-- > 0;)
            if (left[i].bits > most) left.erase(left.begin() + long(i)), which.erase(which.begin() + long(i));
    }
    return which[size_t(fewest() - left.begin())];
}

}  // namespace

void bind_clip_lengths(nb::module_ &m) { m.def("best_length", &best_length); }
