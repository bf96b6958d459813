// Arrays of bits through the adaptive binary coder, for entropy/bit_arrays.py. The coders are in bit_arrays.h.

#include "bit_arrays.h"

void bind_bit_arrays(nb::module_ &m) {
    using namespace bit_arrays;
    nb::class_<CodedBits>(m, "CodedBits").def("__len__", [](const CodedBits &own) { return own.size(); });
    nb::class_<BitArrayEncoder>(m, "BitArrayEncoder")
        .def(nb::init<Table, Table, Table, Table>())
        .def("encode", &BitArrayEncoder::encode)
        .def("copy", [](const BitArrayEncoder &own) { return BitArrayEncoder(own); })
        .def("keep_bits", &BitArrayEncoder::keep_bits)
        .def("take_bits", &BitArrayEncoder::take_bits)
        .def("written", &BitArrayEncoder::written)
        .def("size", &BitArrayEncoder::size)
        .def("finish", &BitArrayEncoder::finish);
    nb::class_<BitArrayCheck>(m, "BitArrayCheck")
        .def(nb::init<Table, Table, Table, Table>())
        .def("follow", &BitArrayCheck::follow)
        .def("finish", &BitArrayCheck::finish);
    nb::class_<BitArrayDecoder>(m, "BitArrayDecoder")
        .def(nb::init<nb::bytes, Table, Table, Table, Table>())
        .def("decode", &BitArrayDecoder::decode)
        .def("at_end", &BitArrayDecoder::at_end)
        .def("exhausted", &BitArrayDecoder::exhausted);
}
