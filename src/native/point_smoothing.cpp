// Moves lattice points towards the surface around them, for codecs/bodycast/point_smoothing.py, which defines the results.
//
//     cells, sample of each point ─► points of the samples around it ─► mean distance along the normals ─► shift

#include "bit_arrays.h"
#include "point_moves.h"

namespace {

using namespace point_moves;

constexpr int64_t LARGEST_SPACING = 1 << 16, LARGEST_CELL = 1 << 29;

// Lattice points (n, 3) as cells.
std::vector<Cell> cells_of(Input<int64_t, 2> cells) {
    std::vector<Cell> result(cells.shape(0));
    if (cells.shape(1) != 3) throw std::invalid_argument("smooth_points: shapes differ");
    for (size_t i = 0; i < cells.size(); ++i) {
        const int64_t value = cells.data()[i];
        if (value > LARGEST_CELL || value < -LARGEST_CELL) throw std::invalid_argument("smooth_points: a cell out of range");
        result[i / 3][i % 3] = int32_t(value);
    }
    return result;
}

// Rows of the surface's own order for samples (n) as they were given.
std::vector<int32_t> own_rows(const Surface &surface, Input<int64_t, 1> samples) {
    std::vector<int32_t> result(samples.shape(0));
    for (size_t i = 0; i < result.size(); ++i) {
        if (samples.data()[i] >= int64_t(surface.size())) throw std::invalid_argument("smooth_points: a sample does not exist");
        result[i] = surface.own_row(samples.data()[i]);
    }
    return result;
}

// Fields shifts, moves and deviations of SmoothedPoints, for lattice points (n, 3) with samples (n). spacing: subunits.
nb::tuple smooth_points(const Surface &surface, Input<int64_t, 2> given_cells, Input<int64_t, 1> given_samples, int64_t spacing) {
    const std::vector<Cell> cells = cells_of(given_cells);
    const std::vector<int32_t> samples = own_rows(surface, given_samples);
    const size_t n = samples.size();
    if (cells.size() != n || spacing < 1 || spacing > LARGEST_SPACING) throw std::invalid_argument("smooth_points: shapes differ");
    Fresh<int64_t> shifts(3 * n), moves(n), deviations(n);
    std::fill_n(shifts.data.get(), 3 * n, 0);
    std::fill_n(moves.data.get(), n, 0);
    std::fill_n(deviations.data.get(), n, 0);
    {
        nb::gil_scoped_release release;
        const PointsOfSamples of(samples.data(), n, surface.size());
        ShortNeighbourhood near(of, cells, surface, spacing);
        Neighbourhood around(cells, surface, spacing);
        for (size_t s = 0; s < surface.size(); ++s) {
            if (!of.size(s)) continue;
            bool is_near = near.is_usable;
            if (is_near) near.gather(s);
            if (!is_near) around.gather(of, s);
            for (int32_t at = of.first[s]; at < of.first[s + 1]; ++at) {
                const size_t i = size_t(of.points[size_t(at)]);
                Move move;
                if (is_near && !near.move(cells[i], move)) {
                    is_near = false;
                    around.gather(of, s);
                }
                if (!is_near) move = around.move(i);
                moves.data[i] = move.length;
                deviations.data[i] = move.deviation;
                for (size_t d = 0; d < 3; ++d) shifts.data[3 * i + d] = shift_of_move(move.length, surface.normal(int32_t(s))[d]);
            }
        }
    }
    return nb::make_tuple(shifts.give({n, 3}), moves.give({n}), deviations.give({n}));
}

constexpr uint32_t STAY_CONTEXTS = 1 << 20, STAY_WEIGHTS = 1024, DEVIATIONS = 16;

// Codes whether points stay (n); 1 without a move. moves, deviations (n); stays (n): in
// the encoder. None if the bytes are cut off.
template <class Coder>
nb::object code_stays(Coder &coder, Input<int64_t, 1> moves, Input<int64_t, 1> deviations, Input<uint8_t, 1> stays) {
    const size_t n = moves.shape(0);
    if (deviations.shape(0) != n || (stays.shape(0) && stays.shape(0) != n)) throw std::invalid_argument("code_stays: shapes differ");
    Fresh<uint8_t> result(n);
    for (size_t i = 0; i < n; ++i) {
        result.data[i] = 1;
        if (!moves.data()[i]) continue;
        const uint32_t length = uint32_t(std::abs(moves.data()[i])), coarse = length >> 3;
        const uint32_t around = uint32_t(std::min<int64_t>(deviations.data()[i] >> 4, DEVIATIONS - 1));
        const uint32_t kinds[bits::INPUTS] = {coarse, 32 + around, 64 + coarse * DEVIATIONS + around, 1024 + (length >> 1), 2048};
        uint32_t contexts[bits::INPUTS];
        for (int k = 0; k < bits::INPUTS; ++k) contexts[k] = STAY_CONTEXTS + kinds[k];
        result.data[i] = uint8_t(coder.code(contexts, STAY_WEIGHTS, stays.shape(0) ? stays.data()[i] : 0));
    }
    return is_cut_off(coder) ? nb::none() : nb::cast(result.give({n}));
}

}  // namespace

void bind_point_smoothing(nb::module_ &m) {
    m.def("code_stays", &code_stays<bit_arrays::BitArrayEncoder>);
    m.def("code_stays", &code_stays<bit_arrays::BitArrayDecoder>);
    m.def("smooth_points", &smooth_points);
}
