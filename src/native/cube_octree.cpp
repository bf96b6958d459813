// Octree of lattice points cube by cube, for codecs/bodycast/cube_octree.py, which defines the results. Integers only.
//
//     centres of the cubes around ─► where the surface passes a cube ─► expected points of its children ─► bits
//           ▲ centre of its children ◄────────────────────────────────────────────────────────────────┘

#include <cstring>

#include "octree_coding.h"

namespace {

using namespace point_octree;

constexpr int CUBES_OF_SAMPLE = 4;
constexpr int64_t LARGEST_SPACING = 1 << 16, LARGEST_DISTANCE = 1 << 25, LARGEST_DEVIATION = 1 << 20;
constexpr int64_t SAMPLE_WEIGHT = 5120, USUAL_WEIGHT = 1024, LEAST_VARIANCE = 16;
constexpr int64_t DENSITY = 1634, LARGEST_DENSITY = 1 << 24, MOST_EXPECTED = 1 << 19, TWO = 2 << 16;
constexpr int LEAST_ODDS = 16;

// The root of an integer below 2^52, rounded down.
int64_t root(int64_t square) { return int64_t(std::sqrt(double(square))); }

// The cubes of a level. neighbours: rows before and behind along every axis, the number of cubes if empty. known: occupied
// octants; one cube more, which stays empty.
struct Cubes {
    std::vector<uint64_t> codes{0};
    std::vector<std::array<int32_t, 3>> places{{0, 0, 0}};
    std::vector<std::array<int32_t, 6>> neighbours{{1, 1, 1, 1, 1, 1}};
    std::vector<uint8_t> known{0, 0};
    std::vector<int32_t> nearest{NOWHERE};

    size_t size() const { return codes.size(); }

    // The cubes of the next level.
    Cubes next() const {
        const int32_t end = int32_t(occupied_octants(known));
        std::vector<int32_t> first(size() + 1, 0);
        for (size_t i = 0; i < size(); ++i) first[i + 1] = first[i] + bits_of(known[i]);
        Cubes below;
        below.codes.resize(size_t(end));
        below.places.resize(size_t(end));
        below.neighbours.resize(size_t(end));
        below.nearest.resize(size_t(end));
        below.known.assign(size_t(end) + 1, 0);
        size_t row = 0;
        for (size_t i = 0; i < size(); ++i)
            for (int octant = 0; octant < 8; ++octant) {
                if (!(known[i] >> octant & 1)) continue;
                below.codes[row] = codes[i] << 3 | uint64_t(octant);
                below.nearest[row] = nearest[i];
                for (int axis = 0; axis < 3; ++axis) {
                    const int bit = octant >> axis & 1, other = octant ^ 1 << axis;
                    below.places[row][size_t(axis)] = 2 * places[i][size_t(axis)] + bit;
                    for (int side = 0; side < 2; ++side) {
                        const size_t parent = bit != side ? i : size_t(neighbours[i][size_t(2 * axis + side)]);
                        const unsigned mask = known[parent];
                        below.neighbours[row][size_t(2 * axis + side)] =
                            mask >> other & 1 ? first[parent] + bits_of(mask & ((1u << other) - 1)) : end;
                    }
                }
                ++row;
            }
        return below;
    }
};

// Where the surface passes the cubes of a level. Lengths are in subunits.
class Passage {
public:
    int64_t distances[8] = {}, narrow[8] = {}, wide[8] = {};  // of the children of the last cube

    Passage(const Surface &surface, const Cubes &cubes, int level, size_t points, const int32_t *bell)
        : surface_(surface), cubes_(cubes), bell_(bell), side_(surface.child_size(level)),
          side_bits_(surface.child_bits(level)),
          spacing_(std::min(surface.spacing(), LARGEST_SPACING)), centres_(cubes.size()),
          noise_(cubes.size(), 4 * side_ * side_), far_(cubes.size(), 0), samples_(cubes.size()), held_(surface.size()) {
        int64_t known = 0, sum = 0;
        for (size_t i = 0; i < cubes.size(); ++i) {
            centres_[i] = Surface::centre_of(cubes.places[i], 2 * side_);
            samples_[i].fill(0);
            if (cubes.nearest[i] < 0) continue;
            far_[i] = std::clamp(surface.distance(centres_[i], cubes.nearest[i]), -LARGEST_DISTANCE, LARGEST_DISTANCE);
            ++known;
            sum += std::abs(far_[i]);
        }
        places_ = centres_;
        if (known) {
            usual_ = sum / known;
            const int64_t across = side_ * 256 / spacing_;
            const int64_t samples = int64_t(surface.size());
            density_ = std::min(int64_t(points) * DENSITY * across * across / (samples * 16), LARGEST_DENSITY);
            find_cubes_of_samples();
        }
        if (2 * side_ > surface.spacing())
            classify_samples(surface, cubes.codes, level, [&](size_t i, size_t octant, uint8_t kind) { samples_[i][octant] = kind; });
    }

    // Sets what is expected of the children of cube i, which has a sample: octants 0, octant_step, 2 octant_step …
    void expect(size_t i, int octant_step) {
        const int32_t own = cubes_.nearest[i];
        int64_t offset, variance;
        find_surface(i, offset, variance);
        Place first;
        for (size_t d = 0; d < 3; ++d) first[d] = cubes_.places[i][d] * 2 * side_ + side_ / 2 - HALF_UNIT;
        const int64_t distance = surface_.distance(first, own) - offset;
        int64_t steps[3];
        for (size_t d = 0; d < 3; ++d) steps[d] = wrapped_product(surface_.normal(own)[d], side_) >> NORMAL_BITS;
        const int64_t cut = 4 * side_ * side_ / 48;
        const int64_t sigma = root(variance + cut), wide_sigma = root(3 * variance + cut);
        const int64_t most = most_expected(sigma), wide_most = most_expected(wide_sigma);
        for (int octant = 0; octant < 8; octant += octant_step) {
            int64_t away = distance;
            for (int d = 0; d < 3; ++d) away += octant >> d & 1 ? steps[d] : 0;
            distances[octant] = away;
            narrow[octant] = (most * weight(away, sigma) >> 12) + 1;
            wide[octant] = (wide_most * weight(away, wide_sigma) >> 12) + 1;
        }
    }

    // The occupied children of cube i are known.
    void learn(size_t i) {
        const unsigned known = cubes_.known[i];
        const int64_t count = bits_of(known);
        static constexpr unsigned UPPER[] = {0xAA, 0xCC, 0xF0};
        for (size_t d = 0; d < 3; ++d)
            places_[i][d] = centres_[i][d] - side_ / 2 + int64_t(bits_of(known & UPPER[d])) * side_ / count;
        noise_[i] = 4 * side_ * side_ / (6 * count);
    }

    int distance_class(int octant) const {
        const int steps = steps_[size_t(std::min<int64_t>(4 * std::abs(distances[octant]) >> side_bits_, CLASSES - 1))];
        return FAR / 2 + (distances[octant] < 0 ? -steps : steps);
    }

    int samples(size_t i, int octant) const { return samples_[i][size_t(octant)]; }

private:
    struct Held {
        std::array<int32_t, CUBES_OF_SAMPLE> rows;
        int32_t count = 0;
    };

    // At most CUBES_OF_SAMPLE cubes of each sample.
    void find_cubes_of_samples() {
        std::vector<int32_t> first(surface_.size() + 1, 0);
        for (int32_t s : cubes_.nearest)
            if (s >= 0) ++first[size_t(s) + 1];
        for (size_t s = 0; s < surface_.size(); ++s) first[s + 1] += first[s];
        std::vector<int32_t> rows(size_t(first.back())), next(first.begin(), first.end() - 1);
        for (size_t i = 0; i < cubes_.size(); ++i)
            if (cubes_.nearest[i] >= 0) rows[size_t(next[size_t(cubes_.nearest[i])]++)] = int32_t(i);
        for (size_t s = 0; s < surface_.size(); ++s) {
            const int32_t count = first[s + 1] - first[s];
            held_[s].count = std::min(count, CUBES_OF_SAMPLE);
            for (int32_t k = 0; k < held_[s].count; ++k) {
                const int64_t number = int64_t(k) * count / held_[s].count;
                held_[s].rows[size_t(k)] = rows[size_t(first[s] + number)];
            }
        }
    }

    // The distance of the surface from that of the sample of cube i, and its variance.
    void find_surface(size_t i, int64_t &offset, int64_t &variance) const {
        int64_t weights[13 * CUBES_OF_SAMPLE], away[13 * CUBES_OF_SAMPLE], total = 0, sum = 0;
        int count = 0;
        const int32_t own = cubes_.nearest[i], *around = surface_.around(own);
        const int64_t square = spacing_ * spacing_;
        const Place &centre = centres_[i], &normal = surface_.normal(own);
        for (int k = -1; k < NEIGHBOURS; ++k) {
            const int32_t sample = k < 0 ? own : around[k];
            if (k >= 0 && sample == own) continue;
            const Held &held = held_[size_t(sample)];
            const Place &other = surface_.normal(sample);
            for (int32_t n = 0; n < held.count; ++n) {
                const size_t row = size_t(held.rows[size_t(n)]);
                int64_t apart = 0, along = 0;
                for (size_t d = 0; d < 3; ++d) {
                    const int64_t step = places_[row][d] - centre[d];
                    apart += step * step;
                    along += step * (normal[d] + other[d]);
                }
                weights[count] = floor_quotient(square << 16, 13 * apart + 10 * square + 64 * noise_[row] + 1);
                away[count] = far_[i] + (along >> (NORMAL_BITS + 1));
                total += weights[count];
                sum += weights[count] * away[count];
                ++count;
            }
        }
        offset = floor_quotient(sum, total + SAMPLE_WEIGHT);
        int64_t spread = USUAL_WEIGHT * usual_;
        for (int n = 0; n < count; ++n) spread += weights[n] * std::abs(away[n] - offset);
        const int64_t deviation = std::min(floor_quotient(spread, total + USUAL_WEIGHT), LARGEST_DEVIATION);
        variance = std::max((166 * deviation * deviation >> 8) - 4 * side_ * side_ / 20, LEAST_VARIANCE);
    }

    int64_t most_expected(int64_t sigma) const { return std::min(density_ * side_ / (sigma * 256), MOST_EXPECTED); }

    // The normal density at a distance. The quotient of floats is exact enough: integers below 2^52.
    int64_t weight(int64_t distance, int64_t sigma) const {
        const double steps = double(std::abs(distance)) * BELL_PER_DEVIATION / double(sigma);
        return bell_[steps < BELL_STEPS ? int(steps) : BELL_STEPS];
    }

    const Surface &surface_;
    const Cubes &cubes_;
    const int32_t *bell_;
    const int64_t side_;
    const int side_bits_;
    const int64_t spacing_;
    std::vector<Place> centres_, places_;
    std::vector<int64_t> noise_, far_;
    std::vector<std::array<uint8_t, 8>> samples_;
    std::vector<Held> held_;
    int64_t usual_ = 0, density_ = 0;
    const std::array<int, CLASSES> steps_ = distance_classes();
};

// The class of the odds of an octant with `own` expected points, and `others` in those still to come: the binary order and
// the two digits after the first. The quotient of floats is exact enough below 2^32, where the classes end.
int odds_class(int64_t own, int64_t others, int few) {
    const int64_t first = own * (TWO + own) >> 17;
    const double odds = few || others >= TWO ? double(first << 8) : double(first * 128 * (TWO + others)) / double(others);
    if (odds < double(1 << LEAST_ODDS)) return 0;
    uint64_t digits;
    std::memcpy(&digits, &odds, sizeof digits);
    return int(std::min<uint64_t>((digits >> 50) - 4 * (1023 + LEAST_ODDS), NO_HINT - 1));
}

class Tree {
public:
    Tree(int depth, const Surface *surface, const int32_t *bell) : depth_(depth), surface_(surface), bell_(bell) {}

    // Codes a frame. codes: of the points, null in the decoder. Returns whether the bytes were a tree of `points` points;
    // `failed_level` and `failed_cubes` say where they were not.
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
            cubes_ = cubes_.next();
        }
        return true;
    }

    const Cubes &points() const { return cubes_; }

    int failed_level = 0;
    size_t failed_cubes = 0;

private:
    template <class Coder>
    void code_level(Coder &coder, int level, size_t points, const uint8_t *occupied) {
        if (!surface_) {
            for (size_t i = 0; i < cubes_.size(); ++i) code_cube(coder, i, level, nullptr, occupied);
            return;
        }
        surface_->attach(cubes_.places, level, cubes_.nearest);
        Passage passage(*surface_, cubes_, level, points, bell_);
        for (size_t i = 0; i < cubes_.size(); ++i) {
            if (cubes_.nearest[i] >= 0) passage.expect(i, level == depth_ - 1 ? LATTICE_STEP : 1);
            code_cube(coder, i, level, &passage, occupied);
            if (cubes_.nearest[i] >= 0) passage.learn(i);
        }
    }

    template <class Coder>
    void code_cube(Coder &coder, size_t i, int level, const Passage *passage, const uint8_t *occupied) {
        const int octant_step = level == depth_ - 1 ? LATTICE_STEP : 1, height = depth_ - level, tall = std::min(height, 15);
        const bool is_near = passage && cubes_.nearest[i] >= 0;
        const int hint = passage ? 1 + is_near : 0;
        int64_t narrow_left = 0, wide_left = 0;
        if (is_near)
            for (int octant = 0; octant < 8; octant += octant_step) {
                narrow_left += passage->narrow[octant];
                wide_left += passage->wide[octant];
            }
        int filled = 0;
        for (int32_t row : cubes_.neighbours[i]) filled += size_t(row) < cubes_.size();
        filled = std::min(filled / 2, 3);
        unsigned known = 0;
        for (int octant = 0; octant < 8; octant += octant_step) {
            const int left = (7 - octant) / octant_step, few = std::min(bits_of(known), 3);
            int narrow = NO_HINT, wide = NO_HINT, distance = FAR;
            if (is_near) {
                narrow_left -= passage->narrow[octant];
                wide_left -= passage->wide[octant];
                distance = passage->distance_class(octant);
            }
            if (!left && !known) {
                known |= 1u << octant;
                break;
            }
            if (is_near) {
                narrow = odds_class(passage->narrow[octant], narrow_left, few);
                wide = odds_class(passage->wide[octant], wide_left, few);
            }
            int beside = 0, nearby = 0;
            find_neighbours(i, octant, known, beside, nearby);
            const int samples = passage ? passage->samples(i, octant) : 0;
            const uint32_t contexts[bits::INPUTS] = {
                uint32_t(((octant * 4 + few) * 64 + beside) * 4 + filled),
                uint32_t(narrow * 4 + few),
                uint32_t((wide * 4 + few) * 16 + tall),
                uint32_t(((distance * 5 + samples) * 4 + few) * 16 + tall),
                uint32_t(((narrow * 7 + nearby) * 4 + few) * 8 + left),
            };
            const uint32_t set = uint32_t((std::min(height, 20) * 4 + few) * 3 + hint);
            known |= unsigned(coder.code(contexts, set, occupied ? occupied[i] >> octant & 1 : 0)) << octant;
        }
        cubes_.known[i] = uint8_t(known);
    }

    // beside, nearby: contexts from the octants and cubes beside an octant of cube i, whose octants `known` are occupied.
    void find_neighbours(size_t i, int octant, unsigned known, int &beside, int &nearby) const {
        for (int axis = 0; axis < 3; ++axis) {
            const int opposite = octant ^ 1 << axis, is_upper = octant >> axis & 1;
            const size_t row = size_t(cubes_.neighbours[i][size_t(2 * axis + is_upper)]);
            const int inner = int((is_upper ? known : unsigned(cubes_.known[row])) >> opposite & 1);
            const int outer = row < cubes_.size();
            beside = beside * 4 + 2 * inner + outer;
            nearby += inner + outer;
        }
    }

    const int depth_;
    const Surface *surface_;
    const int32_t *bell_;
    Cubes cubes_;
};

}  // namespace

void bind_cube_octree(nb::module_ &m) { OctreeFunctions<Tree>::bind(m, "cube_octree"); }
