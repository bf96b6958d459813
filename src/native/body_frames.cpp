// Poses in a body's frame, for geometry/body_frame.py and codecs/liu2006.

#include <stdexcept>

#include "arrays.h"
#include "body_frames.h"

namespace {

// body_frame.to_world: writes poses (frames, 3 columns) to these columns of positions (frames, points, 3). origin
// (frames, 3); heading (frames, 2); up: the vertical axis.
void place_in_world(Input<double, 2> poses, Input<int64_t, 1> columns, Input<double, 2> origin, Input<double, 2> heading,
                    size_t up, InPlace<double, 3> positions) {
    const body_frames::World world(columns, origin, heading, up, positions);
    const size_t width = 3 * columns.shape(0);
    if (poses.shape(0) != positions.shape(0) || poses.shape(1) != width) throw std::invalid_argument("place_in_world: shapes differ");
    for (size_t t = 0; t < poses.shape(0); ++t) world.place(t, poses.data() + t * width);
}

// body_frame.to_body: poses (frames, 3 columns) from these columns of positions (frames, points, 3).
Output<double> place_in_body(Input<double, 3> positions, Input<int64_t, 1> columns, Input<double, 2> origin,
                             Input<double, 2> heading, size_t up) {
    const size_t frames = positions.shape(0), count = columns.shape(0), points = positions.shape(1);
    if (positions.shape(2) != 3 || origin.shape(0) != frames || origin.shape(1) != 3 || heading.shape(0) != frames ||
        heading.shape(1) != 2 || up > 2)
        throw std::invalid_argument("place_in_body: shapes differ");
    for (size_t i = 0; i < count; ++i)
        if (size_t(columns.data()[i]) >= points) throw std::invalid_argument("place_in_body: no such point");
    const size_t a = (up + 1) % 3, b = (up + 2) % 3;
    Fresh<double> out(frames * count * 3);
    for (size_t t = 0; t < frames; ++t) {
        const double cosine = heading.data()[2 * t], sine = heading.data()[2 * t + 1], *from = origin.data() + 3 * t;
        for (size_t i = 0; i < count; ++i) {
            const double *at = positions.data() + (t * points + size_t(columns.data()[i])) * 3;
            const double x = at[a] - from[a], y = at[b] - from[b];
            double *pose = &out.data[(t * count + i) * 3];
            pose[up] = at[up] - from[up];
            pose[a] = cosine * x + sine * y;
            pose[b] = cosine * y - sine * x;
        }
    }
    return out.give({frames, 3 * count});
}

// segment_model._nearest_marker of a pose (markers, 3).
Output<int64_t> nearest_earlier(Input<int64_t, 2> pose) {
    const size_t n = pose.shape(0);
    if (pose.shape(1) != 3) throw std::invalid_argument("nearest_earlier: shapes differ");
    Fresh<int64_t> out(n);
    for (size_t i = 0; i < n; ++i) out.data[i] = body_frames::nearest_earlier(pose.data(), i);
    return out.give({n});
}

}  // namespace

void bind_body_frames(nb::module_ &m) {
    m.def("place_in_world", &place_in_world, nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg().noconvert());
    m.def("place_in_body", &place_in_body);
    m.def("nearest_earlier", &nearest_earlier);
}
