// Codes a chunk with the lattice engine of stages/lattice.py: recursive least squares predict each sample from decoded
// samples; the residual is a point of a body-centred cubic lattice.
//
// Float operations have the same order as in the NumPy code.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstring>
#include <type_traits>
#include <vector>

#include "adaptive_bits.h"
#include "lattice_buckets.h"
#include "lattice_points.h"
#include "least_squares.h"

namespace lattice {

using std::ptrdiff_t;

constexpr double DISTANCE_MEMORY = 0.995, RADIAL_MEMORY = 0.98;
constexpr double DISTORTION = 384;         // cost of an error at the bound, 1/256 bit, for its effect on predictions
constexpr double NEAR = 8;                 // partners nearer than this give no direction
constexpr double LIMIT = 1099511627776.0;  // 2^40: larger predictions and residuals are not coded
constexpr double WIDE = 12;                // residuals with a larger coordinate are not optimised
constexpr int LARGEST_STRIDE_LOG = 6;
constexpr int EDGE = 7;                    // level of samples without both neighbours in time
// An encoder stops once the first points, a share s of all, take over (CLEARLY · s + OF_FIRST_POINTS) · most_bytes: the very
// first points take up to half more bytes than others.
constexpr double CLEARLY = 1.25, OF_FIRST_POINTS = 0.05;

struct Layout {
    size_t frames, points;
    const uint8_t *missing;       // (frames, points), 1 in gaps
    const int32_t *sequence;      // (points,)
    const int32_t *neighbours;    // (points, NEIGHBOURS), points coded earlier, −1: none; the first is the partner
    int stride_log;               // frames of level 0 are 2^stride_log apart
};

template <class Coder>
class Chunk {
public:
    static constexpr bool ENCODES = std::is_same<Coder, bits::Encoder>::value;

    Chunk(const Layout &layout, const bits::Tables &tables, Coder &coder, const double *wanted)
        : of(layout), mixer(tables), coder_(coder), wanted_(wanted), decoded(layout.points * layout.frames),
          activity_(layout.points * layout.frames), radial_(layout.points * layout.frames) {
        const int levels = of.stride_log + 1;
        for (int l = 0; l < levels; ++l) {
            std::memset(mean_weights_[l], 0, sizeof mean_weights_[l]);
            if (l) mean_weights_[l][0] = -0.0625;
            level_activity_[l] = 64 * 16;
        }
    }

    // Codes the chunk. A decoder returns whether the stream was consistent; an encoder, whether it coded all samples: it stops
    // if the first points show that the stream would clearly be longer than `most_bytes`.
    bool run(double most_bytes = HUGE_VAL) {
        for (size_t i = 0; i < of.points; ++i) {
            if (!point(size_t(of.sequence[i]), i == 0)) return false;
            if constexpr (ENCODES) {
                const double share = double(i + 1) / double(of.points), bytes = double(coder_.size());
                if (bytes > most_bytes * (CLEARLY * share + OF_FIRST_POINTS)) {
                    expected_bytes = size_t(bytes / share);
                    return false;
                }
            }
        }
        return true;
    }

    size_t expected_bytes = 0;  // estimated length of the stream if the encoder stopped; otherwise 0

private:
    const Layout of;
    bits::Mixer mixer;
    Coder &coder_;
    const double *wanted_;  // (points, frames, 3), half steps

public:
    std::vector<Vec> decoded;  // (points, frames), half steps

private:
    std::vector<int32_t> activity_, radial_;
    double mean_weights_[8][FEATURES];
    int64_t level_activity_[8];

    // state of the current point
    size_t p_ = 0;
    const int32_t *near_ = nullptr;
    int known_ = 0;
    double distance_ = 0, distances_ = 0;  // decaying sums: distances to the partner, and their number
    Vec *own_ = nullptr;
    const Vec *beside_[NEIGHBOURS] = {};

    // state of the current level
    int level_ = 0;
    ptrdiff_t half_ = 0, step_ = 0;
    Predictor predictor_;
    int64_t slow_ = 0;
    double radial_square_ = 0, radial_product_ = 0;
    Vec beyond_[NEIGHBOURS];     // each neighbour − the mean of its frames around, at `beyond_frame_`
    ptrdiff_t beyond_frame_ = 0;

    // state of the current sample
    Features features_;
    Vec base_;
    int class_ = 0;
    uint32_t radial_context_ = 0;
    bits::Mixed parity_;  // for the bit "coordinates are odd"

    bool point(size_t p, bool first) {
        p_ = p;
        near_ = of.neighbours + p * NEIGHBOURS;
        own_ = &decoded[p * of.frames];
        for (known_ = 0; known_ < NEIGHBOURS && near_[known_] >= 0; ++known_)
            beside_[known_] = &decoded[size_t(near_[known_]) * of.frames];
        distance_ = distances_ = 0;
        for (level_ = 0; level_ <= of.stride_log; ++level_)
            if (!level(first)) return false;
        return true;
    }

    bool level(bool first) {
        half_ = ptrdiff_t(1) << (of.stride_log - level_);
        step_ = level_ ? 2 * half_ : half_;
        predictor_.start(mean_weights_[level_]);
        slow_ = level_activity_[level_];
        radial_square_ = 1e-3;
        radial_product_ = 0;
        beyond_frame_ = -1;
        for (ptrdiff_t t = level_ ? half_ : 0; t < ptrdiff_t(of.frames); t += step_) {
            if (missing(t)) gap(t);
            else if (!sample(t, first && t == 0)) return false;
        }
        level_activity_[level_] = (level_activity_[level_] * 7 + slow_ * 3) / 10;
        for (int i = 0; i < FEATURES; ++i)
            mean_weights_[level_][i] = (mean_weights_[level_][i] + predictor_.weights[i]) / 2;
        return true;
    }

    void gap(ptrdiff_t t) {
        follow(t);
        own_[t] = limited(base_);
        int32_t *activity = &activity_[p_ * of.frames];
        activity[t] = t >= step_ ? activity[t - step_] : 0;
    }

    bool sample(ptrdiff_t t, bool origin) {
        const bool inside = level_ ? t + half_ < ptrdiff_t(of.frames) && !missing(t - half_) && !missing(t + half_)
                                   : t >= 2 * half_ && !missing(t - half_) && !missing(t - 2 * half_);
        contexts(t, inside, origin);
        if (!inside) follow(t);
        else if (level_) interpolate(t);
        else extrapolate(t);
        const Vec linear = limited(inside ? base_ + predictor_.predict(features_) : base_);
        Vec guess = linear, axes[3];
        double away = 0;
        const bool radial = known_ && inside && distances_ > 0 && towards_partner(t, axes, guess, away);
        radial_context_ = radial ? radial_context(t) : 0;
        int64_t z[3];
        if (!code(t, guess, axes, radial, z)) return false;
        Vec value;
        if (radial) {
            for (int k = 0; k < 3; ++k)
                value[k] = guess[k] + (axes[0][k] * double(z[0]) + axes[1][k] * double(z[1]) + axes[2][k] * double(z[2]));
        } else {
            for (int k = 0; k < 3; ++k) value[k] = guess[k] + double(z[k]);
        }
        own_[t] = value;
        const int64_t sum = std::min<int64_t>(4000, std::abs(z[0]) + std::abs(z[1]) + std::abs(z[2]));
        activity_[p_ * of.frames + size_t(t)] = int32_t(sum);
        radial_[p_ * of.frames + size_t(t)] = int32_t(std::min<int64_t>(4000, std::abs(z[0])));
        if (inside) slow_ += (sum * 256 - slow_) >> 4;
        if (known_) measure(value, beside_[0][t], linear, axes[0], radial, away);
        if (inside) predictor_.learn(features_, value - base_);
        return true;
    }

    // Replaces a prediction that is out of range by the base, or 0.
    Vec limited(Vec guess) const {
        for (int k = 0; k < 3; ++k)
            if (!(std::fabs(guess[k]) < LIMIT)) guess[k] = std::fabs(base_[k]) < LIMIT ? base_[k] : 0.0;
        return guess;
    }

    // Axes along and across the direction from the partner, and the prediction at the mean distance; false if the
    // partner is too near.
    bool towards_partner(ptrdiff_t t, Vec (&axes)[3], Vec &guess, double &away) const {
        const Vec direction = guess - beside_[0][t];
        const double length = std::sqrt(square(direction));
        if (!(length > NEAR)) return false;
        for (int k = 0; k < 3; ++k) axes[0][k] = direction[k] / length;
        complete_axes(axes);
        away = distance_ / distances_ - length;
        const double share = std::min(1.0, std::max(0.0, radial_product_ / radial_square_));
        guess = guess + share * away * axes[0];
        return true;
    }

    // Updates the mean distance to the partner, and the gain of corrections along the direction to it.
    void measure(const Vec &value, const Vec &partner, const Vec &linear, const Vec &axis, bool radial, double away) {
        distance_ = distance_ * DISTANCE_MEMORY + std::sqrt(square(value - partner));
        distances_ = distances_ * DISTANCE_MEMORY + 1;
        if (!radial) return;
        const Vec off = value - linear;
        const double along = axis[0] * off[0] + axis[1] * off[1] + axis[2] * off[2];
        radial_square_ = radial_square_ * RADIAL_MEMORY + away * away;
        radial_product_ = radial_product_ * RADIAL_MEMORY + away * along;
    }

    bool missing(ptrdiff_t t) const { return of.missing[size_t(t) * of.points + p_] != 0; }

    // Prediction beside a gap or an end: the frame before or after plus the partner's motion since; between two, their mean.
    void follow(ptrdiff_t t) {
        const bool before = t >= half_, after = level_ && t + half_ < ptrdiff_t(of.frames);
        const bool from_before = before && !(after && missing(t - half_) && !missing(t + half_));
        const ptrdiff_t from = from_before ? t - half_ : t + half_;
        if (!before && !after) base_ = known_ ? beside_[0][t] : Vec();
        else if (before && after && missing(t - half_) == missing(t + half_))
            base_ = 0.5 * (own_[t - half_] + own_[t + half_]);
        else base_ = own_[from] + (known_ ? beside_[0][t] - beside_[0][from] : Vec());
    }

    // Level 0: predicts from the two frames before, `half` apart.
    void extrapolate(ptrdiff_t t) {
        auto bend = [&](const Vec *of_point, ptrdiff_t s) {
            return of_point[s] - 2 * of_point[s - half_] + of_point[s - 2 * half_];
        };
        base_ = 2 * own_[t - half_] - own_[t - 2 * half_];
        for (int i = 0; i < OWN; ++i) features_[i] = t >= (i + 3) * half_ ? bend(own_, t - (i + 1) * half_) : Vec();
        for (int q = 0; q < NEIGHBOURS; ++q) {
            Vec *x = features_ + OWN + 2 * q;
            x[0] = q < known_ ? bend(beside_[q], t) : Vec();
            x[1] = q < known_ && t + half_ < ptrdiff_t(of.frames) ? bend(beside_[q], t + half_) : Vec();
        }
    }

    // Higher levels: predicts from the frames around, `half` apart.
    void interpolate(ptrdiff_t t) {
        const ptrdiff_t half = half_, frames = ptrdiff_t(of.frames);
        const Vec left = own_[t - half], right = own_[t + half];
        const Vec left3 = t >= 3 * half ? own_[t - 3 * half] : 2 * left - right;
        const Vec right3 = t + 3 * half < frames ? own_[t + 3 * half] : 2 * right - left;
        const Vec left5 = t >= 5 * half ? own_[t - 5 * half] : 2 * left3 - left;
        const Vec right5 = t + 5 * half < frames ? own_[t + 5 * half] : 2 * right3 - right;
        base_ = 0.5 * (left + right);
        features_[0] = (left3 - left) - (right - right3);
        features_[1] = t >= 2 * half ? own_[t - 2 * half] - 0.5 * (left3 + left) : Vec();
        features_[2] = (left5 - left3) - (right3 - right5);
        features_[3] = t >= 4 * half ? own_[t - 4 * half] - 0.5 * (left3 + left5) : Vec();
        for (int q = 0; q < known_; ++q) {
            const Vec *other = beside_[q];
            auto off = [&](ptrdiff_t s) {
                return s < half || s + half >= frames ? Vec() : other[s] - 0.5 * (other[s - half] + other[s + half]);
            };
            const Vec below = beyond_frame_ == t - half ? beyond_[q] : off(t - half);
            beyond_[q] = off(t + half);
            features_[OWN + 2 * q] = off(t);
            features_[OWN + 2 * q + 1] = below + beyond_[q];
        }
        beyond_frame_ = t + half;
        for (int i = OWN + 2 * known_; i < FEATURES; ++i) features_[i] = Vec();
    }

    void contexts(ptrdiff_t t, bool inside, bool origin) {
        const int32_t *own = &activity_[p_ * of.frames];
        const int64_t before = t >= step_ ? own[t - step_] : slow_ / 256;
        const int64_t before2 = t >= 2 * step_ ? own[t - 2 * step_] : before;
        int64_t beside[3];
        for (int q = 0; q < 3; ++q)
            beside[q] = q < known_ ? activity_[size_t(near_[q]) * of.frames + size_t(t)] : q ? beside[q - 1] : before;
        const bool has_next = known_ && t + step_ < ptrdiff_t(of.frames);
        const int64_t next = has_next ? activity_[size_t(near_[0]) * of.frames + size_t(t + step_)] : beside[0];
        int64_t around = 2 * before;
        if (level_) around = own[t - half_] + own[t + half_ < ptrdiff_t(of.frames) ? t + half_ : t - half_];
        class_ = origin ? 6 : inside ? std::min(level_, 5) : EDGE;
        const uint32_t c = uint32_t(class_);
        const uint32_t mean = uint32_t(coarse_log(slow_ / 16)), mine = uint32_t(coarse_log(8 * (2 * before + before2)));
        const uint32_t near = uint32_t(coarse_log(8 * (beside[0] + beside[1]) + 4 * (beside[2] + next)));
        const uint32_t outer = uint32_t(coarse_log(8 * around));
        const uint32_t all = uint32_t(coarse_log(
            (slow_ / 16 * 2 + 10 * (2 * before + before2) + 8 * (2 * beside[0] + beside[1] + beside[2])) / 4));
        const uint32_t list[bits::INPUTS] = {c * 24 + mean, 200 + mine * 24 + near, 1000 + (c * 24 + near) * 24 + mean,
                                             8000 + (c * 24 + outer) * 24 + near, 14000 + c * 24 + all};
        mixer.contexts(list);
        mixer.prefetch(0);
        for (int odd = 0; odd < 2; ++odd) mixer.prefetch(kind(odd, false, 0));
    }

    // Context of the coordinate along the direction to the partner.
    uint32_t radial_context(ptrdiff_t t) const {
        const int32_t *radial = &radial_[p_ * of.frames];
        const int64_t r1 = t >= step_ ? radial[t - step_] : 0, r2 = t >= 2 * step_ ? radial[t - 2 * step_] : 0;
        return uint32_t(1 + coarse_log(16 * (r1 + r2)));
    }

    // Kind of the bit "magnitude is beyond bucket b". Odd coordinates, and coordinates
    // along the partner, have their own kinds.
    uint32_t kind(int odd, bool along, int b) const {
        return uint32_t(1 + (2 * along + odd) * 32 + std::min(b, COMMON)) + (along ? radial_context_ * 256u * 257u : 0u);
    }
    uint32_t set(uint32_t what) const { return what * 8 + uint32_t(class_); }
    uint32_t magnitude_set(int odd, bool along, int b) const {
        return set(uint32_t(1 + (2 * along + odd) * 8 + std::min(b, 7)));
    }

    bool code(ptrdiff_t t, const Vec &guess, const Vec (&axes)[3], bool radial, int64_t *z) {
        mixer.mix(parity_, 0, set(0));
        if constexpr (ENCODES) {
            const double *wanted = wanted_ + (p_ * of.frames + size_t(t)) * 3;
            double residual[3], off[3];
            for (int k = 0; k < 3; ++k) off[k] = wanted[k] - guess[k];
            for (int k = 0; k < 3; ++k) {
                residual[k] = radial ? axes[k][0] * off[0] + axes[k][1] * off[1] + axes[k][2] * off[2] : off[k];
                if (!(std::fabs(residual[k]) < LIMIT)) return false;
            }
            choose(residual, radial, z);
        }
        const int odd = bit(parity_, int(z[0] & 1));
        for (int k = 0; k < 3; ++k) {
            const bool along = radial && k == 0;
            const int64_t magnitude = ENCODES ? std::abs(z[k]) >> 1 : 0;
            const int wanted = ENCODES ? bucket_of(magnitude) : 0;
            int b = 0;
            while (b < BUCKETS - 1 &&
                   bit(wanted > b, kind(odd, along, b), magnitude_set(odd, along, b)))
                ++b;
            const Bucket &bucket = buckets()[b];
            if (bucket.width > 42) return false;
            const int64_t rest = within(b, bucket.width, magnitude - bucket.first);
            if constexpr (!ENCODES) z[k] = 2 * (bucket.first + rest) + odd;
            if (odd || (ENCODES ? z[k] != 0 : z[k] > 0)) {
                const bool negative = plain(z[k] < 0);
                if (!ENCODES && negative) z[k] = -z[k];
            }
        }
        if constexpr (!ENCODES) return !coder_.exhausted();
        return true;
    }

    // Codes the bits within a bucket, highest first.
    int64_t within(int b, int width, int64_t rest) {
        int64_t found = 0;
        for (int place = width - 1; place >= 0; --place) {
            const int wanted = ENCODES ? int(rest >> place & 1) : 0;
            const int one = place == width - 1 ? bit(wanted, uint32_t(140 + b), set(40)) : plain(wanted);
            found |= int64_t(one) << place;
        }
        return found;
    }

    // Codes the wanted bit, or decodes one.
    int bit(int wanted, uint32_t kind, uint32_t set) {
        bits::Mixed m;
        mixer.mix(m, kind, set);
        return bit(m, wanted);
    }

    int bit(bits::Mixed &m, int wanted) {
        wanted = plain(wanted, m.p);
        mixer.learn(m, wanted);
        return wanted;
    }

    int plain(int wanted, int32_t p = bits::HALF) {
        if constexpr (ENCODES) coder_.bit(wanted, p);
        else wanted = coder_.bit(p);
        return wanted;
    }

    // ---- the encoder's choice
    void choose(const double *residual, bool radial, int64_t *z) {
        if (std::max({std::fabs(residual[0]), std::fabs(residual[1]), std::fabs(residual[2])}) > WIDE) {
            nearest(residual, z);
            return;
        }
        Candidate within[16];
        const int count = candidates(residual, within);
        if (count < 2) {  // no choice, in three of five samples
            if (count) std::memcpy(z, within[0].z, sizeof within[0].z);
            else nearest(residual, z);
            return;
        }
        const int32_t parity[2] = {mixer.cost[(65536 - parity_.p) >> 4], mixer.cost[parity_.p >> 4]};
        Costs costs[2][2];
        double best = 1e300;
        for (const Candidate *c = within; c < within + count; ++c) {
            double cost = parity[c->odd] + DISTORTION * c->square / RADIUS_2;
            for (int k = 0; k < 3; ++k) {
                const bool along = radial && k == 0;
                cost += bucket_cost(costs[along][c->odd], c->odd, along, bucket_of(std::abs(c->z[k]) >> 1));
            }
            if (cost < best) {
                best = cost;
                std::memcpy(z, c->z, sizeof c->z);
            }
        }
    }

    int32_t bucket_cost(Costs &costs, int odd, bool along, int bucket) {
        for (int &b = costs.known; b <= bucket; ++b) {
            bits::Mixed m;
            mixer.mix(m, kind(odd, along, b), magnitude_set(odd, along, b));
            costs.of[b] = costs.sum + mixer.cost[(65536 - m.p) >> 4] + (odd || b ? 256 : 0) + 256 * buckets()[b].width;
            costs.sum += mixer.cost[m.p >> 4];
        }
        return costs.of[bucket];
    }
};

}  // namespace lattice
