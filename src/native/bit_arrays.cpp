// Arrays of bits through the adaptive binary coder, for entropy/bit_arrays.py. Its parts are in adaptive_bits.h.

#include <stdexcept>

#include "adaptive_bits.h"
#include "arrays.h"

namespace {

using Table = Input<int32_t, 1>;
using Contexts = Input<uint32_t, 2>;
using Sets = Input<uint32_t, 1>;

// Owns copies of the tables, so that the arrays may go.
struct OwnTables {
    std::vector<int32_t> squash, stretch, rate, cost;

    OwnTables(Table a, Table b, Table c, Table d)
        : squash(a.data(), a.data() + a.shape(0)), stretch(b.data(), b.data() + b.shape(0)),
          rate(c.data(), c.data() + c.shape(0)), cost(d.data(), d.data() + d.shape(0)) {
        if (squash.size() != 4096 || stretch.size() != 4096 || cost.size() != 4096 || rate.size() <= size_t(bits::SLOWEST))
            throw std::invalid_argument("bit arrays: tables of other sizes");
    }

    bits::Tables pointers() const { return {squash.data(), stretch.data(), rate.data(), cost.data()}; }
};

size_t rows_of(const Contexts &contexts, const Sets &sets) {
    if (contexts.shape(1) != size_t(bits::INPUTS) || contexts.shape(0) != sets.shape(0))
        throw std::invalid_argument("bit arrays: shapes differ");
    return sets.shape(0);
}

class BitArrayEncoder {
public:
    BitArrayEncoder(Table squash, Table stretch, Table rate, Table cost)
        : tables_(squash, stretch, rate, cost), mixer_(tables_.pointers()) {}

    void encode(Contexts contexts, Sets sets, Input<uint8_t, 1> values) {
        const size_t n = rows_of(contexts, sets);
        if (values.shape(0) != n) throw std::invalid_argument("bit arrays: shapes differ");
        bits::Mixed mixed;
        for (size_t i = 0; i < n; ++i) {
            mixer_.contexts(contexts.data() + i * bits::INPUTS);
            const int bit = values.data()[i] != 0;
            encoder_.bit(bit, mixer_.mix(mixed, 0, sets.data()[i]));
            mixer_.learn(mixed, bit);
        }
    }

    nb::bytes finish() {
        const std::vector<uint8_t> out = encoder_.finish();
        return nb::bytes(reinterpret_cast<const char *>(out.data()), out.size());
    }

private:
    OwnTables tables_;
    bits::Mixer mixer_;
    bits::Encoder encoder_;
};

class BitArrayDecoder {
public:
    BitArrayDecoder(nb::bytes data, Table squash, Table stretch, Table rate, Table cost)
        : tables_(squash, stretch, rate, cost), data_(data.c_str(), data.c_str() + data.size()), mixer_(tables_.pointers()),
          decoder_(data_.data(), data_.size()) {}

    Output<uint8_t> decode(Contexts contexts, Sets sets) {
        const size_t n = rows_of(contexts, sets);
        Fresh<uint8_t> out(n);
        bits::Mixed mixed;
        for (size_t i = 0; i < n; ++i) {
            mixer_.contexts(contexts.data() + i * bits::INPUTS);
            const int bit = decoder_.bit(mixer_.mix(mixed, 0, sets.data()[i]));
            mixer_.learn(mixed, bit);
            out.data[i] = uint8_t(bit);
        }
        return out.give({n});
    }

    bool at_end() const { return decoder_.at_end(); }
    bool exhausted() const { return decoder_.exhausted(); }

private:
    OwnTables tables_;
    std::vector<uint8_t> data_;
    bits::Mixer mixer_;
    bits::Decoder decoder_;
};

}  // namespace

void bind_bit_arrays(nb::module_ &m) {
    nb::class_<BitArrayEncoder>(m, "BitArrayEncoder")
        .def(nb::init<Table, Table, Table, Table>())
        .def("encode", &BitArrayEncoder::encode)
        .def("finish", &BitArrayEncoder::finish);
    nb::class_<BitArrayDecoder>(m, "BitArrayDecoder")
        .def(nb::init<nb::bytes, Table, Table, Table, Table>())
        .def("decode", &BitArrayDecoder::decode)
        .def("at_end", &BitArrayDecoder::at_end)
        .def("exhausted", &BitArrayDecoder::exhausted);
}
