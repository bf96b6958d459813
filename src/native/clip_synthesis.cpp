// Positions of clips from their integers, up to rounding, for codecs/hou2014/stream.py, reconstruct.

#include <nanobind/stl/vector.h>

#include <stdexcept>
#include <vector>

#include "arrays.h"
#include "cosine_series.h"

namespace {

using cosine_series::PANEL;
using cosine_series::Rows;
using cosine_series::Series;

constexpr size_t GROUP = 4;  // panels of columns that are multiplied at a time

// Bᵀ of each left transform with the mean pose below it, (transforms, components + 1, columns), in groups of columns.
class Matrices {
public:
    explicit Matrices(const Input<double, 3> &matrices)
        : rows(matrices.shape(1)), columns(matrices.shape(2)), panels((columns + PANEL - 1) / PANEL),
          of_(matrices.shape(0) * rows * panels * PANEL, 0.0) {
        for (size_t j = 0; j < matrices.shape(0); ++j)
            for (size_t panel = 0; panel < panels; ++panel) {
                const size_t first = panel / GROUP * GROUP, width = PANEL * std::min(GROUP, panels - first);
                double *to = of_.data() + (j * panels + first) * rows * PANEL + (panel - first) * PANEL;
                const double *from = matrices.data() + j * rows * columns + panel * PANEL;
                const size_t count = std::min(PANEL, columns - panel * PANEL);
                for (size_t i = 0; i < rows; ++i) std::copy_n(from + i * columns, count, to + i * width);
            }
    }

    // A group's matrix (rows, PANEL · panels of the group).
    const double *group(size_t transform, size_t first) const {
        return of_.data() + (transform * panels + first) * rows * PANEL;
    }

    const size_t rows, columns, panels;

private:
    std::vector<double> of_;
};

struct Coefficient {
    size_t component;
    double value;
};

// Nonzero coefficients of a clip.
struct Sparse {
    std::vector<Coefficient> of;
    std::vector<size_t> ends;  // end of each frequency's coefficients

    void read(const int64_t *rows, size_t known, size_t components, double scale) {
        of.clear(), ends.clear();
        for (size_t f = 0; f < known; ++f) {
            for (size_t i = 0; i < components; ++i)
                if (const int64_t value = rows[f * components + i]) of.push_back({i, double(value) * scale});
            ends.push_back(of.size());
        }
    }
};

// Spectra (frequencies, PANEL) of PANELS panels, times the scales of the series. pitch: doubles from panel to panel.
template <size_t PANELS>
ALWAYS_INLINE void multiply(const Sparse &sparse, const double *matrix, size_t components, const Series &series, double *to, size_t pitch) {
    const Coefficient *at = sparse.of.data();
    for (size_t f = 0; f < sparse.ends.size(); ++f) {
        Four sums[2 * PANELS];
        for (Four &each : sums) each = Four{} * 0.0;
        if (!f) {
            const double *mean = matrix + components * PANELS * PANEL, root = std::sqrt(double(series.frames()));
            for (size_t i = 0; i < 2 * PANELS; ++i) load(sums[i], mean + 4 * i), sums[i] *= root;
        }
        for (const Coefficient *end = sparse.of.data() + sparse.ends[f]; at != end; ++at) {
            const double *row = matrix + at->component * PANELS * PANEL;
            for (size_t i = 0; i < 2 * PANELS; ++i) {
                Four of_row;
                load(of_row, row + 4 * i);
                sums[i] += of_row * at->value;
            }
        }
        const double scale = series.scale(f);
        for (size_t i = 0; i < 2 * PANELS; ++i) store(sums[i] * scale, to + i / 2 * pitch + f * PANEL + i % 2 * 4);
    }
}

struct Buffers {
    Sparse sparse;
    Rows spectra, other;
};

// Writes one clip to out (frames, columns).
ALWAYS_INLINE void synthesise(const Sparse &sparse, const Matrices &matrices, size_t transform, const Series &series, double *out, Buffers &buffers) {
    const size_t size = series.buffer(), columns = matrices.columns, components = matrices.rows - 1;
    double *spectra = buffers.spectra.of(GROUP * size), *other = buffers.other.of(size);
    for (size_t first = 0; first < matrices.panels; first += GROUP) {
        const size_t count = std::min(GROUP, matrices.panels - first);
        double *to = spectra + Series::MARGIN * PANEL;
        const double *matrix = matrices.group(transform, first);
        if (count == 4) multiply<4>(sparse, matrix, components, series, to, size);
        else if (count == 3) multiply<3>(sparse, matrix, components, series, to, size);
        else if (count == 2) multiply<2>(sparse, matrix, components, series, to, size);
        else multiply<1>(sparse, matrix, components, series, to, size);
        for (size_t panel = 0; panel < count; ++panel) {
            const size_t column = (first + panel) * PANEL;
            series.run(spectra + panel * size, other, out + column, columns, std::min(PANEL, columns - column));
        }
    }
}

void synthesise_anywhere(const Sparse &sparse, const Matrices &matrices, size_t transform, const Series &series, double *out, Buffers &buffers) {
    synthesise(sparse, matrices, transform, series, out, buffers);
}

#ifdef HAS_AVX2_TWIN
WITH_AVX2 void synthesise_with_avx2(const Sparse &sparse, const Matrices &matrices, size_t transform, const Series &series, double *out, Buffers &buffers) {
    synthesise(sparse, matrices, transform, series, out, buffers);
}
#endif

// stream.reconstruct to out (frames, columns). coefficients: S_iᵀ, clip by clip;
// series, transform_index, steps: of each clip.
void reconstruct_clips(Input<int64_t, 2> coefficients, std::vector<const Series *> series, Input<int64_t, 1> transform_index,
                       Input<double, 1> steps, Input<double, 3> matrices, InPlace<double, 2> out) {
    const size_t components = coefficients.shape(1), clips = series.size();
    size_t frames = 0, rows = 0;
    for (const Series *each : series) frames += each->frames(), rows += each->known();
    for (size_t i = 0; i < transform_index.shape(0); ++i)
        if (uint64_t(transform_index.data()[i]) >= matrices.shape(0)) throw std::invalid_argument("reconstruct_clips: no such transform");
    if (transform_index.shape(0) != clips || steps.shape(0) != clips || matrices.shape(1) != components + 1 ||
        coefficients.shape(0) != rows || out.shape(0) != frames || out.shape(1) != matrices.shape(2))
        throw std::invalid_argument("reconstruct_clips: shapes differ");
    nb::gil_scoped_release release;
    const Matrices packed(matrices);
    Buffers buffers;
    const int64_t *from = coefficients.data();
    double *to = out.data();
    for (size_t clip = 0; clip < clips; ++clip) {
        const Series &of_clip = *series[clip];
        const size_t transform = size_t(transform_index.data()[clip]);
        buffers.sparse.read(from, of_clip.known(), components, steps.data()[clip]);
#ifdef HAS_AVX2_TWIN
        static const bool has_avx2 = processor_has_avx2();
        if (has_avx2) synthesise_with_avx2(buffers.sparse, packed, transform, of_clip, to, buffers);
        else
#endif
            synthesise_anywhere(buffers.sparse, packed, transform, of_clip, to, buffers);
        from += of_clip.known() * components, to += of_clip.frames() * packed.columns;
    }
}

}  // namespace

void bind_clip_synthesis(nb::module_ &m) {
    nb::class_<Series>(m, "CosineSeries").def(nb::init<size_t, size_t>());
    m.def("reconstruct_clips", &reconstruct_clips, nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg().noconvert());
}
