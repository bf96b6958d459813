// Coefficients of a chunk of codecs/tempo from positions: models/model.py, analyse. They agree with NumPy's up to rounding.
//
//   positions ─place, heading─► poses ─bones or points─► curves (columns, frames) ─DCT─► spectrum ─bases─► coefficients
#pragma once

#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>
#include <vector>

#include "bone_coordinates.h"
#include "chunk_synthesis.h"
#include "fast_cosines.h"

namespace chunks {

using fast_cosines::FastCosines;

// Inputs of the analysis besides Shape. bases: for each band, from coordinates before `scale` to components, in panels
// of PANEL components, (panels, dimensions, PANEL). joints, pairs, pair_frames: bones::Schedule; parents: of each point.
struct Analysis {
    std::vector<std::shared_ptr<const std::vector<double>>> bases;
    std::vector<int64_t> joints, parents, pairs;
    std::vector<double> pair_frames;
};

struct AnalysisScratch {
    std::vector<double> columns, curves, heading, cosine, sine, spectrum;
    std::vector<double> work;  // of FastCosines

    static NEVER_INLINE AnalysisScratch &of_thread() {  // looks its address up once
        static thread_local AnalysisScratch scratch;
        return scratch;
    }
};

class Analyser {
public:
    // heading_frequencies: number of kept coefficients of the heading.
    Analyser(const Shape &shape, const Analysis &analysis, const Cosines &cosines, const FastCosines &spectra,
             const size_t *band_ends, double heading_step, size_t heading_frequencies)
        : of_(shape), with_(analysis), cosines_(cosines), spectra_(spectra), band_ends_(band_ends), heading_step_(heading_step),
          heading_frequencies_(std::min(heading_frequencies, cosines.frames)), frames_(cosines.frames),
          rows_of_spectrum_(shape.dimensions + 3) {}

    // positions (frames, points, 3), y up; out (frames, rows).
    ALWAYS_INLINE void run(const double *positions, size_t rows, double *out) const {
        AnalysisScratch &scratch = AnalysisScratch::of_thread();
        std::fill_n(out, frames_ * rows, 0.0);
        scratch.curves.resize(rows_of_spectrum_ * frames_);
        by_columns(positions, scratch);
        centre(scratch);
        heading(scratch, rows, out);
        turn(scratch);
        coordinates(scratch);
        transform(scratch);
        components(scratch, rows, out);
    }

private:
    double *column(AnalysisScratch &scratch, size_t axis, size_t point) const {
        return scratch.columns.data() + (axis * of_.points + point) * frames_;
    }

    // Transposes positions to (3, points, frames).
    ALWAYS_INLINE void by_columns(const double *positions, AnalysisScratch &scratch) const {
        const size_t points = of_.points;
        scratch.columns.resize(3 * points * frames_);
        for (size_t first = 0; first < frames_; first += 8) {  // eight frames fit into the cache
            const size_t last = std::min(frames_, first + 8);
            for (size_t p = 0; p < points; ++p)
                for (size_t k = 0; k < 3; ++k) {
                    double *to = column(scratch, k, p);
                    for (size_t f = first; f < last; ++f) to[f] = positions[(f * points + p) * 3 + k];
                }
        }
    }

    // Writes the place, times √points, to the last curves; subtracts the place from the columns.
    ALWAYS_INLINE void centre(AnalysisScratch &scratch) const {
        const double points = double(of_.points), scale = std::sqrt(points);
        for (size_t k = 0; k < 3; ++k) {
            double *place = scratch.curves.data() + (of_.dimensions + k) * frames_;
            std::fill_n(place, frames_, 0.0);
            for (size_t p = 0; p < of_.points; ++p) {
                const double *from = column(scratch, k, p);
                for (size_t f = 0; f < frames_; ++f) place[f] += from[f];
            }
            for (size_t f = 0; f < frames_; ++f) place[f] /= points;
            for (size_t p = 0; p < of_.points; ++p) {
                double *of = column(scratch, k, p);
                for (size_t f = 0; f < frames_; ++f) of[f] -= place[f];
            }
            for (size_t f = 0; f < frames_; ++f) place[f] *= scale;
        }
    }

    // pose/heading.py, heading; model.py, smooth_heading: writes the heading's row, and cosine and sine of its inverse.
    ALWAYS_INLINE void heading(AnalysisScratch &scratch, size_t rows, double *out) const {
        scratch.heading.assign(frames_, 0.0);
        scratch.cosine.assign(frames_, 0.0), scratch.sine.assign(frames_, 0.0);
        double *angle = scratch.heading.data(), *cosine = scratch.cosine.data(), *sine = scratch.sine.data();
        for (size_t p = 0; p < of_.points; ++p) {
            const double *x = column(scratch, 0, p), *z = column(scratch, 2, p);
            const double px = of_.pose[3 * p], pz = of_.pose[3 * p + 2];
            for (size_t f = 0; f < frames_; ++f) {
                cosine[f] += x[f] * px + z[f] * pz;
                sine[f] += x[f] * pz - z[f] * px;
            }
        }
        for (size_t f = 0; f < frames_; ++f) angle[f] = std::atan2(sine[f], cosine[f]);
        unwrap(angle);
        std::fill_n(cosine, frames_, 0.0);  // from here on: the decoded heading
        for (size_t k = 0; k < heading_frequencies_; ++k) {
            double sum = 0;
            for (size_t t = 0; t < frames_; ++t) sum += angle[t] * cosine_of(k, t);
            const double kept = std::nearbyint(sum / heading_step_) * heading_step_;
            out[k * rows + HEADING] = kept;
            if (kept == 0) continue;
            for (size_t t = 0; t < frames_; ++t) cosine[t] += kept * cosine_of(k, t);
        }
        for (size_t f = 0; f < frames_; ++f) sine[f] = std::sin(-cosine[f]), cosine[f] = std::cos(cosine[f]);
    }

    ALWAYS_INLINE double cosine_of(size_t frequency, size_t t) const {
        const size_t parity = frequency % 2, mirrored = t < cosines_.half ? t : frames_ - 1 - t;
        const double value = cosines_.block(mirrored / TILE, parity)[frequency / 2 * TILE + mirrored % TILE];
        return t != mirrored && parity ? -value : value;
    }

    // np.unwrap, then adds whole turns so that the first angle is at most half a turn.
    void unwrap(double *angle) const {
        using bones::PI;
        double turns = 0, before = angle[0];
        const double first = 2 * PI * std::nearbyint(angle[0] / (2 * PI));
        for (size_t f = 0; f < frames_; ++f) {
            const double step = angle[f] - before;
            before = angle[f];
            if (step > PI) turns -= 2 * PI;
            else if (step < -PI) turns += 2 * PI;
            angle[f] += turns - first;
        }
    }

    // heading.rotate: rotates by the inverse of the heading.
    ALWAYS_INLINE void turn(AnalysisScratch &scratch) const {
        const double *cosine = scratch.cosine.data(), *sine = scratch.sine.data();
        for (size_t p = 0; p < of_.points; ++p) {
            double *x = column(scratch, 0, p), *z = column(scratch, 2, p);
            for (size_t f = 0; f < frames_; ++f) {
                const double turned = cosine[f] * x[f] + sine[f] * z[f];
                z[f] = cosine[f] * z[f] - sine[f] * x[f];
                x[f] = turned;
            }
        }
    }

    // coordinates.py, forward: writes the first curves.
    ALWAYS_INLINE void coordinates(AnalysisScratch &scratch) const {
        if (!of_.tree) {
            for (size_t p = 0; p < of_.points; ++p)
                for (size_t k = 0; k < 3; ++k) {
                    const double *from = column(scratch, k, p), rest = of_.pose[3 * p + k];
                    double *to = scratch.curves.data() + (3 * p + k) * frames_;
                    for (size_t f = 0; f < frames_; ++f) to[f] = from[f] - rest;
                }
            return;
        }
        const Tree &tree = *of_.tree;
        const bones::Schedule schedule{tree.program.data(), tree.order.data(), with_.joints.data(), with_.parents.data(),
                                       with_.pairs.data(), tree.rests.data(), tree.homes.data(), with_.pair_frames.data(),
                                       tree.program.size() / 6, tree.bones, tree.hubs, tree.slots};
        double *curves = scratch.curves.data();
        bones::all_coordinates(schedule, {scratch.columns.data(), of_.points, frames_}, curves);
        bones::unwrap_all(tree.bones, tree.hubs, curves, frames_);
    }

    // stages/dct.py, forward: DCT of all curves, (blocks of TILE frequencies, columns, TILE).
    ALWAYS_INLINE void transform(AnalysisScratch &scratch) const {
        const size_t columns = rows_of_spectrum_;
        scratch.spectrum.resize((frames_ + TILE - 1) / TILE * TILE * columns);
        scratch.work.resize(spectra_.work());
        for (size_t first = 0; first < columns; first += PANEL) {
            const size_t count = std::min(PANEL, columns - first);
            double *to = scratch.spectrum.data() + first * TILE;
            spectra_.forward(scratch.curves.data() + first * frames_, count, scratch.work.data(), [=](size_t k, const double *row) {
                double *at = to + k / TILE * columns * TILE + k % TILE;
                for (size_t j = 0; j < count; ++j) at[j * TILE] = row[j];
            });
        }
    }

    // Applies the bases, band by band, and writes the rows of the place.
    ALWAYS_INLINE void components(AnalysisScratch &scratch, size_t rows, double *out) const {
        const size_t columns = rows_of_spectrum_, parts = rows - POSE, dimensions = of_.dimensions;
        size_t begin = 0;
        for (size_t band = 0; band < with_.bases.size(); begin = band_ends_[band++])
            for (size_t block = begin / TILE; block * TILE < band_ends_[band]; ++block) {
                const double *spectrum = scratch.spectrum.data() + block * TILE * columns;
                const size_t first = std::max(begin, block * TILE), last = std::min(band_ends_[band], (block + 1) * TILE);
                for (size_t panel = 0; panel * PANEL < parts; ++panel) {
                    Four sums[TILE][2];
                    tile(spectrum, with_.bases[band]->data() + panel * dimensions * PANEL, dimensions, sums);
                    const size_t count = std::min(PANEL, parts - panel * PANEL);
                    for (size_t k = first; k < last; ++k) {
                        double *to = out + k * rows + POSE + panel * PANEL;
                        const Four *from = sums[k - block * TILE];
                        if (count == PANEL) store(from[0], to), store(from[1], to + 4);
                        else std::memcpy(to, from, count * sizeof(double));
                    }
                }
            }
        for (size_t k = 0; k < frames_; ++k)
            for (size_t axis = 0; axis < 3; ++axis)
                out[k * rows + HEADING + 1 + axis] =
                    scratch.spectrum[(k / TILE * columns + dimensions + axis) * TILE + k % TILE];
    }

    const Shape &of_;
    const Analysis &with_;
    const Cosines &cosines_;
    const FastCosines &spectra_;
    const size_t *band_ends_;
    const double heading_step_;
    const size_t heading_frequencies_, frames_, rows_of_spectrum_;
};

}  // namespace chunks
