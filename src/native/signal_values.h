// Turns integers of channels into values (signals/forms.py), with the float operations of the NumPy code, each rounded.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>

#include "signal_lanes.h"

namespace signals {

enum Kind { CONSTANT, INTEGERS, COUNTS, GRID, CORRECTED, PALETTE, COPY };

// forms.Form, without the items of constants and the channels of copies.
struct Form {
    int kind;
    double step, offset;
    int64_t exponent;
    const uint64_t *palette;
    size_t palette_size;
};

template <class T>
struct FloatType;
template <>
struct FloatType<float> {
    using Word = uint32_t;
    static constexpr int mantissa_bits = 23, least_exponent = -149;
};
template <>
struct FloatType<double> {
    using Word = uint64_t;
    static constexpr int mantissa_bits = 52, least_exponent = -1074;
};

template <class T>
typename FloatType<T>::Word word_of(T value) {
    typename FloatType<T>::Word word;
    std::memcpy(&word, &value, sizeof word);
    return word;
}

template <class T>
T from_word(typename FloatType<T>::Word word) {
    T value;
    std::memcpy(&value, &word, sizeof value);
    return value;
}

// forms._rank, forms._from_rank
template <class T>
int64_t rank_of(T value) {
    const auto word = word_of(value);
    constexpr auto sign = typename FloatType<T>::Word(1) << (8 * sizeof(T) - 1);
    const auto magnitude = int64_t(word & ~sign);
    return word & sign ? -magnitude : magnitude;
}

template <class T>
T from_rank(int64_t rank) {
    using Word = typename FloatType<T>::Word;
    constexpr Word sign = Word(1) << (8 * sizeof(T) - 1);
    const uint64_t size = rank < 0 ? 0 - uint64_t(rank) : uint64_t(rank);
    return from_word<T>(Word((Word(size) & ~sign) | (rank < 0 ? sign : 0)));
}

// forms._last_bit: exponent of the last bit of a value with an integer of this size; sets the number of lower bits.
template <class T>
int64_t last_bit(const Form &form, uint64_t size, int &width) {
    const int64_t leading = top_bit(std::max<uint64_t>(size, 1)) + form.exponent;
    const int64_t last = std::max<int64_t>(leading - FloatType<T>::mantissa_bits, FloatType<T>::least_exponent);
    width = int(std::max<int64_t>(0, form.exponent - last));
    return last;
}

inline uint64_t size_of(int64_t integer) { return integer < 0 ? 0 - uint64_t(integer) : uint64_t(integer); }

// forms.inverse for a float type. lower: lower bits of a grid; corrections: of corrected counts. False if there are too
// few or too many lower bits.
template <class T>
bool float_values(const Form &form, const int64_t *integers, const int64_t *corrections, BitReader lower, size_t count,
                  T *out) {
    if (form.kind == COUNTS) {
        for (size_t t = 0; t < count; ++t) out[t] = T(double(integers[t]) * form.step + form.offset);
    } else if (form.kind == CORRECTED) {
        for (size_t t = 0; t < count; ++t) {
            const T near = T(double(integers[t]) * form.step + form.offset);
            out[t] = from_rank<T>(int64_t(uint64_t(rank_of(near)) + uint64_t(corrections[t])));
        }
    } else if (form.kind == PALETTE) {
        using Word = typename FloatType<T>::Word;
        constexpr Word sign = Word(1) << (8 * sizeof(T) - 1);
        const auto last = int64_t(form.palette_size) - 1;
        for (size_t t = 0; t < count; ++t) {
            const Word entry = Word(form.palette[std::clamp<int64_t>(integers[t], 0, last)]);
            out[t] = from_word<T>(entry & sign ? entry ^ sign : Word(~entry));
        }
    } else {
        for (size_t t = 0; t < count; ++t) {
            const uint64_t size = size_of(integers[t]);
            if (size >> 53) return false;  // no encoder writes it; NumPy decides
            int width;
            const int64_t last = last_bit<T>(form, size, width);
            if (size == 0) {
                out[t] = 0;
                continue;
            }
            const int64_t drop = last - form.exponent;
            const uint64_t mantissa = width > 0 ? size << width | uint64_t(lower.get(width))
                                                : drop < 64 ? size >> std::max<int64_t>(0, drop) : 0;
            const double magnitude = last > -1000 && last < 900
                                         ? double(mantissa) * from_word<double>(uint64_t(last + 1023) << 52)
                                         : std::ldexp(double(mantissa), int(last));
            out[t] = T(integers[t] < 0 ? -magnitude : magnitude);
        }
        return (lower.at + 7) / 8 == lower.size;
    }
    return true;
}

// forms.inverse for an integer type: products wrap around.
template <class T>
void integer_values(const Form &form, const int64_t *integers, size_t count, T *out) {
    const auto step = uint64_t(form.step);
    for (size_t t = 0; t < count; ++t) out[t] = T(uint64_t(integers[t]) * step);
}

}  // namespace signals
