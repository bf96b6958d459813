// Serial steps of the entropy coders. Every kernel is integer, and gives what the NumPy code beside its caller gives.

#include <stdexcept>
#include <vector>

#include "arrays.h"

namespace {

constexpr int PRECISION = 12;

// codecs/tempo/lanes.py, encode: final states (lanes,) and words, from the frequency and start of each symbol
// (steps, lanes) and first states (lanes,).
nb::tuple lanes_encode(Input<int64_t, 2> frequencies, Input<int64_t, 2> starts, Input<int64_t, 1> first) {
    const size_t steps = frequencies.shape(0), lanes = frequencies.shape(1);
    if (starts.shape(0) != steps || starts.shape(1) != lanes || first.shape(0) != lanes)
        throw std::invalid_argument("lanes_encode: shapes differ");
    Fresh<int64_t> states(lanes);
    for (size_t lane = 0; lane < lanes; ++lane) states.data[lane] = first.data()[lane];
    std::vector<uint16_t> words;
    words.reserve(steps * lanes / 2);
    for (size_t step = steps; step-- > 0;) {
        const int64_t *f = frequencies.data() + step * lanes, *c = starts.data() + step * lanes;
        for (size_t lane = lanes; lane-- > 0;) {
            if (f[lane] <= 0) throw std::invalid_argument("lanes_encode: a symbol of weight zero");
            uint64_t x = uint64_t(states.data[lane]);
            if (x >= uint64_t(f[lane]) << (32 - PRECISION)) {
                words.push_back(uint16_t(x));
                x >>= 16;
            }
            // A state is below 2^32, and a division of 32 bits is several times faster.
            const uint32_t x32 = uint32_t(x), f32 = uint32_t(f[lane]), quotient = x32 / f32;
            states.data[lane] = int64_t((uint64_t(quotient) << PRECISION) + (x32 - quotient * f32) + uint64_t(c[lane]));
        }
    }
    Fresh<uint16_t> sequence(words.size());
    std::copy(words.rbegin(), words.rend(), sequence.data.get());
    return nb::make_tuple(states.give({lanes}), sequence.give({sequence.size}));
}

}  // namespace

void bind_entropy(nb::module_ &m) {
    m.def("lanes_encode", &lanes_encode);
}
