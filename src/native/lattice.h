// One chunk by the lattice engine of codecs/tempo/coding/lattice.py: each sample is predicted from decoded ones by
// recursive least squares, and its residual is a point of a body-centred cubic lattice.
//
// Floats are computed by the same operations in the same order as in the NumPy code.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstring>
#include <type_traits>

#include "adaptive_bits.h"

namespace lattice {

using std::ptrdiff_t;

constexpr double FORGETTING = 0.999, FIRST_COVARIANCE = 1.0 / 128;
constexpr double DISTANCE_MEMORY = 0.995, RADIAL_MEMORY = 0.98;
constexpr double DISTORTION = 384;  // cost of an error at the bound, 1/256 bit: what it does to predictions
constexpr int NEIGHBOURS = 3, OWN = 4, PER_NEIGHBOUR = 2, FEATURES = OWN + NEIGHBOURS * PER_NEIGHBOUR;
constexpr int BUCKETS = 96, COMMON = 30;  // buckets of magnitudes; those with contexts of their own
constexpr double NEAR = 8;                // partners nearer than this have no direction
constexpr double LIMIT = 1099511627776.0;  // 2^40: predictions and residuals beyond are not coded
constexpr double RADIUS_2 = 1.25;         // squared covering radius of the lattice, half steps
constexpr double WIDE = 12;               // residuals with a coordinate beyond are not optimised
constexpr int LARGEST_STRIDE_LOG = 6;
constexpr int EDGE = 7;                   // level of samples without both neighbours in time

// ---- magnitudes: 0 … 4, then two buckets an octave
struct Bucket {
    int64_t first;
    int width;
};

inline const Bucket *buckets() {
    static Bucket table[BUCKETS];
    static bool ready = false;
    if (!ready) {
        int64_t first = 0;
        for (int b = 0; b < BUCKETS; ++b) {
            const int width = b < 5 ? 0 : (b - 5) / 2 + 1;
            table[b] = {first, width};
            first += int64_t(1) << std::min(width, 62);
        }
        ready = true;
    }
    return table;
}

inline int bucket_of(int64_t magnitude) {
    const Bucket *table = buckets();
    int b = int(std::min<int64_t>(magnitude, 5));
    while (b + 1 < BUCKETS && magnitude >= table[b + 1].first) ++b;
    return b;
}

// Twice the logarithm of a number of sixteenths, 0 … 23.
inline int coarse_log(int64_t v) {
    if (v <= 0) return 0;
    int octave = 63 - __builtin_clzll(uint64_t(v));
    const int half = octave ? int(v >> (octave - 1) & 1) : 0;
    return std::min(23, 2 * octave + half + 1);
}

// ---- recursive least squares: one set of weights for the three axes
struct Predictor {
    double weights[FEATURES], covariance[FEATURES][FEATURES];

    void start(const double *from) {
        std::memcpy(weights, from, sizeof weights);
        reset();
    }

    void reset() {
        std::memset(covariance, 0, sizeof covariance);
        for (int i = 0; i < FEATURES; ++i) covariance[i][i] = FIRST_COVARIANCE;
    }

    double predict(const double *x) const {
        double sum = 0;
        for (int i = 0; i < FEATURES; ++i) sum += weights[i] * x[i];
        return sum;
    }

    void learn(const double *x, double error, double forgetting) {
        double gain[FEATURES];
        double power = forgetting;
        for (int i = 0; i < FEATURES; ++i) {
            double sum = 0;
            for (int j = 0; j < FEATURES; ++j) sum += covariance[j][i] * x[j];
            gain[i] = sum;
        }
        for (int i = 0; i < FEATURES; ++i) power += gain[i] * x[i];
        if (!(power >= 0.5 * forgetting && power < 1e300)) {
            reset();
            return;
        }
        const double inverse = 1 / power, longer = 1 / forgetting;
        for (int i = 0; i < FEATURES; ++i) weights[i] += gain[i] * inverse * error;
        for (int i = 0; i < FEATURES; ++i) {
            const double scaled = gain[i] * inverse;
            for (int j = 0; j < FEATURES; ++j) covariance[i][j] = (covariance[i][j] - scaled * gain[j]) * longer;
        }
    }
};

struct Layout {
    size_t frames, points;
    const uint8_t *missing;       // (frames, points), 1 in gaps
    const int32_t *sequence;      // (points,)
    const int32_t *neighbours;    // (points, NEIGHBOURS), of points coded before, −1 for none; the first is the partner
    int stride_log;               // the first frames are 2^stride_log apart
};

template <class Coder>
class Chunk {
public:
    static constexpr bool ENCODES = std::is_same<Coder, bits::Encoder>::value;

    Chunk(const Layout &layout, const bits::Tables &tables, Coder &coder, const double *wanted)
        : of(layout), mixer(tables), coder_(coder), wanted_(wanted), decoded(layout.points * layout.frames * 3),
          activity_(layout.points * layout.frames), radial_(layout.points * layout.frames) {
        const int levels = of.stride_log + 1;
        for (int l = 0; l < levels; ++l) {
            std::memset(mean_weights_[l], 0, sizeof mean_weights_[l]);
            if (l) mean_weights_[l][0] = -0.0625;
            level_activity_[l] = 64 * 16;
        }
    }

    // Whether the stream was consistent.
    bool run() {
        for (size_t i = 0; i < of.points; ++i)
            if (!point(size_t(of.sequence[i]), i == 0)) return false;
        return true;
    }

private:
    const Layout of;
    bits::Mixer mixer;
    Coder &coder_;
    const double *wanted_;  // (points, frames, 3), half steps

public:
    std::vector<double> decoded;  // (points, frames, 3), half steps

private:
    std::vector<int32_t> activity_, radial_;
    double mean_weights_[8][FEATURES];
    int64_t level_activity_[8];

    // the sample that is coded
    double features_[3][FEATURES], base_[3];
    size_t p_ = 0;
    const int32_t *near_ = nullptr;
    int level_ = 0, class_ = 0, known_ = 0;
    uint32_t radial_context_ = 0;

    double at(size_t p, ptrdiff_t t, int k) const { return decoded[(p * of.frames + size_t(t)) * 3 + size_t(k)]; }

    bool point(size_t p, bool first) {
        p_ = p;
        near_ = of.neighbours + p * NEIGHBOURS;
        known_ = 0;
        while (known_ < NEIGHBOURS && near_[known_] >= 0) ++known_;
        double distance = 0, distances = 0;
        for (level_ = 0; level_ <= of.stride_log; ++level_)
            if (!level(distance, distances, first)) return false;
        return true;
    }

    bool level(double &distance, double &distances, bool first) {
        const ptrdiff_t frames = ptrdiff_t(of.frames);
        const ptrdiff_t half = ptrdiff_t(1) << (of.stride_log - level_);
        const ptrdiff_t step = level_ ? 2 * half : half;
        Predictor predictor;
        predictor.start(mean_weights_[level_]);
        int64_t slow = level_activity_[level_];
        double radial_square = 1e-3, radial_product = 0;
        for (ptrdiff_t t = level_ ? half : 0; t < frames; t += step) {
            const bool gap = missing(t);
            const bool inside = !gap && (level_ ? t + half < frames && !missing(t - half) && !missing(t + half)
                                                : t >= 2 * half && !missing(t - half) && !missing(t - 2 * half));
            double guess[3];
            if (!inside) follow(t, half);
            else if (level_) interpolate(t, half);
            else extrapolate(t, half);
            for (int k = 0; k < 3; ++k) {
                guess[k] = base_[k] + (inside ? predictor.predict(features_[k]) : 0.0);
                if (!(std::fabs(guess[k]) < LIMIT)) guess[k] = std::fabs(base_[k]) < LIMIT ? base_[k] : 0.0;
            }
            const size_t here = p_ * of.frames + size_t(t);
            if (gap) {
                for (int k = 0; k < 3; ++k) decoded[here * 3 + size_t(k)] = guess[k];
                activity_[here] = t >= step ? activity_[here - size_t(step)] : 0;
                continue;
            }
            double axes[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, away = 0, linear[3] = {guess[0], guess[1], guess[2]};
            bool radial = false;
            if (known_ && inside && distances > 0) {
                double length = 0;
                for (int k = 0; k < 3; ++k) {
                    axes[0][k] = guess[k] - at(size_t(near_[0]), t, k);
                    length += axes[0][k] * axes[0][k];
                }
                length = std::sqrt(length);
                radial = length > NEAR;
                if (radial) {
                    for (int k = 0; k < 3; ++k) axes[0][k] /= length;
                    frame(axes);
                    away = distance / distances - length;
                    const double share = std::min(1.0, std::max(0.0, radial_product / radial_square));
                    for (int k = 0; k < 3; ++k) guess[k] += share * away * axes[0][k];
                } else {
                    axes[0][0] = 1; axes[0][1] = 0; axes[0][2] = 0;
                }
            }
            contexts(t, half, step, inside, radial, slow, first && t == 0);
            int64_t z[3];
            if (!code(here, guess, axes, radial, z)) return false;
            for (int k = 0; k < 3; ++k)
                decoded[here * 3 + size_t(k)] =
                    guess[k] + (axes[0][k] * double(z[0]) + axes[1][k] * double(z[1]) + axes[2][k] * double(z[2]));
            const int64_t sum = std::min<int64_t>(4000, std::abs(z[0]) + std::abs(z[1]) + std::abs(z[2]));
            activity_[here] = int32_t(sum);
            radial_[here] = int32_t(std::min<int64_t>(4000, std::abs(z[0])));
            if (inside) slow += (sum * 256 - slow) >> 4;
            if (known_) {
                double length = 0;
                for (int k = 0; k < 3; ++k) {
                    const double d = decoded[here * 3 + size_t(k)] - at(size_t(near_[0]), t, k);
                    length += d * d;
                }
                distance = distance * DISTANCE_MEMORY + std::sqrt(length);
                distances = distances * DISTANCE_MEMORY + 1;
                if (radial) {
                    double along = 0;
                    for (int k = 0; k < 3; ++k) along += axes[0][k] * (decoded[here * 3 + size_t(k)] - linear[k]);
                    radial_square = radial_square * RADIAL_MEMORY + away * away;
                    radial_product = radial_product * RADIAL_MEMORY + away * along;
                }
            }
            if (inside)
                for (int k = 0; k < 3; ++k)
                    predictor.learn(features_[k],
                                    decoded[here * 3 + size_t(k)] - base_[k] - predictor.predict(features_[k]),
                                    k == 0 ? FORGETTING : 1.0);
        }
        level_activity_[level_] = (level_activity_[level_] * 7 + slow * 3) / 10;
        for (int i = 0; i < FEATURES; ++i)
            mean_weights_[level_][i] = (mean_weights_[level_][i] + predictor.weights[i]) / 2;
        return true;
    }

    // Two more axes at right angles to the first.
    static void frame(double (&axes)[3][3]) {
        const double *u = axes[0];
        const double a = std::fabs(u[0]), b = std::fabs(u[1]), c = std::fabs(u[2]);
        const int least = a < b ? (a < c ? 0 : 2) : (b < c ? 1 : 2);
        double length = 0;
        for (int k = 0; k < 3; ++k) {
            axes[1][k] = (k == least ? 1.0 : 0.0) - u[least] * u[k];
            length += axes[1][k] * axes[1][k];
        }
        length = std::sqrt(length);
        for (int k = 0; k < 3; ++k) axes[1][k] /= length;
        const double *v = axes[1];
        axes[2][0] = u[1] * v[2] - u[2] * v[1];
        axes[2][1] = u[2] * v[0] - u[0] * v[2];
        axes[2][2] = u[0] * v[1] - u[1] * v[0];
    }

    bool missing(ptrdiff_t t) const { return of.missing[size_t(t) * of.points + p_] != 0; }

    // Beside a gap or an end: moved as the partner has moved, from the frame before or after; between two, their mean.
    void follow(ptrdiff_t t, ptrdiff_t half) {
        const bool before = t >= half, after = level_ && t + half < ptrdiff_t(of.frames);
        const bool from_before = before && !(after && missing(t - half) && !missing(t + half));
        const bool both = before && after && missing(t - half) == missing(t + half);
        for (int k = 0; k < 3; ++k) {
            if (!before && !after) base_[k] = known_ ? at(size_t(near_[0]), t, k) : 0.0;
            else if (both) base_[k] = (at(p_, t - half, k) + at(p_, t + half, k)) / 2;
            else {
                const ptrdiff_t from = from_before ? t - half : t + half;
                base_[k] = at(p_, from, k) + (known_ ? at(size_t(near_[0]), t, k) - at(size_t(near_[0]), from, k) : 0.0);
            }
        }
    }

    // Level 0: from the two frames before, each `half` apart.
    void extrapolate(ptrdiff_t t, ptrdiff_t half) {
        const ptrdiff_t frames = ptrdiff_t(of.frames);
        std::memset(features_, 0, sizeof features_);
        auto bend = [&](size_t p, ptrdiff_t s, int k) { return at(p, s, k) - 2 * at(p, s - half, k) + at(p, s - 2 * half, k); };
        for (int k = 0; k < 3; ++k) {
            double *x = features_[k];
            base_[k] = 2 * at(p_, t - half, k) - at(p_, t - 2 * half, k);
            for (int i = 0; i < OWN; ++i)
                if (t >= (i + 3) * half) x[i] = bend(p_, t - (i + 1) * half, k);
            for (int q = 0; q < known_; ++q) {
                const size_t n = size_t(near_[q]);
                x[OWN + 2 * q] = bend(n, t, k);
                if (t + half < frames) x[OWN + 2 * q + 1] = bend(n, t + half, k);
            }
        }
    }

    // Other levels: from the frames around, each `half` apart.
    void interpolate(ptrdiff_t t, ptrdiff_t half) {
        const ptrdiff_t frames = ptrdiff_t(of.frames);
        std::memset(features_, 0, sizeof features_);
        for (int k = 0; k < 3; ++k) {
            const double left = at(p_, t - half, k), right = at(p_, t + half, k);
            const double left3 = t >= 3 * half ? at(p_, t - 3 * half, k) : 2 * left - right;
            const double right3 = t + 3 * half < frames ? at(p_, t + 3 * half, k) : 2 * right - left;
            const double left5 = t >= 5 * half ? at(p_, t - 5 * half, k) : 2 * left3 - left;
            const double right5 = t + 5 * half < frames ? at(p_, t + 5 * half, k) : 2 * right3 - right;
            double *x = features_[k];
            base_[k] = (left + right) / 2;
            x[0] = (left3 - left) - (right - right3);
            x[1] = t >= 2 * half ? at(p_, t - 2 * half, k) - (left3 + left) / 2 : 0.0;
            x[2] = (left5 - left3) - (right3 - right5);
            x[3] = t >= 4 * half ? at(p_, t - 4 * half, k) - (left3 + left5) / 2 : 0.0;
            for (int q = 0; q < known_; ++q) {
                const size_t n = size_t(near_[q]);
                auto off = [&](ptrdiff_t s) {
                    return s < half || s + half >= frames ? 0.0 : at(n, s, k) - (at(n, s - half, k) + at(n, s + half, k)) / 2;
                };
                x[OWN + 2 * q] = off(t);
                x[OWN + 2 * q + 1] = off(t - half) + off(t + half);
            }
        }
    }

    void contexts(ptrdiff_t t, ptrdiff_t half, ptrdiff_t step, bool inside, bool radial, int64_t slow, bool origin) {
        const ptrdiff_t frames = ptrdiff_t(of.frames);
        auto of_point = [&](size_t p, ptrdiff_t s) { return int64_t(activity_[p * of.frames + size_t(s)]); };
        const int64_t before = t >= step ? of_point(p_, t - step) : slow / 256;
        const int64_t before2 = t >= 2 * step ? of_point(p_, t - 2 * step) : before;
        int64_t beside[3];
        for (int q = 0; q < 3; ++q)
            beside[q] = q < known_ ? of_point(size_t(near_[q]), t) : q ? beside[q - 1] : before;
        const int64_t next = known_ && t + step < frames ? of_point(size_t(near_[0]), t + step) : beside[0];
        int64_t around = 2 * before;
        if (level_) around = of_point(p_, t - half) + of_point(p_, t + half < frames ? t + half : t - half);
        class_ = origin ? 6 : inside ? std::min(level_, 5) : EDGE;
        const uint32_t c = uint32_t(class_);
        const uint32_t mean = uint32_t(coarse_log(slow / 16)), own = uint32_t(coarse_log(8 * (2 * before + before2)));
        const uint32_t near = uint32_t(coarse_log(8 * (beside[0] + beside[1]) + 4 * (beside[2] + next)));
        const uint32_t outer = uint32_t(coarse_log(8 * around));
        const uint32_t all = uint32_t(coarse_log(
            (slow / 16 * 2 + 10 * (2 * before + before2) + 8 * (2 * beside[0] + beside[1] + beside[2])) / 4));
        const uint32_t list[bits::INPUTS] = {c * 24 + mean, 200 + own * 24 + near, 1000 + (c * 24 + near) * 24 + mean,
                                             8000 + (c * 24 + outer) * 24 + near, 14000 + c * 24 + all};
        mixer.contexts(list);
        radial_context_ = 0;
        if (radial) {
            const int64_t r1 = t >= step ? radial_[p_ * of.frames + size_t(t - step)] : 0;
            const int64_t r2 = t >= 2 * step ? radial_[p_ * of.frames + size_t(t - 2 * step)] : 0;
            radial_context_ = uint32_t(1 + coarse_log(16 * (r1 + r2)));
        }
    }

    // kind of "is the magnitude beyond bucket b": odd coordinates, and those along the partner, have their own.
    uint32_t kind(int odd, bool along, int b) const {
        return uint32_t(1 + (2 * along + odd) * 32 + std::min(b, COMMON)) + (along ? radial_context_ * 256u * 257u : 0u);
    }
    uint32_t set(uint32_t what) const { return what * 8 + uint32_t(class_); }

    bool code(size_t here, const double *guess, const double (&axes)[3][3], bool radial, int64_t *z) {
        if constexpr (ENCODES) {
            double residual[3], off[3];
            for (int k = 0; k < 3; ++k) off[k] = wanted_[here * 3 + size_t(k)] - guess[k];
            for (int k = 0; k < 3; ++k) {
                residual[k] = axes[k][0] * off[0] + axes[k][1] * off[1] + axes[k][2] * off[2];
                if (!(std::fabs(residual[k]) < LIMIT)) return false;
            }
            choose(residual, radial, z);
        }
        bits::Mixed m;
        int odd = 0;
        mixer.mix(m, 0, set(0));
        if constexpr (ENCODES) { odd = int(z[0] & 1); coder_.bit(odd, m.p); } else odd = coder_.bit(m.p);
        mixer.learn(m, odd);
        for (int k = 0; k < 3; ++k) {
            const bool along = radial && k == 0;
            const int64_t magnitude = ENCODES ? std::abs(z[k]) >> 1 : 0;
            const int wanted = ENCODES ? bucket_of(magnitude) : 0;
            int b = 0;
            for (; b < BUCKETS - 1; ++b) {
                mixer.mix(m, kind(odd, along, b), set(uint32_t(1 + (2 * along + odd) * 8 + std::min(b, 7))));
                int more = wanted > b;
                if constexpr (ENCODES) coder_.bit(more, m.p); else more = coder_.bit(m.p);
                mixer.learn(m, more);
                if (!more) break;
            }
            const Bucket &bucket = buckets()[b];
            if (bucket.width > 42) return false;
            int64_t rest = ENCODES ? magnitude - bucket.first : 0;
            for (int place = bucket.width - 1; place >= 0; --place) {
                int bit = int(rest >> place & 1);
                if (place == bucket.width - 1) {
                    mixer.mix(m, uint32_t(140 + b), set(40));
                    if constexpr (ENCODES) coder_.bit(bit, m.p); else bit = coder_.bit(m.p);
                    mixer.learn(m, bit);
                } else if constexpr (ENCODES) coder_.bit(bit, bits::HALF);
                else bit = coder_.bit(bits::HALF);
                if constexpr (!ENCODES) rest |= int64_t(bit) << place;
            }
            if constexpr (!ENCODES) z[k] = 2 * (bucket.first + rest) + odd;
            if (odd || (ENCODES ? z[k] != 0 : z[k] > 0)) {
                if constexpr (ENCODES) coder_.bit(z[k] < 0, bits::HALF);
                else if (coder_.bit(bits::HALF)) z[k] = -z[k];
            }
        }
        if constexpr (!ENCODES) return !coder_.exhausted();
        return true;
    }

    // ---- the encoder's choice
    void choose(const double *residual, bool radial, int64_t *z) {
        int64_t even[3], odd[3];
        double even2 = 0, odd2 = 0;
        for (int k = 0; k < 3; ++k) {
            const double e = std::floor(residual[k] / 2 + 0.5) * 2, o = std::floor(residual[k] / 2) * 2 + 1;
            even2 += (residual[k] - e) * (residual[k] - e);
            odd2 += (residual[k] - o) * (residual[k] - o);
            even[k] = int64_t(e);
            odd[k] = int64_t(o);
        }
        std::memcpy(z, even2 <= odd2 ? even : odd, sizeof even);
        if (std::max({std::fabs(residual[0]), std::fabs(residual[1]), std::fabs(residual[2])}) > WIDE) return;
        int32_t parity[2], costs[2][2][16];
        bits::Mixed m;
        mixer.mix(m, 0, set(0));
        parity[1] = mixer.t.cost[m.p >> 4];
        parity[0] = mixer.t.cost[(65536 - m.p) >> 4];
        int most[2] = {0, 0};
        for (int k = 0; k < 3; ++k) {
            const int b = bucket_of(int64_t(std::fabs(residual[k]) + 1.2) >> 1);
            int &of_kind = most[radial && k == 0];
            of_kind = std::max(of_kind, b);
        }
        for (int along = 0; along < (radial ? 2 : 1); ++along)
            for (int o = 0; o < 2; ++o) {
                int32_t sum = 0;
                for (int b = 0; b <= most[along]; ++b) {
                    mixer.mix(m, kind(o, along, b), set(uint32_t(1 + (2 * along + o) * 8 + std::min(b, 7))));
                    costs[along][o][b] = sum + mixer.t.cost[(65536 - m.p) >> 4] + (o || b ? 256 : 0) + 256 * buckets()[b].width;
                    sum += mixer.t.cost[m.p >> 4];
                }
            }
        double best = 1e300;
        for (int o = 0; o < 2; ++o) {
            int64_t low[3];
            for (int k = 0; k < 3; ++k) low[k] = int64_t(std::floor((residual[k] - o) / 2)) * 2 + o;
            for (int corner = 0; corner < 8; ++corner) {
                const int64_t y[3] = {low[0] + 2 * (corner & 1), low[1] + (corner & 2), low[2] + (corner >> 1 & 2)};
                double square = 0;
                for (int k = 0; k < 3; ++k) square += (residual[k] - double(y[k])) * (residual[k] - double(y[k]));
                if (square > RADIUS_2) continue;
                double cost = parity[o] + DISTORTION * square / RADIUS_2;
                for (int k = 0; k < 3; ++k) cost += costs[radial && k == 0][o][bucket_of(std::abs(y[k]) >> 1)];
                if (cost < best) {
                    best = cost;
                    std::memcpy(z, y, sizeof y);
                }
            }
        }
    }
};

}  // namespace lattice
