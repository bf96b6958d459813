// Serial loops of signals/: the adaptive coder of prediction residuals, and linear prediction. Integers only.

#include <algorithm>
#include <stdexcept>
#include <vector>

#include "arrays.h"
#include "signal_lanes.h"
#include "signal_prediction.h"

namespace {

using namespace signals;
using Numbers = Input<int64_t, 1>;

void check_tables(const Input<int16_t, 2> &high, const Input<int16_t, 3> &low) {
    if (high.shape(0) != CONTEXTS || high.shape(1) != HIGH || low.shape(0) != CONTEXTS || low.shape(1) != HIGH ||
        low.shape(2) != LOW)
        throw std::invalid_argument("signals: tables of wrong sizes");
}

// residuals.start_code
int start_code(const int64_t *residuals, size_t count) {
    int64_t sum = 0;
    count = std::min<size_t>(count, 32);
    for (size_t t = 0; t < count; ++t) sum += residuals[t] < 0 ? -residuals[t] : residuals[t];
    const int64_t mean = std::max<int64_t>(4, count ? int64_t(double(sum) / double(count) * 256) : 0);
    const int octave = top_bit(uint64_t(mean)) - 2;
    return std::min<int>(START_CODES - 1, int(4 * octave + (mean >> octave) - 4));
}

// residuals.encode: start code, final state, words in decoding order, raw bits packed in bytes.
nb::tuple signals_encode(Numbers residuals, Input<int16_t, 2> high, Input<int16_t, 3> low) {
    check_tables(high, low);
    const int start = start_code(residuals.data(), residuals.shape(0));
    Model model(high.data(), low.data(), start_of(start));
    const CodedLane lane = encode_lane(residuals.data(), residuals.shape(0), model);
    Fresh<uint16_t> words(lane.words.size());
    std::reverse_copy(lane.words.begin(), lane.words.end(), words.data.get());
    Fresh<uint8_t> raw(lane.raw.size());
    std::copy(lane.raw.begin(), lane.raw.end(), raw.data.get());
    return nb::make_tuple(start, lane.state, words.give({lane.words.size()}), raw.give({lane.raw.size()}));
}

// residuals.decode: the residuals of each lane; None if the bytes of a lane are not a lane of its length.
nb::object signals_decode(nb::list lanes, Input<int16_t, 2> high, Input<int16_t, 3> low) {
    check_tables(high, low);
    nb::list result;
    std::vector<LaneDecoder> decoders;
    std::vector<size_t> counts;
    std::vector<Input<uint8_t, 1>> all_bits;  // keeps the arrays alive while their memory is read
    for (nb::handle lane : lanes) {
        const nb::tuple fields = nb::cast<nb::tuple>(lane);
        const auto count = nb::cast<size_t>(fields[0]);
        const auto words = nb::cast<Input<uint16_t, 1>>(fields[3]);
        const auto &bits = all_bits.emplace_back(nb::cast<Input<uint8_t, 1>>(fields[4]));
        Fresh<int64_t> out(count);
        std::vector<uint8_t> bytes(2 * words.shape(0));
        for (size_t i = 0; i < words.shape(0); ++i) {
            bytes[2 * i] = uint8_t(words.data()[i]);
            bytes[2 * i + 1] = uint8_t(words.data()[i] >> 8);
        }
        decoders.emplace_back(Model(high.data(), low.data(), nb::cast<int64_t>(fields[1])), out.data.get(),
                              nb::cast<uint32_t>(fields[2]), bytes.data(), words.shape(0),
                              BitReader{bits.data(), bits.shape(0)});
        counts.push_back(count);
        result.append(out.give({count}));
    }
    if (!decode_lanes(decoders, counts)) return nb::none();
    return result;
}

// prediction.inverse: samples from residuals. base: prediction.known_sums.
Output<int64_t> signals_restore(Numbers residuals, Numbers base, Numbers own, int shift, int64_t first) {
    const size_t count = residuals.shape(0);
    if (base.shape(0) != count) throw std::invalid_argument("signals_restore: shapes differ");
    Fresh<int64_t> out(count);
    std::copy(residuals.data(), residuals.data() + count, out.data.get());
    restore(out.data.get(), base.data(), count, own.data(), own.shape(0), shift, first);
    return out.give({count});
}

// prediction._add_taps
void signals_add_taps(InPlace<int64_t, 1> sums, Numbers samples, Numbers taps, size_t delay) {
    if (samples.shape(0) != sums.shape(0)) throw std::invalid_argument("signals_add_taps: shapes differ");
    add_taps(sums.data(), samples.data(), sums.shape(0), taps.data(), taps.shape(0), delay);
}

}  // namespace

void bind_signals(nb::module_ &m) {
    m.def("signals_encode", &signals_encode);
    m.def("signals_decode", &signals_decode);
    m.def("signals_restore", &signals_restore);
    m.def("signals_add_taps", &signals_add_taps, nb::arg("sums").noconvert(), nb::arg("samples"), nb::arg("taps"),
          nb::arg("delay"));
}
