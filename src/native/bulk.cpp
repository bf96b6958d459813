// entropy/bulk.py, _tokens: long arrays of tokens, diagonal by diagonal. Integers of 16 and 32 bits, as there.

#include <algorithm>
#include <stdexcept>
#include <vector>

#include "arrays.h"

namespace {

constexpr int PRECISION = 12;
constexpr uint32_t MASK = (1u << PRECISION) - 1, LOWEST = 1u << 16;
constexpr uint16_t ESCAPE = 255;
constexpr int64_t TOO_FEW_WORDS = -1, OUT_OF_RANGE = -2;

// layout.Layout: places of the flat array.
struct Layout {
    int64_t steps, lanes, segments, row;
};

// bulk._DiagonalContexts
class Contexts {
public:
    Contexts(const Layout &layout, uint16_t *tokens, const uint16_t *weights, const uint16_t *hints)
        : of_(layout), tokens_(tokens), weights_(weights), hints_(hints), mean_(size_t(layout.lanes * layout.segments), 0) {}

    void expected(int64_t i, int64_t begin, int64_t end, uint16_t *out) const {
        const int64_t row = of_.row, k = of_.segments, count = end - begin;
        const int64_t offsets[] = {row, 2 * row, row + k, 2 * row + 2 * k, 2 * row + k};
        std::fill_n(out, count, uint16_t(0));
        for (int n = 0; n < 5; ++n) {
            const uint16_t weight = weights_[n], *near = tokens_ + begin - offsets[n];
            for (int64_t j = 0; weight && j < count; ++j) out[j] = uint16_t(out[j] + near[j] * weight);
        }
        const uint16_t of_mean = weights_[5], of_hint = hints_ ? weights_[6] : uint16_t(0);
        const uint16_t *means = mean_.data() + first(i, begin);
        for (int64_t j = 0; of_mean && j < count; ++j)
            out[j] = uint16_t(out[j] + (uint16_t((means[j] >> 4) * of_mean) >> 4));
        for (int64_t j = 0; of_hint && j < count; ++j) out[j] = uint16_t(out[j] + hints_[begin + j] * of_hint);
    }

    void update(int64_t i, int64_t begin, int64_t end) {
        const int64_t k = of_.segments, left = (i + 2) * of_.row;
        if (i < of_.steps) {
            std::copy_n(tokens_ + left + 2 * k, k, tokens_ + left + k);
            std::copy_n(tokens_ + left + 2 * k, k, tokens_ + left);
        }
        if (weights_[5]) {
            uint16_t *means = mean_.data() + first(i, begin);
            for (int64_t j = 0; j < end - begin; ++j) {
                const int64_t age = i - j / k - std::max<int64_t>(0, i - of_.steps + 1);
                const int speed = age == 0 ? 1 : age < 3 ? 2 : 3;
                means[j] = uint16_t(means[j] - (means[j] >> speed) + (tokens_[begin + j] << (8 - speed)));
            }
        }
        if (i + 1 < of_.lanes) {
            const int64_t ours = left + (i + 2) * k;
            for (int64_t j = 0; j < k; ++j) {
                const uint16_t newest = tokens_[ours + j];
                tokens_[ours + k + j] = tokens_[ours + k - of_.row + j] = newest;
                mean_[size_t((i + 1) * k + j)] = uint16_t(newest << 8);
            }
        }
    }

private:
    int64_t first(int64_t i, int64_t begin) const { return begin - (i + 2) * of_.row - 2 * of_.segments; }

    const Layout of_;
    uint16_t *tokens_;
    const uint16_t *weights_, *hints_;
    std::vector<uint16_t> mean_;
};

// bulk._pop: false where there are too few words. law(j): of symbol j; put(j, symbol).
template <class Law, class Put>
bool pop(uint32_t *states, int64_t count_of_states, int64_t count, const uint32_t *slots, const uint16_t *words,
         int64_t known, int64_t &used, Law law, Put put) {
    for (int64_t turn = 0; turn < count; turn += count_of_states)
        for (int64_t j = turn; j < std::min(turn + count_of_states, count); ++j) {
            uint32_t x = states[j - turn];
            const uint32_t found = slots[(size_t(law(j)) << PRECISION) + (x & MASK)];
            put(j, uint16_t(found & 255));
            x = (x >> PRECISION) * (found >> 20) + ((found >> 8) & MASK);
            if (x < LOWEST) {
                if (used == known) return false;
                x = x << 16 | words[used++];
            }
            states[j - turn] = x;
        }
    return true;
}

// Fills `tokens` (flat) and leaves the last states in `states`; returns how many words were taken, or what is wrong.
// diagonals (n, 3): Layout.diagonals; shape: steps, lanes, segments, row; hints: flat, or none.
int64_t bulk_tokens(InPlace<uint16_t, 1> tokens, InPlace<uint32_t, 1> states, Input<int64_t, 2> diagonals,
                    Input<int64_t, 1> shape, Input<uint16_t, 1> weights, Input<uint8_t, 1> ladder, Input<uint32_t, 1> slots,
                    Input<int64_t, 1> last, Input<uint16_t, 1> words, Input<uint16_t, 1> hints) {
    if (shape.shape(0) != 4 || weights.shape(0) != 7 || diagonals.shape(1) != 3 || !last.shape(0) || !states.shape(0) ||
        slots.shape(0) != last.shape(0) << PRECISION || (hints.shape(0) && hints.shape(0) != tokens.shape(0)))
        throw std::invalid_argument("bulk_tokens: shapes differ");
    const Layout layout{shape.data()[0], shape.data()[1], shape.data()[2], shape.data()[3]};
    if (int64_t(tokens.shape(0)) != (layout.steps + layout.lanes + 1) * layout.row || layout.segments < 1 ||
        layout.row != (layout.lanes + 2) * layout.segments)
        throw std::invalid_argument("bulk_tokens: another layout");
    const int64_t laws = int64_t(last.shape(0)) - 1;  // the last table is of what escapes are beyond their law
    if (std::any_of(ladder.data(), ladder.data() + ladder.shape(0), [=](uint8_t law) { return law >= laws; }))
        throw std::invalid_argument("bulk_tokens: a law without a table");
    uint16_t *flat = tokens.data();
    Contexts contexts(layout, flat, weights.data(), hints.shape(0) ? hints.data() : nullptr);
    std::vector<uint16_t> expected(size_t(layout.lanes * layout.segments));
    std::vector<int64_t> escaped;
    int64_t used = 0;
    const int64_t known = int64_t(words.shape(0)), count_of_states = int64_t(states.shape(0));
    nb::gil_scoped_release release;
    for (size_t d = 0; d < diagonals.shape(0); ++d) {
        const int64_t i = diagonals.data()[3 * d], begin = diagonals.data()[3 * d + 1], end = diagonals.data()[3 * d + 2];
        const int64_t place = begin - (i + 2) * layout.row - 2 * layout.segments;
        if (i < 0 || i >= layout.steps + layout.lanes - 1 || place < 0 || end <= begin ||
            place + end - begin > layout.lanes * layout.segments)
            return OUT_OF_RANGE;
        contexts.expected(i, begin, end, expected.data());
        uint16_t most = 0;
        for (int64_t j = 0; j < end - begin; ++j) most = std::max(most, expected[size_t(j)]);
        if (most >= ladder.shape(0)) return OUT_OF_RANGE;
        escaped.clear();
        auto law = [&](int64_t j) { return ladder.data()[expected[size_t(j)]]; };
        auto put = [&](int64_t j, uint16_t symbol) {
            flat[begin + j] = symbol;
            if (symbol == ESCAPE) escaped.push_back(j);
        };
        auto beyond = [&](int64_t e, uint16_t symbol) {
            const int64_t j = escaped[size_t(e)];
            flat[begin + j] = uint16_t(std::min<int64_t>(last.data()[law(j)] + symbol, 255));
        };
        if (!pop(states.data(), count_of_states, end - begin, slots.data(), words.data(), known, used, law, put) ||
            !pop(states.data(), count_of_states, int64_t(escaped.size()), slots.data(), words.data(), known, used,
                 [=](int64_t) { return laws; }, beyond))
            return TOO_FEW_WORDS;
        contexts.update(i, begin, end);
    }
    return used;
}

}  // namespace

void bind_bulk(nb::module_ &m) {
    m.def("bulk_tokens", &bulk_tokens, nb::arg().noconvert(), nb::arg().noconvert(), nb::arg(), nb::arg(), nb::arg(),
          nb::arg(), nb::arg(), nb::arg(), nb::arg(), nb::arg());
}
