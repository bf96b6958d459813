// Corrections that stay valid for many frames, for stages/bounded.py.

#include <algorithm>
#include <stdexcept>
#include <vector>

#include "arrays.h"

namespace {

constexpr double SQUARED_BOUND = 0.75;  // in lattice units

// Samples of a point in a block of frames, `pitch` apart: errors in lattice units,
// their nearest lattice points, corrections.
struct Track {
    const double *error;
    const int64_t *nearest;
    int64_t *correction;
    size_t frames, pitch;
};

// bounded._longest_lasting for one lane. choices (count, 3): lattice points, the first is zero. beyond: number of
// frames without an error after the track in the block.
class LongestLasting {
public:
    explicit LongestLasting(const Input<int64_t, 2> &choices) : choices_(choices.data()), lasts_(choices.shape(0)) {
        for (size_t i = 0; i < lasts_.size(); ++i) {
            const int64_t *c = choices_ + 3 * i;
            squares_.push_back(double(c[0] * c[0] + c[1] * c[1] + c[2] * c[2]));
        }
    }

    void run(const Track &of, int beyond) {
        best_.assign(of.frames, nullptr);
        std::fill(lasts_.begin(), lasts_.end(), 0);
        lasts_[0] = beyond;
        for (size_t f = of.frames; f-- > 0;) find_best(of, f);
        int64_t current[3] = {};
        for (size_t f = 0; f < of.frames; ++f) {
            const double *e = of.error + f * of.pitch;
            const double x = e[0] - double(current[0]), y = e[1] - double(current[1]), z = e[2] - double(current[2]);
            if (!(x * x + y * y + z * z <= SQUARED_BOUND)) std::copy_n(best_[f], 3, current);
            std::copy_n(current, 3, of.correction + f * of.pitch);
        }
    }

private:
    // Finds the choice that is valid for the most frames from f on; the nearest lattice point if none is valid.
    void find_best(const Track &of, size_t f) {
        const double *e = of.error + f * of.pitch;
        const double limit = SQUARED_BOUND - (e[0] * e[0] + e[1] * e[1] + e[2] * e[2]);
        const int64_t *found = of.nearest + f * of.pitch;
        int longest = 0;
        for (size_t i = 0; i < lasts_.size(); ++i) {
            const int64_t *c = choices_ + 3 * i;
            const double along = e[0] * double(c[0]) + e[1] * double(c[1]) + e[2] * double(c[2]);
            lasts_[i] = squares_[i] - 2 * along <= limit ? lasts_[i] + 1 : 0;
            if (lasts_[i] > longest) longest = lasts_[i], found = c;
        }
        best_[f] = found;
    }

    const int64_t *choices_;
    std::vector<double> squares_;  // squared lengths of the choices
    std::vector<int> lasts_;       // number of frames for which each choice is valid
    std::vector<const int64_t *> best_;
};

// bounded._lasting_corrections: (frames, points, 3) in lattice units. outside (frames, points): 1 where an error is beyond the
// bound.
Output<int64_t> lasting_corrections(Input<double, 3> error, Input<int64_t, 3> nearest, Input<uint8_t, 2> outside,
                                    Input<int64_t, 2> choices, size_t block) {
    const size_t frames = error.shape(0), points = error.shape(1), size = 3 * frames * points;
    if (error.size() != size || nearest.size() != size || outside.size() != frames * points || choices.shape(1) != 3 ||
        !choices.shape(0) || !block)
        throw std::invalid_argument("lasting_corrections: shapes differ");
    Fresh<int64_t> out(size);
    {
        nb::gil_scoped_release release;
        std::fill_n(out.data.get(), size, 0);
        LongestLasting lasting(choices);
        for (size_t first = 0; first < frames; first += block) {
            const size_t count = std::min(block, frames - first);
            for (size_t p = 0; p < points; ++p) {
                bool any = false;
                for (size_t f = first; f < first + count && !any; ++f) any = outside.data()[f * points + p] != 0;
                const size_t at = 3 * (first * points + p);
                if (any)
                    lasting.run({error.data() + at, nearest.data() + at, out.data.get() + at, count, 3 * points},
                                int(block - count));
            }
        }
    }
    return out.give({frames, points, 3});
}

}  // namespace

void bind_bounded(nb::module_ &m) { m.def("lasting_corrections", &lasting_corrections); }
