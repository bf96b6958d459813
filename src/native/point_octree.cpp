// Octree of lattice points, coded from the bodies' surface, for codecs/bodycast/point_octree.py, which defines the results.
//
//     sorted Morton codes ─► level by level, octant by octant ─► occupancy bits with contexts ─► bit_arrays.h

#include "bit_arrays.h"
#include "octree_surface.h"

namespace {

using namespace point_octree;

constexpr int POSTERIORS = 64, NO_HINT = POSTERIORS, FAR = 21;
constexpr int BELL_STEPS = 64, BELL_PER_DEVIATION = 16;
constexpr int CLASSES = 25;  // quarters of a child's side, the last for all beyond
constexpr int DISTANCE_STEPS[] = {1, 2, 3, 4, 5, 7, 9, 12, 16, 24};
constexpr int LATTICE_STEP = 7;  // from the first to the second octant of the last level
constexpr int SAMPLE_STEPS[] = {1, 2, 3, 5};

// What the surface says about the children of one cube, and what is left of it while its octants are coded.
struct Hints {
    uint16_t narrow[8], wide[8];          // weights of the children
    int32_t narrow_left, wide_left;       // sums over the octants still to come
    uint8_t distance[8], samples[8];      // classes
    uint8_t usable;                       // whether there is a surface near the cube
};

// The cubes of a level with what is known of them.
struct Level {
    std::vector<uint64_t> codes;
    std::vector<std::array<int32_t, 3>> places;
    std::vector<std::array<int32_t, 6>> neighbours;  // rows before and behind along every axis; the number of cubes if empty
    std::vector<uint8_t> known;                      // occupied octants; one cube more, which stays empty
    std::vector<int32_t> nearest;

    size_t size() const { return codes.size(); }
};

// Bits of the numbers from 0 to 255.
struct BitCounts {
    uint8_t of[256] = {};
    BitCounts() {
        for (int mask = 1; mask < 256; ++mask) of[mask] = uint8_t(of[mask >> 1] + (mask & 1));
    }
};

const BitCounts BITS;

int bits_of(unsigned mask) { return BITS.of[mask & 255]; }

// The row of an octant of a cube among the cubes of the next level; `end` if it is empty.
int32_t child_row(const std::vector<uint8_t> &masks, const std::vector<int32_t> &first, size_t parent, int octant,
                  int32_t end) {
    const unsigned mask = masks[parent];
    return mask >> octant & 1 ? first[parent] + bits_of(mask & ((1u << octant) - 1)) : end;
}

// The cubes of the next level.
Level children_of(const Level &level) {
    std::vector<int32_t> first(level.size() + 1);
    int32_t end = 0;
    for (size_t i = 0; i < level.size(); ++i) {
        first[i] = end;
        end += bits_of(level.known[i]);
    }
    Level next;
    next.codes.resize(size_t(end));
    next.places.resize(size_t(end));
    next.neighbours.resize(size_t(end));
    next.nearest.resize(size_t(end));
    next.known.assign(size_t(end) + 1, 0);
    size_t row = 0;
    for (size_t i = 0; i < level.size(); ++i)
        for (int octant = 0; octant < 8; ++octant) {
            if (!(level.known[i] >> octant & 1)) continue;
            next.codes[row] = level.codes[i] << 3 | uint64_t(octant);
            next.nearest[row] = level.nearest[i];
            std::array<int32_t, 3> &place = next.places[row];
            std::array<int32_t, 6> &around = next.neighbours[row];
            ++row;
            for (int axis = 0; axis < 3; ++axis) {
                const int bit = octant >> axis & 1;
                place[size_t(axis)] = 2 * level.places[i][size_t(axis)] + bit;
                for (int side = 0; side < 2; ++side) {
                    const size_t parent = bit != side ? i : size_t(level.neighbours[i][size_t(2 * axis + side)]);
                    around[size_t(2 * axis + side)] = child_row(level.known, first, parent, octant ^ 1 << axis, end);
                }
            }
        }
    return next;
}

// (n): which children of the cubes of a level hold points. codes: of the points, sorted.
std::vector<uint8_t> occupancy(const uint64_t *codes, size_t points, const Level &level, int below) {
    std::vector<uint8_t> masks(level.size(), 0);
    for (size_t i = 0, cube = 0; i < points; ++i) {
        const uint64_t child = codes[i] >> 3 * below;
        while (cube < level.size() && level.codes[cube] != child >> 3) ++cube;
        if (cube == level.size()) throw std::invalid_argument("point_octree: a code is beyond the octree");
        masks[cube] |= uint8_t(1u << (child & 7));
    }
    return masks;
}

// The posteriors of an octant in a batch of cubes, and what is left of their weights. The quotients of floats are exact
// enough: numerators are below 2^19, and quotients at most POSTERIORS.
class Posteriors {
public:
    static constexpr size_t CUBES = 32;

    Posteriors() {
        std::fill_n(below_, 2 * CUBES, 1.0f);
        std::fill_n(quotients_, 2 * CUBES, NO_HINT);
    }

    void take(Hints *hints, size_t count, int octant) {
        for (size_t k = 0; k < count; ++k) {
            Hints &own = hints[k];
            above_[k] = float(own.narrow[octant] * POSTERIORS), below_[k] = float(own.narrow_left + 1);
            above_[CUBES + k] = float(own.wide[octant] * POSTERIORS), below_[CUBES + k] = float(own.wide_left + 1);
            own.narrow_left -= own.narrow[octant];
            own.wide_left -= own.wide[octant];
        }
        for (size_t k = 0; k < 2 * CUBES; ++k) quotients_[k] = int32_t(above_[k] / below_[k]);
        for (size_t k = 0; k < count; ++k)
            if (!hints[k].usable) quotients_[k] = quotients_[CUBES + k] = NO_HINT;
    }

    int narrow(size_t k) const { return quotients_[k]; }
    int wide(size_t k) const { return quotients_[CUBES + k]; }

private:
    float above_[2 * CUBES] = {}, below_[2 * CUBES];
    int32_t quotients_[2 * CUBES];
};

class Tree {
public:
    Tree(int depth, const Surface *surface, const int32_t *bell) : depth_(depth), surface_(surface), bell_(bell) {
        for (int q = 0; q < CLASSES; ++q)
            for (int step : DISTANCE_STEPS) class_[q] += step <= q;
    }

    // Codes a frame. codes: of the points, null in the decoder. Returns whether the bytes were a tree of `points` points;
    // `failed_level` and `failed_cubes` say where they were not.
    template <class Coder>
    bool code(Coder &coder, const uint64_t *codes, size_t points) {
        level_.codes = {0};
        level_.places = {{0, 0, 0}};
        level_.neighbours = {{1, 1, 1, 1, 1, 1}};
        level_.known.assign(2, 0);
        level_.nearest = {NOWHERE};
        for (int level = 0; level < depth_; ++level) {
            std::vector<uint8_t> occupied;
            if (codes) occupied = occupancy(codes, points, level_, depth_ - level - 1);
            if (surface_) look_at_surface(level, level == depth_ - 1 ? LATTICE_STEP : 1);
            code_level(coder, depth_ - level, codes ? occupied.data() : nullptr);
            if (is_cut_off(coder)) return false;
            size_t cubes = 0;
            for (size_t i = 0; i < level_.size(); ++i) cubes += size_t(bits_of(level_.known[i]));
            if (!cubes || cubes > points) {
                failed_level = level + 1;
                failed_cubes = cubes;
                return false;
            }
            level_ = children_of(level_);
        }
        return true;
    }

    const Level &points() const { return level_; }

    int failed_level = 0;
    size_t failed_cubes = 0;

private:
    static bool is_cut_off(const bit_arrays::BitArrayEncoder &) { return false; }
    static bool is_cut_off(const bit_arrays::BitArrayDecoder &decoder) { return decoder.exhausted(); }

    // height: levels from the cubes to the points. occupied: masks of the cubes, null in the decoder.
    template <class Coder>
    void code_level(Coder &coder, int height, const uint8_t *occupied) {
        static constexpr int ALL[] = {0, 1, 2, 3, 4, 5, 6, 7}, LATTICE[] = {0, 7};
        const int *octants = height == 1 ? LATTICE : ALL;
        const int count = height == 1 ? 2 : 8;
        const size_t cubes = level_.size();
        filled_.resize(cubes);
        for (size_t i = 0; i < cubes; ++i) {
            int filled = 0;
            for (int32_t row : level_.neighbours[i]) filled += size_t(row) < cubes;
            filled_[i] = uint8_t(std::min(filled / 2, 3));
        }
        if (surface_) sum_weights(octants, count);
        for (int place = 0; place < count; ++place) code_octant(coder, octants[place], count - place - 1, height, occupied);
    }

    // Codes one octant of all cubes; `left` octants follow. The contexts depend on octants before it alone, so those of a
    // batch of cubes come before its bits, and their counters are in the cache in time.
    template <class Coder>
    void code_octant(Coder &coder, int octant, int left, int height, const uint8_t *occupied) {
        constexpr size_t BATCH = Posteriors::CUBES;
        uint32_t counters[BATCH][bits::INPUTS], sets[BATCH];
        Posteriors posteriors;
        const int tall = std::min(height, 15), set = std::min(height, 20) * 4;
        for (size_t start = 0; start < level_.size(); start += BATCH) {
            const size_t stop = std::min(start + BATCH, level_.size());
            if (surface_) posteriors.take(&hints_[start], stop - start, octant);
            for (size_t i = start; i < stop; ++i) {
                const int few = std::min(bits_of(level_.known[i]), 3);
                uint32_t contexts[bits::INPUTS];
                set_contexts(contexts, i, octant, few, tall, left, posteriors.narrow(i - start), posteriors.wide(i - start));
                sets[i - start] = uint32_t((set + few) * 3 + (surface_ ? 1 + hints_[i].usable : 0));
                bits::Mixer::counters_of(contexts, counters[i - start]);
                coder.fetch(counters[i - start]);
            }
            for (size_t i = start; i < stop; ++i) {
                int bit = 1;
                if (left || level_.known[i])
                    bit = coder.code_with(counters[i - start], sets[i - start], occupied ? occupied[i] >> octant & 1 : 0);
                level_.known[i] = uint8_t(level_.known[i] | bit << octant);
            }
        }
    }

    // The contexts of an octant of cube i; docs/payloads/bodycast-points.md has the table.
    void set_contexts(uint32_t *contexts, size_t i, int octant, int few, int tall, int left, int narrow, int wide) const {
        const unsigned known = level_.known[i];
        int beside = 0, nearby = 0;
        for (int axis = 0; axis < 3; ++axis) {
            const int opposite = octant ^ 1 << axis;
            int inner = 0, outer;
            if (octant >> axis & 1) {
                inner = known >> opposite & 1;
                outer = level_.known[size_t(level_.neighbours[i][size_t(2 * axis + 1)])] >> opposite & 1;
            } else {
                outer = size_t(level_.neighbours[i][size_t(2 * axis)]) < level_.size();
            }
            beside = beside * 4 + 2 * inner + outer;
            nearby += inner + outer;
        }
        int distance = FAR, samples = 0;
        if (surface_) {
            samples = hints_[i].samples[octant];
            if (hints_[i].usable) distance = hints_[i].distance[octant];
        }
        contexts[0] = uint32_t(((octant * 4 + few) * 64 + beside) * 4 + filled_[i]);
        contexts[1] = uint32_t(narrow * 4 + few);
        contexts[2] = uint32_t((wide * 4 + few) * 16 + tall);
        contexts[3] = uint32_t(((distance * 5 + samples) * 4 + few) * 16 + tall);
        contexts[4] = uint32_t(((narrow * 7 + nearby) * 4 + few) * 8 + left);
    }

    void sum_weights(const int *octants, int count) {
        for (Hints &hints : hints_) {
            hints.narrow_left = hints.wide_left = 0;
            if (!hints.usable) continue;
            for (int place = 0; place < count; ++place) {
                hints.narrow_left += hints.narrow[octants[place]];
                hints.wide_left += hints.wide[octants[place]];
            }
        }
    }

    // Samples near the cubes of a level, and what they say about their children: octants 0, octant_step, 2 octant_step …
    void look_at_surface(int level, int octant_step) {
        surface_->attach(level_.places, level, level_.nearest);
        surface_->offsets(level_.places, level, level_.nearest, offset_, spread_);
        const int side_bits = surface_->child_bits(level);
        const int64_t side = surface_->child_size(level);
        hints_.assign(level_.size(), Hints{});
        for (size_t i = 0; i < level_.size(); ++i) {
            const int32_t row = level_.nearest[i];
            if (row < 0) continue;
            Hints &hints = hints_[i];
            hints.usable = 1;
            Place first;
            for (size_t d = 0; d < 3; ++d) first[d] = level_.places[i][d] * 2 * side + side / 2 - HALF_UNIT;
            const int64_t distance = surface_->distance(first, row) - offset_[i];
            int64_t step[3];
            for (size_t d = 0; d < 3; ++d) step[d] = wrapped_product(surface_->normal(row)[d], side) >> NORMAL_BITS;
            const int64_t deviation = std::max(spread_[i], side / 4);  // at least 4
            for (int octant = 0; octant < 8; octant += octant_step) {
                int64_t away = distance;
                for (int d = 0; d < 3; ++d) away += octant >> d & 1 ? step[d] : 0;
                const uint64_t magnitude = away < 0 ? -uint64_t(away) : uint64_t(away);
                const int kind = class_[std::min<uint64_t>(4 * magnitude >> side_bits, CLASSES - 1)];
                hints.distance[octant] = uint8_t(away < 0 ? FAR / 2 - kind : FAR / 2 + kind);
                // the quotient of floats is exact enough: integers below 2^52
                const double steps = double(magnitude) * BELL_PER_DEVIATION / double(deviation);
                hints.narrow[octant] = weight(steps);
                hints.wide[octant] = weight(steps / 2);
            }
        }
        if (2 * side > surface_->spacing()) count_samples(level);
    }

    // The normal density at a distance in steps of the table.
    uint16_t weight(double steps) const {
        return uint16_t(bell_[steps < BELL_STEPS ? int(steps) : BELL_STEPS]);
    }

    // Classes of how many samples the children of the cubes hold.
    void count_samples(int level) {
        const std::vector<uint64_t> codes = surface_->sample_codes(level + 1);
        size_t at = 0;
        for (size_t i = 0; i < level_.size(); ++i)
            for (uint64_t octant = 0; octant < 8; ++octant) {
                const uint64_t child = level_.codes[i] << 3 | octant;
                while (at < codes.size() && codes[at] < child) ++at;
                int count = 0;
                for (; at < codes.size() && codes[at] == child; ++at) ++count;
                for (int most : SAMPLE_STEPS) hints_[i].samples[octant] += count >= most;
            }
    }

    const int depth_;
    const Surface *surface_;
    const int32_t *bell_;
    int class_[CLASSES] = {};
    Level level_;
    std::vector<Hints> hints_;
    std::vector<int64_t> offset_, spread_;
    std::vector<uint8_t> filled_;
};

Tree tree_of(int depth, const Surface *surface, const Input<int32_t, 1> &bell) {
    if (bell.shape(0) != BELL_STEPS + 1 || depth < 0 || depth > 20 || (surface && surface->depth() != depth))
        throw std::invalid_argument("point_octree: a depth or a table of another size");
    return Tree(depth, surface, bell.data());
}

Output<int64_t> rows_of(const Level &level) {
    Fresh<int64_t> rows(level.size());
    std::copy(level.nearest.begin(), level.nearest.end(), rows.data.get());
    return rows.give({level.size()});
}

// The sample near each of the sorted distinct codes.
Output<int64_t> encode(bit_arrays::BitArrayEncoder &coder, Input<uint64_t, 1> codes, int depth, const Surface *surface,
                       Input<int32_t, 1> bell) {
    Tree tree = tree_of(depth, surface, bell);
    for (size_t i = 1; i < codes.shape(0); ++i)
        if (codes.data()[i] <= codes.data()[i - 1]) throw std::invalid_argument("point_octree: the codes are not sorted");
    if (!tree.code(coder, codes.data(), codes.shape(0)) || tree.points().size() != codes.shape(0))
        throw std::invalid_argument("point_octree: the codes are not those of a lattice");
    return rows_of(tree.points());
}

// (codes, samples, 0, 0), or (None, None, level, cubes of the level) of bytes that are no tree of this many points.
nb::tuple decode(bit_arrays::BitArrayDecoder &coder, size_t points, int depth, const Surface *surface,
                 Input<int32_t, 1> bell) {
    Tree tree = tree_of(depth, surface, bell);
    if (!tree.code(coder, nullptr, points))
        return nb::make_tuple(nb::none(), nb::none(), tree.failed_level, tree.failed_cubes);
    const Level &level = tree.points();
    Fresh<int64_t> codes(level.size());
    std::copy(level.codes.begin(), level.codes.end(), codes.data.get());
    return nb::make_tuple(codes.give({level.size()}), rows_of(level), 0, size_t(0));
}

}  // namespace

void bind_point_octree(nb::module_ &m) {
    nb::class_<Surface>(m, "OctreeSurface")
        .def(nb::init<Input<int64_t, 2>, Input<int64_t, 2>, Input<int64_t, 2>, int64_t, int, int64_t>());
    m.def("point_octree_encode", &encode, nb::arg(), nb::arg(), nb::arg(), nb::arg().none(), nb::arg());
    m.def("point_octree_decode", &decode, nb::arg(), nb::arg(), nb::arg(), nb::arg().none(), nb::arg());
}
