// Octree of lattice points cube by cube, for codecs/bodycast/cube_octree.py, which defines the results. Integers only.
//
//     centres of the cubes around ─► estimated surface in a cube ─► expected points of its children ─► bits
//           ▲ centre of its children ◄────────────────────────────────────────────────────────────────┘

#include <cstring>
#include <optional>
#include <type_traits>

#include "near_cubes.h"
#include "octree_coding.h"

namespace {

using namespace point_octree;

constexpr int64_t LARGEST_SPACING = 1 << 16, LARGEST_DISTANCE = 1 << 25, LARGEST_DEVIATION = 1 << 20;
constexpr int64_t USUAL_WEIGHT = 1024, LEAST_VARIANCE = 16;
constexpr int64_t DENSITY = 1634, LARGEST_DENSITY = 1 << 24, MOST_EXPECTED = 1 << 19, TWO = 2 << 16;
constexpr int64_t BEYOND = int64_t(1) << 40;  // all classes and weights are equal beyond this distance
constexpr int LEAST_ODDS = 16;

// The bits of each number from 0 to 255 as bytes, the lowest first.
struct BytesOfBits {
    uint64_t of[256] = {};
    constexpr BytesOfBits() {
        for (int mask = 0; mask < 256; ++mask)
            for (int bit = 0; bit < 8; ++bit) of[mask] |= uint64_t(mask >> bit & 1) << 8 * bit;
    }
};

constexpr BytesOfBits BYTES;

// The cubes of a level. neighbours: indices before and behind along every axis; size(): none. known: occupied octants,
// with one extra cube that stays empty.
struct Cubes {
    std::vector<uint64_t> codes{0};
    std::vector<std::array<int32_t, 3>> places{{0, 0, 0}};
    std::vector<std::array<int32_t, 6>> neighbours{{1, 1, 1, 1, 1, 1}};
    std::vector<uint8_t> known{0, 0};
    std::vector<int32_t> nearest{NOWHERE};
    std::vector<int32_t> first;  // of each cube of the level above, the first child

    size_t size() const { return codes.size(); }

    // The cubes of the next level, in the memory of other cubes. is_last: there is none after it, so only codes and samples are needed.
    void find_next(Cubes &below, bool is_last) const {
        const size_t count = occupied_octants(known);
        const int32_t end = int32_t(count);
        below.first.resize(size() + 1);
        for (size_t i = 0, row = 0; i < size(); row += size_t(bits_of(known[i])), ++i) below.first[i] = int32_t(row);
        below.codes.resize(count);
        below.nearest.resize(count);
        below.places.resize(is_last ? 0 : count);
        below.neighbours.resize(is_last ? 0 : count);
        below.known.assign(count + 1, 0);
        size_t row = 0;
        for (size_t i = 0; i < size(); ++i)
            for (unsigned left = known[i]; left; left &= left - 1, ++row) {
                const int octant = lowest_bit(left);
                below.codes[row] = codes[i] << 3 | uint64_t(octant);
                below.nearest[row] = nearest[i];
                if (is_last) continue;
                for (int axis = 0; axis < 3; ++axis) {
                    const int bit = octant >> axis & 1, other = octant ^ 1 << axis;
                    below.places[row][size_t(axis)] = 2 * places[i][size_t(axis)] + bit;
                    for (int side = 0; side < 2; ++side) {
                        const size_t parent = bit != side ? i : size_t(neighbours[i][size_t(2 * axis + side)]);
                        const unsigned mask = known[parent];
                        below.neighbours[row][size_t(2 * axis + side)] =
                            mask >> other & 1 ? below.first[parent] + bits_of(mask & ((1u << other) - 1)) : end;
                    }
                }
            }
    }
};

// Contexts of the children of a cube that can be occupied: classes of their odds while no octant is known to be
// occupied [0], and when one is [1]; classes of their distances.
struct Expected {
    uint8_t narrow[2][8], wide[2][8], distance[8];
};

// Where the surface passes a cube: its distance from the plane of the cube's sample, and the variance.
struct SurfaceInCube {
    int64_t offset, variance;
};

// Estimates the surface within the cubes of a level. Lengths are in subunits.
class Passage {
public:
    // near: of the surface, for the levels of a frame one after the other.
    Passage(const Surface &surface, const Cubes &cubes, NearCubes &near, int level, size_t points, const int32_t *bell)
        : surface_(surface), cubes_(cubes), near_(near), bell_(bell), side_(surface.child_size(level)),
          side_bits_(surface.child_bits(level)), spacing_(std::min(surface.spacing(), LARGEST_SPACING)),
          far_(cubes.size(), 0), shown_by_(cubes.size(), NOWHERE), samples_(cubes.size()) {
        int64_t known = 0, sum = 0;
        for (size_t i = 0; i < cubes.size(); ++i) {
            if (cubes.nearest[i] < 0) continue;
            far_[i] = std::clamp(surface.distance(centre(i), cubes.nearest[i]), -LARGEST_DISTANCE, LARGEST_DISTANCE);
            ++known;
            sum += std::abs(far_[i]);
        }
        if (known) {
            usual_ = sum / known;
            const int64_t across = side_ * 256 / spacing_;
            const int64_t samples = int64_t(surface.size());
            density_ = std::min(int64_t(points) * DENSITY * across * across / (samples * 16), LARGEST_DENSITY);
            fill_tables();
            find_shown();
        }
        if (2 * side_ > surface.spacing())
            classify_samples(surface, cubes.codes, level, [&](size_t i, size_t octant, uint8_t kind) { samples_[i][octant] = kind; });
    }

    // Distance from the plane of cube i's sample to the estimated surface, and its variance. The cube has a sample.
    SurfaceInCube find_surface(size_t i) const {
        SurfaceAround around;
        if (!near_.find(cubes_.nearest[i], centre(i), far_[i], around)) around = distant_surface(i);
        const int64_t spread = USUAL_WEIGHT * usual_ + around.spread;
        const int64_t deviation = std::min(floor_quotient(spread, around.total + USUAL_WEIGHT), LARGEST_DEVIATION);
        return {around.offset, std::max((166 * deviation * deviation >> 8) - 4 * side_ * side_ / 20, LEAST_VARIANCE)};
    }

    // Contexts of the `COUNT` children (8, or 2 on the last level) of cube i, from the surface in it.
    template <int COUNT>
    void expect(size_t i, const SurfaceInCube &surface, Expected &of) const {
        const int64_t variance = surface.variance;
        double away[COUNT], magnitudes[COUNT], sides[COUNT], odds[2][COUNT];
        find_distances<COUNT>(i, cubes_.nearest[i], surface.offset, away);
        const double per_quarter = 4.0 / double(side_), last = CLASSES - 1;
        for (int k = 0; k < COUNT; ++k) magnitudes[k] = std::abs(away[k]);
        for (int k = 0; k < COUNT; ++k) sides[k] = magnitudes[k] * per_quarter < last ? magnitudes[k] * per_quarter : last;
        int32_t quarters[COUNT];
        for (int k = 0; k < COUNT; ++k) quarters[k] = int32_t(sides[k]);
        for (int k = 0; k < COUNT; ++k) {
            const int steps = steps_[size_t(quarters[k])];
            of.distance[k] = uint8_t(away[k] < 0 ? FAR / 2 - steps : FAR / 2 + steps);
        }
        const int64_t cut = 4 * side_ * side_ / 48;
        find_odds<COUNT>(magnitudes, root(variance + cut), odds);
        classify<COUNT>(odds, of.narrow);
        find_odds<COUNT>(magnitudes, root(3 * variance + cut), odds);
        classify<COUNT>(odds, of.wide);
    }

    // Updates the estimate with the occupied children of cube i.
    void learn(size_t i) {
        const int32_t row = shown_by_[i];
        if (row < 0) return;
        static constexpr unsigned UPPER[] = {0xAA, 0xCC, 0xF0};
        const unsigned known = cubes_.known[i];
        Shown &shown = shown_[size_t(row)];
        shown.children = bits_of(known);
        for (size_t d = 0; d < 3; ++d)
            shown.place[d] = corner_of(cubes_.places[i][d]) + share_[size_t(shown.children)][size_t(bits_of(known & UPPER[d]))];
        near_.put(size_t(row), size_t(cubes_.nearest[i]), shown.place, least_[size_t(shown.children)]);
    }

    // Classes of the numbers of samples in the children of cube i.
    const std::array<uint8_t, 8> &samples(size_t i) const { return samples_[i]; }

private:
    // A cube's observation of the surface: its centre, or that of its children if some are known.
    struct Shown {
        std::array<int32_t, 3> place;
        int32_t children;
        Place normal;  // normal of the cube's sample
    };

    Place centre(size_t i) const { return Surface::centre_of(cubes_.places[i], 2 * side_); }

    // The centre of the first child along an axis.
    int32_t corner_of(int32_t place) const { return int32_t(place * 2 * side_ + side_ / 2 - HALF_UNIT); }

    // Selects at most CUBES_OF_SAMPLE cubes of each sample, sample by sample.
    void find_shown() {
        std::vector<int32_t> first(surface_.size() + 1, 0);
        for (int32_t s : cubes_.nearest)
            if (s >= 0) ++first[size_t(s) + 1];
        for (size_t s = 0; s < surface_.size(); ++s) first[s + 1] += first[s];
        std::vector<int32_t> rows(size_t(first.back())), next(first.begin(), first.end() - 1);
        for (size_t i = 0; i < cubes_.size(); ++i)
            if (cubes_.nearest[i] >= 0) rows[size_t(next[size_t(cubes_.nearest[i])]++)] = int32_t(i);
        first_shown_.assign(surface_.size() + 1, 0);
        for (size_t s = 0; s < surface_.size(); ++s)
            first_shown_[s + 1] = first_shown_[s] + std::min(first[s + 1] - first[s], CUBES_OF_SAMPLE);
        near_.start_level(side_, spacing_);
        shown_.reserve(size_t(first_shown_.back()));
        for (size_t s = 0; s < surface_.size(); ++s) {
            const int32_t count = first[s + 1] - first[s], kept = first_shown_[s + 1] - first_shown_[s];
            for (int32_t k = 0; k < kept; ++k) {
                const size_t i = size_t(rows[size_t(first[s] + int64_t(k) * count / kept)]);
                const Place at = centre(i);
                shown_by_[i] = int32_t(shown_.size());
                shown_.push_back({{int32_t(at[0]), int32_t(at[1]), int32_t(at[2])}, 0, surface_.normal(int32_t(s))});
                near_.add(s, shown_.back().place, least_[0]);
            }
        }
    }

    // share_[count][upper]: shift of the centre of `count` children with `upper` of them in the upper half.
    // least_[count]: constant part of a weight's denominator, by the number of children.
    void fill_tables() {
        for (int64_t count = 1; count <= 8; ++count)
            for (int64_t upper = 0; upper <= count; ++upper) share_[size_t(count)][size_t(upper)] = int32_t(upper * side_ / count);
        for (int64_t count = 0; count <= 8; ++count) {
            const int64_t noise = count ? 4 * side_ * side_ / (6 * count) : 4 * side_ * side_;
            least_[size_t(count)] = 10 * spacing_ * spacing_ + 64 * noise + 1;
        }
    }

    // Finds the observations of the cubes of a sample and of its neighbours; returns their number. Writes
    // CUBES_OF_SAMPLE rows for each sample, which avoids an unpredictable branch.
    int find_rows(int32_t own, int32_t *rows) const {
        const int32_t *around = surface_.around(own), *first = first_shown_.data();
        int count = 0;
        const auto add = [&](int32_t sample, bool is_used) {
            for (int k = 0; k < CUBES_OF_SAMPLE; ++k) rows[count + k] = first[sample] + k;
            count += is_used ? first[sample + 1] - first[sample] : 0;
        };
        add(own, true);
        for (int k = 0; k < NEIGHBOURS; ++k) add(around[k], around[k] != own);
        return count;
    }

    // What is around cube i, wherever that lies.
    SurfaceAround distant_surface(size_t i) const {
        constexpr int MOST = (NEIGHBOURS + 1) * CUBES_OF_SAMPLE;
        int32_t rows[MOST + CUBES_OF_SAMPLE];
        const int32_t own = cubes_.nearest[i];
        const int count = find_rows(own, rows);
        int64_t away[MOST];
        double below[MOST];
        const Place at = centre(i), normal = surface_.normal(own);
        const int64_t far = far_[i];
        const Shown *shown = shown_.data();
        for (int n = 0; n < count; ++n) {
            const Shown &other = shown[rows[n]];
            const int64_t a = other.place[0] - at[0], b = other.place[1] - at[1], c = other.place[2] - at[2];
            const int64_t along = a * (normal[0] + other.normal[0]) + b * (normal[1] + other.normal[1]) + c * (normal[2] + other.normal[2]);
            below[n] = double(13 * (a * a + b * b + c * c) + least_[size_t(other.children)]);
            away[n] = far + (along >> (NORMAL_BITS + 1));
        }
        const double above = double(spacing_ * spacing_ << 16);  // below 2^49, so float quotients are exact enough
        int32_t weights[MOST];
        for (int n = 0; n < count; ++n) weights[n] = int32_t(above / below[n]);
        int64_t total = 0, sum = 0, spread = 0;
        for (int n = 0; n < count; ++n) {
            total += weights[n];
            sum += weights[n] * away[n];
        }
        const int64_t offset = floor_quotient(sum, total + SAMPLE_WEIGHT);
        for (int n = 0; n < count; ++n) spread += weights[n] * std::abs(away[n] - offset);
        return {total, offset, spread};
    }

    // The distances of the children from the surface, at most BEYOND.
    template <int COUNT>
    void find_distances(size_t i, int32_t own, int64_t offset, double *away) const {
        Place first;
        for (size_t d = 0; d < 3; ++d) first[d] = corner_of(cubes_.places[i][d]);
        const int64_t distance = surface_.distance(first, own) - offset;
        int64_t steps[3];
        for (size_t d = 0; d < 3; ++d) steps[d] = wrapped_product(surface_.normal(own)[d], side_) >> NORMAL_BITS;
        const auto is_near = [](int64_t value) { return value > -BEYOND / 4 && value < BEYOND / 4; };
        if (is_near(distance) && is_near(steps[0]) && is_near(steps[1]) && is_near(steps[2])) {
            const double x = double(steps[0]), y = double(steps[1]), z = double(steps[2]), from = double(distance);
            if (COUNT == 8)
                for (int k = 0; k < COUNT; ++k) away[k] = from + (k & 1 ? x : 0) + (k & 2 ? y : 0) + (k & 4 ? z : 0);
            else
                away[0] = from, away[COUNT - 1] = from + x + y + z;
            return;
        }
        for (int k = 0; k < COUNT; ++k) {
            const int octant = COUNT == 8 ? k : k * LATTICE_STEP;
            int64_t sum = distance;
            for (int d = 0; d < 3; ++d) sum += octant >> d & 1 ? steps[d] : 0;
            away[k] = double(std::clamp(sum, -BEYOND, BEYOND));
        }
    }

    // Odds of each child while no octant is known to be occupied [0], and when one is [1], for a standard deviation.
    // Floats hold exact integers below 2^48.
    template <int COUNT>
    void find_odds(const double *magnitudes, int64_t sigma, double (*odds)[COUNT]) const {
        const uint32_t most = uint32_t(std::min(density_ * side_ / (sigma * 256), MOST_EXPECTED));
        // Larger by a factor 1 + 2^-50, so that rounding down keeps quotients that are integers.
        const double per_deviation = BELL_PER_DEVIATION / double(sigma) * (1 + 1.0 / (int64_t(1) << 50)), last = BELL_STEPS;
        double steps[COUNT], expected[COUNT], others[COUNT];
        int32_t bells[COUNT], whole[COUNT];
        for (int k = 0; k < COUNT; ++k) steps[k] = magnitudes[k] * per_deviation < last ? magnitudes[k] * per_deviation : last;
        for (int k = 0; k < COUNT; ++k) bells[k] = int32_t(steps[k]);
        for (int k = 0; k < COUNT; ++k) whole[k] = int32_t(most * uint32_t(bell_[bells[k]]) >> 12) + 1;
        for (int k = 0; k < COUNT; ++k) expected[k] = double(whole[k]);
        others[COUNT - 1] = 0;
        for (int k = COUNT - 1; k > 0; --k) others[k - 1] = others[k] + expected[k];
        for (int k = 0; k < COUNT; ++k) whole[k] = int32_t(expected[k] * (TWO + expected[k]) * (1.0 / TWO));
        for (int k = 0; k < COUNT; ++k) odds[1][k] = double(whole[k]) * 256;
        for (int k = 0; k < COUNT; ++k) {
            const double alone = odds[1][k] * 0.5 * (TWO + others[k]) / others[k];
            odds[0][k] = others[k] < TWO ? alone : odds[1][k];
        }
    }

    // Classes of odds: the binary exponent and the next two bits.
    template <int COUNT>
    static void classify(double (*odds)[COUNT], uint8_t (*classes)[8]) {
        for (int is_known = 0; is_known < 2; ++is_known)
            for (int k = 0; k < COUNT; ++k) {
                uint64_t digits;
                std::memcpy(&digits, &odds[is_known][k], sizeof digits);
                const int64_t kind = int64_t(digits >> 50) - 4 * (1023 + LEAST_ODDS);
                classes[is_known][k] = uint8_t(std::clamp<int64_t>(kind, 0, NO_HINT - 1));
            }
    }

    // Square root of an integer below 2^52, rounded down.
    static int64_t root(int64_t square) { return int64_t(std::sqrt(double(square))); }

    const Surface &surface_;
    const Cubes &cubes_;
    NearCubes &near_;
    const int32_t *bell_;
    const int64_t side_;
    const int side_bits_;
    const int64_t spacing_;
    std::vector<int64_t> far_;
    std::vector<int32_t> shown_by_, first_shown_;  // observation of each cube, or NOWHERE; first observation of each sample
    std::vector<Shown> shown_;
    std::vector<std::array<uint8_t, 8>> samples_;
    int64_t usual_ = 0, density_ = 0, least_[9] = {};
    std::array<std::array<int32_t, 9>, 9> share_{};
    const std::array<int, CLASSES> steps_ = distance_classes();
};

// What the contexts of a cube's bits are made of. around: for each octant, of the cubes beside; filled: class of the number of these.
struct CubeContexts {
    Expected expected;
    std::array<uint8_t, 8> samples;
    uint8_t around[8];
    int filled, tall, first_set;  // of the weight sets
};

struct Bit {
    uint32_t counters[bits::INPUTS], set;
    int is_occupied;
};

class Tree {
public:
    Tree(int depth, const Surface *surface, const int32_t *bell) : depth_(depth), surface_(surface), bell_(bell) {
        if (surface) near_.emplace(*surface);
    }

    // Codes a frame. codes: of the points, null in the decoder. Returns whether the bytes are a tree of `points`
    // points; if not, `failed_level` and `failed_cubes` say where.
    template <class Coder>
    bool code(Coder &coder, const uint64_t *codes, size_t points) {
        for (int level = 0; level < depth_; ++level) {
            std::vector<uint8_t> occupied;
            if (codes) occupied = occupancy(codes, points, cubes_.codes, depth_ - level - 1);
            code_level(coder, level, points, codes ? occupied.data() : nullptr);
            if (is_cut_off(coder)) return false;
            const size_t count = occupied_octants(cubes_.known);
            if (!count || count > points) {
                failed_level = level + 1;
                failed_cubes = count;
                return false;
            }
            cubes_.find_next(below_, level == depth_ - 1);
            std::swap(cubes_, below_);
        }
        return true;
    }

    const Cubes &points() const { return cubes_; }

    int failed_level = 0;
    size_t failed_cubes = 0;

private:
    template <class Coder>
    void code_level(Coder &coder, int level, size_t points, const uint8_t *occupied) {
        if (level == depth_ - 1)
            code_cubes<2>(coder, level, points, occupied);
        else
            code_cubes<8>(coder, level, points, occupied);
    }

    // COUNT: number of octants of a cube that can be occupied.
    template <int COUNT, class Coder>
    void code_cubes(Coder &coder, int level, size_t points, const uint8_t *occupied) {
        std::optional<Passage> passage;
        if (surface_) {
            surface_->attach(cubes_.places, level, cubes_.nearest);
            passage.emplace(*surface_, cubes_, *near_, level, points, bell_);
        }
        Passage *const known = passage ? &*passage : nullptr;
        if constexpr (std::is_same_v<Coder, bit_arrays::BitArrayEncoder>)
            encode_cubes<COUNT>(coder, level, known, occupied);
        else
            for (size_t i = 0; i < cubes_.size(); ++i) decode_cube<COUNT>(coder, i, level, known);
    }

    // The encoder knows all bits. So it takes each step for many cubes, which need not wait for one another.
    template <int COUNT>
    void encode_cubes(bit_arrays::BitArrayEncoder &coder, int level, Passage *passage, const uint8_t *occupied) {
        SurfaceInCube surfaces[BATCH];
        CubeContexts contexts[BATCH];
        Bit bits[BATCH * COUNT];
        for (size_t first = 0; first < cubes_.size(); first += BATCH) {
            const size_t count = std::min(BATCH, cubes_.size() - first);
            for (size_t k = 0; k < count; ++k) {
                cubes_.known[first + k] = possible<COUNT>(occupied[first + k]);
                if (!has_surface(passage, first + k)) continue;
                surfaces[k] = passage->find_surface(first + k);
                passage->learn(first + k);
            }
            for (size_t k = 0; k < count; ++k) find_contexts<COUNT>(first + k, level, passage, surfaces[k], contexts[k]);
            Bit *end = bits;
            for (size_t k = 0; k < count; ++k) {
                const unsigned all = cubes_.known[first + k];
                unsigned known = 0;
                for (int place = 0; place < COUNT && !is_certain<COUNT>(place, known); ++place) {
                    const unsigned octant = 1u << octant_of<COUNT>(place);
                    find_bit<COUNT>(contexts[k], place, known, *end);
                    end->is_occupied = (all & octant) != 0;
                    coder.fetch(end++->counters);
                    known |= all & octant;
                }
            }
            for (const Bit *bit = bits; bit < end; ++bit) coder.code_with(bit->counters, bit->set, bit->is_occupied);
        }
    }

    template <int COUNT>
    void decode_cube(bit_arrays::BitArrayDecoder &coder, size_t i, int level, Passage *passage) {
        CubeContexts contexts;
        const bool is_near = has_surface(passage, i);
        find_contexts<COUNT>(i, level, passage, is_near ? passage->find_surface(i) : SurfaceInCube{}, contexts);
        Bit next[2];  // after a 0 and after a 1
        const auto fetch = [&](int place, int bit, unsigned known) {
            find_bit<COUNT>(contexts, place, known, next[bit]);
            coder.fetch(next[bit].counters);
        };
        unsigned known = 0;
        int bit = 0;
        fetch(0, 0, 0);
        for (int place = 0; place < COUNT; ++place) {
            const int octant = octant_of<COUNT>(place);
            if (is_certain<COUNT>(place, known)) {
                known = 1u << octant;
                break;
            }
            const Bit own = next[bit];
            if (place < COUNT - 1) {
                fetch(place + 1, 0, known);
                fetch(place + 1, 1, known | 1u << octant);
            }
            bit = coder.code_with(own.counters, own.set, 0);
            known |= unsigned(bit) << octant;
        }
        cubes_.known[i] = uint8_t(known);
        if (is_near) passage->learn(i);
    }

    bool has_surface(const Passage *passage, size_t i) const { return passage && cubes_.nearest[i] >= 0; }

    template <int COUNT>
    static int octant_of(int place) {
        return COUNT == 8 ? place : place * LATTICE_STEP;
    }

    // The octants of these that can be occupied, at least one.
    template <int COUNT>
    static uint8_t possible(unsigned octants) {
        const unsigned left = COUNT == 8 ? octants : octants & (1u | 1u << LATTICE_STEP);
        return uint8_t(left ? left : 1u << LATTICE_STEP);
    }

    // Whether the octant at this place is occupied since no other is.
    template <int COUNT>
    static bool is_certain(int place, unsigned known) {
        return place == COUNT - 1 && !known;
    }

    // surface: in cube i if it has a sample. passage: null without a surface.
    template <int COUNT>
    void find_contexts(size_t i, int level, const Passage *passage, const SurfaceInCube &surface, CubeContexts &of) const {
        const bool is_near = has_surface(passage, i);
        if (is_near) {
            passage->expect<COUNT>(i, surface, of.expected);
        } else {
            std::memset(&of.expected, NO_HINT, sizeof of.expected);
            std::memset(of.expected.distance, FAR, sizeof of.expected.distance);
        }
        of.samples = passage ? passage->samples(i) : std::array<uint8_t, 8>{};
        of.filled = find_neighbours(i, of.around);
        const int height = depth_ - level;
        of.tall = std::min(height, 15);
        of.first_set = std::min(height, 20) * 12 + (passage ? 1 + is_near : 0);
    }

    // The bit at a place of a cube, where octants are known to be occupied.
    template <int COUNT>
    static void find_bit(const CubeContexts &of, int place, unsigned known, Bit &bit) {
        const int octant = octant_of<COUNT>(place), few = MASKS.few[known], left = COUNT - 1 - place;
        const int narrow = of.expected.narrow[few > 0][place], wide = of.expected.wide[few > 0][place];
        const int beside = of.around[octant] | MASKS.inner[octant][known], nearby = bits_of(unsigned(beside));
        const uint32_t contexts[bits::INPUTS] = {
            uint32_t(((octant * 4 + few) * 64 + beside) * 4 + of.filled),
            uint32_t(narrow * 4 + few),
            uint32_t((wide * 4 + few) * 16 + of.tall),
            uint32_t(((of.expected.distance[place] * 5 + of.samples[size_t(octant)]) * 4 + few) * 16 + of.tall),
            uint32_t(((narrow * 7 + nearby) * 4 + few) * 8 + left),
        };
        bits::Mixer::counters_of(contexts, bit.counters);
        bit.set = uint32_t(of.first_set + 3 * few);
    }

    // around (8): for each octant, the context from the cubes beside cube i. Returns the class of their number.
    int find_neighbours(size_t i, uint8_t *around) const {
        static constexpr unsigned LOWER[] = {0x55, 0x33, 0x0F};
        const std::array<int32_t, 6> &rows = cubes_.neighbours[i];
        const int32_t end = int32_t(cubes_.size());
        int filled = 0;
        uint64_t all = 0;  // one byte for each octant
        for (int axis = 0; axis < 3; ++axis) {
            const int32_t before = rows[size_t(2 * axis)], behind = rows[size_t(2 * axis + 1)];
            const unsigned outer = (before < end ? LOWER[axis] : 0) | (behind < end ? 255 - LOWER[axis] : 0);
            const unsigned inner = cubes_.known[size_t(before)] >> (1 << axis) & LOWER[axis];
            filled += (before < end) + (behind < end);
            all |= (BYTES.of[outer] | BYTES.of[inner] << 1) << Masks::outer_bit(axis);
        }
        for (int octant = 0; octant < 8; ++octant) around[octant] = uint8_t(all >> 8 * octant);
        return std::min(filled / 2, 3);
    }

    static constexpr size_t BATCH = 32;

    const int depth_;
    const Surface *surface_;
    const int32_t *bell_;
    std::optional<NearCubes> near_;
    Cubes cubes_, below_;  // of a level, and of the next one while it is made
};

}  // namespace

void bind_cube_octree(nb::module_ &m) { OctreeFunctions<Tree>::bind(m, "cube_octree"); }
