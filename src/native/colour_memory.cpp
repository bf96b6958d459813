// Colours that earlier frames showed on the bodies' surface, for codecs/bodycast/surface_memory.py, which defines the
// results. Integers only: floats hold keys to compare, doubles exact quotients.

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <stdexcept>
#include <vector>

#include "arrays.h"
#include "integers.h"
#include "least_lanes.h"

namespace {

constexpr size_t KEPT = 8, SEARCHED = 7;  // kept points of a sample; samples searched for candidates
constexpr size_t AVERAGED = 4;            // nearest candidates to average
constexpr size_t CANDIDATES = KEPT * SEARCHED;
constexpr double PLACE_WEIGHT = double(int64_t(1) << 40);
constexpr int64_t PLACE_SOFTENING = 2000;
constexpr int32_t LARGEST_PLACE = 1 << 23;

using Rows = Input<int64_t, 1>;
using Numbers = Input<int64_t, 2>;
using Places = Input<int32_t, 3>;   // (m, 3, KEPT)
using Colours = Input<int16_t, 3>;  // (m, KEPT, 3)
using Place = std::array<int32_t, 3>;

void require(bool good, const char *what) {
    if (!good) throw std::invalid_argument(what);
}

// The nearest candidates of a place, in any order: their numbers and squared distances. Of equal ones the first count.
struct Nearest {
    std::array<size_t, AVERAGED> slot;
    std::array<int64_t, AVERAGED> square;
};

// The points kept by a sample and its neighbours.
class Candidates {
public:
    Candidates(const int32_t *places, const std::array<size_t, SEARCHED> &searched) : places_(places), searched_(searched) {}

    size_t sample_of(size_t slot) const { return searched_[slot / KEPT]; }

    // Coordinates of the points of searched sample k along an axis (KEPT).
    const int32_t *coordinates(size_t k, size_t axis) const { return places_ + (3 * searched_[k] + axis) * KEPT; }

    Nearest nearest(const Place &place) const {
        Nearest result;
        result.square.fill(INT64_MAX);
        for (size_t slot = 0; slot < CANDIDATES; ++slot) {
            int64_t square = 0;
            for (size_t axis = 0; axis < 3; ++axis) {
                const int64_t apart = coordinates(slot / KEPT, axis)[slot % KEPT] - place[axis];
                square += apart * apart;
            }
            if (square >= result.square[AVERAGED - 1]) continue;
            size_t i = AVERAGED - 1;
            for (; i && result.square[i - 1] > square; --i) result.square[i] = result.square[i - 1], result.slot[i] = result.slot[i - 1];
            result.square[i] = square;
            result.slot[i] = slot;
        }
        return result;
    }

private:
    const int32_t *places_;
    const std::array<size_t, SEARCHED> &searched_;
};

#if defined(__SSE2__)

// Candidates around an origin in 16-bit numbers. Those beyond FAR are moved to FAR, so a search may fail.
class NearCandidates {
public:
    NearCandidates(const Candidates &candidates, const Place &origin) : origin_(origin) {
        for (size_t k = 0; k < SEARCHED; ++k) {
            __m128i near[3];
            for (size_t axis = 0; axis < 3; ++axis) near[axis] = limited(candidates.coordinates(k, axis), origin[axis]);
            __m128i *xy = xy_ + 2 * k, *z = z_ + 2 * k;
            xy[0] = _mm_unpacklo_epi16(near[0], near[1]);
            xy[1] = _mm_unpackhi_epi16(near[0], near[1]);
            z[0] = _mm_unpacklo_epi16(near[2], _mm_setzero_si128());
            z[1] = _mm_unpackhi_epi16(near[2], _mm_setzero_si128());
        }
        std::fill(xy_ + CANDIDATES / 4, xy_ + GROUPS, _mm_set1_epi16(FAR));
        std::fill(z_ + CANDIDATES / 4, z_ + GROUPS, _mm_setzero_si128());
    }

    // Finds the nearest candidates; false if candidates beyond FAR may be among them.
    bool find(const Place &place, Nearest &nearest) const {
        int32_t own[3];
        for (size_t axis = 0; axis < 3; ++axis) {
            own[axis] = place[axis] - origin_[axis];
            if (std::abs(own[axis]) > REACH) return false;
        }
        alignas(16) int32_t squares[4 * GROUPS];
        const int32_t limit = find_squares(own, squares);
        if (limit - ONE >= (FAR - REACH) * (FAR - REACH)) return false;
        uint64_t nearer = bits_within(squares, limit), as_near = 0;
        if (has_more_than_averaged(nearer)) {
            as_near = nearer;
            nearer = bits_within(squares, limit - 1);
            as_near &= ~nearer;
        }
        for (size_t i = 0; i < AVERAGED; ++i) {
            uint64_t &bits = nearer ? nearer : as_near;
            nearest.slot[i] = size_t(lowest_bit(bits));
            nearest.square[i] = squares[nearest.slot[i]] - ONE;
            bits &= bits - 1;
        }
        return true;
    }

private:
    static constexpr size_t GROUPS = 16;  // four at a time; those without candidates are far
    static constexpr int32_t FAR = 16000, REACH = 2800;  // 2^-16 m: (FAR + REACH)² · 3 < 2^30
    static constexpr int32_t ONE = 1 << 30;              // added to squares: floats with their bits have the same order

    // KEPT coordinates relative to the origin's.
    static __m128i limited(const int32_t *coordinates, int32_t origin) {
        const auto four = [&](const int32_t *at) {
            return _mm_sub_epi32(_mm_loadu_si128(reinterpret_cast<const __m128i *>(at)), _mm_set1_epi32(origin));
        };
        const __m128i eight = _mm_packs_epi32(four(coordinates), four(coordinates + 4));
        return _mm_max_epi16(_mm_min_epi16(eight, _mm_set1_epi16(FAR)), _mm_set1_epi16(-FAR));
    }

    // The sums of ONE and the squared distances of all candidates; returns the AVERAGED-th least.
    int32_t find_squares(const int32_t *own, int32_t *squares) const {
        const __m128i xy = _mm_set1_epi32((own[0] & 0xffff) | int32_t(uint32_t(own[1]) << 16));
        const __m128i z = _mm_set1_epi32((own[2] & 0xffff) | int32_t(0x80000000));  // (−2^15)² is ONE
        const auto four = [&](size_t group) {
            const __m128i aside = _mm_sub_epi16(xy, xy_[group]), along = _mm_sub_epi16(z, z_[group]);
            const __m128i sum = _mm_add_epi32(_mm_madd_epi16(aside, aside), _mm_madd_epi16(along, along));
            _mm_store_si128(reinterpret_cast<__m128i *>(squares) + group, sum);
            return _mm_castsi128_ps(sum);
        };
        LeastLanes least = LeastLanes::of(four(0), four(1), four(2), four(3));
        for (size_t group = 4; group < GROUPS; group += 4)
            least.merge(LeastLanes::of(four(group), four(group + 1), four(group + 2), four(group + 3)));
        least.merge_lanes();
        return _mm_cvtsi128_si32(_mm_castps_si128(least.least[AVERAGED - 1]));
    }

    // A bit for each square that is at most the limit.
    static uint64_t bits_within(const int32_t *squares, int32_t limit) {
        const __m128i above = _mm_set1_epi32(limit + 1);
        uint64_t bits = 0;
        for (size_t start = 0; start < CANDIDATES; start += KEPT) {
            const auto four = [&](size_t at) { return _mm_cmplt_epi32(_mm_load_si128(reinterpret_cast<const __m128i *>(squares + at)), above); };
            const __m128i eight = _mm_packs_epi32(four(start), four(start + 4));
            bits |= uint64_t(_mm_movemask_epi8(_mm_packs_epi16(eight, _mm_setzero_si128()))) << start;
        }
        return bits;
    }

    static bool has_more_than_averaged(uint64_t bits) {
        for (size_t i = 0; i < AVERAGED; ++i) bits &= bits - 1;
        return bits != 0;
    }

    Place origin_;
    __m128i xy_[GROUPS], z_[GROUPS];  // x and y in turn; z and 0 in turn
};

#else

struct NearCandidates {
    NearCandidates(const Candidates &, const Place &) {}
    bool find(const Place &, Nearest &) const { return false; }
};

#endif

// surface_memory.mean_colour. Quotients of doubles are exact enough: if they are no integers, they are farther from one
// than 2^-50 of their size.
void average(const Nearest &nearest, const Candidates &candidates, const int16_t *colours, int16_t *mean) {
    double total = 0, sums[3] = {0, 0, 0};
    for (size_t i = 0; i < AVERAGED; ++i) {
        const size_t slot = nearest.slot[i];
        const int16_t *colour = colours + 3 * (KEPT * candidates.sample_of(slot) + slot % KEPT);
        const double weight = double(int64_t(PLACE_WEIGHT / double(nearest.square[i] + PLACE_SOFTENING)));
        total += weight;
        for (size_t d = 0; d < 3; ++d) sums[d] += weight * colour[d];
    }
    total = std::max(total, 1.0);
    const double half = double(int64_t(total / 2));
    for (size_t d = 0; d < 3; ++d) {
        const double quotient = (sums[d] + half) / total;
        const int32_t whole = int32_t(quotient);
        mean[d] = int16_t(whole - (whole > quotient));
    }
}

// Numbers of the points in the order of their rows; starts (samples + 1): where the points of each row are.
std::vector<uint32_t> points_by_row(const Rows &rows, std::vector<uint32_t> &starts) {
    const size_t n = rows.shape(0), samples = starts.size() - 1;
    for (size_t i = 0; i < n; ++i) {
        require(rows.data()[i] >= 0 && size_t(rows.data()[i]) < samples, "expected_colours: a row beyond the samples");
        ++starts[size_t(rows.data()[i])];
    }
    uint32_t end = 0;
    for (uint32_t &start : starts) end += start, start = end;
    std::vector<uint32_t> points(n);
    for (size_t i = n; i--;) points[--starts[size_t(rows.data()[i])]] = uint32_t(i);
    return points;
}

// ColourMemory.expected. rows (n), places (n, 3): of the points; neighbours (m, SEARCHED - 1), known places and colours of the
// memory.
Output<int16_t> expected_colours(Rows rows, Numbers places, Numbers neighbours, Places known, Colours colours) {
    const size_t n = rows.shape(0), samples = known.shape(0);
    require(places.shape(0) == n && places.shape(1) == 3 && neighbours.shape(0) == samples && neighbours.shape(1) == SEARCHED - 1 &&
                known.shape(1) == 3 && known.shape(2) == KEPT && colours.shape(0) == samples && colours.shape(1) == KEPT &&
                colours.shape(2) == 3,
            "expected_colours: shapes differ");
    for (size_t i = 0; i < 3 * n; ++i)
        require(std::abs(places.data()[i]) <= LARGEST_PLACE, "expected_colours: a place out of range");
    Fresh<int16_t> out(3 * n);
    {
        nb::gil_scoped_release release;
        std::vector<uint32_t> starts(samples + 1);
        const std::vector<uint32_t> points = points_by_row(rows, starts);
        const auto place_of = [&](uint32_t point) {
            const int64_t *at = places.data() + 3 * point;
            return Place{int32_t(at[0]), int32_t(at[1]), int32_t(at[2])};
        };
        for (size_t row = 0; row < samples; ++row) {
            if (starts[row] == starts[row + 1]) continue;
            std::array<size_t, SEARCHED> searched{row};
            for (size_t k = 1; k < SEARCHED; ++k) {
                const int64_t neighbour = neighbours.data()[row * (SEARCHED - 1) + k - 1];
                require(neighbour >= 0 && size_t(neighbour) < samples, "expected_colours: a row beyond the samples");
                searched[k] = size_t(neighbour);
            }
            const Candidates candidates(known.data(), searched);
            const NearCandidates near(candidates, place_of(points[starts[row]]));
            for (size_t i = starts[row]; i < starts[row + 1]; ++i) {
                Nearest nearest;
                if (!near.find(place_of(points[i]), nearest)) nearest = candidates.nearest(place_of(points[i]));
                average(nearest, candidates, colours.data(), out.data.get() + 3 * points[i]);
            }
        }
    }
    return out.give({n, 3});
}

// ColourMemory.learn: updates known places (m, 3, kept), shown colours (m, kept, 3) and numbers of seen points (m) with
// rows (n), places and colours (n, 3).
void learn_colours(Rows rows, Numbers places, Input<int16_t, 2> colours, InPlace<int32_t, 3> known, InPlace<int16_t, 3> shown,
                   InPlace<int64_t, 1> seen) {
    const size_t n = rows.shape(0), samples = seen.shape(0);
    require(places.shape(0) == n && places.shape(1) == 3 && colours.shape(0) == n && colours.shape(1) == 3 && known.shape(0) == samples &&
                known.shape(1) == 3 && known.shape(2) == KEPT && shown.shape(0) == samples && shown.shape(1) == KEPT && shown.shape(2) == 3,
            "learn_colours: shapes differ");
    for (size_t i = 0; i < n; ++i) {
        require(rows.data()[i] >= 0 && size_t(rows.data()[i]) < samples, "learn_colours: a row beyond the samples");
        const size_t row = size_t(rows.data()[i]), slot = size_t(seen.data()[row]++) % KEPT;
        for (size_t d = 0; d < 3; ++d) {
            known.data()[(3 * row + d) * KEPT + slot] = int32_t(places.data()[3 * i + d]);
            shown.data()[3 * (KEPT * row + slot) + d] = colours.data()[3 * i + d];
        }
    }
}

}  // namespace

void bind_colour_memory(nb::module_ &m) {
    m.def("expected_colours", &expected_colours);
    m.def("learn_colours", &learn_colours, nb::arg(), nb::arg(), nb::arg(), nb::arg().noconvert(), nb::arg().noconvert(),
          nb::arg().noconvert());
}
