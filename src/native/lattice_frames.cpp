// Points on a lattice: cells, places and distances, for codecs/bodycast/lattice_frames.py, lattice.py, octree.py and
// integer_surface.py, which define the results. Float operations have NumPy's order.

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "key_order.h"
#include "octree_surface.h"
#include "rounding.h"

namespace {

using Numbers = Input<int64_t, 2>;
using Values = Input<double, 2>;

void require(bool good) {
    if (!good) throw std::invalid_argument("lattice_frames: shapes differ, or a row lies beyond the points");
}

double square(double x, double y, double z) { return x * x + y * y + z * z; }

// Numbers beyond 64 bits become the least integer, as in NumPy on most processors.
int64_t whole(double value) {
    return std::abs(value) < 9.2e18 ? int64_t(value) : std::numeric_limits<int64_t>::min();
}

double rounded_down(double value) {
    if (!(std::abs(value) < 9e15)) return std::floor(value);
    const double cut = double(int64_t(value));
    return cut - (cut > value);
}

// The lattice point nearest to each of points (n, 3).
Output<int64_t> nearest_lattice_points(Values points, double step) {
    const size_t n = points.shape(0);
    require(points.shape(1) == 3);
    Fresh<int64_t> cells(3 * n);
    for (size_t i = 0; i < n; ++i) {
        double even[3], odd[3], from_even[3], from_odd[3];
        for (size_t d = 0; d < 3; ++d) {
            const double scaled = points.data()[3 * i + d] / step;
            even[d] = 2 * rounded(scaled / 2);
            odd[d] = 2 * rounded((scaled - 1) / 2) + 1;
            from_even[d] = scaled - even[d];
            from_odd[d] = scaled - odd[d];
        }
        const bool is_odd = square(from_odd[0], from_odd[1], from_odd[2]) < square(from_even[0], from_even[1], from_even[2]);
        for (size_t d = 0; d < 3; ++d) cells.data[3 * i + d] = whole(is_odd ? odd[d] : even[d]);
    }
    return cells.give({n, 3});
}

// Distance of each of originals (m, 3) from its own decoded point: decoded (n, 3) at rows (m).
Output<double> own_distances(Values originals, Values decoded, Input<int64_t, 1> rows) {
    const size_t m = originals.shape(0), n = decoded.shape(0);
    require(originals.shape(1) == 3 && decoded.shape(1) == 3 && rows.shape(0) == m);
    Fresh<double> distances(m);
    for (size_t i = 0; i < m; ++i) {
        const int64_t row = rows.data()[i];
        require(row >= 0 && size_t(row) < n);
        const double *a = originals.data() + 3 * i, *b = decoded.data() + 3 * size_t(row);
        distances.data[i] = std::sqrt(square(a[0] - b[0], a[1] - b[1], a[2] - b[2]));
    }
    return distances.give({m});
}

// Places of cells (n, 3), relative to corner (3), after shifts (n, 3) in 2^-bits units. step: of the shifts, metres.
Output<double> shifted_positions(Numbers cells, Input<int64_t, 1> corner, Numbers shifts, int bits, double step) {
    const size_t n = cells.shape(0);
    require(cells.shape(1) == 3 && corner.shape(0) == 3 && shifts.shape(0) == n && shifts.shape(1) == 3 && bits >= 0 && bits < 32);
    Fresh<double> places(3 * n);
    for (size_t i = 0; i < n; ++i)
        for (size_t d = 0; d < 3; ++d) {
            const uint64_t cell = uint64_t(cells.data()[3 * i + d] + corner.data()[d]) << bits;
            places.data[3 * i + d] = double(int64_t(cell + uint64_t(shifts.data()[3 * i + d]))) * step;
        }
    return places.give({n, 3});
}

// Places of cells (n, 3), relative to corner (3), in units of 1 / scale, rounded down; at most `limit` from the origin.
Output<int64_t> places_of_cells(Numbers cells, Input<int64_t, 1> corner, double scale, double limit) {
    const size_t n = cells.shape(0);
    require(cells.shape(1) == 3 && corner.shape(0) == 3);
    Fresh<int64_t> places(3 * n);
    for (size_t i = 0; i < n; ++i)
        for (size_t d = 0; d < 3; ++d) {
            const double place = double(cells.data()[3 * i + d] + corner.data()[d]) * scale;
            places.data[3 * i + d] = int64_t(rounded_down(std::min(std::max(place, -limit), limit)));
        }
    return places.give({n, 3});
}

// octree.morton_codes of cells (n, 3), with coordinates 0 … 2^20 − 1.
Output<int64_t> morton_codes(Numbers cells) {
    const size_t n = cells.shape(0);
    require(cells.shape(1) == 3);
    Fresh<int64_t> codes(n);
    for (size_t i = 0; i < n; ++i) {
        const int64_t *cell = cells.data() + 3 * i;
        codes.data[i] = int64_t(point_octree::morton_code(cell[0], cell[1], cell[2]));
    }
    return codes.give({n});
}

// The inverse of `morton_codes`.
Output<int64_t> cells_of_codes(Input<int64_t, 1> codes) {
    const size_t n = codes.shape(0);
    Fresh<int64_t> cells(3 * n);
    for (size_t i = 0; i < n; ++i)
        for (size_t d = 0; d < 3; ++d) cells.data[3 * i + d] = point_octree::gathered_bits(uint64_t(codes.data()[i]) >> d);
    return cells.give({n, 3});
}

// (2, 3): the least and the largest coordinates of cells (n, 3), n > 0.
Output<int64_t> box_of_cells(Numbers cells) {
    const size_t n = cells.shape(0);
    require(cells.shape(1) == 3 && n > 0);
    std::array<int64_t, 3> low, high;
    std::copy_n(cells.data(), 3, low.begin());
    high = low;
    for (size_t i = 1; i < n; ++i)
        for (size_t d = 0; d < 3; ++d) {
            const int64_t v = cells.data()[3 * i + d];
            low[d] = std::min(low[d], v), high[d] = std::max(high[d], v);
        }
    Fresh<int64_t> box(6);
    std::copy(low.begin(), low.end(), box.data.get());
    std::copy(high.begin(), high.end(), box.data.get() + 3);
    return box.give({2, 3});
}

// (codes, rows): the sorted distinct codes of cells (n, 3) from a corner (3), with coordinates 0 … 2^20 − 1 from there, and
// which of them is that of each.
nb::tuple distinct_codes(Numbers cells, Input<int64_t, 1> corner) {
    const size_t n = cells.shape(0);
    require(cells.shape(1) == 3 && corner.shape(0) == 3 && n <= std::numeric_limits<uint32_t>::max());
    const int64_t *from = corner.data();
    std::vector<KeyOfRow> sorted(n);
    for (size_t i = 0; i < n; ++i) {
        const int64_t *cell = cells.data() + 3 * i;
        sorted[i] = {point_octree::morton_code(cell[0] - from[0], cell[1] - from[1], cell[2] - from[2]), uint32_t(i)};
    }
    sort_keys(sorted);
    Fresh<int64_t> codes(n), rows(n);
    size_t count = 0;
    for (size_t i = 0; i < n; ++i) {
        if (!i || sorted[i].key != sorted[i - 1].key) codes.data[count++] = int64_t(sorted[i].key);
        rows.data[sorted[i].row] = int64_t(count) - 1;
    }
    return nb::make_tuple(codes.give({count}), rows.give({n}));
}

// The mean colour of each of `count` rows, halves rounded to even: colours (n, 3) at rows (n). Each row has colours.
Output<uint8_t> mean_colours(Input<uint8_t, 2> colours, Input<int64_t, 1> rows, size_t count) {
    const size_t n = rows.shape(0);
    require(colours.shape(0) == n && colours.shape(1) == 3);
    std::vector<std::array<int64_t, 4>> sums(count, {0, 0, 0, 0});
    for (size_t i = 0; i < n; ++i) {
        require(rows.data()[i] >= 0 && size_t(rows.data()[i]) < count);
        std::array<int64_t, 4> &sum = sums[size_t(rows.data()[i])];
        for (size_t d = 0; d < 3; ++d) sum[d] += colours.data()[3 * i + d];
        ++sum[3];
    }
    Fresh<uint8_t> means(3 * count);
    for (size_t row = 0; row < count; ++row)
        for (size_t d = 0; d < 3; ++d)
            means.data[3 * row + d] = uint8_t(rounded(double(sums[row][d]) / double(std::max<int64_t>(sums[row][3], 1))));
    return means.give({count, 3});
}

// Median of the squared distances of points (m, 3) from their first neighbours; neighbours (m, k).
int64_t median_gap(Numbers points, Numbers neighbours) {
    const size_t m = points.shape(0);
    require(points.shape(1) == 3 && neighbours.shape(0) == m && neighbours.shape(1) > 0 && m > 0);
    std::vector<int64_t> gaps(m);
    for (size_t i = 0; i < m; ++i) {
        const int64_t row = neighbours.data()[neighbours.shape(1) * i];
        require(row >= 0 && size_t(row) < m);
        uint64_t sum = 0;
        for (size_t d = 0; d < 3; ++d) {
            const uint64_t apart = uint64_t(points.data()[3 * size_t(row) + d]) - uint64_t(points.data()[3 * i + d]);
            sum += apart * apart;
        }
        gaps[i] = int64_t(sum);
    }
    std::nth_element(gaps.begin(), gaps.begin() + std::ptrdiff_t(m / 2), gaps.end());
    return gaps[m / 2];
}

}  // namespace

void bind_lattice_frames(nb::module_ &m) {
    m.def("nearest_lattice_points", &nearest_lattice_points);
    m.def("own_distances", &own_distances);
    m.def("shifted_positions", &shifted_positions);
    m.def("places_of_cells", &places_of_cells);
    m.def("morton_codes", &morton_codes);
    m.def("cells_of_codes", &cells_of_codes);
    m.def("box_of_cells", &box_of_cells);
    m.def("distinct_codes", &distinct_codes);
    m.def("mean_colours", &mean_colours);
    m.def("median_gap", &median_gap);
}
