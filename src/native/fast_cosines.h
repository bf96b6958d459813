// The orthonormal DCT of all frequencies and any number of frames, in eight columns at a time: stages/dct.py, forward, to
// rounding.
//
//   samples ─even ones, odd ones in reverse─► pairs of columns as complex numbers ─Fourier transform─► coefficients
//
// (Makhoul, "A fast cosine transform in one and two dimensions", 1980.) A clip may have a prime number of frames, so the Fourier
// transform is a convolution with a chirp (Bluestein, "A linear filtering approach to the computation of discrete Fourier
// transform", 1970), whose length is a power of two. Passes of radix 4 go
// there and back; quarters are convolved one after another, so that each stays in the nearest cache.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

#include "vectors.h"

namespace fast_cosines {

constexpr size_t PANEL = 8;  // columns: real parts of four complex numbers, then imaginary parts
constexpr double PI = 3.14159265358979323846;

struct Complex4 {
    Four re, im;
};

ALWAYS_INLINE Complex4 operator+(const Complex4 &a, const Complex4 &b) { return {a.re + b.re, a.im + b.im}; }
ALWAYS_INLINE Complex4 operator-(const Complex4 &a, const Complex4 &b) { return {a.re - b.re, a.im - b.im}; }
ALWAYS_INLINE Complex4 i_times(const Complex4 &a) { return {a.im * -1.0, a.re}; }
// Times the complex number `by` (real and imaginary part), and times its conjugate.
ALWAYS_INLINE Complex4 times(const Complex4 &a, const double *by) {
    return {a.re * by[0] - a.im * by[1], a.re * by[1] + a.im * by[0]};
}
ALWAYS_INLINE Complex4 times_conjugate(const Complex4 &a, const double *by) {
    return {a.re * by[0] + a.im * by[1], a.im * by[0] - a.re * by[1]};
}

ALWAYS_INLINE Complex4 load(const double *from) {
    Complex4 out;
    ::load(out.re, from), ::load(out.im, from + 4);
    return out;
}
ALWAYS_INLINE void store(const Complex4 &from, double *to) { ::store(from.re, to), ::store(from.im, to + 4); }

class FastCosines {
public:
    explicit FastCosines(size_t frames) : frames(frames), size_(SMALLEST) {
        while (size_ < 2 * frames) size_ *= 2;
        for (size_t n = 0; n < frames; ++n) add_turn(chirp_, double(n * n % (2 * frames)) / double(frames), 1);
        for (size_t length = size_; length > BASE; length /= 4)
            for (size_t j = 0; j < length / 4; ++j)
                for (size_t i = 1; i < 4; ++i) add_turn(twiddles_, 2 * double(i * j) / double(length), 1);
        for (size_t k = 0; 2 * k <= frames; ++k) add_turn(shifts_, double(k) / double(2 * frames), std::sqrt(0.5 / double(frames)));
        find_kernel();
    }

    // Doubles that `forward` needs in `work`.
    size_t work() const { return size_ * PANEL; }

    // Coefficients (frames, PANEL) of `count` columns of samples, `frames` doubles from each to the next, by take(k, row).
    template <class Take>
    ALWAYS_INLINE void forward(const double *columns, size_t count, double *work, const Take &take) const {
        gather(columns, count, work);
        convolve(work);
        double row[PANEL];
        const Complex4 zeroth = load(work);
        const double scale = std::sqrt(1 / double(frames));
        store({zeroth.re * scale, zeroth.im * scale}, row);
        take(size_t(0), row);
        for (size_t k = 1; 2 * k <= frames; ++k) {
            const Complex4 here = times(load(work + k * PANEL), chirp_.data() + 2 * k);
            const Complex4 mirrored = times(load(work + (frames - k) * PANEL), chirp_.data() + 2 * (frames - k));
            const Four re = here.re + mirrored.re, im = here.im + mirrored.im;
            const Four re_less = here.re - mirrored.re, im_less = here.im - mirrored.im;
            const double cosine = shifts_[2 * k], sine = -shifts_[2 * k + 1];
            store({re * cosine + im_less * sine, im * cosine - re_less * sine}, row);
            take(k, row);
            if (2 * k == frames) break;
            store({re * sine - im_less * cosine, im * sine + re_less * cosine}, row);
            take(frames - k, row);
        }
    }

    const size_t frames;

private:
    static constexpr size_t SMALLEST = 8, BASE = 4;  // BASE or half of it is what is left after the passes

    // scale · e^(−iπ · half_turns)
    static void add_turn(std::vector<double> &to, double half_turns, double scale) {
        to.push_back(std::cos(PI * half_turns) * scale), to.push_back(-std::sin(PI * half_turns) * scale);
    }

    // Even samples, then odd ones in reverse, times the chirp; zeros up to half of the convolution.
    ALWAYS_INLINE void gather(const double *columns, size_t count, double *work) const {
        std::memset(work, 0, size_ / 2 * PANEL * sizeof(double));
        for (size_t j = 0; j < count; ++j) {
            const double *of = columns + j * frames;
            double *to = work + j;
            for (size_t t = 0; t < frames; t += 2) to[t / 2 * PANEL] = of[t];
            for (size_t t = 1; t < frames; t += 2) to[(frames - 1 - t / 2) * PANEL] = of[t];
        }
        for (size_t n = 0; n < frames; ++n) store(times(load(work + n * PANEL), chirp_.data() + 2 * n), work + n * PANEL);
    }

    // The circular convolution with the conjugate of the chirp: the first half, of the first half, the second one being zero.
    ALWAYS_INLINE void convolve(double *work) const {
        const size_t quarter = size_ / 4;
        const double *twiddles = twiddles_.data();
        for (size_t j = 0; j < quarter; ++j) {
            double *at = work + j * PANEL;
            const Complex4 a = load(at), b = load(at + quarter * PANEL), turned = i_times(b);
            store(a + b, at);
            store(times(a - turned, twiddles + 6 * j), at + quarter * PANEL);
            store(times(a - b, twiddles + 6 * j + 2), at + 2 * quarter * PANEL);
            store(times(a + turned, twiddles + 6 * j + 4), at + 3 * quarter * PANEL);
        }
        for (size_t part = 0; part < 4; ++part)
            convolve_quarter(work + part * quarter * PANEL, kernel_.data() + part * quarter * 2);
        for (size_t j = 0; j < quarter; ++j) {
            double *at = work + j * PANEL;
            const Complex4 a = load(at), b = times_conjugate(load(at + quarter * PANEL), twiddles + 6 * j);
            const Complex4 c = times_conjugate(load(at + 2 * quarter * PANEL), twiddles + 6 * j + 2);
            const Complex4 d = times_conjugate(load(at + 3 * quarter * PANEL), twiddles + 6 * j + 4);
            store((a + c) + (b + d), at);
            store((a - c) + i_times(b - d), at + quarter * PANEL);
        }
    }

    ALWAYS_INLINE void convolve_quarter(double *work, const double *kernel) const {
        const size_t quarter = size_ / 4;
        const double *twiddles = twiddles_.data() + 6 * quarter;
        size_t length = quarter;
        for (; length > BASE; twiddles += 6 * (length / 4), length /= 4) there(work, quarter, length, twiddles);
        if (length == BASE) multiply<BASE>(work, quarter, kernel);
        else multiply<BASE / 2>(work, quarter, kernel);
        for (length *= 4; length <= quarter; length *= 4) {
            twiddles -= 6 * (length / 4);
            back(work, quarter, length, twiddles);
        }
    }

    // One pass of radix 4 over blocks of `length` of the first `size` numbers.
    ALWAYS_INLINE static void there(double *work, size_t size, size_t length, const double *twiddles) {
        const size_t quarter = length / 4 * PANEL;
        for (size_t first = 0; first < size; first += length)
            for (size_t j = 0; j < length / 4; ++j) {
                double *at = work + (first + j) * PANEL;
                Complex4 of[4] = {load(at), load(at + quarter), load(at + 2 * quarter), load(at + 3 * quarter)};
                butterfly(of);
                store(of[0], at);
                for (size_t i = 1; i < 4; ++i) store(times(of[i], twiddles + 6 * j + 2 * (i - 1)), at + i * quarter);
            }
    }

    // The inverse of `there`, times four.
    ALWAYS_INLINE static void back(double *work, size_t size, size_t length, const double *twiddles) {
        const size_t quarter = length / 4 * PANEL;
        for (size_t first = 0; first < size; first += length)
            for (size_t j = 0; j < length / 4; ++j) {
                double *at = work + (first + j) * PANEL;
                Complex4 of[4] = {load(at)};
                for (size_t i = 1; i < 4; ++i) of[i] = times_conjugate(load(at + i * quarter), twiddles + 6 * j + 2 * (i - 1));
                inverse_butterfly(of);
                for (size_t i = 0; i < 4; ++i) store(of[i], at + i * quarter);
            }
    }

    // Transforms of LENGTH numbers, times the kernel, and back.
    template <size_t LENGTH>
    ALWAYS_INLINE static void multiply(double *work, size_t size, const double *kernel) {
        for (size_t first = 0; first < size; first += LENGTH) {
            Complex4 of[LENGTH];
            for (size_t i = 0; i < LENGTH; ++i) of[i] = load(work + (first + i) * PANEL);
            butterfly(of);
            for (size_t i = 0; i < LENGTH; ++i) of[i] = times(of[i], kernel + 2 * (first + i));
            inverse_butterfly(of);
            for (size_t i = 0; i < LENGTH; ++i) store(of[i], work + (first + i) * PANEL);
        }
    }

    ALWAYS_INLINE static void butterfly(Complex4 (&of)[4]) {
        const Complex4 s = of[0] + of[2], t = of[0] - of[2], u = of[1] + of[3], v = i_times(of[1] - of[3]);
        of[0] = s + u, of[1] = t - v, of[2] = s - u, of[3] = t + v;
    }
    ALWAYS_INLINE static void inverse_butterfly(Complex4 (&of)[4]) {
        const Complex4 s = of[0] + of[2], t = of[0] - of[2], u = of[1] + of[3], v = i_times(of[1] - of[3]);
        of[0] = s + u, of[1] = t + v, of[2] = s - u, of[3] = t - v;
    }
    ALWAYS_INLINE static void butterfly(Complex4 (&of)[2]) {
        const Complex4 sum = of[0] + of[1];
        of[1] = of[0] - of[1], of[0] = sum;
    }
    ALWAYS_INLINE static void inverse_butterfly(Complex4 (&of)[2]) { butterfly(of); }

    // The transform of the chirp's conjugate over the length of the convolution, in the order of the passes.
    void find_kernel() {
        std::vector<double> work(size_ * PANEL, 0.0);
        for (size_t n = 0; n < size_; ++n) {
            const size_t distance = n < frames ? n : size_ - n;  // the chirp is symmetric
            if (distance >= frames) continue;
            work[n * PANEL] = chirp_[2 * distance] / double(size_);
            work[n * PANEL + 4] = -chirp_[2 * distance + 1] / double(size_);
        }
        const double *twiddles = twiddles_.data();
        size_t length = size_;
        for (; length > BASE; twiddles += 6 * (length / 4), length /= 4) there(work.data(), size_, length, twiddles);
        if (length == BASE) transform<BASE>(work);
        else transform<BASE / 2>(work);
        for (size_t n = 0; n < size_; ++n) kernel_.push_back(work[n * PANEL]), kernel_.push_back(work[n * PANEL + 4]);
    }

    template <size_t LENGTH>
    static void transform(std::vector<double> &work) {
        for (size_t first = 0; first < work.size(); first += LENGTH * PANEL) {
            Complex4 of[LENGTH];
            for (size_t i = 0; i < LENGTH; ++i) of[i] = load(work.data() + first + i * PANEL);
            butterfly(of);
            for (size_t i = 0; i < LENGTH; ++i) store(of[i], work.data() + first + i * PANEL);
        }
    }

    size_t size_;  // of the convolution
    std::vector<double> chirp_, twiddles_, shifts_, kernel_;  // complex numbers
};

}  // namespace fast_cosines
