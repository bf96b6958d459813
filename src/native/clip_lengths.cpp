// Bits of clips of a given length, up to rounding, for codecs/hou2014/clip_segmentation.py, best_equal_length.

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

// Σ log₂(1 + c²) over the coefficients c of one clip of curves (frames, columns).
ALWAYS_INLINE double logarithms(const Series &series, const double *curves, size_t columns, double *from, double *other) {
    Logarithms found;
    for (size_t column = 0; column < columns; column += PANEL) {
        const double *spectrum = series.transposed(from, other, curves + column, columns, std::min(PANEL, columns - column));
        for (size_t k = 0; k < series.known(); ++k) found.add(spectrum + k * PANEL, series.scale(k));
    }
    return found.sum();
}

double logarithms_anywhere(const Series &series, const double *curves, size_t columns, double *from, double *other) {
    return logarithms(series, curves, columns, from, other);
}

#ifdef HAS_AVX2_TWIN
WITH_AVX2 double logarithms_with_avx2(const Series &series, const double *curves, size_t columns, double *from, double *other) {
    return logarithms(series, curves, columns, from, other);
}
#endif

// clip_segmentation.bits_of_spectra for clips of `length` frames, the last one shorter. curves (frames, columns), in
// steps. Nothing for curves that are too large.
std::optional<double> bits_of_length(Input<double, 2> curves, size_t length) {
    const size_t frames = curves.shape(0), columns = curves.shape(1);
    if (!length || !frames) throw std::invalid_argument("bits_of_length: no frames");
    nb::gil_scoped_release release;
    const double *end = curves.data() + frames * columns;
    if (frames > LONGEST || !std::all_of(curves.data(), end, [](double value) { return std::abs(value) < LARGEST; })) return std::nullopt;
    double sum = 0;
    for (size_t start = 0; start < frames;) {
        const Series series(std::min(length, frames - start), std::min(length, frames - start), true);
        cosine_series::Rows from, other;
        double *first = from.of(series.buffer()), *second = other.of(series.buffer());
        for (; start + series.frames() <= frames; start += series.frames()) {
            const double *clip = curves.data() + start * columns;
#ifdef HAS_AVX2_TWIN
            static const bool has_avx2 = processor_has_avx2();
            if (has_avx2) sum += logarithms_with_avx2(series, clip, columns, first, second);
            else
#endif
                sum += logarithms_anywhere(series, clip, columns, first, second);
        }
    }
    return 0.5 * sum;
}

}  // namespace

void bind_clip_lengths(nb::module_ &m) { m.def("bits_of_length", &bits_of_length); }
