// Shared code of the two octrees of lattice points (point_octree.cpp codes octant by octant, cube_octree.cpp cube by
// cube): classes of contexts, counts of cubes and samples, and the functions for Python.
#pragma once

#include <array>
#include <cmath>
#include <string>

#include "bit_arrays.h"
#include "octree_surface.h"

namespace point_octree {

constexpr int POSTERIORS = 64, NO_HINT = POSTERIORS, FAR = 21;
constexpr int BELL_STEPS = 64, BELL_PER_DEVIATION = 16;
constexpr int DISTANCE_STEPS[] = {1, 2, 3, 4, 5, 7, 9, 12, 16, 24};
constexpr int CLASSES = 25;  // classes by quarters of a child's side; the last is for larger distances
constexpr size_t SAMPLE_STEPS[] = {1, 2, 3, 5};
constexpr int LATTICE_STEP = 7;  // difference of the two octants of the last level

// Number of bits set in 0 … 255.
struct BitCounts {
    uint8_t of[256] = {};
    constexpr BitCounts() {
        for (int mask = 1; mask < 256; ++mask) of[mask] = uint8_t(of[mask >> 1] + (mask & 1));
    }
};

inline constexpr BitCounts BIT_COUNTS;

inline int bits_of(unsigned mask) { return BIT_COUNTS.of[mask & 255]; }

// Tables over masks 0 … 255.
struct Masks {
    uint8_t few[256] = {};       // number of bits set, at most 3
    uint8_t inner[8][256] = {};  // for each octant: context bits of the known octants beside it in its cube

    Masks() {
        for (unsigned mask = 0; mask < 256; ++mask) few[mask] = uint8_t(std::min(bits_of(mask), 3));
        for (int octant = 0; octant < 8; ++octant)
            for (int mask = 0; mask < 256; ++mask)
                for (int axis = 0; axis < 3; ++axis)
                    if (octant >> axis & 1) inner[octant][mask] |= uint8_t((mask >> (octant ^ 1 << axis) & 1) * 2 << outer_bit(axis));
    }

    // Context bit for "the cube or octant beyond the octant's face is occupied".
    static int outer_bit(int axis) { return 2 * (2 - axis); }
};

inline const Masks MASKS;

inline size_t occupied_octants(const std::vector<uint8_t> &masks) {
    size_t count = 0;
    for (uint8_t mask : masks) count += size_t(bits_of(mask));
    return count;
}

// Classes of distances, by quarters of a child's side.
inline std::array<int, CLASSES> distance_classes() {
    std::array<int, CLASSES> classes{};
    for (int q = 0; q < CLASSES; ++q)
        for (int step : DISTANCE_STEPS) classes[size_t(q)] += step <= q;
    return classes;
}

// Occupied children of a level's cubes, as masks. codes: of the points, sorted; below: number of levels below the children.
inline std::vector<uint8_t> occupancy(const uint64_t *codes, size_t points, const std::vector<uint64_t> &cubes, int below) {
    std::vector<uint8_t> masks(cubes.size(), 0);
    for (size_t i = 0, cube = 0; i < points; ++i) {
        const uint64_t child = codes[i] >> 3 * below;
        while (cube < cubes.size() && cubes[cube] != child >> 3) ++cube;
        if (cube == cubes.size()) throw std::invalid_argument("octree: a code is beyond the octree");
        masks[cube] |= uint8_t(1u << (child & 7));
    }
    return masks;
}

// Calls set(cube, octant, class) for the children of a level's cubes that hold samples, with the class of their number.
template <class Set>
void classify_samples(const Surface &surface, const std::vector<uint64_t> &cubes, int level, Set set) {
    const std::vector<uint64_t> &codes = surface.sample_codes();
    const int below = 3 * (surface.depth() - level - 1);
    size_t cube = 0;
    for (size_t first = 0, end = 0; first < codes.size(); first = end) {
        const uint64_t child = codes[first] >> below;
        while (end < codes.size() && codes[end] >> below == child) ++end;
        while (cube < cubes.size() && cubes[cube] < child >> 3) ++cube;
        if (cube == cubes.size()) return;
        if (cubes[cube] != child >> 3) continue;
        uint8_t kind = 0;
        for (size_t least : SAMPLE_STEPS) kind = uint8_t(kind + (end - first >= least));
        set(cube, size_t(child & 7), kind);
    }
}

// Python's functions of a Tree, which has `code`, `failed_level`, `failed_cubes`, and `points` with codes and samples.
template <class Tree>
struct OctreeFunctions {
    static Tree tree_of(int depth, const Surface *surface, const Input<int32_t, 1> &bell) {
        if (bell.shape(0) != BELL_STEPS + 1 || depth < 0 || depth > 20 || (surface && surface->depth() != depth))
            throw std::invalid_argument("octree: the depth or a table's size is wrong");
        return Tree(depth, surface, bell.data());
    }

    // Without the interpreter, so that other threads can work.
    template <class Coder>
    static bool code_alone(Tree &tree, Coder &coder, const uint64_t *codes, size_t points) {
        nb::gil_scoped_release release;
        return tree.code(coder, codes, points);
    }

    static Output<int64_t> samples_of(const Tree &tree, const Surface *surface) {
        const std::vector<int32_t> &nearest = tree.points().nearest;
        Fresh<int64_t> rows(nearest.size());
        for (size_t i = 0; i < nearest.size(); ++i) rows.data[i] = surface ? surface->given_row(nearest[i]) : NOWHERE;
        return rows.give({nearest.size()});
    }

    // Codes sorted distinct codes; returns the sample near each.
    static Output<int64_t> encode(bit_arrays::BitArrayEncoder &coder, Input<uint64_t, 1> codes, int depth,
                                  const Surface *surface, Input<int32_t, 1> bell) {
        Tree tree = tree_of(depth, surface, bell);
        for (size_t i = 1; i < codes.shape(0); ++i)
            if (codes.data()[i] <= codes.data()[i - 1]) throw std::invalid_argument("octree: the codes are not sorted");
        const bool is_tree = code_alone(tree, coder, codes.data(), codes.shape(0));
        const std::vector<uint64_t> &coded = tree.points().codes;
        if (!is_tree || coded.size() != codes.shape(0) || !std::equal(coded.begin(), coded.end(), codes.data()))
            throw std::invalid_argument("octree: the codes are not lattice points");
        return samples_of(tree, surface);
    }

    // (codes, samples, 0, 0), or (None, None, level, cubes of the level) if the bytes are not a tree of `points` points.
    static nb::tuple decode(bit_arrays::BitArrayDecoder &coder, size_t points, int depth, const Surface *surface,
                            Input<int32_t, 1> bell) {
        Tree tree = tree_of(depth, surface, bell);
        if (!code_alone(tree, coder, nullptr, points))
            return nb::make_tuple(nb::none(), nb::none(), tree.failed_level, tree.failed_cubes);
        const std::vector<uint64_t> &found = tree.points().codes;
        Fresh<int64_t> codes(found.size());
        std::copy(found.begin(), found.end(), codes.data.get());
        return nb::make_tuple(codes.give({found.size()}), samples_of(tree, surface), 0, size_t(0));
    }

    // Binds them as NAME_encode and NAME_decode.
    static void bind(nb::module_ &m, const std::string &name) {
        m.def((name + "_encode").c_str(), &encode, nb::arg(), nb::arg(), nb::arg(), nb::arg().none(), nb::arg());
        m.def((name + "_decode").c_str(), &decode, nb::arg(), nb::arg(), nb::arg(), nb::arg().none(), nb::arg());
    }
};

}  // namespace point_octree
