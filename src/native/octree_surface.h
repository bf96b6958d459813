// The posed surface of the bodies as the octree of a frame sees it, for codecs/bodycast/surface_hints.py, which defines
// the results. Integers only; sums wrap as in NumPy.
//
//     samples ─sorted once by the octree's cells─► nearest sample of a cube ─► distance of its children from the surface
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <vector>

#include "arrays.h"
#include "integers.h"

namespace point_octree {

constexpr int SUBUNIT_BITS = 4, NORMAL_BITS = 10, NEIGHBOURS = 12;
constexpr int SEARCHED = 3;           // samples of a cell that are candidates for the nearest
constexpr int COARSEST_SPACINGS = 4;  // side of the largest cubes that have a nearest sample, in spacings
constexpr int PRIOR_COUNT = 2;        // cubes that a correction of zero counts for
constexpr int64_t HALF_UNIT = 1 << (SUBUNIT_BITS - 1);
constexpr int32_t NOWHERE = -1;
constexpr double LARGEST_SUM = 4e18;  // of distances: only of a damaged file

using Place = std::array<int64_t, 3>;

inline int64_t wrapped_product(int64_t a, int64_t b) { return int64_t(uint64_t(a) * uint64_t(b)); }

// Bits of a coordinate below 2^21 three places apart, as octree.morton_codes.
inline uint64_t spread_bits(uint64_t v) {
    v = (v | v << 32) & 0x1F00000000FFFF;
    v = (v | v << 16) & 0x1F0000FF0000FF;
    v = (v | v << 8) & 0x100F00F00F00F00F;
    v = (v | v << 4) & 0x10C30C30C30C30C3;
    return (v | v << 2) & 0x1249249249249249;
}

inline uint64_t morton_code(int64_t x, int64_t y, int64_t z) {
    return spread_bits(uint64_t(x)) | spread_bits(uint64_t(y)) << 1 | spread_bits(uint64_t(z)) << 2;
}

// A cell's coordinates below 2^21 as one number.
inline uint64_t cell_key(int64_t x, int64_t y, int64_t z) { return uint64_t(x) | uint64_t(y) << 21 | uint64_t(z) << 42; }

// Rows by 64-bit key: open addressing with linear probing, behind a filter that knows most keys that are not there.
class KeyTable {
public:
    static constexpr uint64_t HASH = 0x9E3779B97F4A7C15u;

    explicit KeyTable(size_t keys) {
        size_t slots = 16;
        while (slots < 2 * keys) slots *= 2;
        keys_.assign(slots, EMPTY);
        rows_.resize(slots);
    }

    void add(uint64_t key, int32_t row) {
        const uint64_t hash = key * HASH;
        filter_[hash >> 54] |= uint64_t(1) << (hash >> 48 & 63);
        size_t at = slot(hash);
        while (keys_[at] != EMPTY) at = (at + 1) & (keys_.size() - 1);
        keys_[at] = key;
        rows_[at] = row;
    }

    // The row of this key, −1 without one.
    int32_t find(uint64_t key) const { return find(key, key * HASH); }

    // The same with the product of the key and HASH.
    int32_t find(uint64_t key, uint64_t hash) const {
        if (!(filter_[hash >> 54] >> (hash >> 48 & 63) & 1)) return -1;
        for (size_t at = slot(hash); keys_[at] != EMPTY; at = (at + 1) & (keys_.size() - 1))
            if (keys_[at] == key) return rows_[at];
        return -1;
    }

private:
    static constexpr uint64_t EMPTY = ~uint64_t(0);

    size_t slot(uint64_t hash) const { return (hash >> 32) & (keys_.size() - 1); }

    std::array<uint64_t, 1024> filter_{};  // a bit for each of the upper 16 bits of a hash

    std::vector<uint64_t> keys_;
    std::vector<int32_t> rows_;
};

// A step to one of the 27 cells around a cube. key: added to that of the cube. axes: along how many it leads.
struct Around {
    int32_t x, y, z;
    uint64_t key;
    int64_t axes;
};

struct AllAround {
    std::array<Around, 27> of;
    AllAround() {
        static constexpr int32_t STEPS[3] = {0, -1, 1};
        for (size_t k = 0; k < of.size(); ++k) {
            const int32_t x = STEPS[k / 9], y = STEPS[k / 3 % 3], z = STEPS[k % 3];
            const uint64_t key = uint64_t(x) + (uint64_t(y) << 21) + (uint64_t(z) << 42);
            of[k] = {x, y, z, key, int64_t(x != 0) + (y != 0) + (z != 0)};
        }
    }
};

const AllAround AROUND;

class Surface {
public:
    // points, normals (m, 3); neighbours (m, NEIGHBOURS); spacing: between samples, subunits; depth: of the octree;
    // largest_corrected: side of the largest cubes that correct the surface, subunits.
    Surface(Input<int64_t, 2> points, Input<int64_t, 2> normals, Input<int64_t, 2> neighbours, int64_t spacing, int depth,
            int64_t largest_corrected)
        : spacing_(spacing), largest_corrected_(largest_corrected), depth_(depth), points_(rows_of_three(points)), normals_(rows_of_three(normals)),
          neighbours_(neighbours.data(), neighbours.data() + neighbours.size()) {
        const size_t m = points.shape(0);
        if (normals.shape(0) != m || neighbours.shape(0) != m || neighbours.shape(1) != NEIGHBOURS || spacing < 1 ||
            depth < 0 || depth > 20)
            throw std::invalid_argument("OctreeSurface: shapes differ");
        for (int32_t row : neighbours_)
            if (row < 0 || size_t(row) >= m) throw std::invalid_argument("OctreeSurface: a neighbour beyond the samples");
        sort_by_cell();
    }

    int depth() const { return depth_; }
    size_t size() const { return points_.size(); }
    int64_t spacing() const { return spacing_; }
    const Place &place(int32_t row) const { return points_[size_t(row)]; }
    const Place &normal(int32_t row) const { return normals_[size_t(row)]; }
    const int32_t *around(int32_t row) const { return &neighbours_[size_t(row) * NEIGHBOURS]; }

    // Side of the children of a level's cubes, subunits.
    int64_t child_size(int level) const { return int64_t(1) << child_bits(level); }
    int child_bits(int level) const { return SUBUNIT_BITS + depth_ - level - 1; }

    // Replaces the sample of each cube's parent by one near the cube's centre.
    void attach(const std::vector<std::array<int32_t, 3>> &places, int level, std::vector<int32_t> &nearest) const {
        const int64_t size = 2 * child_size(level);
        if (points_.empty() || size > COARSEST_SPACINGS * spacing_) {
            std::fill(nearest.begin(), nearest.end(), NOWHERE);
            return;
        }
        const bool searches = 2 * size > spacing_;
        const Cells cells = searches ? cells_of_level(level) : Cells{KeyTable(0), {}};
        for (size_t i = 0; i < places.size(); ++i) {
            const Place centre = centre_of(places[i], size);
            nearest[i] = descend(centre, nearest[i]);
            if (searches) nearest[i] = nearest_around(places[i], centre, level, size, cells, nearest[i]);
        }
    }

    // The centre of a cube, half a unit before: lattice points lie at the corners of unit cubes.
    static Place centre_of(const std::array<int32_t, 3> &place, int64_t size) {
        Place centre;
        for (int d = 0; d < 3; ++d) centre[d] = place[d] * size + size / 2 - HALF_UNIT;
        return centre;
    }

    // The mean distance of the cubes around each cube from the surface, and the mean deviation from it, subunits.
    void offsets(const std::vector<std::array<int32_t, 3>> &places, int level, const std::vector<int32_t> &nearest,
                 std::vector<int64_t> &offset, std::vector<int64_t> &spread) const {
        const int64_t size = 2 * child_size(level);
        offset.assign(places.size(), 0);
        spread.assign(places.size(), size);
        std::vector<int64_t> distances(places.size());
        int64_t used = 0;
        for (size_t i = 0; i < places.size(); ++i) {
            if (nearest[i] < 0) continue;
            distances[i] = distance(centre_of(places[i], size), nearest[i]);
            ++used;
        }
        if (!used) return;
        std::vector<int64_t> mean(points_.size(), 0);
        if (size <= largest_corrected_) mean = mean_around(distances, nearest, 0);
        uint64_t sum = 0;
        for (size_t i = 0; i < places.size(); ++i) {
            if (nearest[i] < 0) continue;
            offset[i] = mean[size_t(nearest[i])];
            distances[i] = std::abs(distances[i] - offset[i]);
            sum += uint64_t(distances[i]);
        }
        const int64_t usual = floor_division(int64_t(sum), used);
        const std::vector<int64_t> deviation = mean_around(distances, nearest, usual * PRIOR_COUNT);
        for (size_t i = 0; i < places.size(); ++i)
            if (nearest[i] >= 0) spread[i] = deviation[size_t(nearest[i])];
    }

    // The distance of a place from the tangent plane of a sample, subunits, positive outside.
    int64_t distance(const Place &place, int32_t row) const {
        uint64_t sum = 0;
        for (int d = 0; d < 3; ++d)
            sum += uint64_t(wrapped_product(place[d] - points_[size_t(row)][d], normals_[size_t(row)][d]));
        return int64_t(sum) >> NORMAL_BITS;
    }

    // Codes, in order, of the cells of a level that the samples within the octree lie in.
    std::vector<uint64_t> sample_codes(int level) const {
        std::vector<uint64_t> result(codes_.size());
        for (size_t i = 0; i < codes_.size(); ++i) result[i] = codes_[i] >> 3 * (depth_ - level);
        return result;
    }

private:
    static std::vector<Place> rows_of_three(const Input<int64_t, 2> &values) {
        if (values.shape(1) != 3) throw std::invalid_argument("OctreeSurface: shapes differ");
        std::vector<Place> result(values.shape(0));
        for (size_t i = 0; i < result.size(); ++i) std::copy_n(values.data() + 3 * i, 3, result[i].begin());
        return result;
    }

    // Samples within the octree by their unit cell, those of a cell by row. A cell of any level is a run of them.
    void sort_by_cell() {
        const int64_t end = int64_t(1) << (SUBUNIT_BITS + depth_);
        std::vector<std::pair<uint64_t, int32_t>> sorted;
        sorted.reserve(points_.size());
        for (size_t i = 0; i < points_.size(); ++i) {
            int64_t v[3];
            bool inside = true;
            for (int d = 0; d < 3; ++d) {
                v[d] = points_[i][d] + HALF_UNIT;
                inside &= v[d] >= 0 && v[d] < end;
                v[d] >>= SUBUNIT_BITS;
            }
            if (inside) sorted.emplace_back(morton_code(v[0], v[1], v[2]), int32_t(i));
        }
        std::sort(sorted.begin(), sorted.end());
        for (const auto &[code, row] : sorted) {
            codes_.push_back(code);
            sorted_rows_.push_back(row);
        }
    }

    // The first SEARCHED samples, by row, of every cell of a level; NOWHERE where it holds fewer. at: rows of `first`.
    struct Cells {
        KeyTable at;
        std::vector<std::array<int32_t, SEARCHED>> first;
    };

    // The cell of a level that a sample within the octree lies in.
    uint64_t key_of_sample(int32_t row, int level) const {
        const Place &v = points_[size_t(row)];
        const int bits = SUBUNIT_BITS + depth_ - level;
        return cell_key((v[0] + HALF_UNIT) >> bits, (v[1] + HALF_UNIT) >> bits, (v[2] + HALF_UNIT) >> bits);
    }

    Cells cells_of_level(int level) const {
        const std::vector<uint64_t> codes = sample_codes(level);
        size_t count = 0;
        for (size_t i = 0; i < codes.size(); ++i) count += !i || codes[i] != codes[i - 1];
        Cells cells{KeyTable(count), {}};
        for (size_t start = 0, stop; start < codes.size(); start = stop) {
            for (stop = start + 1; stop < codes.size() && codes[stop] == codes[start];) ++stop;
            std::array<int32_t, SEARCHED> first;
            first.fill(NOWHERE);
            const auto end = std::partial_sort_copy(sorted_rows_.begin() + start, sorted_rows_.begin() + stop,
                                                    first.begin(), first.end());
            std::fill(end, first.end(), NOWHERE);
            cells.at.add(key_of_sample(sorted_rows_[start], level), int32_t(cells.first.size()));
            cells.first.push_back(first);
        }
        return cells;
    }

    int64_t square(const Place &centre, int32_t row) const {
        uint64_t sum = 0;
        for (int d = 0; d < 3; ++d) {
            const int64_t away = points_[size_t(row)][d] - centre[d];
            sum += uint64_t(wrapped_product(away, away));
        }
        return int64_t(sum);
    }

    // The nearest among a sample and its neighbours, the first where several are; NOWHERE stays.
    int32_t descend(const Place &centre, int32_t row) const {
        if (row < 0) return NOWHERE;
        int32_t found = row;
        int64_t best = square(centre, row);
        const int32_t *around = &neighbours_[size_t(row) * NEIGHBOURS];
        for (int k = 0; k < NEIGHBOURS; ++k) {
            const int64_t own = square(centre, around[k]);
            if (own < best) best = own, found = around[k];
        }
        return found;
    }

    // The nearest of the samples in the 27 cells around a cube, or `row` if none is nearer.
    int32_t nearest_around(const std::array<int32_t, 3> &place, const Place &centre, int level, int64_t size,
                           const Cells &cells, int32_t row) const {
        const int32_t side = int32_t(1) << level;
        int64_t best = row < 0 ? std::numeric_limits<int64_t>::max() : square(centre, row);
        const uint64_t key = cell_key(place[0], place[1], place[2]), hash = key * KeyTable::HASH;
        bool is_inner = true;  // all cells around are within the octree
        for (int32_t v : place) is_inner &= v > 0 && v < side - 1;
        const auto search = [&](const Around &step) {
            if (!is_inner) {
                const int32_t x = place[0] + step.x, y = place[1] + step.y, z = place[2] + step.z;
                if (x < 0 || y < 0 || z < 0 || x >= side || y >= side || z >= side) return;
            }
            const int32_t cell = cells.at.find(key + step.key, hash + step.key * KeyTable::HASH);
            if (cell < 0) return;
            for (int32_t other : cells.first[size_t(cell)]) {
                if (other < 0) break;
                const int64_t own = square(centre, other);
                if (own < best) best = own, row = other;
            }
        };
        search(AROUND.of[0]);
        const int64_t quarter = size / 2 * (size / 2);  // squared distance of the centre from a face
        for (size_t k = 1; k < AROUND.of.size() && quarter < best; ++k)
            if (AROUND.of[k].axes * quarter < best) search(AROUND.of[k]);  // otherwise all of the cell is as far
        return row;
    }

    // The mean of the values at the cubes' samples over each sample and its neighbours; of samples without cubes, 0.
    std::vector<int64_t> mean_around(const std::vector<int64_t> &values, const std::vector<int32_t> &rows,
                                     int64_t prior) const {
        std::vector<double> sums(points_.size(), 0.0);  // as NumPy's bincount: exact below 2^53
        std::vector<int64_t> count(points_.size(), 0), total(points_.size()), result(points_.size(), 0);
        for (size_t i = 0; i < rows.size(); ++i) {
            if (rows[i] < 0) continue;
            sums[size_t(rows[i])] += double(values[i]);
            ++count[size_t(rows[i])];
        }
        for (size_t s = 0; s < total.size(); ++s)
            total[s] = std::abs(sums[s]) < LARGEST_SUM ? int64_t(sums[s]) : 0;
        for (size_t s = 0; s < total.size(); ++s) {
            if (!count[s]) continue;
            const int32_t *around = &neighbours_[s * NEIGHBOURS];
            uint64_t sum = uint64_t(total[s]) + uint64_t(prior);
            int64_t cubes = count[s] + PRIOR_COUNT;
            for (int k = 0; k < NEIGHBOURS; ++k) {
                sum += uint64_t(total[size_t(around[k])]);
                cubes += count[size_t(around[k])];
            }
            result[s] = floor_quotient(int64_t(sum), cubes);
        }
        return result;
    }

    int64_t spacing_, largest_corrected_;
    int depth_;
    std::vector<Place> points_, normals_;
    std::vector<int32_t> neighbours_;
    std::vector<uint64_t> codes_;       // of the unit cells of the samples within the octree, in order
    std::vector<int32_t> sorted_rows_;  // the samples of `codes_`
};

}  // namespace point_octree
