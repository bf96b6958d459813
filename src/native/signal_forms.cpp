// Turns values of channels into integers, for signals/forms.py, which has the same code in NumPy. Inverse:
// signal_values.h.

#include <stdexcept>

#include "arrays.h"
#include "signal_values.h"

namespace {

using namespace signals;

// forms.py has the same constants and explains them.
constexpr int64_t MAX_INTEGER = int64_t(1) << 29, MAX_CORRECTION = int64_t(1) << 20;
constexpr double ROUNDING = 6755399441055744.0;  // 1.5 · 2^52: adding it rounds to integers, halves to even

// Integers, special samples, and corrections or lower bits, each (forms, samples) or (samples,).
struct Sources {
    Fresh<int64_t> integers;
    Fresh<bool> special;
    Fresh<int64_t> extra;

    explicit Sources(size_t count) : integers(count), special(count), extra(count) {}

    nb::tuple give(std::initializer_list<size_t> shape) {
        return nb::make_tuple(integers.give(shape), special.give(shape), extra.give(shape));
    }
};

// forms._nearest_all
template <class T>
nb::tuple signals_nearest(Input<T, 1> values, Input<double, 1> steps, Input<double, 1> offsets, bool is_corrected) {
    const size_t count = values.shape(0), forms = steps.shape(0);
    if (offsets.shape(0) != forms) throw std::invalid_argument("signals_nearest: shapes differ");
    Sources out(forms * count);
    for (size_t f = 0, at = 0; f < forms; ++f) {
        const double step = steps.data()[f], offset = offsets.data()[f];
        for (size_t t = 0; t < count; ++t, ++at) {
            const T value = values.data()[t];
            const double counts = (double(value) - offset) / step;
            const double rounded = counts + ROUNDING - ROUNDING;
            bool is_usable = std::abs(rounded) < double(MAX_INTEGER);
            const int64_t integer = is_usable ? int64_t(rounded) : 0;
            T back = T(double(integer) * step + offset);
            const int64_t extra = int64_t(uint64_t(rank_of(value)) - uint64_t(rank_of(back)));
            if (is_corrected) {
                is_usable = is_usable && -MAX_CORRECTION < extra && extra < MAX_CORRECTION;
                back = from_rank<T>(rank_of(value));
            }
            const bool is_special = !is_usable || word_of(back) != word_of(value);
            out.integers.data[at] = is_special ? 0 : integer;
            out.special.data[at] = is_special;
            out.extra.data[at] = extra;
        }
    }
    return out.give({forms, count});
}

// forms._truncated
template <class T>
nb::tuple signals_truncated(Input<T, 1> values, int64_t exponent) {
    using Type = FloatType<T>;
    constexpr int exponent_bits = int(8 * sizeof(T)) - 1 - Type::mantissa_bits;
    constexpr uint64_t one = uint64_t(1) << Type::mantissa_bits;
    const size_t count = values.shape(0);
    Sources out(count);
    for (size_t t = 0; t < count; ++t) {
        const auto word = uint64_t(word_of(values.data()[t]));
        const bool is_negative = word >> (8 * sizeof(T) - 1);
        const auto stored = int64_t(word >> Type::mantissa_bits & ((uint64_t(1) << exponent_bits) - 1));
        const uint64_t mantissa = (word & (one - 1)) | (stored > 0 ? one : 0);
        const int64_t below = exponent - (std::max<int64_t>(stored, 1) - 1 + Type::least_exponent);
        const uint64_t size = below > 0 ? mantissa >> std::min<int64_t>(below, 63)
                                        : mantissa << std::min<int64_t>(-below, 63 - Type::mantissa_bits);
        const bool is_finite = stored != (int64_t(1) << exponent_bits) - 1;
        const bool is_special = (size == 0 && word != 0) || !is_finite || size >= uint64_t(MAX_INTEGER);
        const uint64_t lower = (uint64_t(1) << std::clamp<int64_t>(below, 0, 62)) - 1;
        out.integers.data[t] = is_special ? 0 : is_negative ? -int64_t(size) : int64_t(size);
        out.special.data[t] = is_special;
        out.extra.data[t] = is_special ? 0 : int64_t(mantissa & lower);
    }
    return out.give({count});
}

// forms.lower_bits: bits of each value below its integer on a grid, packed in bytes.
template <class T>
Output<uint8_t> signals_lower_bits(Input<int64_t, 1> integers, Input<int64_t, 1> extra, int64_t exponent) {
    if (integers.shape(0) != extra.shape(0)) throw std::invalid_argument("signals_lower_bits: shapes differ");
    const Form form{GRID, 1, 0, exponent, nullptr, 0};
    BitWriter bits;
    for (size_t t = 0; t < integers.shape(0); ++t) {
        int width;
        last_bit<T>(form, size_of(integers.data()[t]), width);
        bits.put(uint64_t(extra.data()[t]), integers.data()[t] ? width : 0);
    }
    bits.finish();
    Fresh<uint8_t> out(bits.bytes.size());
    std::copy(bits.bytes.begin(), bits.bytes.end(), out.data.get());
    return out.give({bits.bytes.size()});
}

}  // namespace

void bind_signal_forms(nb::module_ &m) {
    m.def("signals_nearest_4", &signals_nearest<float>);
    m.def("signals_nearest_8", &signals_nearest<double>);
    m.def("signals_lower_bits_4", &signals_lower_bits<float>);
    m.def("signals_lower_bits_8", &signals_lower_bits<double>);
    m.def("signals_truncated_4", &signals_truncated<float>);
    m.def("signals_truncated_8", &signals_truncated<double>);
}
