// Vectors of four doubles, and functions compiled twice: for every processor, and for AVX2.
//
// Both do the same operations in the same order, without fused multiply-adds, so their bits are equal.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstring>

#if defined(__GNUC__)
#define ALWAYS_INLINE inline __attribute__((always_inline))
#define NEVER_INLINE __attribute__((noinline))
#else
#define ALWAYS_INLINE __forceinline
#define NEVER_INLINE __declspec(noinline)
#endif

#if defined(__GNUC__) && defined(__x86_64__)
#define HAS_AVX2_TWIN 1
#define WITH_AVX2 __attribute__((target("avx2")))
#define FLATTENED __attribute__((flatten))  // inlines everything that a function calls
inline bool processor_has_avx2() { return __builtin_cpu_supports("avx2"); }
#endif

#if defined(__GNUC__)
typedef double Four __attribute__((vector_size(32), aligned(8), may_alias));
#else
struct Four {
    double of[4];
    double &operator[](size_t i) { return of[i]; }
    double operator[](size_t i) const { return of[i]; }
};
#define FOUR_OPERATOR(op)                                                                                            \
    ALWAYS_INLINE Four operator op(const Four &a, const Four &b) {                                                   \
        return {{a.of[0] op b.of[0], a.of[1] op b.of[1], a.of[2] op b.of[2], a.of[3] op b.of[3]}};                   \
    }                                                                                                                \
    ALWAYS_INLINE Four operator op(const Four &a, double b) { return a op Four{{b, b, b, b}}; }                      \
    ALWAYS_INLINE Four operator op(double a, const Four &b) { return Four{{a, a, a, a}} op b; }                      \
    ALWAYS_INLINE Four &operator op##=(Four &a, const Four &b) { return a = a op b; }                                \
    ALWAYS_INLINE Four &operator op##=(Four &a, double b) { return a = a op b; }
FOUR_OPERATOR(+)
FOUR_OPERATOR(-)
FOUR_OPERATOR(*)
FOUR_OPERATOR(/)
#undef FOUR_OPERATOR
#endif

// Where `test` is less than `limit`, `below`; `others` elsewhere.
ALWAYS_INLINE Four where_less(const Four &test, double limit, const Four &below, const Four &others) {
#if defined(__GNUC__)
    return test < Four{limit, limit, limit, limit} ? below : others;
#else
    Four out;
    for (size_t i = 0; i < 4; ++i) out[i] = test[i] < limit ? below[i] : others[i];
    return out;
#endif
}
ALWAYS_INLINE Four root(const Four &of) {
    Four out;
    for (size_t i = 0; i < 4; ++i) out[i] = std::sqrt(of[i]);
    return out;
}
ALWAYS_INLINE Four magnitude(const Four &of) { return where_less(of, 0, of * -1.0, of); }
ALWAYS_INLINE Four at_least(const Four &of, double least) {
    return where_less(of, least, Four{least, least, least, least}, of);
}

ALWAYS_INLINE void load(Four &into, const double *from) { std::memcpy(&into, from, sizeof into); }
ALWAYS_INLINE void store(const Four &from, double *into) { std::memcpy(into, &from, sizeof from); }

// Views memory of doubles as vectors of four.
template <class Doubles>
ALWAYS_INLINE Four *fours(Doubles &of) { return reinterpret_cast<Four *>(of.data()); }
