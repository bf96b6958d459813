// Natural cubic splines through key frames, for stages/spline.py, with the same float operations in the same order.

#include <nanobind/stl/optional.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <stdexcept>
#include <vector>

#include "arrays.h"
#include "splines.h"

namespace {

using namespace splines;

// spline.interpolate: splines through values (keys, k) at ascending key frames. at: frames in any order. Returns (at, k).
Output<double> spline_interpolate(Input<int64_t, 1> keyframes, Input<double, 2> values, Input<int64_t, 1> at) {
    const size_t keys = keyframes.shape(0), k = values.shape(1), count = at.shape(0);
    if (keys < 2 || values.shape(0) != keys) throw std::invalid_argument("spline_interpolate: shapes differ");
    require_ascending(keyframes.data(), keys);
    Spline spline(keyframes.data(), keys, k, [&](size_t i) { return values.data() + i * k; });
    Fresh<double> out(count * k);
    for (size_t j = 0; j < count; ++j) spline.at(at.data()[j], &out.data[j * k]);
    return out.give({count, k});
}

template <class T>
Output<T> array_of(const std::vector<T> &values) {
    Fresh<T> out(values.size());
    std::copy(values.begin(), values.end(), out.data.get());
    return out.give({values.size()});
}

// spline.splits of key frames (keys) in a run of `frames` frames.
Output<uint8_t> spline_splits(Input<int64_t, 1> keys, int64_t frames) {
    if (frames < 1) throw std::invalid_argument("spline_splits: no frames");
    std::vector<uint8_t> chosen(size_t(frames), 0), splits;
    for (size_t i = 0; i < keys.shape(0); ++i) {
        if (keys.data()[i] < 0 || keys.data()[i] >= frames) throw std::invalid_argument("spline_splits: a key frame is out of range");
        chosen[size_t(keys.data()[i])] = 1;
    }
    Frames by_level, sizes;
    auto halved = [&](int64_t middle) {
        splits.push_back(chosen[size_t(middle)]);
        return splits.back() != 0;
    };
    halve(frames, halved, by_level, sizes);
    return array_of(splits);
}

// spline.keyframes of a trajectory (frames, k): key frames by level, sizes of the levels.
nb::tuple spline_keyframes(Input<double, 2> trajectory, double tolerance) {
    const int64_t frames = int64_t(trajectory.shape(0));
    const size_t k = trajectory.shape(1);
    if (frames < 1) throw std::invalid_argument("spline_keyframes: no frames");
    auto wanted = [&](int64_t t) { return trajectory.data() + size_t(t) * k; };
    Frames keys = evenly(frames), middles, merged;
    std::vector<double> found(k);
    const double limit = tolerance * tolerance;
    while (int64_t(keys.size()) < frames) {
        Spline spline(keys.data(), keys.size(), k, [&](size_t i) { return wanted(keys[i]); });
        auto too_far = [&](int64_t t) {
            spline.at(t, found.data());
            double sum = 0;
            for (size_t c = 0; c < k; ++c) sum += (found[c] - wanted(t)[c]) * (found[c] - wanted(t)[c]);
            return sum > limit;
        };
        middles.clear();
        for (size_t i = 0; i + 1 < keys.size(); ++i) {
            const int64_t middle = (keys[i] + keys[i + 1]) / 2;
            bool off = middle > keys[i] && too_far(middle);  // where the error is usually largest
            for (int64_t t = keys[i] + 1; !off && t < keys[i + 1]; ++t) off = too_far(t);
            if (off) middles.push_back(middle);
        }
        if (middles.empty()) break;
        merged.resize(keys.size() + middles.size());
        std::merge(keys.begin(), keys.end(), middles.begin(), middles.end(), merged.begin());
        keys.swap(merged);
    }
    std::vector<uint8_t> chosen(size_t(frames), 0);
    for (int64_t key : keys) chosen[size_t(key)] = 1;
    Frames by_level, sizes;
    halve(frames, [&](int64_t middle) { return chosen[size_t(middle)] != 0; }, by_level, sizes);
    return nb::make_tuple(array_of(by_level), array_of(sizes));
}

// spline.from_splits: key frames by level, sizes of the levels, number of bits read; None for too few bits.
std::optional<nb::tuple> spline_from_splits(Input<uint8_t, 1> bits, int64_t frames) {
    if (frames < 1) throw std::invalid_argument("spline_from_splits: no frames");
    size_t used = 0;
    bool enough = true;
    Frames by_level, sizes;
    auto halved = [&](int64_t) {
        if (used >= bits.shape(0)) return enough = false;
        return bits.data()[used++] != 0;
    };
    halve(frames, halved, by_level, sizes);
    if (!enough) return std::nullopt;
    return nb::make_tuple(array_of(by_level), array_of(sizes), used);
}

// spline.values
Output<double> spline_values(Input<int64_t, 1> by_level, Input<int64_t, 1> sizes, Input<int64_t, 2> numbers, double step) {
    const size_t keys = by_level.shape(0), k = numbers.shape(1);
    if (numbers.shape(0) != keys) throw std::invalid_argument("spline_values: shapes differ");
    Fresh<double> out(keys * k);
    descend(by_level.data(), keys, sizes.data(), sizes.shape(0), k, out.data.get(), [&](size_t i, const double *prediction, double *value) {
        for (size_t c = 0; c < k; ++c) value[c] = prediction[c] + double(numbers.data()[i * k + c]) * step;
    });
    return out.give({keys, k});
}

// spline.differences: integers and values; None beyond ±2^52.
std::optional<nb::tuple> spline_differences(Input<int64_t, 1> by_level, Input<int64_t, 1> sizes, Input<double, 2> wanted, double step) {
    const size_t keys = by_level.shape(0), k = wanted.shape(1);
    if (wanted.shape(0) != keys) throw std::invalid_argument("spline_differences: shapes differ");
    Fresh<double> values(keys * k);
    Fresh<int64_t> numbers(keys * k);
    bool fits = true;
    descend(by_level.data(), keys, sizes.data(), sizes.shape(0), k, values.data.get(), [&](size_t i, const double *prediction, double *value) {
        for (size_t c = 0; c < k; ++c) {
            const double scaled = (wanted.data()[i * k + c] - prediction[c]) / step;
            const bool small = std::abs(scaled) < 4503599627370496.0;
            fits = fits && small;
            const int64_t number = small ? int64_t(std::copysign(std::floor(std::abs(scaled) + 0.5), scaled)) : 0;
            numbers.data[i * k + c] = number;
            value[c] = prediction[c] + double(number) * step;
        }
    });
    if (!fits) return std::nullopt;
    return nb::make_tuple(numbers.give({keys, k}), values.give({keys, k}));
}

}  // namespace

void bind_splines(nb::module_ &m) {
    nb::class_<TrackSpline>(m, "TrackSpline")
        .def(nb::init<Input<int64_t, 1>, Input<double, 2>>())
        .def("at", &TrackSpline::at);
    nb::class_<PoseSpline>(m, "PoseSpline")
        .def(nb::init<Input<int64_t, 1>, Input<double, 2>, Input<double, 2>, Input<double, 1>>())
        .def("place", nb::overload_cast<int64_t, Input<int64_t, 1>, Input<double, 2>, Input<double, 2>, size_t, InPlace<double, 3>>(&PoseSpline::place),
             nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg().noconvert());
    m.def("spline_interpolate", &spline_interpolate);
    m.def("spline_keyframes", &spline_keyframes);
    m.def("spline_splits", &spline_splits);
    m.def("spline_from_splits", &spline_from_splits);
    m.def("spline_values", &spline_values);
    m.def("spline_differences", &spline_differences);
}
