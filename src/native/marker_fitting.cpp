// Search for the bones that markers sit on, for codecs/tempo/models/marker_fitting.py.

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "algebra3.h"
#include "arrays.h"

namespace {

struct Bone {
    double start[3], along[3], square;  // square: of the length
};

// marker_fitting._nearest_bones: of poses (guesses, points, 3), joints (guesses, bones, 3).
nb::tuple nearest_bones(Input<double, 3> poses, Input<double, 3> joints, Input<int64_t, 1> parents) {
    const size_t guesses = poses.shape(0), points = poses.shape(1), count = joints.shape(1);
    bool fits = poses.shape(2) == 3 && joints.shape(2) == 3 && joints.shape(0) == guesses && parents.shape(0) == count && count;
    for (size_t b = 0; fits && b < count; ++b) fits = parents.data()[b] >= 0 && size_t(parents.data()[b]) < count;
    if (!fits) throw std::invalid_argument("nearest_bones: shapes differ");
    Fresh<int64_t> nearest(guesses * points);
    Fresh<double> shares(guesses * points), distances(guesses * points);
    {
        nb::gil_scoped_release release;
        std::vector<Bone> bones(count);
        for (size_t g = 0; g < guesses; ++g) {
            const double *of_guess = joints.data() + g * count * 3;
            for (size_t b = 0; b < count; ++b) {
                Bone &bone = bones[b];
                std::copy_n(of_guess + 3 * parents.data()[b], 3, bone.start);
                for (size_t k = 0; k < 3; ++k) bone.along[k] = of_guess[3 * b + k] - bone.start[k];
                bone.square = dot(bone.along, bone.along) + 1e-9;
            }
            for (size_t i = g * points; i < (g + 1) * points; ++i) {
                const double *point = poses.data() + 3 * i;
                double least = std::numeric_limits<double>::infinity();
                nearest.data[i] = 0, shares.data[i] = 0, distances.data[i] = least;
                for (size_t b = 0; b < count; ++b) {
                    const Bone &bone = bones[b];
                    double offset[3];
                    for (size_t k = 0; k < 3; ++k) offset[k] = point[k] - bone.start[k];
                    const double share = std::min(std::max(dot(offset, bone.along) / bone.square, 0.0), 1.0);
                    for (size_t k = 0; k < 3; ++k) offset[k] -= share * bone.along[k];
                    const double square = dot(offset, offset);
                    if (!(square < least)) continue;
                    const double distance = std::sqrt(square);
                    if (!(distance < distances.data[i])) continue;  // equal after rounding: the first bone
                    least = square, nearest.data[i] = int64_t(b), shares.data[i] = share, distances.data[i] = distance;
                }
            }
        }
    }
    return nb::make_tuple(nearest.give({guesses, points}), shares.give({guesses, points, 1}), distances.give({guesses, points}));
}

}  // namespace

void bind_marker_fitting(nb::module_ &m) { m.def("nearest_bones", &nearest_bones); }
