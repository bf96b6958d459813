// Functions that pass once over the positions of a motion, where NumPy needs many passes: screening
// (codecs/tempo/preparation.py), residuals on a grid (codecs/tempo/coding/direct.py), distances (metrics/motion.py).

#include <algorithm>
#include <cmath>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "algebra3.h"
#include "arrays.h"

namespace {

// Screens positions (frames, points, 3). Four flags: a position is missing (NaN in x); some positions, but not all,
// repeat the bits of the frame before; a position is a spike (leaps.spikes); a step is longer than `leap` metres.
nb::tuple screen_positions(Input<double, 3> positions, double leap, double factor) {
    const size_t frames = positions.shape(0), pitch = positions.shape(1) * 3;
    if (positions.shape(2) != 3) throw std::invalid_argument("screen_positions: positions need three axes");
    const double *data = positions.data();
    bool missing = false, repeats = false, spike = false, leaps = false;
    {
        nb::gil_scoped_release release;
        for (size_t f = 0; f < frames; ++f) {
            size_t same = 0;
            for (size_t i = 0; i < pitch; i += 3) {
                const double *here = data + f * pitch + i;
                missing |= here[0] != here[0];
                if (!f) continue;
                const double *before = here - pitch;
                if (here[0] - before[0] == 0) same += !std::memcmp(here, before, 3 * sizeof(double));
                leaps |= squared_distance(here, before) > leap * leap;
                if (f + 1 == frames) continue;
                const double *after = here + pitch;
                double off[3];
                for (size_t k = 0; k < 3; ++k) off[k] = here[k] - (before[k] + after[k]) / 2;
                const double distance = dot(off, off);
                if (distance > leap * leap)
                    spike |= std::sqrt(distance) > factor / 2 * std::sqrt(squared_distance(after, before));
            }
            repeats |= same && 3 * same < pitch;
        }
    }
    return nb::make_tuple(missing, repeats, spike, leaps);
}

// leaps.discontinuities without the limit of their number: the first frames after leaps of positions (frames, points, 3).
nb::list leap_frames(Input<double, 3> positions, double least, double factor) {
    const size_t frames = positions.shape(0), pitch = positions.shape(1) * 3;
    if (positions.shape(2) != 3) throw std::invalid_argument("leap_frames: three axes");
    std::vector<size_t> found;
    {
        nb::gil_scoped_release release;
        auto step = [&](size_t f, size_t i) {  // from frame f to the next
            const double *from = positions.data() + f * pitch + i;
            return squared_distance(from + pitch, from);
        };
        for (size_t f = 0; f + 1 < frames && frames > 3; ++f) {
            const size_t before = f ? f - 1 : 1, after = f + 2 < frames ? f + 1 : f - 1;
            for (size_t i = 0; i < pitch; i += 3) {
                const double here = step(f, i);
                if (!(here > least * least)) continue;
                const double around = std::sqrt(std::max(step(before, i), step(after, i)));
                if (!(std::sqrt(here) > factor * around)) continue;
                found.push_back(f + 1);
                break;
            }
        }
    }
    nb::list out;
    for (const size_t each : found) out.append(each);
    return out;
}

// direct._predict of frame m from the known frames m − around and m + around.
int64_t predicted(const int64_t *values, size_t m, size_t around, size_t last) {
    const int64_t line = values[m - around] + values[std::min(m + around, last)];
    if (m < 3 * around || m + 3 * around > last) return (line + 1) >> 1;
    return (9 * line - values[m - 3 * around] - values[m + 3 * around] + 8) >> 4;
}

// Sums (coordinates,) of the magnitudes of direct._residuals without the first frame, for each `every`th point of
// positions (frames, points, 3) in steps of `step` metres. None for positions too large to count in steps.
nb::object direct_residuals(Input<double, 3> positions, double step, size_t every, int64_t largest) {
    const size_t frames = positions.shape(0), points = positions.shape(1);
    if (positions.shape(2) != 3 || !every || !frames) throw std::invalid_argument("direct_residuals: shapes differ");
    const size_t count = 3 * ((points + every - 1) / every), last = frames - 1;
    Fresh<int64_t> sums(count);
    bool fits = true;
    {
        nb::gil_scoped_release release;
        std::vector<int64_t> values(frames);
        for (size_t c = 0; c < count && fits; ++c) {
            const double *from = positions.data() + c / 3 * every * 3 + c % 3;
            for (size_t f = 0; f < frames; ++f) {
                const double scaled = from[f * points * 3] / step;
                if (!(std::fabs(scaled) < double(largest))) fits = false;
                values[f] = fits ? int64_t(std::nearbyint(scaled)) : 0;
            }
            size_t stride = 1;
            while (stride < last) stride *= 2;
            int64_t sum = last ? std::abs(values[last] - values[0]) : 0;
            while (stride > 1) {
                stride /= 2;
                for (size_t m = stride; m < last; m += 2 * stride)
                    sum += std::abs(values[m] - predicted(values.data(), m, stride, last));
            }
            sums.data[c] = sum;
        }
    }
    return fits ? nb::cast(sums.give({count})) : nb::none();
}

// Compares positions (frames, points, 3): whether the same samples are missing (NaN in x); number of the others, and
// sum and maximum of their distances; NaN if a distance is NaN.
nb::tuple compare_positions(Input<double, 3> original, Input<double, 3> decoded) {
    if (original.shape(0) != decoded.shape(0) || original.shape(1) != decoded.shape(1) || original.shape(2) != 3 ||
        decoded.shape(2) != 3)
        throw std::invalid_argument("compare_positions: shapes differ");
    const size_t frames = original.shape(0), pitch = original.shape(1) * 3;
    bool same = true, broken = false;
    size_t count = 0;
    double sum = 0, largest = 0;
    {
        nb::gil_scoped_release release;
        for (size_t f = 0; f < frames; ++f) {
            double of_frame = 0;
            for (size_t i = 0; i < pitch; i += 3) {
                const double *a = original.data() + f * pitch + i, *b = decoded.data() + f * pitch + i;
                const bool missing = a[0] != a[0];
                same &= missing == (b[0] != b[0]);
                if (missing) continue;
                const double distance = std::sqrt(squared_distance(a, b));
                ++count;
                of_frame += distance;
                largest = std::max(largest, distance);
                broken |= distance != distance;
            }
            sum += of_frame;
        }
    }
    if (broken) sum = largest = std::nan("");
    return nb::make_tuple(same, count, sum, largest);
}

}  // namespace

void bind_positions(nb::module_ &m) {
    m.def("screen_positions", &screen_positions);
    m.def("leap_frames", &leap_frames);
    m.def("direct_residuals", &direct_residuals);
    m.def("compare_positions", &compare_positions);
}
