// Linear prediction of signals (signals/prediction.py). Integers only; sums wrap around at 64 bits.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

namespace signals {

constexpr int64_t MAX_PREDICTION = int64_t(1) << 29;

inline int64_t clamp_prediction(uint64_t sum, int shift) {
    return std::clamp<int64_t>(int64_t(sum) >> shift, -MAX_PREDICTION, MAX_PREDICTION);
}

// prediction._add_taps: sums[t] += taps[i] · samples[t − delay − i]; before the first sample, the first repeats.
inline void add_taps(int64_t *sums, const int64_t *samples, size_t count, const int64_t *taps, size_t order,
                     size_t delay) {
    if (!count) return;
    const size_t edge = std::min(count, delay + order);
    for (size_t t = 0; t < edge; ++t)
        for (size_t i = 0; i < order; ++i)
            sums[t] = int64_t(uint64_t(sums[t]) +
                              uint64_t(taps[i]) * uint64_t(samples[t >= delay + i ? t - delay - i : 0]));
    for (size_t t = edge; t < count; ++t) {
        uint64_t sum = uint64_t(sums[t]);
        for (size_t i = 0; i < order; ++i) sum += uint64_t(taps[i]) * uint64_t(samples[t - delay - i]);
        sums[t] = int64_t(sum);
    }
}

// prediction.inverse for one lane: turns residuals into samples in place. sums: prediction.known_sums.
inline void restore(int64_t *residuals, const int64_t *sums, size_t count, const int64_t *own, size_t order, int shift,
                    int64_t first) {
    std::vector<int64_t> past(count + order, first);  // `order` samples before the first
    std::vector<int64_t> taps(own, own + order);
    std::reverse(taps.begin(), taps.end());
    for (size_t t = 0; t < count; ++t) {
        uint64_t sum = uint64_t(sums[t]);
        const int64_t *before = past.data() + t;
        for (size_t i = 0; i < order; ++i) sum += uint64_t(taps[i]) * uint64_t(before[i]);
        past[t + order] = int64_t(uint64_t(residuals[t]) + uint64_t(clamp_prediction(sum, shift)));
    }
    std::copy(past.begin() + std::ptrdiff_t(order), past.end(), residuals);
}

}  // namespace signals
