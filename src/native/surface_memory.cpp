// The bodies' surface over the frames of a chunk, for codecs/bodycast/integer_surface.py and surface_memory.py, which
// define the results. Integers only; sums wrap around as in NumPy.

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <stdexcept>
#include <vector>

#include "arrays.h"
#include "integers.h"

namespace {

constexpr int TURN_BITS = 20, SHARE_BITS = 12, NORMAL_BITS = 10;
constexpr size_t SMOOTHED = 6;
constexpr int64_t COUNT_UNIT = 16, PRIOR_UNITS = 32, KEPT_FIFTHS = 4, FARTHEST = 983, MAX_ASIDE = 2621;
constexpr int64_t LARGEST_PLACE = 1 << 23;

using Rows = Input<int64_t, 1>;
using Numbers = Input<int64_t, 2>;
using Turns = Input<int64_t, 3>;

uint64_t product(int64_t a, int64_t b) { return uint64_t(a) * uint64_t(b); }

void require(bool good) {
    if (!good) throw std::invalid_argument("surface_memory: shapes differ, or a row beyond the samples");
}

void require_shape(const Numbers &values, size_t rows, size_t columns = 3) {
    require(values.shape(0) == rows && values.shape(1) == columns);
}

void require_rows(const int64_t *rows, size_t n, size_t end) {
    for (size_t i = 0; i < n; ++i) require(rows[i] >= 0 && size_t(rows[i]) < end);
}

// IntegerSurface.posed: points, normals (m, 3), links (m, 2), shares (m), turns (links, 3, 3), moves (links, 3).
nb::tuple posed_surface(Numbers points, Numbers normals, Numbers links, Rows shares, Turns turns, Numbers moves) {
    const size_t m = points.shape(0), count = moves.shape(0);
    require_shape(points, m);
    require_shape(normals, m);
    require_shape(links, m, 2);
    require_shape(moves, count);
    require(shares.shape(0) == m && turns.shape(0) == count && turns.shape(1) == 3 && turns.shape(2) == 3);
    require_rows(links.data(), links.size(), count);
    const auto turned = [&](int64_t link, const int64_t *v, size_t row) {
        const int64_t *turn = turns.data() + 9 * size_t(link) + 3 * row;
        return int64_t(product(turn[0], v[0]) + product(turn[1], v[1]) + product(turn[2], v[2])) >> TURN_BITS;
    };
    Fresh<int64_t> places(3 * m), directions(3 * m);
    for (size_t i = 0; i < m; ++i) {
        const int64_t *pair = links.data() + 2 * i, share = shares.data()[i];
        for (size_t d = 0; d < 3; ++d) {
            directions.data[3 * i + d] = turned(pair[0], normals.data() + 3 * i, d);
            const int64_t first = turned(pair[0], points.data() + 3 * i, d) + moves.data()[3 * size_t(pair[0]) + d];
            places.data[3 * i + d] = first;
            if (pair[0] == pair[1]) continue;
            const int64_t second = turned(pair[1], points.data() + 3 * i, d) + moves.data()[3 * size_t(pair[1]) + d];
            places.data[3 * i + d] = second + (int64_t(product(first - second, share)) >> SHARE_BITS);
        }
    }
    return nb::make_tuple(places.give({m, 3}), directions.give({m, 3}));
}

// SampleTable.canonical. Table: canonical (t, 3). Frame: rows (m), places (m, 3), links (m), turns (links, 3, 3), points (n, 3),
// samples (n).
Output<int64_t> canonical_places(Numbers canonical, Rows rows, Numbers places, Rows links, Turns turns, Numbers points,
                                 Rows samples) {
    const size_t m = rows.shape(0), n = samples.shape(0);
    require_shape(canonical, canonical.shape(0));
    require_shape(places, m);
    require_shape(points, n);
    require(links.shape(0) == m && turns.shape(1) == 3 && turns.shape(2) == 3);
    require_rows(rows.data(), m, canonical.shape(0));
    require_rows(links.data(), m, turns.shape(0));
    require_rows(samples.data(), n, m);
    Fresh<int64_t> out(3 * n);
    for (size_t i = 0; i < n; ++i) {
        const size_t sample = size_t(samples.data()[i]);
        const int64_t *turn = turns.data() + 9 * size_t(links.data()[sample]), *origin = canonical.data() + 3 * size_t(rows.data()[sample]);
        int64_t apart[3];
        for (size_t d = 0; d < 3; ++d) apart[d] = points.data()[3 * i + d] - places.data()[3 * sample + d];
        for (size_t d = 0; d < 3; ++d) {
            const uint64_t sum = product(turn[d], apart[0]) + product(turn[3 + d], apart[1]) + product(turn[6 + d], apart[2]);
            out.data[3 * i + d] = std::clamp(origin[d] + (int64_t(sum) >> TURN_BITS), -LARGEST_PLACE, LARGEST_PLACE);
        }
    }
    return out.give({n, 3});
}

// PlaceMemory.corrected. Frame: rows (m), places, normals (m, 3). Memory: neighbours (t, k), distances, counts (t).
Output<int64_t> corrected_places(Rows rows, Numbers places, Numbers normals, Numbers neighbours, Rows distances,
                                 Rows counts) {
    const size_t m = rows.shape(0), table = distances.shape(0), around = neighbours.shape(1);
    require_shape(places, m);
    require_shape(normals, m);
    require(neighbours.shape(0) == table && counts.shape(0) == table);
    require_rows(rows.data(), m, table);
    require_rows(neighbours.data(), neighbours.size(), table);
    Fresh<int64_t> out(3 * m);
    for (size_t i = 0; i < m; ++i) {
        const size_t row = size_t(rows.data()[i]);
        int64_t distance = 2 * distances.data()[row], count = 2 * counts.data()[row] + PRIOR_UNITS;
        for (size_t k = 0; k < std::min(around, SMOOTHED); ++k) {
            const size_t other = size_t(neighbours.data()[row * around + k]);
            distance += distances.data()[other];
            count += counts.data()[other];
        }
        const int64_t offset = floor_quotient(COUNT_UNIT * distance, count);
        for (size_t d = 0; d < 3; ++d)
            out.data[3 * i + d] = places.data()[3 * i + d] + (int64_t(product(offset, normals.data()[3 * i + d])) >> NORMAL_BITS);
    }
    return out.give({m, 3});
}

// PlaceMemory.learn: updates distances and counts from points (n, 3) with samples (n), negative: none.
void learn_places(Rows rows, Numbers places, Numbers normals, Numbers points, Rows samples, InPlace<int64_t, 1> distances,
                  InPlace<int64_t, 1> counts) {
    const size_t m = rows.shape(0), n = samples.shape(0), table = distances.shape(0);
    require_shape(places, m);
    require_shape(normals, m);
    require_shape(points, n);
    require(counts.shape(0) == table);
    require_rows(rows.data(), m, table);
    for (size_t s = 0; s < table; ++s) {
        distances.data()[s] = floor_quotient(distances.data()[s] * KEPT_FIFTHS, 5);
        counts.data()[s] = floor_quotient(counts.data()[s] * KEPT_FIFTHS, 5);
    }
    for (size_t i = 0; i < n; ++i) {
        const int64_t sample = samples.data()[i];
        if (sample < 0) continue;
        require(size_t(sample) < m);
        uint64_t sum = 0;
        for (size_t d = 0; d < 3; ++d)
            sum += product(points.data()[3 * i + d] - places.data()[3 * size_t(sample) + d], normals.data()[3 * size_t(sample) + d]);
        const int64_t distance = int64_t(sum) >> NORMAL_BITS;
        if (distance > FARTHEST || distance < -FARTHEST) continue;
        const size_t row = size_t(rows.data()[sample]);
        distances.data()[row] += distance;
        counts.data()[row] += COUNT_UNIT;
    }
}

// reference_points.explained_points. places, normals (m, 3): of a frame; points (n, 3); nearest (n): sample near each
// point, negative: none.
Output<uint8_t> explained_points(Numbers places, Numbers normals, Numbers points, Rows nearest) {
    const size_t m = places.shape(0), n = nearest.shape(0);
    require_shape(places, m);
    require_shape(normals, m);
    require_shape(points, n);
    Fresh<uint8_t> out(n);
    for (size_t i = 0; i < n; ++i) {
        const int64_t sample = nearest.data()[i];
        out.data[i] = 0;
        if (sample < 0) continue;
        require(size_t(sample) < m);
        uint64_t sum = 0, square = 0;
        for (size_t d = 0; d < 3; ++d) {
            const int64_t apart = points.data()[3 * i + d] - places.data()[3 * size_t(sample) + d];
            sum += product(apart, normals.data()[3 * size_t(sample) + d]);
            square += product(apart, apart);
        }
        const int64_t distance = int64_t(sum) >> NORMAL_BITS;
        out.data[i] = distance <= FARTHEST && distance >= -FARTHEST && int64_t(square) <= MAX_ASIDE * MAX_ASIDE;
    }
    return out.give({n});
}

}  // namespace

void bind_surface_memory(nb::module_ &m) {
    m.def("posed_surface", &posed_surface);
    m.def("canonical_places", &canonical_places);
    m.def("corrected_places", &corrected_places);
    m.def("learn_places", &learn_places, nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg().noconvert(),
          nb::arg().noconvert());
    m.def("explained_points", &explained_points);
}
