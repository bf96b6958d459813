// Decodes and encodes chunks of codecs/tempo without the interpreter, for codecs/tempo/compiled_chunks.py.
//
//   bytes ─chunk_symbols.h─► integers ─chunk_synthesis.h─► positions in the caller's array
//   positions ─chunk_analysis.h─► coefficients ─chunk_quantiser.h─► integers ─chunk_packer.h─► bytes
//   chunk_errors.h: errors of decoded positions, and corrections

#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <deque>
#include <mutex>
#include <stdexcept>

#include "arrays.h"
#include "chunk_analysis.h"
#include "chunk_errors.h"
#include "chunk_packer.h"
#include "chunk_quantiser.h"
#include "chunk_synthesis.h"

namespace {

using namespace chunks;

template <class T, class U>
std::vector<T> copied(const U &array) {
    return std::vector<T>(array.data(), array.data() + array.size());
}

bool synthesise(const Synthesis &synthesis, const Integers &integers, const Target &out) {
    return synthesis.run(integers, out);
}

#ifdef HAS_AVX2_TWIN
WITH_AVX2 bool synthesise_with_avx2(const Synthesis &synthesis, const Integers &integers, const Target &out) {
    return synthesis.run(integers, out);
}
#endif

void analyse(const Analyser &analyser, const double *positions, size_t rows, double *out) {
    analyser.run(positions, rows, out);
}

#ifdef HAS_AVX2_TWIN
WITH_AVX2 void analyse_with_avx2(const Analyser &analyser, const double *positions, size_t rows, double *out) {
    analyser.run(positions, rows, out);
}
#endif

// Tables and bases of a model, from which a ChunksOfLength is made for each chunk length.
class ChunkCodec {
public:
    ChunkCodec(Input<int64_t, 2> frequencies, Input<int64_t, 1> numerator_logs, Input<int64_t, 1> class_of,
                 int64_t first_class, Input<int64_t, 1> exp2, std::vector<Input<double, 2>> bases, Input<double, 2> pose,
                 Input<double, 1> weights)
        : tables(std::make_shared<Tables>()), shape(std::make_shared<Shape>()) {
        Tables &of = *tables;
        of.symbols = frequencies.shape(1);
        if (of.symbols > SYMBOLS || exp2.shape(0) != 1536 || frequencies.shape(0) < size_t(3 * CLASSES) ||
            bases.empty() || !numerator_logs.shape(0) || !class_of.shape(0))
            throw std::invalid_argument("ChunkCodec: tables of wrong sizes");
        for (size_t table = 0; table < frequencies.shape(0); ++table) {
            int64_t start = 0;
            for (size_t s = 0; s < SLOTS; ++s) {
                of.starts.push_back(uint16_t(start));
                if (s < of.symbols) start += frequencies.data()[table * of.symbols + s];
            }
            if (start != TOTAL) throw std::invalid_argument("ChunkCodec: frequencies have a wrong sum");
        }
        of.numerator_logs = copied<int16_t>(numerator_logs);
        of.class_of = copied<uint8_t>(class_of);
        of.exp2 = copied<int32_t>(exp2);
        of.first_class = first_class;
        if (*std::max_element(of.class_of.begin(), of.class_of.end()) >= CLASSES)
            throw std::invalid_argument("ChunkCodec: classes without tables");
        Shape &to = *shape;
        to.points = pose.shape(0), to.dimensions = bases[0].shape(1);
        to.columns = (to.dimensions + POSE + PANEL - 1) / PANEL * PANEL;
        components = bases[0].shape(0);
        to.pose = copied<double>(pose);
        to.weights = copied<double>(weights);
        for (const auto &basis : bases) {
            if (basis.shape(0) != components || basis.shape(1) != to.dimensions)
                throw std::invalid_argument("ChunkCodec: bases of different shapes");
            const bool same = !to.bases.empty() && to.bases.back().get() == basis.data();
            // The array is kept, not copied: a basis of many points takes megabytes.
            to.bases.push_back(same ? to.bases.back() : std::shared_ptr<const double>(basis.data(), [basis](const double *) {}));
        }
        if (pose.shape(1) != 3 || (to.weights.size() && to.weights.size() != to.points))
            throw std::invalid_argument("ChunkCodec: shapes differ");
    }

    // For coordinates that are bone directions. program, order: BoneSchedule; for each joint, its parent, its direction
    // (−1: none), the length of its bone, and its column among the points.
    void set_tree(Input<int64_t, 2> program, Input<double, 3> rests, Input<double, 3> homes, Input<double, 2> ends,
                  Input<int64_t, 1> order, Input<int64_t, 1> parents, Input<int64_t, 1> direction,
                  Input<double, 1> lengths, Input<int64_t, 1> column) {
        auto tree = std::make_unique<Tree>();
        tree->program = copied<int64_t>(program);
        tree->rests = copied<double>(rests), tree->homes = copied<double>(homes), tree->ends = copied<double>(ends);
        tree->order = copied<int64_t>(order), tree->parents = copied<int64_t>(parents);
        tree->direction = copied<int64_t>(direction), tree->column = copied<int64_t>(column);
        tree->lengths = copied<double>(lengths);
        tree->bones = rests.shape(0), tree->hubs = homes.shape(0);
        require_fits(*tree, program.shape(1) == 6);
        shape->tree = std::move(tree);
    }

    // For encoding. costs, prices: bits of each symbol in each table (tables · symbols,), without and with raw bits;
    // bases: for each band, its transposed basis after `scale`, (dimensions, components); for trees, joints: of each
    // bone in schedule order (bones,), and bones::Schedule's pairs (hubs, 2) and pair_frames (hubs, 3, 3).
    void set_encoding(Input<double, 1> costs, Input<double, 1> prices, std::vector<Input<double, 2>> bases,
                      Input<int64_t, 1> joints, Input<int64_t, 2> pairs, Input<double, 3> pair_frames) {
        auto made = std::make_shared<Encoding>();
        made->costs = copied<double>(costs), made->prices = copied<double>(prices);
        bool fits = costs.size() >= 3 * CLASSES * SYMBOLS && prices.size() >= 3 * CLASSES * SYMBOLS &&
                    (bases.empty() || bases.size() == shape->bases.size()) && tables->symbols == SYMBOLS;
        for (const auto &basis : bases)
            fits = fits && basis.shape(0) == shape->dimensions && basis.shape(1) == components;
        if (!fits) throw std::invalid_argument("ChunkCodec.set_encoding: shapes differ");
        for (size_t band = 0; band < bases.size(); ++band) {
            const bool same = band && bases[band].data() == bases[band - 1].data();
            made->analysis.bases.push_back(same ? made->analysis.bases.back() : in_panels(bases[band]));
        }
        if (shape->tree) set_joints(joints, pairs, pair_frames, made->analysis);
        else if (shape->dimensions != 3 * shape->points)
            throw std::invalid_argument("ChunkCodec.set_encoding: three coordinates a point");
        encoding = std::move(made);
    }

    struct Encoding {
        std::vector<double> costs, prices;
        Analysis analysis;
    };

    std::shared_ptr<Tables> tables;
    std::shared_ptr<Shape> shape;
    std::shared_ptr<const Encoding> encoding;
    size_t components = 0;

private:
    static std::shared_ptr<const std::vector<double>> in_panels(const Input<double, 2> &basis) {
        const size_t dimensions = basis.shape(0), parts = basis.shape(1), panels = (parts + PANEL - 1) / PANEL;
        auto out = std::make_shared<std::vector<double>>(panels * dimensions * PANEL, 0.0);
        for (size_t d = 0; d < dimensions; ++d)
            for (size_t c = 0; c < parts; ++c)
                (*out)[(c / PANEL * dimensions + d) * PANEL + c % PANEL] = basis.data()[d * parts + c];
        return out;
    }

    // Converts joints to columns of the points.
    void set_joints(const Input<int64_t, 1> &joints, const Input<int64_t, 2> &pairs, const Input<double, 3> &pair_frames,
                    Analysis &out) const {
        const Tree &tree = *shape->tree;
        auto is_joint = [&](int64_t j) { return j >= 0 && j < int64_t(shape->points) && tree.parents[size_t(j)] >= 0; };
        bool fits = joints.size() >= tree.bones && pairs.size() == 2 * tree.hubs && pair_frames.size() == 9 * tree.hubs;
        for (size_t b = 0; fits && b < tree.bones; ++b) fits = is_joint(joints.data()[b]);
        for (size_t i = 0; fits && i < 2 * tree.hubs; ++i) fits = is_joint(pairs.data()[i]);
        if (!fits) throw std::invalid_argument("ChunkCodec.set_encoding: the tree does not match");
        for (size_t b = 0; b < tree.bones; ++b) out.joints.push_back(tree.column[size_t(joints.data()[b])]);
        for (size_t i = 0; i < 2 * tree.hubs; ++i) out.pairs.push_back(tree.column[size_t(pairs.data()[i])]);
        out.pair_frames = copied<double>(pair_frames);
        out.parents.assign(shape->points, 0);
        for (size_t j = 0; j < shape->points; ++j)
            if (tree.parents[j] >= 0) out.parents[size_t(tree.column[j])] = tree.column[size_t(tree.parents[j])];
    }

    void require_fits(Tree &tree, bool is_program) const {
        const int64_t bones = int64_t(tree.bones), hubs = int64_t(tree.hubs);
        const int64_t directions = bones + int64_t(tree.ends.size() / 3), points = int64_t(shape->points);
        bool fits = is_program && tree.rests.size() == 9 * tree.bones && tree.homes.size() == 9 * tree.hubs &&
                    tree.order.size() == tree.bones && shape->dimensions == 2 * tree.bones + 3 * tree.hubs &&
                    tree.ends.size() % 3 == 0;
        for (const size_t size : {tree.parents.size(), tree.direction.size(), tree.column.size(), tree.lengths.size()})
            fits = fits && size == shape->points;
        for (size_t i = 0; fits && i < tree.program.size(); i += 6)
            tree.slots = std::max(tree.slots, size_t(tree.program[i + 3] + 1));
        for (size_t i = 0; fits && i < tree.program.size(); i += 6) {
            const int64_t *p = tree.program.data() + i;
            fits = p[1] >= 0 && p[1] < (p[0] ? hubs : bones) && p[2] < int64_t(tree.slots) && p[3] >= (p[0] ? 0 : -1) &&
                   p[4] >= (p[0] ? bones : 0) && p[4] < p[5] && p[5] <= (p[0] ? directions : bones);
        }
        for (const int64_t each : tree.order) fits = fits && each >= 0 && each < bones;
        for (int64_t j = 0; fits && j < points; ++j)
            fits = tree.parents[size_t(j)] < j && tree.direction[size_t(j)] < directions &&
                   tree.column[size_t(j)] >= 0 && tree.column[size_t(j)] < points;
        if (!fits) throw std::invalid_argument("ChunkCodec: the tree does not match");
    }
};

// Cached tables of the last chunk lengths, shared by all models: Cosines or FastCosines.
template <class Table>
std::shared_ptr<const Table> table_of(size_t frames) {
    constexpr size_t KEPT = 8;
    static std::mutex lock;
    static std::deque<std::shared_ptr<const Table>> kept;
    const std::lock_guard<std::mutex> guard(lock);
    for (const auto &each : kept)
        if (each->frames == frames) return each;
    if (kept.size() == KEPT) kept.pop_front();
    kept.push_back(std::make_shared<const Table>(frames));
    return kept.back();
}

// Decodes and encodes chunks of one length.
class ChunksOfLength {
public:
    // expected (frames, rows): Model.expected for step 0. band_ends: the frequency after each band.
    // heading_frequencies: see Analyser.
    ChunksOfLength(const ChunkCodec &of, Input<int64_t, 2> expected, std::vector<size_t> band_ends, double heading_step,
                   size_t heading_frequencies)
        : shape_(of.shape), encoding_(of.encoding), expectations_(of.tables, expected.data(), expected.shape(0), expected.shape(1), of.shape->points),
          cosines_of_length_(table_of<Cosines>(expected.shape(0))), cosines_(*cosines_of_length_),
          spectra_(of.encoding ? table_of<FastCosines>(expected.shape(0)) : nullptr), band_ends_(std::move(band_ends)),
          heading_step_(heading_step), heading_frequencies_(heading_frequencies) {
        if (expected.shape(1) != of.components + POSE || !expected.shape(0) || band_ends_.size() != shape_->bases.size() ||
            band_ends_.back() != expected.shape(0))
            throw std::invalid_argument("ChunksOfLength: shapes differ");
    }

    // Decodes frames [first, first + len(out)) of a chunk to out (frames, points, 3). axes: output axis of x, y and z;
    // correction_step: metres. Returns false, with undefined `out`, for bytes that Python must decode or reject, and
    // for positions that are not all finite.
    bool decode(nb::bytes numbers, double correction_step, InPlace<double, 3> out, size_t first,
                std::tuple<size_t, size_t, size_t> axes) const {
        const auto [x, y, z] = axes;
        if (out.shape(1) != shape_->points || out.shape(2) != 3 || first + out.shape(0) > cosines_.frames || x > 2 ||
            y > 2 || z > 2)
            throw std::invalid_argument("ChunksOfLength.decode: shapes differ");
        const Target to{out.data(), first, first + out.shape(0), {x, y, z}};
        const auto *data = reinterpret_cast<const uint8_t *>(numbers.data());
        const size_t size = numbers.size();
        nb::gil_scoped_release release;
        Integers integers;
        std::vector<Correction> corrections;
        if (!expectations_.unpack(data, size, integers) ||
            !corrections_of(integers.lists, cosines_.frames, shape_->points, corrections))
            return false;
        const bool are_finite = positions(integers, to);
        apply(corrections, *shape_, cosines_.frames, correction_step, to);
        return are_finite;
    }

    // Model.analyse: coefficients (frames, rows) of positions (frames, points, 3), y up.
    Output<double> analyse(Input<double, 3> of) const {
        if (!encoding_ || of.shape(0) != cosines_.frames || of.shape(1) != shape_->points || of.shape(2) != 3)
            throw std::invalid_argument("ChunksOfLength.analyse: shapes differ");
        Fresh<double> out(cosines_.frames * expectations_.rows);
        {
            nb::gil_scoped_release release;
            const Analyser analyser(*shape_, encoding_->analysis, cosines_, *spectra_, band_ends_.data(),
                                    heading_step_, heading_frequencies_);
#ifdef HAS_AVX2_TWIN
            static const bool has_avx2 = processor_has_avx2();
            if (has_avx2) analyse_with_avx2(analyser, of.data(), expectations_.rows, out.data.get());
            else
#endif
                ::analyse(analyser, of.data(), expectations_.rows, out.data.get());
        }
        return out.give({cosines_.frames, expectations_.rows});
    }

    // Trial of a step: codecs/tempo/trial.py. spectrum (frames, rows); wanted (frames, points, 3); apart (frames,
    // points), or empty; size: the step in metres; free: the first row with rate–distortion optimised integers; keeps:
    // whether to return the decoded positions. Returns values (frequencies, rows), threshold, bits, sum of distances,
    // sum of squared distances, decoded positions.
    nb::object of_step(Input<double, 2> spectrum, Input<double, 3> wanted, Input<uint8_t, 2> apart, int64_t step,
                       double size, double slope, size_t free, bool keeps) const {
        require_fits(spectrum, wanted, apart);
        const size_t frames = cosines_.frames, points = shape_->points;
        Fresh<double> decoded(3 * frames * points);
        Quantised found;
        Sums sums;
        {
            nb::gil_scoped_release release;
            quantise(spectrum.data(), step, size, slope, free, found);
            positions(found.integers, {decoded.data.get(), 0, frames, {0, 1, 2}});
            sums = sums_of(samples(wanted, apart, decoded.data.get()));
        }
        return nb::make_tuple(values_of(found), found.threshold, found.bits, sums.distance, sums.squared,
                              keeps ? nb::cast(decoded.give({frames, points, 3})) : nb::none());
    }

    // Trial of a step with corrections, in steps of `correction_step` metres, that keep all samples within the bound
    // (metres). Returns values, threshold, bits including corrections, and the corrections' numbers (FIELDS, n); no
    // values if the coefficients alone take `most_bits` or more; None if errors are too large to correct.
    nb::object within_bound(Input<double, 2> spectrum, Input<double, 3> wanted, Input<uint8_t, 2> apart, int64_t step,
                            double size, double slope, size_t free, double bound, double correction_step,
                            double most_bits) const {
        require_fits(spectrum, wanted, apart);
        static thread_local std::vector<double> decoded;
        Quantised found;
        Found corrections;
        std::vector<int64_t> lists;
        bool few = true, fits = true;
        {
            nb::gil_scoped_release release;
            quantise(spectrum.data(), step, size, slope, free, found);
            few = found.bits < most_bits;
            if (few) {
                decoded.resize(wanted.size());
                positions(found.integers, {decoded.data(), 0, cosines_.frames, {0, 1, 2}});
                fits = find_corrections(samples(wanted, apart, decoded.data()), bound, correction_step, corrections);
                lists = numbers_of(corrections);
                found.bits += list_coding(encoding_->costs.data(), lists.data(), lists.size() / FIELDS).bits;
            }
        }
        if (!fits) return nb::none();
        if (!few) return nb::make_tuple(nb::none(), found.threshold, found.bits, nb::none());
        Fresh<int64_t> listed(lists.size());
        std::copy(lists.begin(), lists.end(), listed.data.get());
        return nb::make_tuple(values_of(found), found.threshold, found.bits, listed.give({FIELDS, lists.size() / FIELDS}));
    }

    // coefficients.pack for one chunk: values (frequencies, rows), lists (FIELDS, n).
    nb::bytes pack(Input<int64_t, 2> values, int64_t step, int64_t threshold, Input<int64_t, 2> lists) const {
        if (!encoding_ || values.shape(1) != expectations_.rows || (lists.size() && lists.shape(0) != FIELDS))
            throw std::invalid_argument("ChunksOfLength.pack: shapes differ");
        std::vector<uint8_t> out;
        {
            nb::gil_scoped_release release;
            const Numbers numbers{step, threshold, values.data(), values.shape(0), lists.data(), lists.size() / FIELDS};
            out = Packer(expectations_, encoding_->costs.data()).run(numbers);
        }
        return nb::bytes(reinterpret_cast<const char *>(out.data()), out.size());
    }

private:
    void require_fits(const Input<double, 2> &spectrum, const Input<double, 3> &wanted, const Input<uint8_t, 2> &apart) const {
        const size_t frames = cosines_.frames, points = shape_->points;
        if (!encoding_ || spectrum.shape(0) != frames || spectrum.shape(1) != expectations_.rows ||
            wanted.shape(0) != frames || wanted.shape(1) != points || wanted.shape(2) != 3 ||
            (apart.size() && apart.size() != frames * points))
            throw std::invalid_argument("ChunksOfLength: shapes differ");
    }

    void quantise(const double *spectrum, int64_t step, double size, double slope, size_t free, Quantised &found) const {
        const Quantisation asked{step, heading_step_, size, slope, INWARD, encoding_->prices.data(), free};
        Quantiser(expectations_).run(spectrum, asked, found);
    }

    Samples samples(const Input<double, 3> &wanted, const Input<uint8_t, 2> &apart, const double *decoded) const {
        const double *weights = shape_->weights.empty() ? nullptr : shape_->weights.data();
        return {wanted.data(), decoded, apart.size() ? apart.data() : nullptr, weights, cosines_.frames, shape_->points};
    }

    Output<int64_t> values_of(const Quantised &found) const {
        const size_t rows = expectations_.rows;
        Fresh<int64_t> values(found.frequencies * rows);
        std::fill_n(values.data.get(), found.frequencies * rows, 0);
        for (const Coefficient &c : found.integers.coefficients) values.data[c.frequency * rows + c.row] = c.value;
        return values.give({found.frequencies, rows});
    }

    // Whether all positions are finite.
    bool positions(const Integers &integers, const Target &to) const {
        const double step_m = std::pow(2.0, double(integers.step) / 32);
        const Synthesis synthesis(*shape_, cosines_, band_ends_.data(), step_m, heading_step_);
#ifdef HAS_AVX2_TWIN
        static const bool has_avx2 = processor_has_avx2();
        if (has_avx2) return synthesise_with_avx2(synthesis, integers, to);
#endif
        return synthesise(synthesis, integers, to);
    }

    std::shared_ptr<const Shape> shape_;
    std::shared_ptr<const ChunkCodec::Encoding> encoding_;
    const Expectations expectations_;
    const std::shared_ptr<const Cosines> cosines_of_length_;
    const Cosines &cosines_;
    const std::shared_ptr<const FastCosines> spectra_;  // null without `encoding_`
    const std::vector<size_t> band_ends_;
    const double heading_step_;
    const size_t heading_frequencies_;
};

}  // namespace

void bind_chunk_codec(nb::module_ &m) {
    nb::class_<ChunkCodec>(m, "ChunkCodec")
        .def(nb::init<Input<int64_t, 2>, Input<int64_t, 1>, Input<int64_t, 1>, int64_t, Input<int64_t, 1>,
                      std::vector<Input<double, 2>>, Input<double, 2>, Input<double, 1>>())
        .def("set_tree", &ChunkCodec::set_tree)
        .def("set_encoding", &ChunkCodec::set_encoding);
    nb::class_<ChunksOfLength>(m, "ChunksOfLength")
        .def(nb::init<const ChunkCodec &, Input<int64_t, 2>, std::vector<size_t>, double, size_t>())
        .def("decode", &ChunksOfLength::decode, nb::arg(), nb::arg(), nb::arg().noconvert(), nb::arg(), nb::arg())
        .def("analyse", &ChunksOfLength::analyse)
        .def("of_step", &ChunksOfLength::of_step)
        .def("within_bound", &ChunksOfLength::within_bound)
        .def("pack", &ChunksOfLength::pack);
}
