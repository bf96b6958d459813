// Estimates the surface of points, for codecs/bodycast/reference_surface.py, which defines the results. Integers only.
//
//     points ─► nearest points of each ─► fitted plane ─► places on it, normals, neighbours with similar normals

#include <array>
#include <cmath>

#include "integers.h"
#include "nearest_others.h"
#include "octree_surface.h"

namespace {

using point_octree::NEIGHBOURS;
using point_octree::NORMAL_BITS;
using point_octree::Place;

constexpr int SPREAD_BITS = 9, COLUMN_BITS = 20;

// Normal of the plane through the origin that fits points.
Place plane_normal(const std::array<Place, NEIGHBOURS> &apart) {
    uint64_t widest = 0;
    for (const Place &p : apart)
        for (int64_t v : p) widest = std::max(widest, uint64_t(v < 0 ? -v : v));
    const int excess = std::max(bit_length(widest) - SPREAD_BITS, 0);
    int64_t total[3] = {}, c[3][3] = {};
    for (const Place &p : apart)
        for (int i = 0; i < 3; ++i) {
            total[i] += p[size_t(i)] >> excess;
            for (int j = i; j < 3; ++j) c[i][j] += (p[size_t(i)] >> excess) * (p[size_t(j)] >> excess);
        }
    for (int i = 0; i < 3; ++i)
        for (int j = i; j < 3; ++j) c[i][j] = (NEIGHBOURS + 1) * c[i][j] - total[i] * total[j];
    const int64_t xx = c[0][0], xy = c[0][1], xz = c[0][2], yy = c[1][1], yz = c[1][2], zz = c[2][2];
    const int64_t upper[3] = {xz * yz - xy * zz, xy * yz - xz * yy, xy * xz - xx * yz};
    const Place columns[3] = {{yy * zz - yz * yz, upper[0], upper[1]},
                              {upper[0], xx * zz - xz * xz, upper[2]},
                              {upper[1], upper[2], xx * yy - xy * xy}};
    size_t largest = 0;
    for (size_t k = 1; k < 3; ++k)
        if (columns[k][k] > columns[largest][largest]) largest = k;
    Place column = columns[largest];
    uint64_t size = 0, square = 0;
    for (int64_t v : column) size = std::max(size, uint64_t(v < 0 ? -v : v));
    const int surplus = std::max(bit_length(size) - COLUMN_BITS, 0);
    for (int64_t &v : column) {
        v >>= surplus;
        square += uint64_t(v * v);
    }
    const int64_t length = int64_t(std::sqrt(double(square)));
    if (!length) return {0, 0, int64_t(1) << NORMAL_BITS};
    for (int64_t &v : column) v = floor_division(v * (int64_t(1) << NORMAL_BITS), length);
    return column;
}

// Nearest other points (m, NEIGHBOURS) of points (m, 3), equal distances by row. m > NEIGHBOURS; magnitudes below 2^30.
Output<int64_t> nearest_others(Input<int64_t, 2> points) {
    const size_t m = points.shape(0);
    if (points.shape(1) != 3 || m <= size_t(NEIGHBOURS)) throw std::invalid_argument("nearest_others: shapes differ");
    std::vector<Place> own(m);
    for (size_t i = 0; i < m; ++i)
        for (size_t d = 0; d < 3; ++d) {
            own[i][d] = points.data()[3 * i + d];
            if (std::abs(own[i][d]) >= int64_t(1) << 30) throw std::invalid_argument("nearest_others: range");
        }
    Fresh<int64_t> rows(m * NEIGHBOURS);
    NearestOthers(own).find<NEIGHBOURS>(rows.data.get());
    return rows.give({m, size_t(NEIGHBOURS)});
}

// surface_of_points: (places, normals, neighbours) of points (m, 3), which are distinct and below 2^24.
nb::tuple surface_of_points(Input<int64_t, 2> points) {
    const size_t m = points.shape(0);
    if (points.shape(1) != 3 || m <= size_t(NEIGHBOURS)) throw std::invalid_argument("surface_of_points: shapes differ");
    std::vector<Place> own(m);
    Place centre = {0, 0, 0};
    for (size_t i = 0; i < m; ++i) {
        std::copy_n(points.data() + 3 * i, 3, own[i].begin());
        for (size_t d = 0; d < 3; ++d) {
            if (own[i][d] < 0 || own[i][d] >= int64_t(1) << 24) throw std::invalid_argument("surface_of_points: range");
            centre[d] += own[i][d];
        }
    }
    for (int64_t &v : centre) v = floor_division(v, int64_t(m));
    Fresh<int64_t> around(m * NEIGHBOURS), places(3 * m), normals(3 * m);
    NearestOthers(own).find<NEIGHBOURS>(around.data.get());
    for (size_t i = 0; i < m; ++i) {
        std::array<Place, NEIGHBOURS> apart;
        Place total = {0, 0, 0}, outward;
        for (size_t k = 0; k < size_t(NEIGHBOURS); ++k)
            for (size_t d = 0; d < 3; ++d) {
                apart[k][d] = own[size_t(around.data[i * NEIGHBOURS + k])][d] - own[i][d];
                total[d] += apart[k][d];
            }
        Place normal = plane_normal(apart);
        for (size_t d = 0; d < 3; ++d) outward[d] = own[i][d] - centre[d];
        if (dot(outward.data(), normal.data()) < 0)
            for (int64_t &v : normal) v = -v;
        const int64_t offset = floor_division(dot(total.data(), normal.data()) >> NORMAL_BITS, NEIGHBOURS + 1);
        for (size_t d = 0; d < 3; ++d) {
            places.data[3 * i + d] = own[i][d] + (offset * normal[d] >> NORMAL_BITS);
            normals.data[3 * i + d] = normal[d];
        }
    }
    for (size_t i = 0; i < m; ++i) {
        int64_t *row = &around.data[i * NEIGHBOURS];
        const int64_t *n = &normals.data[3 * i];
        size_t kept = 0;
        for (size_t k = 0; k < size_t(NEIGHBOURS); ++k) {
            if (dot(n, &normals.data[3 * size_t(row[k])]) > 0) row[kept++] = row[k];
        }
        std::fill(row + kept, row + NEIGHBOURS, int64_t(i));
    }
    return nb::make_tuple(places.give({m, 3}), normals.give({m, 3}), around.give({m, size_t(NEIGHBOURS)}));
}

}  // namespace

void bind_reference_surface(nb::module_ &m) {
    m.def("nearest_others", &nearest_others);
    m.def("surface_of_points", &surface_of_points);
}
