// Lattice engine for chunks of tempo, for stages/lattice.py.

#include "lattice.h"

#include <stdexcept>

#include "arrays.h"
#include "vectors.h"

namespace {

using Table = Input<int32_t, 1>;

#ifdef HAS_AVX2_TWIN
// Compiles the engine and everything it calls once more, with AVX2.
template <class Coder>
WITH_AVX2 FLATTENED bool run_with_avx2(lattice::Chunk<Coder> &chunk, double most_bytes) {
    return chunk.run(most_bytes);
}
#endif

// Runs the engine. Returns whether it coded the chunk, or the stream was consistent.
template <class Coder>
bool run(lattice::Chunk<Coder> &chunk, double most_bytes = HUGE_VAL) {
#ifdef HAS_AVX2_TWIN
    static const bool has_avx2 = processor_has_avx2();
    if (has_avx2) return run_with_avx2(chunk, most_bytes);
#endif
    return chunk.run(most_bytes);
}

bits::Tables tables_of(const Table &squash, const Table &stretch, const Table &rate, const Table &cost) {
    if (squash.shape(0) != 4096 || stretch.shape(0) != 4096 || cost.shape(0) != 4096 || rate.shape(0) <= size_t(bits::SLOWEST))
        throw std::invalid_argument("lattice: tables of wrong sizes");
    return {squash.data(), stretch.data(), rate.data(), cost.data()};
}

lattice::Layout layout_of(const Input<uint8_t, 2> &missing, const Table &sequence, const Input<int32_t, 2> &neighbours,
                          int stride_log) {
    const size_t points = missing.shape(1);
    if (sequence.shape(0) != points || neighbours.shape(0) != points || neighbours.shape(1) != lattice::NEIGHBOURS ||
        stride_log < 0 || stride_log > lattice::LARGEST_STRIDE_LOG)
        throw std::invalid_argument("lattice: shapes differ");
    std::vector<bool> coded(points);
    for (size_t i = 0; i < points; ++i) {
        const int32_t p = sequence.data()[i];
        if (p < 0 || size_t(p) >= points || coded[size_t(p)]) throw std::invalid_argument("lattice: not a sequence");
        for (int q = 0; q < lattice::NEIGHBOURS; ++q) {
            const int32_t n = neighbours.data()[size_t(p) * lattice::NEIGHBOURS + size_t(q)];
            if (n >= 0 && (size_t(n) >= points || !coded[size_t(n)]))
                throw std::invalid_argument("lattice: a neighbour is not coded before its point");
        }
        coded[size_t(p)] = true;
    }
    return {missing.shape(0), points, missing.data(), sequence.data(), neighbours.data(), stride_log};
}

Output<double> give(const std::vector<lattice::Vec> &values, const lattice::Layout &of) {
    Fresh<double> out(values.size() * 3);
    double *to = out.data.get();
    for (const lattice::Vec &value : values) to = std::copy(value.v, value.v + 3, to);
    return out.give({of.points, of.frames, 3});
}

// The stream and its decoded samples (points, frames, 3); its estimated length alone if that clearly exceeds `most_bytes`;
// None if a sample is too large.
nb::object tempo_lattice_encode(Input<double, 3> wanted, Input<uint8_t, 2> missing, Table sequence,
                                Input<int32_t, 2> neighbours, int stride_log, double most_bytes, Table squash,
                                Table stretch, Table rate, Table cost) {
    const lattice::Layout of = layout_of(missing, sequence, neighbours, stride_log);
    if (wanted.shape(0) != of.points || wanted.shape(1) != of.frames || wanted.shape(2) != 3)
        throw std::invalid_argument("lattice: shapes differ");
    const bits::Tables tables = tables_of(squash, stretch, rate, cost);
    std::vector<uint8_t> stream;
    std::vector<lattice::Vec> decoded;
    bool coded;
    size_t expected_bytes;
    {
        nb::gil_scoped_release release;
        bits::Encoder encoder;
        lattice::Chunk<bits::Encoder> chunk(of, tables, encoder, wanted.data());
        coded = run(chunk, most_bytes);
        expected_bytes = chunk.expected_bytes;
        stream = encoder.finish();
        decoded = std::move(chunk.decoded);
    }
    if (expected_bytes) return nb::int_(expected_bytes);
    if (!coded) return nb::none();
    return nb::make_tuple(nb::bytes(reinterpret_cast<const char *>(stream.data()), stream.size()), give(decoded, of));
}

// The samples (points, frames, 3) of a stream; None for a damaged stream.
nb::object tempo_lattice_decode(nb::bytes stream, Input<uint8_t, 2> missing, Table sequence, Input<int32_t, 2> neighbours,
                                int stride_log, Table squash, Table stretch, Table rate, Table cost) {
    const lattice::Layout of = layout_of(missing, sequence, neighbours, stride_log);
    const bits::Tables tables = tables_of(squash, stretch, rate, cost);
    const uint8_t *data = reinterpret_cast<const uint8_t *>(stream.c_str());
    const size_t size = stream.size();
    std::vector<lattice::Vec> decoded;
    bool whole;
    {
        nb::gil_scoped_release release;
        bits::Decoder decoder(data, size);
        lattice::Chunk<bits::Decoder> chunk(of, tables, decoder, nullptr);
        whole = run(chunk) && decoder.at_end();
        decoded = std::move(chunk.decoded);
    }
    if (!whole) return nb::none();
    return nb::object(nb::cast(give(decoded, of)));
}

}  // namespace

void bind_lattice(nb::module_ &m) {
    m.def("tempo_lattice_encode", &tempo_lattice_encode);
    m.def("tempo_lattice_decode", &tempo_lattice_decode);
}
