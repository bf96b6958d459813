// Transforms poses from the body's frame to the world: geometry/body_frame.py, to_world.
#pragma once

#include <stdexcept>

#include "arrays.h"

namespace body_frames {

// Writes some columns of positions (frames, points, 3). origin (frames, 3); heading (frames, 2); up: the vertical axis.
class World {
public:
    World(const Input<int64_t, 1> &columns, const Input<double, 2> &origin, const Input<double, 2> &heading, size_t up,
          const InPlace<double, 3> &positions)
        : columns_(columns), origin_(origin.data()), heading_(heading.data()), points_(positions.shape(1)), up_(up),
          positions_(positions.data()) {
        const size_t frames = positions.shape(0);
        if (origin.shape(0) != frames || origin.shape(1) != 3 || heading.shape(0) != frames || heading.shape(1) != 2 ||
            positions.shape(2) != 3 || up > 2)
            throw std::invalid_argument("body frames: shapes differ");
        for (size_t i = 0; i < columns.shape(0); ++i)
            if (size_t(columns.data()[i]) >= points_) throw std::invalid_argument("body frames: no such point");
    }

    // Writes the pose (columns, 3) of one frame.
    void place(size_t frame, const double *pose) const {
        const size_t a = (up_ + 1) % 3, b = (up_ + 2) % 3;
        const double cosine = heading_[2 * frame], sine = -heading_[2 * frame + 1], *from = origin_ + 3 * frame;
        for (size_t i = 0; i < columns_.shape(0); ++i, pose += 3) {
            double *to = positions_ + (frame * points_ + size_t(columns_.data()[i])) * 3;
            to[up_] = pose[up_] + from[up_];
            to[a] = cosine * pose[a] + sine * pose[b] + from[a];
            to[b] = cosine * pose[b] - sine * pose[a] + from[b];
        }
    }

private:
    const Input<int64_t, 1> &columns_;
    const double *origin_, *heading_;
    const size_t points_, up_;
    double *positions_;
};

}  // namespace body_frames
