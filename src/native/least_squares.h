// Predictor of the lattice engine: recursive least squares over features of three axes.
#pragma once

#include <algorithm>
#include <cstring>

namespace lattice {

constexpr double FORGETTING = 0.999, FIRST_COVARIANCE = 1.0 / 128;
constexpr int NEIGHBOURS = 3, OWN = 4, PER_NEIGHBOUR = 2, FEATURES = OWN + NEIGHBOURS * PER_NEIGHBOUR;

// ---- a point in space; the fourth number, 0, makes it two pairs for vector instructions
struct alignas(16) Vec {
    double v[4] = {};
    double operator[](int k) const { return v[k]; }
    double &operator[](int k) { return v[k]; }
};

inline Vec operator+(const Vec &a, const Vec &b) {
    Vec out;
    for (int k = 0; k < 4; ++k) out.v[k] = a.v[k] + b.v[k];
    return out;
}

inline Vec operator-(const Vec &a, const Vec &b) {
    Vec out;
    for (int k = 0; k < 4; ++k) out.v[k] = a.v[k] - b.v[k];
    return out;
}

inline Vec operator*(double scale, const Vec &a) {
    Vec out;
    for (int k = 0; k < 4; ++k) out.v[k] = scale * a.v[k];
    return out;
}

inline double square(const Vec &a) { return a[0] * a[0] + a[1] * a[1] + a[2] * a[2]; }

using Features = Vec[FEATURES];

// ---- two numbers in one vector register, each computed as if alone
#if defined(__GNUC__)
using Pair = double __attribute__((vector_size(16)));
inline Pair twice(double value) { return Pair{value, value}; }
#else
struct Pair {
    double v[2];
    double operator[](int i) const { return v[i]; }
    double &operator[](int i) { return v[i]; }
};
inline Pair twice(double value) { return {{value, value}}; }
inline Pair operator+(Pair a, Pair b) { return {{a.v[0] + b.v[0], a.v[1] + b.v[1]}}; }
inline Pair operator-(Pair a, Pair b) { return {{a.v[0] - b.v[0], a.v[1] - b.v[1]}}; }
inline Pair operator*(Pair a, Pair b) { return {{a.v[0] * b.v[0], a.v[1] * b.v[1]}}; }
#endif

// ---- recursive least squares: one set of weights for the three axes
struct Predictor {
    static constexpr int PAIRS = FEATURES / 2;
    double weights[FEATURES];
    Pair covariance[FEATURES][PAIRS];

    void start(const double *from) {
        std::memcpy(weights, from, sizeof weights);
        reset();
    }

    void reset() {
        std::memset(covariance, 0, sizeof covariance);
        for (int i = 0; i < FEATURES; ++i) covariance[i][i / 2][i % 2] = FIRST_COVARIANCE;
    }

    Vec predict(const Features &x) const {
        Vec sum;
        for (int i = 0; i < FEATURES; ++i) sum = sum + weights[i] * x[i];
        return sum;
    }

    // off: sample − base. Learns the axes in turn, and sums the gain of the next axis while it updates the covariance.
    void learn(const Features &x, const Vec &off) {
        Pair gain[PAIRS];
        gains(x, 0, gain);
        learn_axis<0>(x, off, gain);
        learn_axis<1>(x, off, gain);
        learn_axis<2>(x, off, gain);
    }

private:
    void gains(const Features &x, int k, Pair *gain) const {
        Pair sum[PAIRS] = {};
        for (int j = 0; j < FEATURES; ++j)
            for (int i = 0; i < PAIRS; ++i) sum[i] = sum[i] + covariance[j][i] * twice(x[j].v[k]);
        std::copy(sum, sum + PAIRS, gain);
    }

    // gain: on entry for the features of axis K, on exit for those of the next axis.
    template <int K>
    void learn_axis(const Features &x, const Vec &off, Pair *gain) {
        constexpr double forgetting = K ? 1.0 : FORGETTING;
        constexpr int next = K < 2 ? K + 1 : K;
        double predicted = 0, power = forgetting;
        for (int i = 0; i < FEATURES; ++i) predicted += weights[i] * x[i].v[K];
        for (int i = 0; i < FEATURES; ++i) power += gain[i / 2][i % 2] * x[i].v[K];
        if (!(power >= 0.5 * forgetting && power < 1e300)) {
            reset();
            if (K < 2) gains(x, next, gain);
            return;
        }
        const double inverse = 1 / power, error = off[K] - predicted;
        double scaled[FEATURES];
        for (int i = 0; i < FEATURES; ++i) scaled[i] = gain[i / 2][i % 2] * inverse;
        for (int i = 0; i < FEATURES; ++i) weights[i] += scaled[i] * error;
        Pair sum[PAIRS] = {};
        for (int i = 0; i < FEATURES; ++i)
            for (int j = 0; j < PAIRS; ++j) {
                Pair c = covariance[i][j] - twice(scaled[i]) * gain[j];
                if (K == 0) c = c * twice(1 / FORGETTING);  // 1 for the other axes
                covariance[i][j] = c;
                if (K < 2) sum[j] = sum[j] + c * twice(x[i].v[next]);
            }
        if (K < 2) std::copy(sum, sum + PAIRS, gain);
    }
};

}  // namespace lattice
