// Cosine series of any length, eight columns at a time: stages/dct.py, inverse and forward, up to rounding.
//
//   coefficients ─► halving: sums of half as many cosines ─► samples                     if the frames halve often enough
//   coefficients ─► halving ─► samples of a coarse grid ─16 taps─► samples               for all other numbers of frames
//
// Halving is Lee's recursion ("A new algorithm to compute the discrete cosine transform", 1984): x(n) and x(N − 1 − n)
// are the sum and the difference of two series of N / 2 samples. The grid has b · 2^j samples, which halve well, and
// OVERSAMPLING times as many samples as frequencies. The interpolation window is sinh(β √(1 − z²)); its Fourier transform
// is a Bessel function (Potts and Tasche, "Continuous window functions for NFFT", 2021). The error is below 1e-11 of the
// coefficient at the highest frequencies and 1e-14 at low ones. The forward transform is the transpose of all steps.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "vectors.h"

#if defined(__GNUC__)  // ALWAYS_INLINE for lambdas, which are called from AVX2 code
#define ALWAYS_INLINE_LAMBDA __attribute__((always_inline))
#else
#define ALWAYS_INLINE_LAMBDA
#endif

namespace cosine_series {

constexpr size_t PANEL = 8, TILE = 4;  // columns and samples computed at a time
constexpr size_t TAPS = 16;
constexpr double OVERSAMPLING = 1.6, PI = 3.14159265358979323846;

ALWAYS_INLINE void load(Four (&into)[2], const double *from) { ::load(into[0], from), ::load(into[1], from + 4); }
ALWAYS_INLINE void store(const Four (&from)[2], double *into) { ::store(from[0], into), ::store(from[1], into + 4); }

// Memory with rows of PANEL doubles aligned to cache lines.
struct Rows {
    double *of(size_t doubles) {
        memory.resize(doubles + PANEL);
        return memory.data() + (64 - reinterpret_cast<uintptr_t>(memory.data()) % 64) % 64 / sizeof(double);
    }

    std::vector<double> memory;
};

// Σ X(k) cos(π (2n + 1) k / 2N) for N = base · 2^levels samples n and the lowest `known` frequencies k.
class Halving {
public:
    Halving() = default;

    // forward: also prepares `transposed`.
    Halving(size_t samples, size_t levels, size_t known, bool forward = false) : base_(samples >> levels), counts_{known} {
        for (size_t level = 0; level < levels; ++level) {
            const size_t size = samples >> level;
            counts_.push_back(std::min(size / 2, counts_.back() / 2 + 1));
            secants_.emplace_back(size / 2);
            for (size_t n = 0; n < size / 2; ++n) secants_.back()[n] = 0.5 / std::cos(PI * double(2 * n + 1) / double(2 * size));
        }
        std::vector<double> quarter_turns(4 * base_);
        for (size_t j = 0; j < 4 * base_; ++j) quarter_turns[j] = std::cos(PI * double(j) / double(2 * base_));
        const size_t half = (base_ + 1) / 2;
        for (size_t parity = 0; parity < 2; ++parity) {
            const size_t count = frequencies(parity);
            cosines_[parity].assign((half + TILE - 1) / TILE * count * TILE, 0.0);
            for (size_t n = 0; n < half; ++n)
                for (size_t i = 0; i < count; ++i)
                    cosines_[parity][(n / TILE * count + i) * TILE + n % TILE] =
                        quarter_turns[(2 * n + 1) * (2 * i + parity) % (4 * base_)];
            if (!forward) continue;
            turned_[parity].assign((count + TILE - 1) / TILE * half * TILE, 0.0);
            for (size_t n = 0; n < half; ++n)
                for (size_t i = 0; i < count; ++i)
                    turned_[parity][(i / TILE * half + n) * TILE + i % TILE] =
                        quarter_turns[(2 * n + 1) * (2 * i + parity) % (4 * base_)];
        }
    }

    // Operations a sample.
    static double cost(size_t levels, size_t known) {
        return 6.0 * double(levels) + double(known >> levels) + (levels ? 1.0 : 0.0);
    }

    size_t samples() const { return base_ << secants_.size(); }
    size_t known() const { return counts_[0]; }
    // Size of each buffer of `run`, in rows of PANEL doubles.
    size_t rows() const { return std::max(samples(), counts_.back() << secants_.size()); }

    // Input: the first `known()` rows of `from`, overwritten. Returns the buffer with the samples, `from` or `other`.
    ALWAYS_INLINE double *run(double *from, double *other) const {
        const size_t levels = secants_.size();
        for (size_t level = 0; level < levels; ++level) {
            for (size_t block = 0; block < size_t(1) << level; ++block) split(level, block, from, other);
            std::swap(from, other);
        }
        for (size_t block = 0; block < size_t(1) << levels; ++block)
            sum(from + block * counts_.back() * PANEL, other + block * base_ * PANEL);
        std::swap(from, other);
        for (size_t level = levels; level-- > 0;) {
            for (size_t block = 0; block < size_t(1) << level; ++block) merge(level, block, from, other);
            std::swap(from, other);
        }
        return from;
    }

    // The transpose of `run`: Σ x(n) cos(π (2n + 1) k / 2N), (known, PANEL), for the samples in `from`.
    ALWAYS_INLINE double *transposed(double *from, double *other) const {
        const size_t levels = secants_.size();
        for (size_t level = 0; level < levels; ++level) {
            for (size_t block = 0; block < size_t(1) << level; ++block) fold(level, block, from, other);
            std::swap(from, other);
        }
        for (size_t block = 0; block < size_t(1) << levels; ++block)
            sum_of_samples(from + block * base_ * PANEL, other + block * counts_.back() * PANEL);
        std::swap(from, other);
        for (size_t level = levels; level-- > 0;) {
            for (size_t block = 0; block < size_t(1) << level; ++block) join(level, block, from, other);
            std::swap(from, other);
        }
        return from;
    }

private:
    size_t frequencies(size_t parity) const { return (counts_.back() + 1 - parity) / 2; }

    // Splits X into X(2k), and X(2k − 1) + X(2k + 1).
    ALWAYS_INLINE void split(size_t level, size_t block, const double *from, double *to) const {
        const size_t known = counts_[level], count = counts_[level + 1];
        const double *x = from + block * known * PANEL;
        double *even = to + 2 * block * count * PANEL, *odd = even + count * PANEL;
        const Four zero = Four{} * 0.0;
        Four before[2] = {zero, zero};
        for (size_t k = 0; k < count; ++k) {
            Four here[2] = {zero, zero}, after[2] = {zero, zero};
            if (2 * k < known) load(here, x + 2 * k * PANEL);
            if (2 * k + 1 < known) load(after, x + (2 * k + 1) * PANEL);
            store(here, even + k * PANEL);
            const Four sum[2] = {before[0] + after[0], before[1] + after[1]};
            store(sum, odd + k * PANEL);
            before[0] = after[0], before[1] = after[1];
        }
    }

    ALWAYS_INLINE void merge(size_t level, size_t block, const double *from, double *to) const {
        const std::vector<double> &secant = secants_[level];
        const size_t half = secant.size();
        const double *even = from + 2 * block * half * PANEL, *odd = even + half * PANEL;
        double *head = to + 2 * block * half * PANEL, *tail = head + (2 * half - 1) * PANEL;
        for (size_t n = 0; n < half; ++n) {
            Four a[2], b[2];
            load(a, even + n * PANEL), load(b, odd + n * PANEL);
            b[0] *= secant[n], b[1] *= secant[n];
            const Four sum[2] = {a[0] + b[0], a[1] + b[1]}, difference[2] = {a[0] - b[0], a[1] - b[1]};
            store(sum, head + n * PANEL), store(difference, tail - n * PANEL);
        }
    }

    // The transpose of `merge`.
    ALWAYS_INLINE void fold(size_t level, size_t block, const double *from, double *to) const {
        const std::vector<double> &secant = secants_[level];
        const size_t half = secant.size();
        const double *head = from + 2 * block * half * PANEL, *tail = head + (2 * half - 1) * PANEL;
        double *even = to + 2 * block * half * PANEL, *odd = even + half * PANEL;
        for (size_t n = 0; n < half; ++n) {
            Four a[2], b[2];
            load(a, head + n * PANEL), load(b, tail - n * PANEL);
            const Four sum[2] = {a[0] + b[0], a[1] + b[1]};
            const Four difference[2] = {(a[0] - b[0]) * secant[n], (a[1] - b[1]) * secant[n]};
            store(sum, even + n * PANEL), store(difference, odd + n * PANEL);
        }
    }

    // The transpose of `split`.
    ALWAYS_INLINE void join(size_t level, size_t block, const double *from, double *to) const {
        const size_t known = counts_[level], count = counts_[level + 1];
        const double *even = from + 2 * block * count * PANEL, *odd = even + count * PANEL;
        double *out = to + block * known * PANEL;
        for (size_t k = 0; 2 * k < known; ++k) {
            Four here[2], after[2];
            load(here, even + k * PANEL);
            store(here, out + 2 * k * PANEL);
            if (2 * k + 1 >= known) break;
            load(here, odd + k * PANEL);
            if (k + 1 < count) load(after, odd + (k + 1) * PANEL), here[0] += after[0], here[1] += after[1];
            store(here, out + (2 * k + 1) * PANEL);
        }
    }

    // The transpose of `sum`; overwrites the samples.
    ALWAYS_INLINE void sum_of_samples(double *x, double *out) const {
        for (size_t n = 0; n < base_ / 2; ++n) {
            Four a[2], b[2];
            load(a, x + n * PANEL), load(b, x + (base_ - 1 - n) * PANEL);
            const Four sum[2] = {a[0] + b[0], a[1] + b[1]}, difference[2] = {a[0] - b[0], a[1] - b[1]};
            store(sum, x + n * PANEL), store(difference, x + (base_ - 1 - n) * PANEL);
        }
        const size_t half = (base_ + 1) / 2;
        for (size_t parity = 0; parity < 2; ++parity)
            for (size_t first = 0; first < frequencies(parity); first += TILE) {
                Four sums[TILE][2];
                const double *cosines = turned_[parity].data() + first * half;
                if (parity) tile<-1>(cosines, x + (base_ - 1) * PANEL, base_ / 2, sums);
                else tile<1>(cosines, x, half, sums);
                for (size_t i = 0; i < TILE && first + i < frequencies(parity); ++i)
                    store(sums[i], out + (2 * (first + i) + parity) * PANEL);
            }
    }

    // The series of `base_` samples as a matrix product: cosines of even frequencies are symmetric about the middle.
    ALWAYS_INLINE void sum(const double *x, double *out) const {
        const size_t half = (base_ + 1) / 2;
        for (size_t first = 0; first < half; first += TILE) {
            Four even[TILE][2], odd[TILE][2];
            tile<2>(cosines_[0].data() + first * frequencies(0), x, frequencies(0), even);
            tile<2>(cosines_[1].data() + first * frequencies(1), x + PANEL, frequencies(1), odd);
            for (size_t i = 0; i < TILE && first + i < half; ++i) {
                const Four sum[2] = {even[i][0] + odd[i][0], even[i][1] + odd[i][1]};
                const Four difference[2] = {even[i][0] - odd[i][0], even[i][1] - odd[i][1]};
                store(difference, out + (base_ - 1 - first - i) * PANEL);
                store(sum, out + (first + i) * PANEL);
            }
        }
    }

    // sums[i] = Σ cosines[f][i] · x[STRIDE f]
    template <int STRIDE>
    ALWAYS_INLINE static void tile(const double *cosines, const double *x, size_t count, Four (&sums)[TILE][2]) {
        const Four zero = Four{} * 0.0;
        Four a0 = zero, a1 = zero, b0 = zero, b1 = zero, c0 = zero, c1 = zero, d0 = zero, d1 = zero;
        for (size_t f = 0; f < count; ++f) {
            Four row[2];
            load(row, x + ptrdiff_t(f) * (STRIDE * ptrdiff_t(PANEL)));
            const double *c = cosines + f * TILE;
            a0 += row[0] * c[0], a1 += row[1] * c[0];
            b0 += row[0] * c[1], b1 += row[1] * c[1];
            c0 += row[0] * c[2], c1 += row[1] * c[2];
            d0 += row[0] * c[3], d1 += row[1] * c[3];
        }
        sums[0][0] = a0, sums[0][1] = a1, sums[1][0] = b0, sums[1][1] = b1;
        sums[2][0] = c0, sums[2][1] = c1, sums[3][0] = d0, sums[3][1] = d1;
    }

    size_t base_ = 0;
    std::vector<size_t> counts_;  // number of known frequencies on each level
    std::vector<std::vector<double>> secants_;
    std::vector<double> cosines_[2], turned_[2];  // of even and odd frequencies, for TILE samples, and for TILE frequencies
};

// The orthonormal inverse DCT of the lowest `known` frequencies of `frames` frames.
class Series {
public:
    // forward: also prepares `transposed`.
    Series(size_t frames, size_t known, bool forward = false) : frames_(frames), scales_(known) {
        size_t levels = 0;
        double least = Halving::cost(0, known);
        for (size_t level = 1; frames % (size_t(1) << level) == 0 && known >> level; ++level)
            if (const double cost = Halving::cost(level, known); cost < least) least = cost, levels = level;
        size_t grid = 0;
        for (size_t level = 0; known >> level > TAPS / 2; ++level) {
            const size_t samples = size_t(std::ceil(OVERSAMPLING * double(known) / double(size_t(1) << level))) << level;
            const double cost = 2 * TAPS + Halving::cost(level, known) * double(samples) / double(frames);
            if (samples > 2 * TAPS && cost < least) least = cost, levels = level, grid = samples;
        }
        for (size_t k = 0; k < known; ++k) scales_[k] = std::sqrt((k ? 2.0 : 1.0) / double(frames));
        halving_ = Halving(grid ? grid : frames, levels, known, forward);
        if (grid) interpolate(grid);
        if (grid && forward) turn_weights(grid);
    }

    size_t frames() const { return frames_; }
    size_t known() const { return scales_.size(); }
    double scale(size_t k) const { return scales_[k]; }  // factor of the inputs of `run`
    // Size of a buffer, doubles; align rows of PANEL to cache lines.
    size_t buffer() const { return (std::max(halving_.rows(), firsts_.empty() ? 0 : frames_) + 2 * MARGIN) * PANEL; }

    // Inverse DCT of PANEL columns of coefficients times `scale`, (known, PANEL), after the first MARGIN rows of `from`.
    // Writes the first `width` columns to rows of `out`, `pitch` doubles apart. from, other: `buffer()` doubles each.
    ALWAYS_INLINE void run(double *from, double *other, double *out, size_t pitch, size_t width) const {
        if (width == PANEL) run(from, other, [=](size_t t, const Four(&row)[2]) ALWAYS_INLINE_LAMBDA { store(row, out + t * pitch); });
        else
            run(from, other, [=](size_t t, const Four(&row)[2]) ALWAYS_INLINE_LAMBDA {
                double whole[PANEL];
                store(row, whole);
                std::copy_n(whole, width, out + t * pitch);
            });
    }

    // The transpose of `run`: coefficients (known, PANEL), before `scale`, from samples (frames, width).
    ALWAYS_INLINE const double *transposed(double *from, double *other, const double *in, size_t pitch, size_t width) const {
        if (width == PANEL)
            return transposed(from, other, [=](size_t t, Four(&row)[2]) ALWAYS_INLINE_LAMBDA { load(row, in + t * pitch); });
        return transposed(from, other, [=](size_t t, Four(&row)[2]) ALWAYS_INLINE_LAMBDA {
            double whole[PANEL] = {};
            std::copy_n(in + t * pitch, width, whole);
            load(row, whole);
        });
    }

    static constexpr size_t MARGIN = TAPS / 2;

private:
    template <class Put>
    ALWAYS_INLINE void run(double *from, double *other, Put put) const {
        double *samples = halving_.run(from + MARGIN * PANEL, other + MARGIN * PANEL);
        if (starts_.empty()) {
            for (size_t t = 0; t < frames_; ++t) {
                Four row[2];
                load(row, samples + t * PANEL);
                put(t, row);
            }
            return;
        }
        const size_t grid = halving_.samples();
        for (size_t i = 0; i < MARGIN; ++i) {  // the series is even about both ends
            std::copy_n(samples + i * PANEL, PANEL, samples - (i + 1) * PANEL);
            std::copy_n(samples + (grid - 1 - i) * PANEL, PANEL, samples + (grid + i) * PANEL);
        }
        for (size_t t = 0; t < frames_; ++t) {
            const double *weight = weights_.data() + t * TAPS, *at = samples + (ptrdiff_t(starts_[t]) - ptrdiff_t(MARGIN)) * ptrdiff_t(PANEL);
            Four a[2], b[2];
            tap(a, at, weight), tap(b, at + PANEL, weight + 1);
            for (size_t i = 2; i < TAPS; i += 2) {
                Four c[2], d[2];
                tap(c, at + i * PANEL, weight + i), tap(d, at + (i + 1) * PANEL, weight + i + 1);
                a[0] += c[0], a[1] += c[1], b[0] += d[0], b[1] += d[1];
            }
            const Four row[2] = {a[0] + b[0], a[1] + b[1]};
            put(t, row);
        }
    }

    template <class Get>
    ALWAYS_INLINE const double *transposed(double *from, double *other, Get get) const {
        double *samples = from + MARGIN * PANEL;
        Four row[2];
        if (starts_.empty()) {
            for (size_t t = 0; t < frames_; ++t) get(t, row), store(row, samples + t * PANEL);
            return halving_.transposed(samples, other + MARGIN * PANEL);
        }
        for (size_t t = 0; t < frames_; ++t) get(t, row), store(row, other + t * PANEL);
        const size_t grid = halving_.samples();
        const double *weight = turned_.data();
        for (size_t i = 0; i < grid + 2 * MARGIN; ++i) {
            const double *at = other + size_t(firsts_[i]) * PANEL;
            Four a[2] = {Four{} * 0.0, Four{} * 0.0}, b[2] = {a[0], a[1]};
            size_t left = counts_[i];
            for (; left > 1; left -= 2, at += 2 * PANEL, weight += 2) {
                Four c[2], d[2];
                tap(c, at, weight), tap(d, at + PANEL, weight + 1);
                a[0] += c[0], a[1] += c[1], b[0] += d[0], b[1] += d[1];
            }
            if (left) tap(row, at, weight++), a[0] += row[0], a[1] += row[1];
            const Four sum[2] = {a[0] + b[0], a[1] + b[1]};
            store(sum, from + i * PANEL);
        }
        for (size_t i = 0; i < MARGIN; ++i) {
            add(samples - (i + 1) * PANEL, samples + i * PANEL);
            add(samples + (grid + i) * PANEL, samples + (grid - 1 - i) * PANEL);
        }
        return halving_.transposed(samples, other + MARGIN * PANEL);
    }

    ALWAYS_INLINE static void add(const double *from, double *to) {
        Four a[2], b[2];
        load(a, from), load(b, to);
        b[0] += a[0], b[1] += a[1];
        store(b, to);
    }

    ALWAYS_INLINE static void tap(Four (&into)[2], const double *from, const double *weight) {
        load(into, from);
        into[0] *= *weight, into[1] *= *weight;
    }

    // Computes the window's weights, and divides the scales by its Fourier transform.
    void interpolate(size_t grid) {
        const double half = TAPS / 2.0, shape = TAPS * PI * (1 - 0.5 * double(known()) / double(grid));
        for (size_t k = 0; k < known(); ++k) {
            const double turn = half * PI * double(k) / double(grid);
            scales_[k] /= half * PI * shape * bessel_i1_over(std::sqrt(shape * shape - turn * turn));
        }
        starts_.resize(frames_), weights_.resize(frames_ * TAPS);
        for (size_t t = 0; t < frames_; ++t) {
            const double at = double(grid) * (double(t) + 0.5) / double(frames_) - 0.5;
            const double left = std::floor(at);
            starts_[t] = uint32_t(int64_t(left) + 1);  // MARGIN rows before the first sample
            for (size_t i = 0; i < TAPS; ++i) {
                const double z = (at - left + double(MARGIN - 1) - double(i)) / half;
                weights_[t * TAPS + i] = std::sinh(shape * std::sqrt(std::max(0.0, 1 - z * z)));
            }
        }
    }

    // Transposes the weights: for each sample of the grid and its margins, those of the frames around it.
    void turn_weights(size_t grid) {
        firsts_.assign(grid + 2 * MARGIN, 0), counts_.assign(grid + 2 * MARGIN, 0);
        turned_.clear();
        size_t first = 0;
        for (size_t i = 0; i < firsts_.size(); ++i) {  // starts ascend
            while (first < frames_ && starts_[first] + TAPS <= i) ++first;
            firsts_[i] = uint32_t(first);
            for (size_t t = first; t < frames_ && starts_[t] <= i; ++t, ++counts_[i])
                turned_.push_back(weights_[t * TAPS + i - starts_[t]]);
        }
    }

    // I₁(x) / x, from its power series.
    static double bessel_i1_over(double x) {
        const double square = x * x / 4;
        double term = 0.5, sum = term;
        for (int i = 1; term > 1e-17 * sum; ++i) {
            term *= square / (double(i) * double(i + 1));
            sum += term;
        }
        return sum;
    }

    const size_t frames_;
    std::vector<double> scales_;
    Halving halving_;
    std::vector<uint32_t> starts_;  // first sample of each frame's taps, margin included
    std::vector<double> weights_;   // (frames, TAPS)
    std::vector<uint32_t> firsts_, counts_;  // frames with taps at each sample, margin included
    std::vector<double> turned_;             // weights of these frames
};

}  // namespace cosine_series
