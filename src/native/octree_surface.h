// The posed surface of the bodies, for the contexts of a frame's octree. codecs/bodycast/surface_hints.py defines the
// results. Integers only; sums wrap around as in NumPy.
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

#if defined(__SSE2__)  // part of every x86-64 processor
#include <emmintrin.h>
#endif

#include "arrays.h"
#include "integers.h"
#include "key_order.h"

namespace point_octree {

constexpr int SUBUNIT_BITS = 4, NORMAL_BITS = 10, NEIGHBOURS = 12;
constexpr int SEARCHED = 3;           // candidates for the nearest sample in a cell
constexpr int COARSEST_SPACINGS = 4;  // side of the largest cubes with a nearest sample, in spacings
constexpr int PRIOR_COUNT = 2;        // weight of a correction of zero, in cubes
constexpr int64_t HALF_UNIT = 1 << (SUBUNIT_BITS - 1);
constexpr int32_t NOWHERE = -1;
constexpr double LARGEST_SUM = 4e18;  // sum of distances; only damaged files exceed it

using Place = std::array<int64_t, 3>;

inline int64_t wrapped_product(int64_t a, int64_t b) { return int64_t(uint64_t(a) * uint64_t(b)); }

// Spreads the bits of a coordinate below 2^21 three places apart: octree.morton_codes.
inline uint64_t spread_bits(uint64_t v) {
    v = (v | v << 32) & 0x1F00000000FFFF;
    v = (v | v << 16) & 0x1F0000FF0000FF;
    v = (v | v << 8) & 0x100F00F00F00F00F;
    v = (v | v << 4) & 0x10C30C30C30C30C3;
    return (v | v << 2) & 0x1249249249249249;
}

// The inverse: gathers every third bit, from the lowest.
inline int64_t gathered_bits(uint64_t v) {
    v &= 0x1249249249249249;
    v = (v | v >> 2) & 0x10C30C30C30C30C3;
    v = (v | v >> 4) & 0x100F00F00F00F00F;
    v = (v | v >> 8) & 0x1F0000FF0000FF;
    v = (v | v >> 16) & 0x1F00000000FFFF;
    return int64_t((v | v >> 32) & 0x1FFFFF);
}

inline uint64_t morton_code(int64_t x, int64_t y, int64_t z) {
    return spread_bits(uint64_t(x)) | spread_bits(uint64_t(y)) << 1 | spread_bits(uint64_t(z)) << 2;
}

// A cell's coordinates, below 2^21, as one number.
inline uint64_t cell_key(int64_t x, int64_t y, int64_t z) { return uint64_t(x) | uint64_t(y) << 21 | uint64_t(z) << 42; }

// Hash table from 64-bit keys to rows: open addressing with linear probing; a filter rejects most missing keys.
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

    // The row of this key, −1: none.
    int32_t find(uint64_t key) const { return find(key, key * HASH); }

    // hash: product of the key and HASH.
    int32_t find(uint64_t key, uint64_t hash) const {
        if (!(filter_[hash >> 54] >> (hash >> 48 & 63) & 1)) return -1;
        for (size_t at = slot(hash); keys_[at] != EMPTY; at = (at + 1) & (keys_.size() - 1))
            if (keys_[at] == key) return rows_[at];
        return -1;
    }

private:
    static constexpr uint64_t EMPTY = ~uint64_t(0);

    size_t slot(uint64_t hash) const { return (hash >> 32) & (keys_.size() - 1); }

    std::array<uint64_t, 1024> filter_{};  // a bit for each value of a hash's upper 16 bits

    std::vector<uint64_t> keys_;
    std::vector<int32_t> rows_;
};

// Cells of a block of 4 × 4 × 4, in Morton order.
struct BlockCells {
    struct Cell {
        int8_t x, y, z;
    };
    std::array<Cell, 64> of;
    std::array<std::array<uint64_t, 16>, 3> along{};  // by axis and set of 0 … 3: mask of cells with a coordinate in the set

    BlockCells() {
        for (int k = 0; k < 64; ++k) {
            of[size_t(k)] = {int8_t((k & 1) | (k >> 2 & 2)), int8_t((k >> 1 & 1) | (k >> 3 & 2)), int8_t((k >> 2 & 1) | (k >> 4 & 2))};
            const Cell cell = of[size_t(k)];
            for (size_t set = 0; set < 16; ++set) {
                along[0][set] |= uint64_t(set >> cell.x & 1) << k;
                along[1][set] |= uint64_t(set >> cell.y & 1) << k;
                along[2][set] |= uint64_t(set >> cell.z & 1) << k;
            }
        }
    }
};

const BlockCells BLOCK_CELLS;

// Offsets of the samples around each sample, in 16-bit numbers, if they are near.
class NearNeighbours {
public:
    // 3 · (2 · LARGEST)² · 16 fits into 31 bits.
    static constexpr int64_t LARGEST = 3300;

    void take(const std::vector<Place> &points, const std::vector<int32_t> &neighbours) {
        reach_.resize(points.size());
        offsets_.resize(points.size() * 3 * NEIGHBOURS);
        for (size_t i = 0; i < points.size(); ++i) {
            const Place own = points[i];
            int16_t *to = &offsets_[3 * NEIGHBOURS * i];
            int64_t reach = 0;
            for (size_t k = 0; k < NEIGHBOURS; ++k) {
                const Place &other = points[size_t(neighbours[i * NEIGHBOURS + k])];
                const int64_t x = other[0] - own[0], y = other[1] - own[1], z = other[2] - own[2];
                reach = std::max({reach, std::abs(x), std::abs(y), std::abs(z)});
                to[2 * k] = int16_t(x), to[2 * k + 1] = int16_t(y), to[2 * NEIGHBOURS + k] = int16_t(z);
            }
            reach_[i] = int32_t(std::min(reach, LARGEST + 1));
        }
    }

    // The largest difference of a coordinate from the samples around sample `row`, LARGEST + 1 for all that are larger.
    int32_t reach(size_t row) const { return reach_[row]; }

    // The neighbour nearest to a place relative to sample `row`, counted from 1; 0: the sample itself; −1: numbers too
    // large. Of equal distances the first counts.
    int nearest(size_t row, const Place &place) const {
        if (reach_[row] > LARGEST) return -1;
        for (int64_t v : place)
            if (v > LARGEST || v < -LARGEST) return -1;
        const int16_t *offsets = &offsets_[3 * NEIGHBOURS * row];
        const int32_t x = int32_t(place[0]), y = int32_t(place[1]), z = int32_t(place[2]);
        int32_t best = (x * x + y * y + z * z) * 16;
#if defined(__SSE2__)
        const __m128i flat = _mm_set1_epi32((x & 0xffff) | y * 65536), height = _mm_set1_epi32(z & 0xffff);
        const auto load = [](const int16_t *from) { return _mm_loadu_si128(reinterpret_cast<const __m128i *>(from)); };
        const auto keys = [&](int group, __m128i heights) {
            const __m128i aside = _mm_sub_epi16(load(offsets + 8 * group), flat), above = _mm_sub_epi16(heights, height);
            const __m128i square = _mm_add_epi32(_mm_madd_epi16(aside, aside), _mm_madd_epi16(above, above));
            return _mm_or_si128(_mm_slli_epi32(square, 4), _mm_setr_epi32(4 * group + 1, 4 * group + 2, 4 * group + 3, 4 * group + 4));
        };
        const auto smaller = [](__m128i a, __m128i b) {
            const __m128i is_larger = _mm_cmpgt_epi32(a, b);
            return _mm_or_si128(_mm_and_si128(is_larger, b), _mm_andnot_si128(is_larger, a));
        };
        const int16_t *up = offsets + 2 * NEIGHBOURS;
        const __m128i zero = _mm_setzero_si128(), eight = load(up), last = _mm_loadl_epi64(reinterpret_cast<const __m128i *>(up + 8));
        __m128i least = smaller(keys(0, _mm_unpacklo_epi16(eight, zero)), keys(1, _mm_unpackhi_epi16(eight, zero)));
        least = smaller(least, keys(2, _mm_unpacklo_epi16(last, zero)));
        least = smaller(least, _mm_shuffle_epi32(least, _MM_SHUFFLE(1, 0, 3, 2)));
        least = smaller(least, _mm_shuffle_epi32(least, _MM_SHUFFLE(2, 3, 0, 1)));
        best = std::min(best, _mm_cvtsi128_si32(least));
#else
        for (int k = 0; k < NEIGHBOURS; ++k) {
            const int32_t a = offsets[2 * k] - x, b = offsets[2 * k + 1] - y, c = offsets[2 * NEIGHBOURS + k] - z;
            best = std::min(best, (a * a + b * b + c * c) * 16 + k + 1);
        }
#endif
        return best & 15;
    }

private:
    std::vector<int32_t> reach_;
    std::vector<int16_t> offsets_;  // for each sample: pairs of x and y, then z
};

class Surface {
public:
    // points, normals (m, 3); neighbours (m, NEIGHBOURS); spacing: between samples, subunits; depth: of the octree;
    // largest_corrected: side of the largest cubes that correct the surface, subunits.
    Surface(Input<int64_t, 2> points, Input<int64_t, 2> normals, Input<int64_t, 2> neighbours, int64_t spacing, int depth,
            int64_t largest_corrected)
        : spacing_(spacing), largest_corrected_(largest_corrected), depth_(depth) {
        const size_t m = points.shape(0);
        if (points.shape(1) != 3 || normals.shape(0) != m || normals.shape(1) != 3 || neighbours.shape(0) != m ||
            neighbours.shape(1) != NEIGHBOURS || spacing < 1 || depth < 0 || depth > 20)
            throw std::invalid_argument("OctreeSurface: shapes differ");
        sort_by_cell(points.data(), m);
        points_ = in_order(points.data());
        normals_ = in_order(normals.data());
        take_neighbours(neighbours.data());
        near_.take(points_, neighbours_);
    }

    // Input row of a sample. Samples are stored in the order of their cells, which is the order of cubes.
    int64_t given_row(int32_t row) const { return row < 0 ? row : given_rows_[size_t(row)]; }

    // The inverse: the row at which an input row is stored.
    int32_t own_row(int64_t given) const { return given < 0 ? NOWHERE : own_rows_[size_t(given)]; }

    int depth() const { return depth_; }
    size_t size() const { return points_.size(); }
    int64_t spacing() const { return spacing_; }
    const Place &place(int32_t row) const { return points_[size_t(row)]; }
    const Place &normal(int32_t row) const { return normals_[size_t(row)]; }
    int64_t reach(int32_t row) const { return near_.reach(size_t(row)); }
    const int32_t *around(int32_t row) const { return &neighbours_[size_t(row) * NEIGHBOURS]; }

    // Side of the children of a level's cubes, subunits.
    int64_t child_size(int level) const { return int64_t(1) << child_bits(level); }
    int child_bits(int level) const { return SUBUNIT_BITS + depth_ - level - 1; }

    // Whether cubes of this level are small enough for samples near them.
    bool has_samples(int level) const { return !points_.empty() && 2 * child_size(level) <= COARSEST_SPACINGS * spacing_; }

    // Replaces the sample of each cube's parent by one near the cube's centre.
    void attach(const std::vector<std::array<int32_t, 3>> &places, int level, std::vector<int32_t> &nearest) const {
        const int64_t size = 2 * child_size(level);
        if (!has_samples(level)) {
            std::fill(nearest.begin(), nearest.end(), NOWHERE);
            return;
        }
        const bool searches = 2 * size > spacing_;
        const Cells cells = searches ? cells_of_level(level) : Cells{KeyTable(0), {}, {}};
        const Attached &known = attached_[size_t(level)];
        for (size_t i = 0, at = 0; i < places.size(); ++i) {
            while (at < known.places.size() && is_before(known.places[at], places[i])) ++at;
            if (at < known.places.size() && known.places[at] == places[i]) {
                nearest[i] = known.nearest[at];
                continue;
            }
            const Place centre = centre_of(places[i], size);
            nearest[i] = descend(centre, nearest[i]);
            if (searches) nearest[i] = nearest_around(places[i], centre, size, cells, nearest[i]);
        }
    }

    // Keeps what `attach` found for cubes of a level, in Morton order, for the same cubes in another octree of the frame.
    void keep_attached(const std::vector<std::array<int32_t, 3>> &places, int level, const std::vector<int32_t> &nearest) {
        attached_[size_t(level)] = {places, nearest};
    }

    // The centre of a cube, minus half a unit: lattice points lie at the corners of unit cubes.
    static Place centre_of(const std::array<int32_t, 3> &place, int64_t size) {
        Place centre;
        for (int d = 0; d < 3; ++d) centre[d] = place[d] * size + size / 2 - HALF_UNIT;
        return centre;
    }

    // For each cube, the mean distance of the cubes around it from the surface, and the mean deviation, subunits.
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

    // Signed distance of a place from the tangent plane of a sample, subunits, positive outside.
    int64_t distance(const Place &place, int32_t row) const {
        uint64_t sum = 0;
        for (int d = 0; d < 3; ++d)
            sum += uint64_t(wrapped_product(place[d] - points_[size_t(row)][d], normals_[size_t(row)][d]));
        return int64_t(sum) >> NORMAL_BITS;
    }

    // Sorted codes of the unit cells that contain the samples within the octree.
    const std::vector<uint64_t> &sample_codes() const { return codes_; }

private:
    // The cubes of a level, in Morton order, with the sample near each.
    struct Attached {
        std::vector<std::array<int32_t, 3>> places;
        std::vector<int32_t> nearest;
    };

    // Whether cube a is before cube b in Morton order: by the coordinate whose highest differing bit is the highest.
    static bool is_before(const std::array<int32_t, 3> &a, const std::array<int32_t, 3> &b) {
        size_t axis = 2;
        uint32_t differing = uint32_t(a[2] ^ b[2]);
        for (const size_t other : {size_t(1), size_t(0)}) {
            const uint32_t own = uint32_t(a[other] ^ b[other]);
            if (differing < own && differing < (differing ^ own)) axis = other, differing = own;
        }
        return a[axis] < b[axis];
    }

    // Sorts samples within the octree by unit cell, then by row; others follow. So a cell of any level is a run.
    void sort_by_cell(const int64_t *points, size_t m) {
        const int64_t end = int64_t(1) << (SUBUNIT_BITS + depth_);
        std::vector<KeyOfRow> sorted;
        std::vector<int32_t> outside;
        sorted.reserve(m);
        for (size_t i = 0; i < m; ++i) {
            int64_t v[3];
            bool inside = true;
            for (size_t d = 0; d < 3; ++d) {
                v[d] = points[3 * i + d] + HALF_UNIT;
                inside &= v[d] >= 0 && v[d] < end;
                v[d] >>= SUBUNIT_BITS;
            }
            if (inside)
                sorted.push_back({morton_code(v[0], v[1], v[2]), uint32_t(i)});
            else
                outside.push_back(int32_t(i));
        }
        sort_keys(sorted);
        given_rows_.reserve(m);
        codes_.reserve(sorted.size());
        for (const KeyOfRow &own : sorted) {
            codes_.push_back(own.key);
            given_rows_.push_back(int32_t(own.row));
        }
        given_rows_.insert(given_rows_.end(), outside.begin(), outside.end());
        own_rows_.resize(m);
        for (size_t i = 0; i < m; ++i) own_rows_[size_t(given_rows_[i])] = int32_t(i);
    }

    std::vector<Place> in_order(const int64_t *values) const {
        std::vector<Place> result(given_rows_.size());
        for (size_t i = 0; i < result.size(); ++i) std::copy_n(values + 3 * size_t(given_rows_[i]), 3, result[i].begin());
        return result;
    }

    void take_neighbours(const int64_t *neighbours) {
        neighbours_.resize(given_rows_.size() * NEIGHBOURS);
        for (size_t i = 0; i < given_rows_.size(); ++i)
            for (size_t k = 0; k < NEIGHBOURS; ++k) {
                const int64_t row = neighbours[size_t(given_rows_[i]) * NEIGHBOURS + k];
                if (row < 0 || row >= int64_t(given_rows_.size())) throw std::invalid_argument("OctreeSurface: a neighbour beyond the samples");
                neighbours_[i * NEIGHBOURS + k] = own_rows_[size_t(row)];
            }
    }

    // The first SEARCHED samples of a cell, by input row; NOWHERE if it has fewer.
    using FirstSamples = std::array<int32_t, SEARCHED>;

    // Cells with samples in a block of a level. ranks: index of each among them.
    struct Block {
        uint64_t filled = 0;
        size_t first = 0;
        std::array<uint8_t, 64> ranks{};
    };

    // All cells of a level, in Morton order. at: rows of `blocks` by the keys of their places.
    struct Cells {
        KeyTable at;
        std::vector<Block> blocks;
        std::vector<FirstSamples> first;
    };

    // The block of a level that contains a sample within the octree.
    uint64_t block_of_sample(size_t row, int level) const {
        const Place &v = points_[row];
        const int bits = SUBUNIT_BITS + depth_ - level + 2;
        return cell_key((v[0] + HALF_UNIT) >> bits, (v[1] + HALF_UNIT) >> bits, (v[2] + HALF_UNIT) >> bits);
    }

    Cells cells_of_level(int level) const {
        const int below = 3 * (depth_ - level);
        size_t count = 0;
        const auto block_of = [&](size_t i) { return codes_[i] >> below >> 6; };
        for (size_t i = 0; i < codes_.size(); ++i) count += !i || block_of(i) != block_of(i - 1);
        Cells cells{KeyTable(count), {}, {}};
        cells.blocks.reserve(count);
        for (size_t i = 0; i < codes_.size(); ++i) {
            const uint64_t code = codes_[i] >> below;
            if (!i || block_of(i) != block_of(i - 1)) {
                cells.at.add(block_of_sample(i, level), int32_t(cells.blocks.size()));
                cells.blocks.push_back({0, cells.first.size(), {}});
            }
            if (!i || code != codes_[i - 1] >> below) {
                Block &block = cells.blocks.back();
                block.filled |= uint64_t(1) << (code & 63);
                block.ranks[code & 63] = uint8_t(cells.first.size() - block.first);
                cells.first.emplace_back();
                cells.first.back().fill(std::numeric_limits<int32_t>::max());
            }
            int32_t row = given_rows_[i];
            for (int32_t &own : cells.first.back()) {
                const int32_t later = std::max(own, row);
                own = std::min(own, row);
                row = later;
            }
        }
        for (FirstSamples &first : cells.first)
            for (int32_t &row : first)
                row = row == std::numeric_limits<int32_t>::max() ? NOWHERE : own_rows_[size_t(row)];
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

    // The nearest among a sample and its neighbours, the first of equal ones; NOWHERE for NOWHERE.
    int32_t descend(const Place &centre, int32_t row) const {
        if (row < 0) return NOWHERE;
        const int32_t *around = &neighbours_[size_t(row) * NEIGHBOURS];
        Place apart;
        for (size_t d = 0; d < 3; ++d) apart[d] = centre[d] - points_[size_t(row)][d];
        const int nearest = near_.nearest(size_t(row), apart);
        if (nearest >= 0) return nearest ? around[nearest - 1] : row;
        int32_t found = row;
        int64_t best = square(centre, row);
        for (int k = 0; k < NEIGHBOURS; ++k) {
            const int64_t own = square(centre, around[k]);
            if (own < best) best = own, found = around[k];
        }
        return found;
    }

    // The nearest sample in the 27 cells around a cube, or `row` if none is nearer. Of equal distances the first
    // counts: cells by their steps along x, y and z, each in the order 0, −1, 1; within a cell by row.
    int32_t nearest_around(const std::array<int32_t, 3> &place, const Place &centre, int64_t size, const Cells &cells,
                           int32_t row) const {
        static constexpr int ORDER[3] = {1, 0, 2}, AXES[3] = {1, 0, 1};  // by step −1, 0, 1: rank; leaves the cube
        int64_t best = row < 0 ? std::numeric_limits<int64_t>::max() : square(centre, row);
        int order = -1;
        const int64_t quarter = size / 2 * (size / 2);  // squared distance of the centre from a face
        const auto search = [&](const Block &block, int x, int y, int z, int bit) {  // x, y, z: steps + 1
            if ((AXES[x] + AXES[y] + AXES[z]) * quarter > best) return;  // the whole cell is farther
            const int first = 9 * ORDER[x] + 3 * ORDER[y] + ORDER[z];
            for (int k = 0; k < SEARCHED; ++k) {
                const int32_t other = cells.first[block.first + block.ranks[size_t(bit)]][size_t(k)];
                if (other < 0) break;
                const int64_t own = square(centre, other);
                const int its_order = SEARCHED * first + k;
                if (own < best || (own == best && its_order < order)) best = own, order = its_order, row = other;
            }
        };
        const auto block_at = [&](int x, int y, int z) {
            const int32_t at = x < 0 || y < 0 || z < 0 ? -1 : cells.at.find(cell_key(x, y, z));
            return at < 0 ? nullptr : &cells.blocks[size_t(at)];
        };
        const int own_bit = int(morton_code(place[0] & 3, place[1] & 3, place[2] & 3));
        const Block *own = block_at(place[0] >> 2, place[1] >> 2, place[2] >> 2);
        if (own && own->filled >> own_bit & 1) search(*own, 1, 1, 1, own_bit);
        if (quarter > best) return row;
        for (int z = (place[2] - 1) >> 2; z <= (place[2] + 1) >> 2; ++z)
            for (int y = (place[1] - 1) >> 2; y <= (place[1] + 1) >> 2; ++y)
                for (int x = (place[0] - 1) >> 2; x <= (place[0] + 1) >> 2; ++x) {
                    const int from[3] = {place[0] - 1 - 4 * x, place[1] - 1 - 4 * y, place[2] - 1 - 4 * z};
                    const bool is_own = x == place[0] >> 2 && y == place[1] >> 2 && z == place[2] >> 2;
                    const Block *block = is_own ? own : block_at(x, y, z);
                    if (!block) continue;
                    uint64_t filled = block->filled;
                    for (size_t d = 0; d < 3; ++d) filled &= BLOCK_CELLS.along[d][(7u << (4 + from[d]) >> 4) & 15];
                    if (is_own) filled &= ~(uint64_t(1) << own_bit);
                    for (; filled; filled &= filled - 1) {
                        const int bit = lowest_bit(filled);
                        const BlockCells::Cell cell = BLOCK_CELLS.of[size_t(bit)];
                        search(*block, cell.x - from[0], cell.y - from[1], cell.z - from[2], bit);
                    }
                }
        return row;
    }

    // For each sample, the mean over it and its neighbours of the values of their cubes; 0 without cubes.
    std::vector<int64_t> mean_around(const std::vector<int64_t> &values, const std::vector<int32_t> &rows,
                                     int64_t prior) const {
        std::vector<double> sums(points_.size(), 0.0);  // like NumPy's bincount: exact below 2^53
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
    NearNeighbours near_;
    std::array<Attached, 21> attached_;  // by level, as kept
    std::vector<uint64_t> codes_;        // unit cells of the samples within the octree, which come first
    std::vector<int32_t> given_rows_, own_rows_;  // input row of a stored sample, and the reverse
};

}  // namespace point_octree
