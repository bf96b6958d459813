// Colours of lattice points, for codecs/bodycast/colour_lifting.py, which defines the results. Integers only.

#include <algorithm>
#include <array>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include "bit_arrays.h"
#include "colour_neighbourhood.h"

using namespace colours;

namespace {

constexpr int UNARY = 24, WIDE_BITS = 11, FIRST_MAGNITUDE = 2, WIDE_KIND = FIRST_MAGNITUDE + UNARY;
constexpr int KINDS = WIDE_KIND + WIDE_BITS, CLASSES = 6, ACTIVITIES = 9, LEVELS = 7;
constexpr int CLASS_EDGES[] = {1, 2, 4, 8, 16}, ACTIVITY_EDGES[] = {1, 2, 3, 5, 8, 12, 18, 28};
constexpr int SHARE_BITS = 4, ROUNDING = 96, GREY = 128;
constexpr int32_t LARGEST = 511;
constexpr size_t FIRST_STRIDE = 64;

using Cells = Input<int64_t, 2>;
using Colours = Input<int16_t, 2>;
using Rows = Input<int64_t, 1>;

int64_t square_between(const int64_t *a, const int64_t *b) {
    int64_t sum = 0;
    for (int d = 0; d < 3; ++d) sum += (a[d] - b[d]) * (a[d] - b[d]);
    return sum;
}

void require(bool good, const char *what) {
    if (!good) throw std::invalid_argument(what);
}

// The class of each magnitude below 2^10: the number of edges that `scale` times it reaches. edges: ascending.
class Classes {
public:
    Classes(int64_t scale, int64_t step) {
        uint8_t found = 0;
        for (int64_t size = 0; size < int64_t(of_.size()); ++size) {
            while (found < ACTIVITIES - 1 && ACTIVITY_EDGES[found] * step <= scale * size) ++found;
            of_[size_t(size)] = found;
        }
    }

    uint8_t of(int16_t size) const { return of_[size_t(size)]; }

private:
    std::array<uint8_t, 1 << 10> of_;
};

uint8_t class_of_difference(int32_t size) {
    uint8_t found = 0;
    for (int32_t edge : CLASS_EDGES) found = uint8_t(found + (edge <= size));
    return found;
}

// ColourLifting.code_frame: codes the colours of a frame's points, pass by pass.
class Frame {
public:
    std::vector<Known> known;  // of a pass: the known points in their order; at last all points
    std::array<int64_t, 3> products{}, squares{};  // sums over the points with expected colours
    enum { GOOD, CUT_OFF, OUT_OF_RANGE } outcome = GOOD;

    Frame(Cells cells, Colours expected, Input<uint8_t, 1> is_expected, Rows shares, Rows steps)
        : size_(cells.shape(0)), cells_(cells), expected_(expected), is_expected_(is_expected), shares_(shares), steps_(steps) {
        require(cells.shape(1) == 3 && expected.shape(0) == size_ && expected.shape(1) == 3 && is_expected.shape(0) == size_ &&
                    shares.shape(0) == 3 && steps.shape(0) == 3,
                "colour_frame: shapes differ");
        for (size_t d = 0; d < 3; ++d) {
            require(steps.data()[d] > 0, "colour_frame: a step below 1");
            activities_.emplace_back(2, steps.data()[d]);
            spreads_.emplace_back(1, steps.data()[d]);
        }
        for (size_t i = 0; i < 3 * size_; ++i)
            require(std::abs(expected.data()[i]) <= LARGEST + 1, "colour_frame: an expected colour out of range");
        find_narrow_cells();
    }

    // wanted: YCoCg of each point, null in the decoder.
    template <class Coder>
    void code(Coder &coder, const int16_t *wanted) {
        for (uint32_t level = 0, stride = FIRST_STRIDE; stride && outcome == GOOD; ++level, stride /= 2) {
            const Pass pass(level, stride, size_);
            if (!pass.count) continue;
            predict(pass);
            for (size_t channel = 0; channel < 3 && outcome == GOOD; ++channel) code_channel(coder, wanted, pass, channel);
            add_known(pass);
        }
    }

private:
    // Points that are coded together: first, first + apart, …; those in the middle between two of them are known.
    struct Pass {
        uint32_t level;
        size_t first, apart, count;

        Pass(uint32_t number, size_t stride, size_t size)
            : level(number), first(number ? stride : 0), apart(number ? 2 * stride : stride),
              count(size > first ? (size - first + apart - 1) / apart : 0) {}

        size_t row(size_t k) const { return first + k * apart; }
    };

    // What a channel of the points of a pass is coded from.
    struct Channel {
        std::vector<int16_t> base, correction, predicted;
        std::vector<uint8_t> activity, spread;  // classes

        void resize(size_t n) {
            base.resize(n), correction.resize(n), predicted.resize(n);
            activity.resize(n), spread.resize(n);
        }
    };

    // Cells relative to the lowest, if the frame's extent is narrow.
    void find_narrow_cells() {
        int64_t lowest[3] = {0, 0, 0}, highest[3] = {0, 0, 0};
        for (size_t i = 0; i < size_; ++i)
            for (size_t d = 0; d < 3; ++d) {
                const int64_t at = cells_.data()[3 * i + d];
                lowest[d] = i ? std::min(lowest[d], at) : at;
                highest[d] = i ? std::max(highest[d], at) : at;
            }
        for (size_t d = 0; d < 3; ++d)
            if (highest[d] - lowest[d] >= NARROW) return;
        narrow_.resize(size_);
        for (size_t i = 0; i < size_; ++i) {
            for (size_t d = 0; d < 3; ++d) narrow_[i].at[d] = int16_t(cells_.data()[3 * i + d] - lowest[d]);
            narrow_[i].at[3] = 0;
        }
    }

    // Bases, corrections and classes of the points of a pass.
    void predict(const Pass &pass) {
        for (Channel &channel : channels_) channel.resize(pass.count);
        coded_.assign(pass.count, 0);
        if (!narrow_.empty() && pass.level) {
            known_cells_.resize(known.size());
            for (size_t j = 0; j < known.size(); ++j) known_cells_[j] = narrow_[j * pass.apart];
        }
        for (size_t k = 0; k < pass.count; ++k) {
            const size_t row = pass.row(k);
            const bool is_expected = is_expected_.data()[row];
            const Means means = pass.level ? means_of(known.data(), neighbours(row, pass.apart)) : Means{{GREY, 0, 0, 0}, {}, {}, {}};
            for (size_t d = 0; d < 3; ++d) {
                Channel &channel = channels_[d];
                const int base = is_expected ? expected_.data()[3 * row + d] : means.colour[d];
                channel.base[k] = int16_t(base);
                channel.correction[k] = means.error[d];
                channel.predicted[k] = int16_t(base + (is_expected ? means.error[d] * int(shares_.data()[d]) >> SHARE_BITS : 0));
                channel.activity[k] = activities_[d].of(means.magnitude[d]);
                channel.spread[k] = spreads_[d].of(means.spread[d]);
            }
        }
    }

    // The nearest known points of a point. Points 0, apart, 2 · apart, … are known.
    Neighbours neighbours(size_t row, size_t apart) const {
        const size_t width = std::min(WINDOW, known.size());
        const int64_t start = int64_t(row / apart) + 1 - int64_t(WINDOW / 2);
        const size_t first = size_t(std::clamp<int64_t>(start, 0, int64_t(known.size() - width)));
        if (width == WINDOW && !narrow_.empty()) return NearestOfWindow::find(known_cells_.data(), first, narrow_[row]);
        return nearest_known(first, width, [&](size_t number) {
            return square_between(cells_.data() + 3 * number * apart, cells_.data() + 3 * row);
        });
    }

    template <class Coder>
    void code_channel(Coder &coder, const int16_t *wanted, const Pass &pass, size_t number) {
        Channel &channel = channels_[number];
        const int32_t step = int32_t(steps_.data()[number]);
        if (wanted) {
            const int32_t rounding = step > 1 ? step * ROUNDING >> 8 : 0;
            differences_.resize(pass.count);
            for (size_t k = 0; k < pass.count; ++k) {
                const int32_t apart = wanted[3 * pass.row(k) + number] - channel.predicted[k];
                const int32_t size = int32_t(uint32_t(std::abs(apart) + rounding) / uint32_t(step));
                differences_[k] = apart < 0 ? -size : size;
            }
        }
        code_integers(coder, wanted ? differences_.data() : nullptr, pass, number);
        if (is_cut_off(coder)) outcome = CUT_OFF;
        for (size_t k = 0; k < pass.count && outcome == GOOD; ++k)
            if (std::abs(found_[k]) >= 1 << WIDE_BITS) outcome = OUT_OF_RANGE;
        if (outcome != GOOD) return;
        fresh_.resize(pass.count);
        for (size_t k = 0; k < pass.count; ++k) {
            const int32_t value = std::clamp<int32_t>(channel.predicted[k] + found_[k] * step, -LARGEST - 1, LARGEST);
            const int32_t error = value - channel.base[k], correction = channel.correction[k];
            fresh_[k].colour[number] = int16_t(value);
            fresh_[k].error[number] = int16_t(error);
            coded_[k] = std::max(coded_[k], class_of_difference(std::abs(found_[k])));
            if (!is_expected_.data()[pass.row(k)]) continue;
            products[number] += error * correction;
            squares[number] += correction * correction;
        }
    }

    // The points of a pass join the known ones.
    void add_known(const Pass &pass) {
        for (Known &point : fresh_) point.colour[3] = point.error[3] = 0;
        if (!pass.level) {
            known = fresh_;
            return;
        }
        size_t old = known.size();
        known.resize(old + pass.count);
        if (old > pass.count) --old, known[2 * old] = known[old];
        while (old--) known[2 * old + 1] = fresh_[old], known[2 * old] = known[old];
    }

    // Codes integers of a channel's points, one kind of bits after another. wanted: null in the decoder.
    template <class Coder>
    void code_integers(Coder &coder, const int32_t *wanted, const Pass &pass, size_t number) {
        const Channel &channel = channels_[number];
        const auto code = [&](uint32_t kind, uint32_t row, int bit) {
            const uint32_t base = uint32_t(number) * KINDS + kind, activity = channel.activity[row], spread = channel.spread[row];
            const uint32_t coded = coded_[row];
            const uint32_t contexts[bits::INPUTS] = {
                base * ACTIVITIES + activity, base * CLASSES + coded, (base * ACTIVITIES + spread) * LEVELS + pass.level,
                (base * ACTIVITIES + activity) * CLASSES + coded, (base * ACTIVITIES + spread) * ACTIVITIES + activity};
            return coder.code(contexts, base * CLASSES + coded, bit);
        };
        const auto magnitude = [&](uint32_t row) { return wanted ? std::abs(wanted[row]) : 0; };
        found_.resize(pass.count);
        rest_.resize(pass.count);
        size_t left = 0;
        for (uint32_t row = 0; row < pass.count; ++row) {
            const int bit = code(0, row, magnitude(row) > 0);
            found_[row] = bit;
            rest_[left] = row;
            left += size_t(bit);
        }
        rest_.resize(left);
        negative_.resize(left);
        for (size_t i = 0; i < left; ++i) negative_[i] = uint8_t(code(1, rest_[i], wanted && wanted[rest_[i]] < 0));
        signed_ = rest_;
        for (int size = 0; size < UNARY && left; ++size) {
            const size_t count = left;
            left = 0;
            for (size_t i = 0; i < count; ++i) {
                const uint32_t row = rest_[i];
                const int bit = code(uint32_t(FIRST_MAGNITUDE + size), row, magnitude(row) > size + 1);
                found_[row] += bit;
                rest_[left] = row;
                left += size_t(bit);
            }
        }
        for (int digit = 0; digit < WIDE_BITS; ++digit)
            for (size_t i = 0; i < left; ++i) {
                const uint32_t row = rest_[i];
                found_[row] += code(uint32_t(WIDE_KIND + digit), row, (magnitude(row) - UNARY - 1) >> digit & 1) << digit;
            }
        for (size_t i = 0; i < signed_.size(); ++i)
            if (negative_[i]) found_[signed_[i]] = -found_[signed_[i]];
    }

    const size_t size_;
    const Cells cells_;
    const Colours expected_;
    const Input<uint8_t, 1> is_expected_;
    const Rows shares_, steps_;
    std::vector<Classes> activities_, spreads_;  // of each channel
    std::vector<Cell> narrow_, known_cells_;
    Channel channels_[3];
    std::vector<Known> fresh_;
    std::vector<uint8_t> coded_, negative_;  // coded_: class of earlier channels
    std::vector<uint32_t> rest_, signed_;
    std::vector<int32_t> differences_, found_;
};

// (decoded colours, products, squares, 0), or (None, None, None, outcome).
nb::tuple result_of(const Frame &frame) {
    if (frame.outcome != Frame::GOOD) return nb::make_tuple(nb::none(), nb::none(), nb::none(), int(frame.outcome));
    Fresh<int16_t> known(3 * frame.known.size());
    Fresh<int64_t> products(3), squares(3);
    for (size_t i = 0; i < frame.known.size(); ++i) std::copy_n(frame.known[i].colour, 3, known.data.get() + 3 * i);
    std::copy_n(frame.products.data(), 3, products.data.get());
    std::copy_n(frame.squares.data(), 3, squares.data.get());
    return nb::make_tuple(known.give({frame.known.size(), 3}), products.give({3}), squares.give({3}), 0);
}

nb::tuple encode_frame(bit_arrays::BitArrayEncoder &coder, Colours wanted, Cells cells, Colours expected,
                       Input<uint8_t, 1> is_expected, Rows shares, Rows steps) {
    Frame frame(cells, expected, is_expected, shares, steps);
    require(wanted.shape(0) == cells.shape(0) && wanted.shape(1) == 3, "colour_frame: shapes differ");
    {
        nb::gil_scoped_release release;
        frame.code(coder, wanted.data());
    }
    return result_of(frame);
}

nb::tuple decode_frame(bit_arrays::BitArrayDecoder &coder, Cells cells, Colours expected, Input<uint8_t, 1> is_expected,
                       Rows shares, Rows steps) {
    Frame frame(cells, expected, is_expected, shares, steps);
    {
        nb::gil_scoped_release release;
        frame.code(coder, nullptr);
    }
    return result_of(frame);
}

// point_colours.ycocg_from_rgb: colours (n, 3).
Output<int16_t> ycocg_from_rgb(Input<uint8_t, 2> colours) {
    const size_t n = colours.shape(0);
    require(colours.shape(1) == 3, "ycocg_from_rgb: shapes differ");
    Fresh<int16_t> out(3 * n);
    for (size_t i = 0; i < n; ++i) {
        const int red = colours.data()[3 * i], green = colours.data()[3 * i + 1], blue = colours.data()[3 * i + 2];
        const int co = red - blue, half = blue + (co >> 1), cg = green - half;
        out.data[3 * i] = int16_t(half + (cg >> 1));
        out.data[3 * i + 1] = int16_t(co);
        out.data[3 * i + 2] = int16_t(cg);
    }
    return out.give({n, 3});
}

// point_colours.rgb_from_ycocg: values (n, 3).
Output<uint8_t> rgb_from_ycocg(Colours values) {
    const size_t n = values.shape(0);
    require(values.shape(1) == 3, "rgb_from_ycocg: shapes differ");
    Fresh<uint8_t> out(3 * n);
    const auto byte = [](int value) { return uint8_t(std::clamp(value, 0, 255)); };
    for (size_t i = 0; i < n; ++i) {
        const int y = values.data()[3 * i], co = values.data()[3 * i + 1], cg = values.data()[3 * i + 2];
        const int half = y - (cg >> 1), blue = half - (co >> 1);
        out.data[3 * i] = byte(blue + co);
        out.data[3 * i + 1] = byte(cg + half);
        out.data[3 * i + 2] = byte(blue);
    }
    return out.give({n, 3});
}

}  // namespace

void bind_point_colours(nb::module_ &m) {
    m.def("ycocg_from_rgb", &ycocg_from_rgb);
    m.def("rgb_from_ycocg", &rgb_from_ycocg);
    m.def("colour_frame_encode", &encode_frame);
    m.def("colour_frame_decode", &decode_frame);
}
