// Arithmetic of integers.
#pragma once

#include <cstdint>

// Rounds towards minus infinity, as NumPy's // does.
inline int64_t floor_division(int64_t a, int64_t b) { return a / b - (a % b != 0 && (a < 0) != (b < 0)); }

// The same for b > 0: floats are exact enough for |a| below 2^52, since a quotient that is no integer is at least 1 / b from
// the next one.
inline int64_t floor_quotient(int64_t a, int64_t b) {
    if (a >= int64_t(1) << 52 || a <= -(int64_t(1) << 52)) return floor_division(a, b);
    const double quotient = double(a) / double(b);
    const int64_t whole = int64_t(quotient);
    return whole - (double(whole) > quotient);
}

inline int64_t dot(const int64_t *a, const int64_t *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// As Python's int.bit_length.
inline int bit_length(uint64_t x) {
    int bits = 0;
    for (; x; x >>= 1) ++bits;
    return bits;
}

// The place of the lowest bit of x > 0.
inline int lowest_bit(uint64_t x) {
#if defined(__GNUC__) || defined(__clang__)
    return __builtin_ctzll(x);
#else
    int place = 0;
    while (!(x >> place & 1)) ++place;
    return place;
#endif
}
