// The body's frame, and poses transformed from it to the world: geometry/body_frame.py.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "arrays.h"

namespace body_frames {

constexpr double LEVEL_M = 1e-6;  // body_frame.LEVEL_M

// body_frame.from_markers of one frame: origin (3) and heading (2) from three markers (3, 3). up: the vertical axis.
inline void from_markers(const double *markers, size_t up, double *origin, double *heading) {
    const size_t a = (up + 1) % 3, b = (up + 2) % 3;
    std::copy_n(markers, 3, origin);
    const double x = markers[6 + a] - markers[3 + a], y = markers[6 + b] - markers[3 + b], length = std::hypot(x, y);
    heading[0] = length > LEVEL_M ? x / length : 1.0, heading[1] = length > LEVEL_M ? y / length : 0.0;
}

// Writes some columns of positions (frames, points, 3). origin (frames, 3); heading (frames, 2); up: the vertical axis.
class World {
public:
    World(const int64_t *columns, size_t count, const double *origin, const double *heading, size_t up, size_t points, double *positions)
        : columns_(columns), count_(count), origin_(origin), heading_(heading), points_(points), up_(up), positions_(positions) {}

    World(const Input<int64_t, 1> &columns, const Input<double, 2> &origin, const Input<double, 2> &heading, size_t up,
          const InPlace<double, 3> &positions)
        : World(columns.data(), columns.shape(0), origin.data(), heading.data(), up, positions.shape(1), positions.data()) {
        const size_t frames = positions.shape(0);
        if (origin.shape(0) != frames || origin.shape(1) != 3 || heading.shape(0) != frames || heading.shape(1) != 2 ||
            positions.shape(2) != 3 || up > 2)
            throw std::invalid_argument("body frames: shapes differ");
        for (size_t i = 0; i < count_; ++i)
            if (size_t(columns_[i]) >= points_) throw std::invalid_argument("body frames: no such point");
    }

    size_t count() const { return count_; }

    // Writes the pose (columns, 3) of one frame.
    void place(size_t frame, const double *pose) const {
        const size_t a = (up_ + 1) % 3, b = (up_ + 2) % 3;
        const double cosine = heading_[2 * frame], sine = -heading_[2 * frame + 1], *from = origin_ + 3 * frame;
        for (size_t i = 0; i < count_; ++i, pose += 3) {
            double *to = positions_ + (frame * points_ + size_t(columns_[i])) * 3;
            to[up_] = pose[up_] + from[up_];
            to[a] = cosine * pose[a] + sine * pose[b] + from[a];
            to[b] = cosine * pose[b] - sine * pose[a] + from[b];
        }
    }

private:
    const int64_t *columns_;
    size_t count_;
    const double *origin_, *heading_;
    size_t points_, up_;
    double *positions_;
};

// segment_model._nearest_marker of marker i of a pose (markers, 3): the nearest earlier marker, 0 for the first.
inline int64_t nearest_earlier(const int64_t *pose, size_t i) {
    int64_t least = std::numeric_limits<int64_t>::max(), nearest = 0;
    for (size_t j = 0; j < i; ++j) {
        uint64_t square = 0;  // wraps around like NumPy's integers
        for (size_t d = 0; d < 3; ++d) {
            const uint64_t off = uint64_t(pose[3 * i + d]) - uint64_t(pose[3 * j + d]);
            square += off * off;
        }
        if (int64_t(square) < least) least = int64_t(square), nearest = int64_t(j);
    }
    return nearest;
}

}  // namespace body_frames
