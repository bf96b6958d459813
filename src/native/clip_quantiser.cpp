// Quantises coefficients of clips, for codecs/hou2014/quantised_motion.py, with the same float operations in the same order.

#include <algorithm>
#include <cmath>
#include <cstring>
#include <stdexcept>
#include <utility>
#include <vector>

#include "arrays.h"
#include "vectors.h"

namespace {

using Spectra = Input<double, 3>;  // (clips, frequencies, components)
using Steps = Input<double, 1>;    // (clips), in the unit of the spectra

constexpr double WHOLE = 4503599627370496.0;  // 2^52: larger doubles are integers

// Magnitudes in steps: the largest of each frequency, and sums over the clips (frequencies, components).
ALWAYS_INLINE void add_magnitudes(const Spectra &spectra, const Steps &steps, double *largest, double *sums) {
    const size_t frequencies = spectra.shape(1), k = spectra.shape(2);
    std::vector<double> tops(k);
    for (size_t clip = 0; clip < spectra.shape(0); ++clip) {
        const double step = steps.data()[clip];
        for (size_t f = 0; f < frequencies; ++f) {
            const double *row = spectra.data() + (clip * frequencies + f) * k;
            double *sum = sums + f * k, *top = tops.data();
            for (size_t c = 0; c < k; ++c) {
                const double magnitude = std::abs(row[c] / step);
                sum[c] += magnitude;
                top[c] = magnitude > top[c] ? magnitude : top[c];
            }
            for (double &each : tops) largest[f] = std::max(largest[f], each), each = 0;
        }
    }
}

// quantised_motion._rounding.
struct Rounding {
    double half_economy, sign_below, least, most;
};

ALWAYS_INLINE int64_t bits_of(double value) {
    int64_t bits;
    std::memcpy(&bits, &value, sizeof bits);
    return bits;
}

// ⌊value⌋ for 0 ≤ value < 2^52.
ALWAYS_INLINE int64_t floor_of(double value) {
    const double nearest = (value + WHOLE) - WHOLE, whole = nearest - double(nearest > value);
    return bits_of(whole + WHOLE) - bits_of(WHOLE);
}

// Integers (clips, known, components) of the lowest `known` frequencies. bits (known, components): cost of a step of magnitude.
ALWAYS_INLINE void quantise(const Spectra &spectra, const Steps &steps, const Input<double, 2> &bits, const Rounding &limits, int64_t *out) {
    const size_t frequencies = spectra.shape(1), k = spectra.shape(2), count = bits.shape(0) * k;
    const auto [half_economy, sign_below, least, most] = limits;
    for (size_t clip = 0; clip < spectra.shape(0); ++clip) {
        const double step = steps.data()[clip];
        const double *value = spectra.data() + clip * frequencies * k, *of_step = bits.data();
        int64_t *to = out + clip * count;
        for (size_t i = 0; i < count; ++i) {
            const double scaled = value[i] / step, magnitude = std::abs(scaled);
            const double saved = of_step[i] + double(magnitude < sign_below);
            const double rounding = std::min(most, std::max(least, 0.5 - half_economy * saved));
            const int64_t whole = floor_of(magnitude + rounding), negative = bits_of(scaled) >> 63;
            to[i] = (whole ^ negative) - negative;
        }
    }
}

void add_magnitudes_anywhere(const Spectra &spectra, const Steps &steps, double *largest, double *sums) {
    add_magnitudes(spectra, steps, largest, sums);
}

void quantise_anywhere(const Spectra &spectra, const Steps &steps, const Input<double, 2> &bits, const Rounding &limits, int64_t *out) {
    quantise(spectra, steps, bits, limits, out);
}

#ifdef HAS_AVX2_TWIN
WITH_AVX2 void add_magnitudes_with_avx2(const Spectra &spectra, const Steps &steps, double *largest, double *sums) {
    add_magnitudes(spectra, steps, largest, sums);
}

WITH_AVX2 void quantise_with_avx2(const Spectra &spectra, const Steps &steps, const Input<double, 2> &bits, const Rounding &limits, int64_t *out) {
    quantise(spectra, steps, bits, limits, out);
}
#endif

// Calls the version of a function for this processor.
template <class Function, class... Arguments>
void for_processor(Function anywhere, [[maybe_unused]] Function with_avx2, Arguments &&...arguments) {
#ifdef HAS_AVX2_TWIN
    static const bool has_avx2 = processor_has_avx2();
    if (has_avx2) return with_avx2(std::forward<Arguments>(arguments)...);
#endif
    anywhere(std::forward<Arguments>(arguments)...);
}

#ifdef HAS_AVX2_TWIN
#define TWIN(name) name##_anywhere, name##_with_avx2
#else
#define TWIN(name) name##_anywhere, name##_anywhere
#endif

void require_steps(const Spectra &spectra, const Steps &steps) {
    if (!spectra.shape(0) || steps.shape(0) != spectra.shape(0)) throw std::invalid_argument("clips: shapes differ");
}

// quantised_motion._magnitudes: the largest of each frequency, and means over the clips.
nb::tuple clip_magnitudes(Spectra spectra, Steps steps) {
    require_steps(spectra, steps);
    const size_t frequencies = spectra.shape(1), k = spectra.shape(2);
    Fresh<double> largest(frequencies), means(frequencies * k);
    std::fill_n(largest.data.get(), frequencies, 0.0), std::fill_n(means.data.get(), frequencies * k, 0.0);
    for_processor(TWIN(add_magnitudes), spectra, steps, largest.data.get(), means.data.get());
    const double clips = double(spectra.shape(0));
    for (size_t i = 0; i < frequencies * k; ++i) means.data[i] /= clips;
    return nb::make_tuple(largest.give({frequencies}), means.give({frequencies, k}));
}

// quantised_motion._to_integers with rate–distortion optimised rounding.
Output<int64_t> clip_integers(Spectra spectra, Steps steps, Input<double, 2> bits, double half_economy, double sign_below, double least,
                              double most) {
    require_steps(spectra, steps);
    const size_t clips = spectra.shape(0), known = bits.shape(0), k = spectra.shape(2);
    if (known > spectra.shape(1) || bits.shape(1) != k) throw std::invalid_argument("clips: shapes differ");
    Fresh<int64_t> out(clips * known * k);
    for_processor(TWIN(quantise), spectra, steps, bits, Rounding{half_economy, sign_below, least, most}, out.data.get());
    return out.give({clips, known, k});
}

// quantised_motion._smooth_magnitudes: along frequencies, then along components; the ends repeat.
Output<double> smooth_magnitudes(Input<double, 2> magnitudes) {
    const size_t frequencies = magnitudes.shape(0), k = magnitudes.shape(1);
    Fresh<double> out(frequencies * k);
    std::vector<double> padded(k + 2);
    auto row = [&](size_t f) { return magnitudes.data() + std::min(f, frequencies - 1) * k; };
    for (size_t f = 0; f < frequencies && k; ++f) {
        const double *a = row(f < 2 ? 0 : f - 2), *b = row(f < 1 ? 0 : f - 1), *c = row(f), *d = row(f + 1), *e = row(f + 2);
        double *middle = padded.data() + 1, *to = out.data.get() + f * k;
        for (size_t i = 0; i < k; ++i) middle[i] = (a[i] + 3 * b[i] + 4 * c[i] + 3 * d[i] + e[i]) / 12;
        padded[0] = middle[0], padded[k + 1] = middle[k - 1];
        for (size_t i = 0; i < k; ++i) to[i] = (padded[i] + 2 * padded[i + 1] + padded[i + 2]) / 4;
    }
    return out.give({frequencies, k});
}

// stream._extent: numbers of rows and columns up to the last nonzero.
nb::tuple integers_extent(Input<int64_t, 2> integers) {
    const size_t columns = integers.shape(1);
    size_t rows = 0, used = 0;
    for (size_t row = integers.shape(0); row-- > 0;) {
        const int64_t *of = integers.data() + row * columns;
        size_t last = columns;
        while (last > used && !of[last - 1]) --last;
        if (!rows && (last > used || std::any_of(of, of + used, [](int64_t value) { return value != 0; }))) rows = row + 1;
        used = std::max(used, last);
    }
    return nb::make_tuple(rows, used);
}

}  // namespace

void bind_clip_quantiser(nb::module_ &m) {
    m.def("clip_magnitudes", &clip_magnitudes);
    m.def("clip_integers", &clip_integers);
    m.def("smooth_magnitudes", &smooth_magnitudes);
    m.def("integers_extent", &integers_extent);
}
