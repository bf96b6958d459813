// Errors of a chunk's decoded positions, and the corrections that keep all samples within a bound
// (codecs/tempo/coding/corrections.py, find). Integers equal NumPy's except for its order of summation.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

namespace chunks {

// Positions (frames, points, 3). apart (frames, points): 1 for samples without an error, or null; weights (points,) or null.
struct Samples {
    const double *wanted, *decoded;
    const uint8_t *apart;
    const double *weights;
    size_t frames, points;

    bool skips(size_t at) const { return apart && apart[at]; }

    // The error vector of sample `at`, an index of (frames, points).
    void error(size_t at, double *out) const {
        const double weight = weights ? weights[at % points] : 1.0;
        for (size_t k = 0; k < 3; ++k) {
            out[k] = wanted[3 * at + k] - decoded[3 * at + k];
            if (weights) out[k] *= weight;
        }
    }
};

struct Sums {
    double distance = 0, squared = 0;  // sums of weighted distances, and of unweighted squared distances
};

inline Sums sums_of(const Samples &of) {
    Sums all;
    for (size_t f = 0; f < of.frames; ++f) {
        Sums frame;
        for (size_t p = 0; p < of.points; ++p) {
            const size_t at = f * of.points + p;
            const double *a = of.wanted + 3 * at, *b = of.decoded + 3 * at;
            const double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2], squared = x * x + y * y + z * z;
            frame.squared += squared;
            if (!of.skips(at)) frame.distance += std::sqrt(squared) * (of.weights ? of.weights[p] : 1.0);
        }
        all.distance += frame.distance, all.squared += frame.squared;
    }
    return all;
}

// corrections.Corrections
struct Found {
    std::vector<int64_t> start, length, by;  // by: (n, 3)

    void add(size_t from, size_t frames, const double *vector) {
        start.push_back(int64_t(from)), length.push_back(int64_t(frames));
        for (size_t k = 0; k < 3; ++k) by.push_back(int64_t(vector[k]));
    }
};

// corrections.numbers (5, n): x, y, z, samples since the previous correction, frames − 1.
inline std::vector<int64_t> numbers_of(const Found &of) {
    const size_t n = of.start.size();
    std::vector<int64_t> out(5 * n);
    int64_t end = 0;
    for (size_t i = 0; i < n; ++i) {
        for (size_t k = 0; k < 3; ++k) out[k * n + i] = of.by[3 * i + k];
        out[3 * n + i] = of.start[i] - end;
        out[4 * n + i] = of.length[i] - 1;
        end = of.start[i] + of.length[i];
    }
    return out;
}

constexpr double LARGEST_ERROR_STEPS = 1125899906842624.0;  // coding/direct.py, LARGEST

// Finds corrections. False for errors too large to count in steps.
inline bool find_corrections(const Samples &of, double bound, double step, Found &out) {
    const double limit = bound * bound, pi = 3.14159265358979323846;
    std::vector<size_t> beyond;  // point · frames + frame
    bool fits = true;
    for (size_t at = 0; at < of.frames * of.points; ++at) {
        double e[3];
        if (!of.weights) {  // most samples are within the bound
            const double *a = of.wanted + 3 * at, *b = of.decoded + 3 * at;
            const double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
            if (!(x * x + y * y + z * z > limit)) continue;
        }
        of.error(at, e);
        if (!(e[0] * e[0] + e[1] * e[1] + e[2] * e[2] > limit) || of.skips(at)) continue;
        for (double each : e) fits = fits && std::fabs(each) < LARGEST_ERROR_STEPS * step;
        beyond.push_back(at % of.points * of.frames + at / of.points);
    }
    if (!fits) return false;
    std::sort(beyond.begin(), beyond.end());
    std::vector<double> errors;
    for (size_t first = 0, end; first < beyond.size(); first = end) {
        const size_t start = beyond[first], point = start / of.frames;
        for (end = first + 1; end < beyond.size() && beyond[end] == start + end - first && beyond[end] / of.frames == point;)
            ++end;
        const size_t n = end - first;
        errors.resize(3 * n);
        for (size_t i = 0; i < n; ++i) of.error((start % of.frames + i) * of.points + point, errors.data() + 3 * i);
        double total = 0, by[3] = {}, fitted[3] = {};
        auto weight = [&](size_t i) { return std::sin(pi * double(i + 1) / double(n + 1)); };
        for (size_t i = 0; i < n; ++i) {
            const double w = weight(i);
            total += w * w;
            for (size_t k = 0; k < 3; ++k) fitted[k] += errors[3 * i + k] * w;
        }
        for (size_t k = 0; k < 3; ++k) by[k] = std::nearbyint(fitted[k] / total / step);
        bool suffices = true;
        for (size_t i = 0; i < n && suffices; ++i) {
            double left_2 = 0;
            for (size_t k = 0; k < 3; ++k) {
                const double left = errors[3 * i + k] - by[k] * (weight(i) * step);
                left_2 += left * left;
            }
            suffices = !(left_2 > limit);
        }
        if (suffices) {
            out.add(start, n, by);
            continue;
        }
        for (size_t i = 0; i < n; ++i) {
            for (size_t k = 0; k < 3; ++k) by[k] = std::nearbyint(errors[3 * i + k] / step);
            out.add(start + i, 1, by);
        }
    }
    return true;
}

}  // namespace chunks
