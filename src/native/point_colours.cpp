// Colours of lattice points, for codecs/bodycast/surface_memory.py and colour_lifting.py, which define the results.
// Integers only.

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <vector>

#include "bit_arrays.h"

namespace {

constexpr size_t AVERAGED = 4;                          // points whose mean counts
constexpr int64_t PLACE_WEIGHT = int64_t(1) << 40, PLACE_SOFTENING = 2000;
constexpr int64_t CELL_WEIGHT = 1 << 20, CELL_SOFTENING = 2, WINDOW = 16;
constexpr int UNARY = 24, WIDE_BITS = 11, FIRST_MAGNITUDE = 2, WIDE_KIND = FIRST_MAGNITUDE + UNARY;
constexpr int KINDS = WIDE_KIND + WIDE_BITS, CLASSES = 6, ACTIVITIES = 9, LEVELS = 7;

using Numbers = Input<int64_t, 2>;
using Rows = Input<int64_t, 1>;

int64_t floor_division(int64_t a, int64_t b) { return a / b - (a % b != 0 && (a < 0) != (b < 0)); }

int64_t square_between(const int64_t *a, const int64_t *b) {
    int64_t sum = 0;
    for (int d = 0; d < 3; ++d) sum += (a[d] - b[d]) * (a[d] - b[d]);
    return sum;
}

// The AVERAGED smallest of the squares added, the first of equal ones.
struct Nearest {
    std::array<int64_t, AVERAGED> square;
    std::array<size_t, AVERAGED> at;
    size_t count = 0;

    void add(int64_t own, size_t place) {
        if (count == AVERAGED && own >= square[AVERAGED - 1]) return;
        size_t i = count < AVERAGED ? count++ : AVERAGED - 1;
        for (; i && square[i - 1] > own; --i) square[i] = square[i - 1], at[i] = at[i - 1];
        square[i] = own;
        at[i] = place;
    }
};

void require(bool good, const char *what) {
    if (!good) throw std::invalid_argument(what);
}

// ColourMemory._expected: rows (n), places (n, 3); of the memory: neighbours (m, k), places and colours (m, kept, 3).
Output<int64_t> expected_colours(Rows rows, Numbers places, Numbers neighbours, Input<int64_t, 3> known,
                                 Input<int64_t, 3> colours) {
    const size_t n = rows.shape(0), samples = known.shape(0), kept = known.shape(1), around = neighbours.shape(1);
    require(places.shape(0) == n && places.shape(1) == 3 && neighbours.shape(0) == samples && known.shape(2) == 3 &&
                colours.shape(0) == samples && colours.shape(1) == kept && colours.shape(2) == 3,
            "expected_colours: shapes differ");
    for (size_t i = 0; i < neighbours.size(); ++i)
        require(neighbours.data()[i] >= 0 && size_t(neighbours.data()[i]) < samples, "expected_colours: a row beyond the samples");
    Fresh<int64_t> out(3 * n);
    for (size_t i = 0; i < n; ++i) {
        const int64_t row = rows.data()[i];
        require(row >= 0 && size_t(row) < samples, "expected_colours: a row beyond the samples");
        Nearest nearest;
        for (size_t k = 0; k <= around; ++k) {
            const size_t sample = size_t(k ? neighbours.data()[size_t(row) * around + k - 1] : row);
            for (size_t at = sample * kept; at < (sample + 1) * kept; ++at)
                nearest.add(square_between(known.data() + 3 * at, places.data() + 3 * i), at);
        }
        int64_t total = 0, sums[3] = {0, 0, 0};
        for (size_t k = 0; k < nearest.count; ++k) {
            const int64_t weight = PLACE_WEIGHT / (nearest.square[k] + PLACE_SOFTENING);
            total += weight;
            for (int d = 0; d < 3; ++d) sums[d] += weight * colours.data()[3 * nearest.at[k] + size_t(d)];
        }
        total = std::max<int64_t>(total, 1);
        for (int d = 0; d < 3; ++d) out.data[3 * i + size_t(d)] = floor_division(sums[d] + total / 2, total);
    }
    return out.give({n, 3});
}

// colour_lifting._around for a stride above 0: base, correction, activity and spread (n, 3) of each row.
nb::tuple colour_neighbourhoods(Numbers known, Numbers bases, Numbers cells, Rows rows, int64_t stride, Numbers expected,
                                Input<uint8_t, 1> is_expected) {
    const int64_t points = int64_t(cells.shape(0));
    for (const Numbers *each : {&known, &bases, &cells, &expected})
        require(each->shape(0) == size_t(points) && each->shape(1) == 3, "colour_neighbourhoods: shapes differ");
    require(is_expected.shape(0) == size_t(points) && stride > 0, "colour_neighbourhoods: shapes differ");
    const size_t n = rows.shape(0);
    const int64_t count = (points + stride - 1) / stride, width = std::min(WINDOW, count);
    Fresh<int64_t> base(3 * n), correction(3 * n), activity(3 * n), spread(3 * n);
    for (size_t i = 0; i < n; ++i) {
        const int64_t row = rows.data()[i];
        require(row >= 0 && row < points, "colour_neighbourhoods: a row beyond the points");
        const int64_t first = std::clamp<int64_t>(row / stride + 1 - WINDOW / 2, 0, count - width);
        Nearest nearest;
        for (int64_t k = first; k < first + width; ++k)
            nearest.add(square_between(cells.data() + 3 * k * stride, cells.data() + 3 * row), size_t(k * stride));
        int64_t total = 0, mean[3] = {0, 0, 0}, error[3] = {0, 0, 0}, magnitude[3] = {0, 0, 0};
        for (size_t k = 0; k < nearest.count; ++k) {
            const int64_t weight = std::max<int64_t>(CELL_WEIGHT / (nearest.square[k] + CELL_SOFTENING), 1);
            total += weight;
            for (size_t d = 0; d < 3; ++d) {
                const int64_t colour = known.data()[3 * nearest.at[k] + d];
                const int64_t own = colour - bases.data()[3 * nearest.at[k] + d];
                mean[d] += weight * colour;
                error[d] += weight * own;
                magnitude[d] += weight * std::abs(own);
            }
        }
        for (size_t d = 0; d < 3; ++d) {
            const int64_t middle = floor_division(mean[d], total);
            base.data[3 * i + d] = is_expected.data()[row] ? expected.data()[3 * row + int64_t(d)] : middle;
            correction.data[3 * i + d] = floor_division(error[d], total);
            activity.data[3 * i + d] = magnitude[d] / total;
            int64_t farthest = 0;
            for (size_t k = 0; k < nearest.count; ++k)
                farthest = std::max<int64_t>(farthest, std::abs(known.data()[3 * nearest.at[k] + d] - middle));
            spread.data[3 * i + d] = farthest;
        }
    }
    return nb::make_tuple(base.give({n, 3}), correction.give({n, 3}), activity.give({n, 3}), spread.give({n, 3}));
}

// Integers of the points whose classes are in `place` (n, 4), kind after kind of bits. wanted: null in the decoder.
template <class Coder>
Output<int64_t> code_integers(Coder &coder, const int64_t *wanted, const Numbers &place, uint32_t level) {
    require(place.shape(1) == 4 && level < LEVELS, "colour_integers: shapes differ");
    const size_t n = place.shape(0);
    const auto code = [&](uint32_t kind, size_t row, int bit) {
        const int64_t *of = place.data() + 4 * row;
        const uint32_t base = uint32_t(of[0]) * KINDS + kind, activity = uint32_t(of[1]);
        const uint32_t spread = uint32_t(of[2]), coded = uint32_t(of[3]);
        const uint32_t contexts[bits::INPUTS] = {
            base * ACTIVITIES + activity, base * CLASSES + coded, (base * ACTIVITIES + spread) * LEVELS + level,
            (base * ACTIVITIES + activity) * CLASSES + coded, (base * ACTIVITIES + spread) * ACTIVITIES + activity};
        return coder.code(contexts, base * CLASSES + coded, bit);
    };
    const auto magnitude = [&](size_t row) { return wanted ? std::abs(wanted[row]) : 0; };
    Fresh<int64_t> found(n);
    std::vector<size_t> rows;
    for (size_t i = 0; i < n; ++i) {
        found.data[i] = code(0, i, magnitude(i) > 0);
        if (found.data[i]) rows.push_back(i);
    }
    std::vector<size_t> negative;
    for (size_t row : rows)
        if (code(1, row, wanted && wanted[row] < 0)) negative.push_back(row);
    // The rows whose bit of this kind is 1.
    const auto filtered = [&](uint32_t kind, int64_t limit) {
        std::vector<size_t> left;
        for (size_t row : rows)
            if (code(kind, row, magnitude(row) > limit)) left.push_back(row);
        return left;
    };
    for (int size = 0; size < UNARY && !rows.empty(); ++size) {
        rows = filtered(uint32_t(FIRST_MAGNITUDE + size), size + 1);
        for (size_t row : rows) ++found.data[row];
    }
    for (int digit = 0; digit < WIDE_BITS; ++digit)
        for (size_t row : rows)
            found.data[row] += int64_t(code(uint32_t(WIDE_KIND + digit), row, (magnitude(row) - UNARY - 1) >> digit & 1)) << digit;
    for (size_t row : negative) found.data[row] = -found.data[row];
    return found.give({n});
}

Output<int64_t> encode_integers(bit_arrays::BitArrayEncoder &coder, Rows wanted, Numbers place, uint32_t level) {
    require(wanted.shape(0) == place.shape(0), "colour_integers: shapes differ");
    return code_integers(coder, wanted.data(), place, level);
}

Output<int64_t> decode_integers(bit_arrays::BitArrayDecoder &coder, Numbers place, uint32_t level) {
    return code_integers(coder, nullptr, place, level);
}

}  // namespace

void bind_point_colours(nb::module_ &m) {
    m.def("expected_colours", &expected_colours);
    m.def("colour_neighbourhoods", &colour_neighbourhoods);
    m.def("colour_integers_encode", &encode_integers);
    m.def("colour_integers_decode", &decode_integers);
}
