// Natural cubic splines through key frames: stages/spline.py. Floats by the same operations in the same order as there.
#pragma once

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>
#include <utility>
#include <vector>

#include "arrays.h"
#include "body_frames.h"
#include "vectors.h"

namespace splines {

using Frames = std::vector<int64_t>;

// to (k) = weighted sum of two values and two curvatures, each (2, k), with Spline::Weights.
ALWAYS_INLINE void combine(const double *values, const double *curvatures, const double (&weights)[4], size_t k, double *to) {
    size_t i = 0;
    for (; i + 4 <= k; i += 4) {
        Four left, right, bend_left, bend_right;
        load(left, values + i), load(right, values + k + i);
        load(bend_left, curvatures + i), load(bend_right, curvatures + k + i);
        store(left * weights[0] + right * weights[1] + bend_left * weights[2] + bend_right * weights[3], to + i);
    }
    for (; i < k; ++i)
        to[i] = values[i] * weights[0] + values[k + i] * weights[1] + curvatures[i] * weights[2] + curvatures[k + i] * weights[3];
}

// spline._curvature (LAPACK's ptsv): curvatures (keys, k), zero at both ends, from values (keys, k) at `count` ≥ 3 keys.
ALWAYS_INLINE void bend(const double *width, const double *value, size_t count, size_t k, double *curvature) {
    const size_t inner = count - 2;
    std::vector<double> diagonal(inner), beside(inner);
    for (size_t i = 0; i < inner; ++i) {
        diagonal[i] = (width[i] + width[i + 1]) / 3;
        beside[i] = width[i + 1] / 6;
    }
    for (size_t i = 0; i + 1 < inner; ++i) {  // pttrf: L D Lᵀ
        const double e = beside[i];
        beside[i] = e / diagonal[i];
        diagonal[i + 1] -= beside[i] * e;
    }
    double *right = curvature + k;
    for (size_t i = 0; i < inner; ++i) {  // the right-hand side, and pttrs forwards
        const double *at = value + i * k;
        double *row = right + i * k;
        for (size_t c = 0; c < k; ++c) row[c] = (at[2 * k + c] - at[k + c]) / width[i + 1] - (at[k + c] - at[c]) / width[i];
        for (size_t c = 0; i && c < k; ++c) row[c] -= row[c - k] * beside[i - 1];
    }
    for (size_t c = 0; c < k; ++c) right[(inner - 1) * k + c] /= diagonal[inner - 1];
    for (size_t i = inner - 1; i-- > 0;) {  // pttrs back
        double *row = right + i * k;
        for (size_t c = 0; c < k; ++c) row[c] = row[c] / diagonal[i] - row[k + c] * beside[i];
    }
}

inline void combine_anywhere(const double *values, const double *curvatures, const double (&weights)[4], size_t k, double *to) {
    combine(values, curvatures, weights, k, to);
}

inline void bend_anywhere(const double *width, const double *value, size_t count, size_t k, double *curvature) {
    bend(width, value, count, k, curvature);
}

#ifdef HAS_AVX2_TWIN
WITH_AVX2 inline void combine_with_avx2(const double *values, const double *curvatures, const double (&weights)[4], size_t k, double *to) {
    combine(values, curvatures, weights, k, to);
}

WITH_AVX2 inline void bend_with_avx2(const double *width, const double *value, size_t count, size_t k, double *curvature) {
    bend(width, value, count, k, curvature);
}
#endif

inline void weighted_sum(const double *values, const double *curvatures, const double (&weights)[4], size_t k, double *to) {
#ifdef HAS_AVX2_TWIN
    static const bool has_avx2 = processor_has_avx2();
    if (has_avx2) return combine_with_avx2(values, curvatures, weights, k, to);
#endif
    combine_anywhere(values, curvatures, weights, k, to);
}

inline void find_curvatures(const double *width, const double *value, size_t count, size_t k, double *curvature) {
#ifdef HAS_AVX2_TWIN
    static const bool has_avx2 = processor_has_avx2();
    if (has_avx2) return bend_with_avx2(width, value, count, k, curvature);
#endif
    bend_anywhere(width, value, count, k, curvature);
}

// The natural cubic spline through values (keys, k) at ascending key frames.
class Spline {
public:
    // value(i): the k values of key i.
    template <class Value>
    Spline(const int64_t *keys, size_t count, size_t k, Value value) : key_(keys), count_(count), k_(k), values_(count * k) {
        for (size_t i = 0; i < count; ++i) std::copy_n(value(i), k, &values_[i * k]);
        if (count < 2) return;
        width_.resize(count - 1), curvature_.assign(count * k, 0.0);
        for (size_t i = 0; i + 1 < count; ++i) width_[i] = double(key_[i + 1] - key_[i]);
        if (count > 2 && k) find_curvatures(width_.data(), values_.data(), count, k, curvature_.data());
    }

    // Spline at a frame: of[0] value(left) + of[1] value(left + 1) + of[2] curvature(left) + of[3] curvature(left + 1).
    struct Weights {
        size_t left;
        double of[4];
    };

    // Weights at frame t; needs two keys or more.
    Weights weights(int64_t t) {
        if (t < key_[left_] || t >= key_[left_ + 1])  // frames usually ascend
            left_ = std::clamp<size_t>(size_t(std::upper_bound(key_, key_ + count_, t) - key_), 1, count_ - 1) - 1;
        const double b = double(t - key_[left_]) / width_[left_], a = 1.0 - b, bend = width_[left_] * width_[left_] / 6;
        return {left_, {a, b, (a * a * a - a) * bend, (b * b * b - b) * bend}};
    }

    void at(int64_t t, double *out) {
        if (count_ < 2) {
            std::copy_n(values_.data(), k_, out);
            return;
        }
        const Weights weight = weights(t);
        weighted_sum(value(weight.left), curvature(weight.left), weight.of, k_, out);
    }

    const double *value(size_t key) const { return &values_[key * k_]; }
    const double *curvature(size_t key) const { return &curvature_[key * k_]; }

private:
    const int64_t *key_;
    size_t count_, k_, left_ = 0;
    std::vector<double> values_, width_, curvature_;
};

inline void require_ascending(const int64_t *keys, size_t count) {
    for (size_t i = 0; i + 1 < count; ++i)
        if (keys[i + 1] <= keys[i]) throw std::invalid_argument("splines: key frames must ascend");
}

constexpr size_t FRAMES = 4, PANEL = 8, BATCH = 16;  // frames and columns of a tile; frames at a time

// to (BATCH, columns) = mean + curves (BATCH, k) basis (k, columns).
ALWAYS_INLINE void multiply(const double *curves, size_t k, const double *basis, const double *mean, size_t columns, double *to) {
    for (size_t first = 0; first < BATCH; first += FRAMES)
        for (size_t column = 0; column < columns; column += PANEL) {
            Four a[FRAMES], b[FRAMES];
            for (size_t i = 0; i < FRAMES; ++i) load(a[i], mean + column), load(b[i], mean + column + 4);
            const double *row = basis + column, *of_frame = curves + first * k;
            for (size_t c = 0; c < k; ++c, row += columns) {
                Four x, y;
                load(x, row), load(y, row + 4);
                for (size_t i = 0; i < FRAMES; ++i) a[i] += x * of_frame[i * k + c], b[i] += y * of_frame[i * k + c];
            }
            for (size_t i = 0; i < FRAMES; ++i) {
                double *at = to + (first + i) * columns + column;
                store(a[i], at), store(b[i], at + 4);
            }
        }
}

inline void multiply_anywhere(const double *curves, size_t k, const double *basis, const double *mean, size_t columns, double *to) {
    multiply(curves, k, basis, mean, columns, to);
}

#ifdef HAS_AVX2_TWIN
WITH_AVX2 inline void multiply_with_avx2(const double *curves, size_t k, const double *basis, const double *mean, size_t columns, double *to) {
    multiply(curves, k, basis, mean, columns, to);
}
#endif

inline void product(const double *curves, size_t k, const double *basis, const double *mean, size_t columns, double *to) {
#ifdef HAS_AVX2_TWIN
    static const bool has_avx2 = processor_has_avx2();
    if (has_avx2) return multiply_with_avx2(curves, k, basis, mean, columns, to);
#endif
    multiply_anywhere(curves, k, basis, mean, columns, to);
}

// The spline of a segment_model.KeyframeTrack: key frames (keys) and values (keys, k) by level.
class TrackSpline {
public:
    TrackSpline(const int64_t *by_level, size_t keys, const double *values, size_t k)
        : order_(keys), keys_(keys), k_(k), spline_(sorted(by_level, values)) {}

    TrackSpline(TrackSpline &&) = default;
    TrackSpline(const TrackSpline &) = delete;  // the spline points at the key frames

    TrackSpline(Input<int64_t, 1> by_level, Input<double, 2> values)
        : TrackSpline(by_level.data(), checked(by_level.shape(0), values.shape(0)), values.data(), values.shape(1)) {}

    // Curves (frames, k) at frames [start, stop).
    Output<double> at(int64_t start, int64_t stop) {
        const size_t count = size_t(std::max<int64_t>(0, stop - start));
        Fresh<double> out(count * k_);
        for (size_t t = 0; t < count; ++t) spline_.at(start + int64_t(t), &out.data[t * k_]);
        return out.give({count, k_});
    }

    Spline &spline() { return spline_; }
    const Frames &keys() const { return keys_; }

private:
    static size_t checked(size_t keys, size_t values) {
        if (!keys || values != keys) throw std::invalid_argument("TrackSpline: shapes differ");
        return keys;
    }

    Spline sorted(const int64_t *by_level, const double *values) {
        std::iota(order_.begin(), order_.end(), size_t(0));
        std::sort(order_.begin(), order_.end(), [&](size_t a, size_t b) { return by_level[a] < by_level[b]; });
        for (size_t i = 0; i < order_.size(); ++i) keys_[i] = by_level[order_[i]];
        require_ascending(keys_.data(), keys_.size());
        return Spline(keys_.data(), keys_.size(), k_, [&](size_t i) { return values + order_[i] * k_; });
    }

    std::vector<size_t> order_;
    Frames keys_;
    size_t k_;
    Spline spline_;
};

// Poses of a segment_model.PcaModel: mean (dimensions,) + spline basisᵀ, basis (dimensions, k). Splines are linear in
// their values: if there are few keys, it multiplies the values at keys by the basis, not those at frames.
class PoseSpline {
public:
    // basis (rows, k), mean (rows).
    PoseSpline(TrackSpline track, size_t k, const double *basis, const double *mean, size_t rows)
        : track_(std::move(track)), k_(k), rows_(rows), padded_((rows_ + PANEL - 1) / PANEL * PANEL),
          basis_(k_ * padded_, 0.0), mean_(padded_, 0.0) {
        for (size_t i = 0; i < rows_; ++i)
            for (size_t c = 0; c < k_; ++c) basis_[c * padded_ + i] = basis[i * k_ + c];
        std::copy_n(mean, rows_, mean_.data());
        const size_t keys = track_.keys().size(), frames = size_t(track_.keys().back() - track_.keys().front()) + 1;
        if (keys < 2 || 2 * keys * k_ + 4 * frames >= frames * k_) return;
        const std::vector<double> zero(padded_, 0.0);
        of_keys_ = products(keys, [&](size_t i) { return track_.spline().value(i); }, mean_.data());
        bends_ = products(keys, [&](size_t i) { return track_.spline().curvature(i); }, zero.data());
    }

    PoseSpline(Input<int64_t, 1> by_level, Input<double, 2> values, Input<double, 2> basis, Input<double, 1> mean)
        : PoseSpline(TrackSpline(by_level, values), values.shape(1), basis.data(), mean.data(), basis.shape(0)) {
        if (basis.shape(1) != k_ || mean.shape(0) != rows_) throw std::invalid_argument("PoseSpline: shapes differ");
    }

    // Writes the frames from `start` on, placed by body_frames.h.
    void place(int64_t start, Input<int64_t, 1> columns, Input<double, 2> origin, Input<double, 2> heading, size_t up,
               InPlace<double, 3> positions) {
        const body_frames::World world(columns, origin, heading, up, positions);
        if (rows_ != 3 * world.count()) throw std::invalid_argument("place: shapes differ");
        place(start, positions.shape(0), world);
    }

    void place(int64_t start, size_t frames, const body_frames::World &world) {
        std::vector<double> curves(BATCH * k_), poses(BATCH * padded_);
        for (size_t first = 0; first < frames; first += BATCH) {
            const size_t count = std::min(BATCH, frames - first);
            if (of_keys_.empty()) {
                for (size_t t = 0; t < count; ++t) track_.spline().at(start + int64_t(first + t), curves.data() + t * k_);
                product(curves.data(), k_, basis_.data(), mean_.data(), padded_, poses.data());
            } else
                for (size_t t = 0; t < count; ++t) {
                    const Spline::Weights at = track_.spline().weights(start + int64_t(first + t));
                    weighted_sum(&of_keys_[at.left * padded_], &bends_[at.left * padded_], at.of, padded_, &poses[t * padded_]);
                }
            for (size_t t = 0; t < count; ++t) world.place(first + t, poses.data() + t * padded_);
        }
    }

private:
    // offset + row(i) basisᵀ for each key i, (keys, padded_), then unused rows.
    template <class Row>
    std::vector<double> products(size_t keys, Row row, const double *offset) const {
        std::vector<double> out((keys + BATCH - 1) / BATCH * BATCH * padded_), rows(BATCH * k_, 0.0);
        for (size_t first = 0; first < keys; first += BATCH) {
            for (size_t i = 0; i < std::min(BATCH, keys - first); ++i) std::copy_n(row(first + i), k_, &rows[i * k_]);
            product(rows.data(), k_, basis_.data(), offset, padded_, &out[first * padded_]);
        }
        return out;
    }

    TrackSpline track_;
    size_t k_, rows_, padded_;
    std::vector<double> basis_, mean_, of_keys_, bends_;  // basis (k, padded)
};

// spline.evenly
inline Frames evenly(int64_t frames) {
    Frames keys;
    for (int i = 0; i < 4; ++i) {
        const int64_t key = i == 3 ? frames - 1 : int64_t(std::nearbyint(i * (double(frames - 1) / 3)));
        if (keys.empty() || key > keys.back()) keys.push_back(key);
    }
    return keys;
}

// spline._halve: levels of key frames, one after another. halved(middle): whether to halve the interval with this middle.
template <class Halved>
void halve(int64_t frames, Halved halved, Frames &by_level, Frames &sizes) {
    by_level = evenly(frames);
    sizes = {int64_t(by_level.size())};
    std::vector<std::pair<int64_t, int64_t>> intervals, next;
    for (size_t i = 0; i + 1 < by_level.size(); ++i) intervals.emplace_back(by_level[i], by_level[i + 1]);
    for (;;) {
        next.clear();
        const size_t before = by_level.size();
        for (const auto &[left, right] : intervals) {
            const int64_t middle = (left + right) / 2;
            if (right - left < 2 || !halved(middle)) continue;
            by_level.push_back(middle);
            next.emplace_back(left, middle), next.emplace_back(middle, right);
        }
        if (by_level.size() == before) return;
        sizes.push_back(int64_t(by_level.size() - before));
        intervals.swap(next);
    }
}

// spline._descend: values (keys, k), level by level; decode(i, prediction, out) computes the values of key i.
template <class Decode>
void descend(const int64_t *frames, size_t keys, const int64_t *sizes, size_t levels, size_t k, double *values, Decode decode) {
    size_t stop = 0;
    std::vector<size_t> order(keys);  // known key frames, sorted by frame
    Frames known(keys);
    auto sooner = [&](size_t a, size_t b) { return frames[a] < frames[b]; };
    for (size_t level = 0; level < levels; ++level) {
        const size_t start = stop;
        stop += size_t(std::max<int64_t>(0, sizes[level]));
        if (stop > keys) throw std::invalid_argument("splines: levels have too many key frames");
        std::iota(order.begin() + long(start), order.begin() + long(stop), start);
        if (!level) {
            const std::vector<double> zero(k, 0.0);
            for (size_t i = 0; i < stop; ++i) decode(i, i ? values + (i - 1) * k : zero.data(), values + i * k);
            continue;
        }
        for (size_t i = 0; i < start; ++i) known[i] = frames[order[i]];
        require_ascending(known.data(), start);
        Spline spline(known.data(), start, k, [&](size_t i) { return values + order[i] * k; });
        std::vector<double> prediction(k);
        for (size_t i = start; i < stop; ++i) {
            spline.at(frames[i], prediction.data());
            decode(i, prediction.data(), values + i * k);
        }
        std::inplace_merge(order.begin(), order.begin() + long(start), order.begin() + long(stop), sooner);
    }
    if (stop != keys) throw std::invalid_argument("splines: levels have too few key frames");
}

}  // namespace splines
