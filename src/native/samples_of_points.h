// The sample of the surface near each lattice point: the one that the octree finds. For codecs/bodycast/point_choice.py.
#pragma once

#include <array>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include "octree_surface.h"

namespace point_octree {

inline std::array<int32_t, 3> place_of_code(uint64_t code) {
    return {int32_t(gathered_bits(code)), int32_t(gathered_bits(code >> 1)), int32_t(gathered_bits(code >> 2))};
}

// The sample near each of sorted distinct codes, NOWHERE without one; the surface keeps those near the cubes above. Coarse
// levels of the octree have no samples.
inline std::vector<int32_t> samples_of_points(Surface &surface, const uint64_t *points, size_t count) {
    const int depth = surface.depth();
    std::vector<std::array<int32_t, 3>> cells(count), places;
    for (size_t i = 0; i < count; ++i) {
        if (points[i] >> 3 * depth || (i && points[i] <= points[i - 1]))
            throw std::invalid_argument("octree: the codes are not sorted, or beyond the octree");
        cells[i] = place_of_code(points[i]);
    }
    int level = 0;
    while (level < depth && !surface.has_samples(level)) ++level;
    std::vector<int32_t> row(count, 0), nearest(1, NOWHERE), from;  // row: of the cube of each point in the level above
    for (; level < depth; ++level) {
        places.clear();
        from.clear();
        const int below = depth - level;
        uint64_t last = 0;
        for (size_t i = 0; i < count; ++i) {
            const uint64_t code = points[i] >> 3 * below;
            if (places.empty() || code != last) {
                places.push_back({cells[i][0] >> below, cells[i][1] >> below, cells[i][2] >> below});
                from.push_back(nearest[size_t(row[i])]);
                last = code;
            }
            row[i] = int32_t(places.size()) - 1;
        }
        surface.attach(places, level, from);
        surface.keep_attached(places, level, from);
        nearest.swap(from);
    }
    for (int32_t &own : row) own = nearest[size_t(own)];
    return row;
}

}  // namespace point_octree
