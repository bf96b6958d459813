// Integer arithmetic.
#pragma once

#include <cstdint>

// Rounds towards minus infinity, like NumPy's //.
inline int64_t floor_division(int64_t a, int64_t b) { return a / b - (a % b != 0 && (a < 0) != (b < 0)); }

// floor_division for b > 0. Floats are exact enough for |a| < 2^52: a quotient that is not an integer is at least 1 / b
// from the next integer.
inline int64_t floor_quotient(int64_t a, int64_t b) {
    if (a >= int64_t(1) << 52 || a <= -(int64_t(1) << 52)) return floor_division(a, b);
    const double quotient = double(a) / double(b);
    const int64_t whole = int64_t(quotient);
    return whole - (double(whole) > quotient);
}

inline int64_t dot(const int64_t *a, const int64_t *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// Python's int.bit_length.
inline int bit_length(uint64_t x) {
    int bits = 0;
    for (; x; x >>= 1) ++bits;
    return bits;
}

// Index of the lowest set bit of x > 0.
inline int lowest_bit(uint64_t x) {
#if defined(__GNUC__) || defined(__clang__)
    return __builtin_ctzll(x);
#else
    int place = 0;
    while (!(x >> place & 1)) ++place;
    return place;
#endif
}
