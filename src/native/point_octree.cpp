// Octree of lattice points, with contexts from the bodies' surface; codecs/bodycast/point_octree.py defines the results.
//
//     sorted Morton codes ─► level by level, octant by octant ─► occupancy bits with contexts ─► bit_arrays.h

#include "octree_coding.h"

namespace {

using namespace point_octree;

constexpr size_t BATCH = 32;  // cubes with contexts computed together

// Hints of the surface for the children of a level's cubes, octant by octant, and the remaining sums while octants are
// coded. For cubes far from the surface, all are 0, except `distance`, which is FAR.
struct Hints {
    std::array<std::vector<uint16_t>, 8> narrow, wide;     // weights of the children
    std::vector<int32_t> narrow_left, wide_left;           // sums over the octants not yet coded
    std::array<std::vector<uint8_t>, 8> distance, samples;  // classes
    std::vector<uint8_t> usable;                           // whether there is a surface near the cube

    void reset(size_t cubes) {
        cubes += BATCH;  // a batch may end beyond the last cube
        for (size_t octant = 0; octant < 8; ++octant) {
            narrow[octant].assign(cubes, 0);
            wide[octant].assign(cubes, 0);
            distance[octant].assign(cubes, FAR);
            samples[octant].assign(cubes, 0);
        }
        narrow_left.assign(cubes, 0);
        wide_left.assign(cubes, 0);
        usable.assign(cubes, 0);
    }
};

// The cubes of a level, their neighbours, known children and samples.
struct Level {
    std::vector<uint64_t> codes;
    std::vector<std::array<int32_t, 3>> places;
    // indices before and behind along every axis; size(): none
    std::array<std::vector<int32_t>, 6> neighbours;
    std::vector<uint8_t> known;  // occupied octants, with extra cubes that stay empty
    std::vector<int32_t> nearest;

    size_t size() const { return codes.size(); }
};

// Index of a cube's octant among the cubes of the next level; `end` if it is empty.
int32_t child_row(const std::vector<uint8_t> &masks, const std::vector<int32_t> &first, size_t parent, int octant,
                  int32_t end) {
    const unsigned mask = masks[parent];
    const int32_t row = first[parent] + bits_of(mask & ((1u << octant) - 1));
    return mask >> octant & 1 ? row : end;
}

// The cubes of the next level. is_last: it is the last level, which needs only codes and samples.
Level children_of(const Level &level, bool is_last) {
    std::vector<int32_t> first(level.size() + 1);
    int32_t end = 0;
    for (size_t i = 0; i < level.size(); ++i) {
        first[i] = end;
        end += bits_of(level.known[i]);
    }
    Level next;
    next.codes.resize(size_t(end));
    next.nearest.resize(size_t(end));
    if (!is_last) {
        next.places.resize(size_t(end));
        next.known.assign(size_t(end) + BATCH, 0);
        for (std::vector<int32_t> &rows : next.neighbours) rows.assign(size_t(end) + BATCH, end);
    }
    size_t row = 0;
    for (size_t i = 0; i < level.size(); ++i)
        for (unsigned mask = level.known[i]; mask; mask &= mask - 1) {
            const int octant = lowest_bit(mask);
            next.codes[row] = level.codes[i] << 3 | uint64_t(octant);
            next.nearest[row] = level.nearest[i];
            const size_t child = row++;
            if (is_last) continue;
            for (int axis = 0; axis < 3; ++axis) {
                const int bit = octant >> axis & 1;
                next.places[child][size_t(axis)] = 2 * level.places[i][size_t(axis)] + bit;
                for (int side = 0; side < 2; ++side) {
                    const size_t way = size_t(2 * axis + side);
                    const int32_t beside = level.neighbours[way][i];
                    const size_t parent = size_t(bit != side ? int32_t(i) : beside);
                    next.neighbours[way][child] = child_row(level.known, first, parent, octant ^ 1 << axis, end);
                }
            }
        }
    return next;
}

// Posteriors of an octant in a batch of cubes; subtracts its weights from the remaining sums. Float quotients are exact
// enough: numerators are below 2^19, quotients at most POSTERIORS.
class Posteriors {
public:
    void take(Hints &hints, size_t start, size_t octant) {
        take_share(hints.narrow[octant].data() + start, hints.narrow_left.data() + start, 0);
        take_share(hints.wide[octant].data() + start, hints.wide_left.data() + start, BATCH);
        const uint8_t *usable = hints.usable.data() + start;  // quotients are 0 far from the surface
        for (size_t k = 0; k < BATCH; ++k) narrow[k] = uint32_t(int32_t(above_[k] / below_[k]) + NO_HINT - NO_HINT * usable[k]);
        for (size_t k = 0; k < BATCH; ++k)
            wide[k] = uint32_t(int32_t(above_[BATCH + k] / below_[BATCH + k]) + NO_HINT - NO_HINT * usable[k]);
    }

    uint32_t narrow[BATCH], wide[BATCH];

private:
    void take_share(const uint16_t *weights, int32_t *left, size_t to) {
        for (size_t k = 0; k < BATCH; ++k) above_[to + k] = float(weights[k] * POSTERIORS);
        for (size_t k = 0; k < BATCH; ++k) below_[to + k] = float(left[k] + 1);
        for (size_t k = 0; k < BATCH; ++k) left[k] -= weights[k];
    }

    float above_[2 * BATCH], below_[2 * BATCH];
};

class Tree {
public:
    Tree(int depth, const Surface *surface, const int32_t *bell) : depth_(depth), surface_(surface), bell_(bell) {}

    // Codes a frame. codes: of the points, null in the decoder. Returns whether the bytes are a tree of `points`
    // points; if not, `failed_level` and `failed_cubes` say where.
    template <class Coder>
    bool code(Coder &coder, const uint64_t *codes, size_t points) {
        level_.codes = {0};
        level_.places = {{0, 0, 0}};
        for (std::vector<int32_t> &rows : level_.neighbours) rows.assign(1 + BATCH, 1);
        level_.known.assign(1 + BATCH, 0);
        level_.nearest = {NOWHERE};
        for (int level = 0; level < depth_; ++level) {
            std::vector<uint8_t> occupied;
            if (codes) occupied = occupancy(codes, points, level_.codes, depth_ - level - 1);
            if (surface_) look_at_surface(level, level == depth_ - 1 ? LATTICE_STEP : 1);
            code_level(coder, depth_ - level, codes ? occupied.data() : nullptr);
            if (is_cut_off(coder)) return false;
            const size_t cubes = occupied_octants(level_.known);
            if (!cubes || cubes > points) {
                failed_level = level + 1;
                failed_cubes = cubes;
                return false;
            }
            level_ = children_of(level_, level == depth_ - 1);
        }
        return true;
    }

    const Level &points() const { return level_; }

    int failed_level = 0;
    size_t failed_cubes = 0;

private:
    // height: levels from the cubes to the points. occupied: masks of the cubes, null in the decoder.
    template <class Coder>
    void code_level(Coder &coder, int height, const uint8_t *occupied) {
        static constexpr int ALL[] = {0, 1, 2, 3, 4, 5, 6, 7}, LATTICE[] = {0, 7};
        const int *octants = height == 1 ? LATTICE : ALL;
        const int count = height == 1 ? 2 : 8;
        const size_t cubes = level_.size();
        filled_.assign(cubes + BATCH, 0);
        before_.assign(cubes + BATCH, 0);
        for (size_t way = 0; way < 6; ++way) {
            const int32_t *rows = level_.neighbours[way].data(), end = int32_t(cubes);
            const uint8_t place = way % 2 ? 0 : uint8_t(1 << Masks::outer_bit(int(way / 2)));
            for (size_t i = 0; i < cubes; ++i) filled_[i] = uint8_t(filled_[i] + (rows[i] < end));
            for (size_t i = 0; place && i < cubes; ++i) before_[i] = uint8_t(before_[i] | (rows[i] < end ? place : 0));
        }
        for (uint8_t &filled : filled_) filled = std::min<uint8_t>(filled / 2, 3);
        if (surface_) sum_weights(octants, count);
        for (int place = 0; place < count; ++place) code_octant(coder, octants[place], count - place - 1, height, occupied);
    }

    // Codes one octant of all cubes; `left` octants follow. Contexts depend only on earlier octants, so a batch
    // computes its contexts first and prefetches the counters.
    template <class Coder>
    void code_octant(Coder &coder, int octant, int left, int height, const uint8_t *occupied) {
        Contexts of;
        uint8_t *known = level_.known.data();
        for (size_t start = 0; start < level_.size(); start += BATCH) {
            const size_t count = std::min(BATCH, level_.size() - start);
            set_contexts(of, start, octant, left, height);
            for (size_t k = 0; k < count; ++k) coder.fetch(of.counters[k]);
            uint8_t bits[BATCH];  // a copy: writing bytes of `known` would make the compiler reload everything
            for (size_t k = 0; k < count; ++k) {
                bits[k] = 1;
                if (left || known[start + k])
                    bits[k] = uint8_t(coder.code_with(of.counters[k], of.sets[k], occupied ? occupied[start + k] >> octant & 1 : 0));
            }
            for (size_t k = 0; k < count; ++k) known[start + k] = uint8_t(known[start + k] | bits[k] << octant);
        }
    }

    // Counters and weight sets for the bits of a batch.
    struct Contexts {
        uint32_t counters[BATCH][bits::INPUTS], sets[BATCH];
        uint32_t by_input[bits::INPUTS][BATCH];
    };

    // Computes the contexts of an octant in a batch, as counters, and the weight sets (table in
    // docs/payloads/bodycast-points.md). Compilers vectorise the simple loops.
    void set_contexts(Contexts &of, size_t start, int octant, int left, int height) {
        const uint32_t tall = uint32_t(std::min(height, 15)), set = uint32_t(std::min(height, 20) * 4);
        const uint8_t *known = level_.known.data(), *own = known + start, *filled = filled_.data() + start;
        uint32_t few[BATCH], beside[BATCH], nearby[BATCH];
        set_neighbours(beside, start, octant);
        for (size_t k = 0; k < BATCH; ++k) few[k] = MASKS.few[own[k]];
        for (size_t k = 0; k < BATCH; ++k) {
            const uint32_t pairs = (beside[k] & 0x15) + (beside[k] >> 1 & 0x15);
            nearby[k] = (pairs & 3) + (pairs >> 2 & 3) + (pairs >> 4);
        }
        for (size_t k = 0; k < BATCH; ++k) of.by_input[0][k] = ((uint32_t(octant) * 4 + few[k]) * 64 + beside[k]) * 4 + filled[k];
        if (surface_) {
            posteriors_.take(hints_, start, size_t(octant));
            const uint8_t *distance = hints_.distance[size_t(octant)].data() + start, *usable = hints_.usable.data() + start;
            const uint8_t *samples = hints_.samples[size_t(octant)].data() + start;
            for (size_t k = 0; k < BATCH; ++k) of.by_input[3][k] = ((distance[k] * 5u + samples[k]) * 4 + few[k]) * 16 + tall;
            for (size_t k = 0; k < BATCH; ++k) of.sets[k] = (set + few[k]) * 3 + 1 + usable[k];
        } else {
            std::fill_n(posteriors_.narrow, BATCH, NO_HINT);
            std::fill_n(posteriors_.wide, BATCH, NO_HINT);
            for (size_t k = 0; k < BATCH; ++k) of.by_input[3][k] = (FAR * 5u * 4 + few[k]) * 16 + tall;
            for (size_t k = 0; k < BATCH; ++k) of.sets[k] = (set + few[k]) * 3;
        }
        const uint32_t *narrow = posteriors_.narrow, *wide = posteriors_.wide;
        for (size_t k = 0; k < BATCH; ++k) of.by_input[1][k] = narrow[k] * 4 + few[k];
        for (size_t k = 0; k < BATCH; ++k) of.by_input[2][k] = (wide[k] * 4 + few[k]) * 16 + tall;
        for (size_t k = 0; k < BATCH; ++k) of.by_input[4][k] = ((narrow[k] * 7 + nearby[k]) * 4 + few[k]) * 8 + uint32_t(left);
        for (int i = 0; i < bits::INPUTS; ++i)
            for (size_t k = 0; k < BATCH; ++k) of.by_input[i][k] = bits::Mixer::counter_of(i, of.by_input[i][k]);
        for (size_t k = 0; k < BATCH; ++k)
            for (int i = 0; i < bits::INPUTS; ++i) of.counters[k][i] = of.by_input[i][k];
    }

    // Occupancy of the octants and cubes beside an octant in a batch: two bits for each axis.
    void set_neighbours(uint32_t *beside, size_t start, int octant) const {
        const uint8_t *known = level_.known.data();
        uint8_t is_before = 0;  // faces of the octant at the cube before
        for (int axis = 0; axis < 3; ++axis) is_before |= octant >> axis & 1 ? 0 : uint8_t(1 << Masks::outer_bit(axis));
        const uint8_t *inner = MASKS.inner[octant], *before = before_.data() + start;
        for (size_t k = 0; k < BATCH; ++k) beside[k] = uint32_t(inner[known[start + k]] | (before[k] & is_before));
        for (int axis = 0; axis < 3; ++axis) {
            if (!(octant >> axis & 1)) continue;
            const int32_t *behind = level_.neighbours[size_t(2 * axis + 1)].data() + start;
            const int opposite = octant ^ 1 << axis, place = Masks::outer_bit(axis);
            for (size_t k = 0; k < BATCH; ++k) beside[k] |= uint32_t(known[size_t(behind[k])] >> opposite & 1) << place;
        }
    }

    void sum_weights(const int *octants, int count) {
        for (int place = 0; place < count; ++place) {
            const size_t octant = size_t(octants[place]);
            for (size_t i = 0; i < level_.size(); ++i) hints_.narrow_left[i] += hints_.narrow[octant][i];
            for (size_t i = 0; i < level_.size(); ++i) hints_.wide_left[i] += hints_.wide[octant][i];
        }
    }

    // Finds the samples near the cubes of a level, and the hints for children 0, octant_step, 2 octant_step …
    void look_at_surface(int level, int octant_step) {
        surface_->attach(level_.places, level, level_.nearest);
        surface_->offsets(level_.places, level, level_.nearest, offset_, spread_);
        const int side_bits = surface_->child_bits(level);
        const int64_t side = surface_->child_size(level);
        hints_.reset(level_.size());
        for (size_t i = 0; i < level_.size(); ++i) {
            const int32_t row = level_.nearest[i];
            if (row < 0) continue;
            hints_.usable[i] = 1;
            Place first;
            for (size_t d = 0; d < 3; ++d) first[d] = level_.places[i][d] * 2 * side + side / 2 - HALF_UNIT;
            const int64_t distance = surface_->distance(first, row) - offset_[i];
            int64_t step[3];
            for (size_t d = 0; d < 3; ++d) step[d] = wrapped_product(surface_->normal(row)[d], side) >> NORMAL_BITS;
            const int64_t deviation = std::max(spread_[i], side / 4);  // at least 4
            const bool fits = is_small(distance) && is_small(step[0]) && is_small(step[1]) && is_small(step[2]);
            if (fits && deviation < LARGEST_DEVIATION)
                weigh_small(i, distance, step, deviation, side_bits, octant_step);
            else
                weigh(i, distance, step, deviation, side_bits, octant_step);
        }
        if (2 * side > surface_->spacing())
            classify_samples(*surface_, level_.codes, level, [&](size_t i, size_t octant, uint8_t kind) { hints_.samples[octant][i] = kind; });
    }

    // Limits of exact doubles: for numbers and their sums; for deviations, so that a quotient up to BELL_STEPS,
    // computed with a reciprocal that is larger by a factor 1 + 2^-50, rounds down to the exact integer.
    static constexpr int64_t LARGEST_NUMBER = int64_t(1) << 48, LARGEST_DEVIATION = int64_t(1) << 36;
    static bool is_small(int64_t value) { return value < LARGEST_NUMBER && value > -LARGEST_NUMBER; }

    // Hints for the children of cube i. distance: of the first child; step: change of the distance along each axis.
    void weigh_small(size_t i, int64_t distance, const int64_t *step, int64_t deviation, int side_bits, int octant_step) {
        const double x = double(step[0]), y = double(step[1]), z = double(step[2]), first = double(distance);
        const double away[8] = {first, first + x, first + y, first + x + y, first + z, first + x + z, first + y + z, first + x + y + z};
        const double per_deviation = BELL_PER_DEVIATION / double(deviation) * (1 + 1.0 / (int64_t(1) << 50));
        const double per_quarter = 4.0 / double(int64_t(1) << side_bits);
        double deviations[8], sides[8];
        for (int octant = 0; octant < 8; ++octant) {
            const double magnitude = std::abs(away[octant]), beyond = 2 * BELL_STEPS, last = CLASSES - 1;
            deviations[octant] = magnitude * per_deviation < beyond ? magnitude * per_deviation : beyond;
            sides[octant] = magnitude * per_quarter < last ? magnitude * per_quarter : last;
        }
        int32_t steps[8], quarters[8];
        for (int octant = 0; octant < 8; ++octant) steps[octant] = int32_t(deviations[octant]);
        for (int octant = 0; octant < 8; ++octant) quarters[octant] = int32_t(sides[octant]);
        for (int octant = 0; octant < 8; octant += octant_step) {
            const int kind = class_[size_t(quarters[octant])];
            hints_.distance[size_t(octant)][i] = uint8_t(away[octant] < 0 ? FAR / 2 - kind : FAR / 2 + kind);
            hints_.narrow[size_t(octant)][i] = uint16_t(bell_[std::min(steps[octant], BELL_STEPS)]);
            hints_.wide[size_t(octant)][i] = uint16_t(bell_[steps[octant] / 2]);
        }
    }

    // weigh_small without limits, for damaged files.
    void weigh(size_t i, int64_t distance, const int64_t *step, int64_t deviation, int side_bits, int octant_step) {
        for (int octant = 0; octant < 8; octant += octant_step) {
            int64_t away = distance;
            for (int d = 0; d < 3; ++d) away += octant >> d & 1 ? step[d] : 0;
            const uint64_t magnitude = away < 0 ? -uint64_t(away) : uint64_t(away);
            const int kind = class_[std::min<uint64_t>(4 * magnitude >> side_bits, CLASSES - 1)];
            hints_.distance[size_t(octant)][i] = uint8_t(away < 0 ? FAR / 2 - kind : FAR / 2 + kind);
            const double steps = double(magnitude) * BELL_PER_DEVIATION / double(deviation);
            hints_.narrow[size_t(octant)][i] = weight(steps);
            hints_.wide[size_t(octant)][i] = weight(steps / 2);
        }
    }

    // Normal density at a distance, in steps of the table.
    uint16_t weight(double steps) const {
        return uint16_t(bell_[steps < BELL_STEPS ? int(steps) : BELL_STEPS]);
    }

    const int depth_;
    const Surface *surface_;
    const int32_t *bell_;
    const std::array<int, CLASSES> class_ = distance_classes();
    Level level_;
    Hints hints_;
    Posteriors posteriors_;
    std::vector<int64_t> offset_, spread_;
    std::vector<uint8_t> filled_, before_;  // classes of the number of neighbours; context bits of the cubes before
};

}  // namespace

void bind_point_octree(nb::module_ &m) {
    nb::class_<Surface>(m, "OctreeSurface")
        .def(nb::init<Input<int64_t, 2>, Input<int64_t, 2>, Input<int64_t, 2>, int64_t, int, int64_t>());
    OctreeFunctions<Tree>::bind(m, "point_octree");
}
