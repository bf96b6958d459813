// Colours of lattice points, for codecs/bodycast/surface_memory.py and colour_lifting.py, which define the results.
// Integers only.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#if defined(__SSE2__)  // part of every x86-64 processor
#include <emmintrin.h>
#endif

#include "bit_arrays.h"
#include "integers.h"

namespace {

constexpr size_t AVERAGED = 4;                          // nearest points to average
constexpr int64_t PLACE_WEIGHT = int64_t(1) << 40, PLACE_SOFTENING = 2000;
constexpr int64_t CELL_WEIGHT = 1 << 20, CELL_SOFTENING = 2, WINDOW = 16;
constexpr int UNARY = 24, WIDE_BITS = 11, FIRST_MAGNITUDE = 2, WIDE_KIND = FIRST_MAGNITUDE + UNARY;
constexpr int KINDS = WIDE_KIND + WIDE_BITS, CLASSES = 6, ACTIVITIES = 9, LEVELS = 7;
constexpr int CLASS_EDGES[] = {1, 2, 4, 8, 16}, ACTIVITY_EDGES[] = {1, 2, 3, 5, 8, 12, 18, 28};
constexpr int SHARE_BITS = 4, ROUNDING = 96, GREY = 128;
constexpr int64_t LARGEST = 511, LARGEST_PLACE = 1 << 23;
constexpr size_t FIRST_STRIDE = 64;

using Numbers = Input<int64_t, 2>;
using Rows = Input<int64_t, 1>;

template <class Number>
int64_t square_between(const Number *a, const int64_t *b) {
    int64_t sum = 0;
    for (int d = 0; d < 3; ++d) sum += (a[d] - b[d]) * (a[d] - b[d]);
    return sum;
}

// Keeps the AVERAGED smallest squares, the first of equal ones.
struct Nearest {
    std::array<int64_t, AVERAGED> square;
    std::array<size_t, AVERAGED> at;
    size_t count = 0;

    void add(int64_t own, size_t place) {
        if (count == AVERAGED && own >= square[AVERAGED - 1]) return;
        size_t i = count < AVERAGED ? count++ : AVERAGED - 1;
        for (; i && square[i - 1] > own; --i) square[i] = square[i - 1], at[i] = at[i - 1];
        square[i] = own;
        at[i] = place;
    }
};

void require(bool good, const char *what) {
    if (!good) throw std::invalid_argument(what);
}

constexpr size_t KEPT = 8, SEARCHED = 7;  // kept points of a sample; samples searched for candidates
constexpr int64_t SLOTS = 64;              // slots for candidates, at least KEPT · SEARCHED

// A vector of AVERAGED floats.
#if defined(__SSE2__)
struct Group {
    __m128 values;

    static Group of(float value) { return {_mm_set1_ps(value)}; }
    void store(float *to) const { _mm_storeu_ps(to, values); }
    void keep_least(const Group &other) { values = _mm_min_ps(values, other.values); }

    void add_squares(const int32_t *coordinates, int32_t origin) {
        const __m128i numbers = _mm_loadu_si128(reinterpret_cast<const __m128i *>(coordinates));
        const __m128 apart = _mm_cvtepi32_ps(_mm_sub_epi32(numbers, _mm_set1_epi32(origin)));
        values = _mm_add_ps(values, _mm_mul_ps(apart, apart));
    }

    // A bit for each of these that is at most the limit.
    static int within(const float *from, float limit) {
        return _mm_movemask_ps(_mm_cmple_ps(_mm_loadu_ps(from), _mm_set1_ps(limit)));
    }

    float largest() const {
        float all[AVERAGED];
        store(all);
        return *std::max_element(all, all + AVERAGED);
    }
};
#else
struct Group {
    float values[AVERAGED];

    static Group of(float value) { return {{value, value, value, value}}; }
    void store(float *to) const { std::copy(values, values + AVERAGED, to); }

    void keep_least(const Group &other) {
        for (size_t k = 0; k < AVERAGED; ++k) values[k] = std::min(values[k], other.values[k]);
    }

    void add_squares(const int32_t *coordinates, int32_t origin) {
        for (size_t k = 0; k < AVERAGED; ++k) {
            const float apart = float(coordinates[k] - origin);
            values[k] += apart * apart;
        }
    }

    // A bit for each of these that is at most the limit.
    static int within(const float *from, float limit) {
        int result = 0;
        for (size_t k = 0; k < AVERAGED; ++k) result |= int(from[k] <= limit) << k;
        return result;
    }

    float largest() const { return *std::max_element(values, values + AVERAGED); }
};
#endif

// Finds the candidates that may be among the AVERAGED nearest, by squared distances in floats.
class Candidates {
public:
    // known (3, KEPT): coordinates with magnitudes below 2^25.
    void add(const int32_t *known, const int32_t *place) {
        for (size_t k = 0; k < KEPT; k += AVERAGED) {
            Group squares = {};
            for (size_t d = 0; d < 3; ++d) squares.add_squares(known + d * KEPT + k, place[d]);
            squares.store(squares_ + count_ + k);
            least_.keep_least(squares);
        }
        count_ += KEPT;
    }

    // Bit mask of candidates. The minima of AVERAGED groups are AVERAGED candidates,
    // so the nearest are not farther than these.
    uint64_t mask() const {
        const float limit = least_.largest() * SLACK;
        uint64_t result = 0;
        for (size_t k = 0; k < count_; k += AVERAGED) result |= uint64_t(Group::within(squares_ + k, limit)) << k;
        return result;
    }

private:
    static constexpr float SLACK = 1 + 1.0f / (1 << 20);  // relative error of a sum of three squares < 2^-21
    float squares_[SEARCHED * KEPT];
    Group least_ = Group::of(INFINITY);
    size_t count_ = 0;
};

// Keeps the AVERAGED smallest keys, sorted, without branches.
struct Smallest {
    int64_t keys[AVERAGED] = {INT64_MAX, INT64_MAX, INT64_MAX, INT64_MAX};

    void add(int64_t key) {
        for (int64_t &own : keys) {
            const int64_t swapped = (own ^ key) & -int64_t(key < own);
            own ^= swapped;
            key ^= swapped;
        }
    }
};

// ColourMemory._expected. rows (n), places (n, 3): of the points; neighbours (m, k), known places (m, 3, kept), colours
// (m, kept, 3): of the memory.
Output<int64_t> expected_colours(Rows rows, Numbers places, Numbers neighbours, Input<int32_t, 3> known,
                                 Input<int32_t, 3> colours) {
    const size_t n = rows.shape(0), samples = known.shape(0), around = neighbours.shape(1);
    require(places.shape(0) == n && places.shape(1) == 3 && neighbours.shape(0) == samples && around < SEARCHED && known.shape(1) == 3 &&
                known.shape(2) == KEPT && colours.shape(0) == samples && colours.shape(1) == KEPT && colours.shape(2) == 3,
            "expected_colours: shapes differ");
    for (size_t i = 0; i < neighbours.size(); ++i)
        require(neighbours.data()[i] >= 0 && size_t(neighbours.data()[i]) < samples, "expected_colours: a row beyond the samples");
    Fresh<int64_t> out(3 * n);
    {
        nb::gil_scoped_release release;
        for (size_t i = 0; i < n; ++i) {
            const int64_t row = rows.data()[i];
            require(row >= 0 && size_t(row) < samples, "expected_colours: a row beyond the samples");
            int32_t place[3];
            for (size_t d = 0; d < 3; ++d) {
                require(std::abs(places.data()[3 * i + d]) <= LARGEST_PLACE, "expected_colours: a place out of range");
                place[d] = int32_t(places.data()[3 * i + d]);
            }
            Candidates candidates;
            size_t searched[SEARCHED];
            for (size_t k = 0; k <= around; ++k) {
                searched[k] = size_t(k ? neighbours.data()[size_t(row) * around + k - 1] : row);
                candidates.add(known.data() + 3 * KEPT * searched[k], place);
            }
            Smallest nearest;
            for (uint64_t mask = candidates.mask(); mask; mask &= mask - 1) {
                const size_t slot = size_t(lowest_bit(mask));
                const int32_t *own = known.data() + 3 * KEPT * searched[slot / KEPT] + slot % KEPT;
                const int64_t x = int64_t(own[0]) - place[0], y = int64_t(own[KEPT]) - place[1], z = int64_t(own[2 * KEPT]) - place[2];
                nearest.add((x * x + y * y + z * z) * SLOTS + int64_t(slot));
            }
            int64_t total = 0, sums[3] = {0, 0, 0};
            for (int64_t key : nearest.keys) {
                const size_t slot = size_t(key % SLOTS);
                const int32_t *colour = colours.data() + 3 * (KEPT * searched[slot / KEPT] + slot % KEPT);
                const int64_t weight = floor_quotient(PLACE_WEIGHT, key / SLOTS + PLACE_SOFTENING);
                total += weight;
                for (int d = 0; d < 3; ++d) sums[d] += weight * colour[d];
            }
            total = std::max<int64_t>(total, 1);
            for (int d = 0; d < 3; ++d) out.data[3 * i + size_t(d)] = floor_quotient(sums[d] + total / 2, total);
        }
    }
    return out.give({n, 3});
}

// colour_lifting.Neighbourhood: the surroundings of a point before it is coded.
struct Neighbourhood {
    std::array<int32_t, 3> base, correction, activity, spread;
};

int64_t classes(const int *edges, int count, int64_t value) {
    int found = 0;
    while (found < count && edges[found] <= value) ++found;
    return found;
}

// ColourLifting.code_frame: codes the colours of a frame's points, pass by pass.
class Frame {
public:
    std::vector<std::array<int32_t, 3>> known;
    std::array<int64_t, 3> products{}, squares{};  // sums over the points with expected colours
    enum { GOOD, CUT_OFF, OUT_OF_RANGE } outcome = GOOD;

    Frame(Numbers cells, Numbers expected, Input<uint8_t, 1> is_expected, Rows shares, Rows steps)
        : known(cells.shape(0)), cells_(cells), expected_(expected), is_expected_(is_expected), shares_(shares),
          steps_(steps), bases_(cells.shape(0)) {
        require(cells.shape(1) == 3 && expected.shape(0) == cells.shape(0) && expected.shape(1) == 3 &&
                    is_expected.shape(0) == cells.shape(0) && shares.shape(0) == 3 && steps.shape(0) == 3,
                "colour_frame: shapes differ");
        for (int d = 0; d < 3; ++d) require(steps.data()[d] > 0, "colour_frame: a step below 1");
    }

    // wanted: YCoCg of each point, null in the decoder.
    template <class Coder>
    void code(Coder &coder, const int64_t *wanted) {
        for (size_t level = 0, stride = FIRST_STRIDE; stride; ++level, stride /= 2) {
            rows_.clear();
            for (size_t i = level ? stride : 0; i < known.size(); i += level ? 2 * stride : stride) rows_.push_back(i);
            if (rows_.empty()) continue;
            code_pass(coder, wanted, level, level ? 2 * stride : 0);
            if (outcome != GOOD) return;
        }
    }

private:
    template <class Coder>
    void code_pass(Coder &coder, const int64_t *wanted, size_t level, size_t stride) {
        const size_t n = rows_.size();
        around_.resize(n);
        coded_.assign(n, 0);
        for (size_t k = 0; k < n; ++k) around_[k] = around(rows_[k], stride);
        for (size_t k = 0; k < n; ++k) bases_[rows_[k]] = around_[k].base;
        place_.resize(n);
        differences_.resize(n);
        for (size_t channel = 0; channel < 3; ++channel) {
            const int64_t step = steps_.data()[channel], rounding = step > 1 ? step * ROUNDING >> 8 : 0;
            for (size_t k = 0; k < n; ++k) {
                const Neighbourhood &near = around_[k];
                place_[k] = {uint32_t(channel), uint32_t(classes(ACTIVITY_EDGES, ACTIVITIES - 1, 2 * near.activity[channel] / step)),
                             uint32_t(classes(ACTIVITY_EDGES, ACTIVITIES - 1, near.spread[channel] / step)), coded_[k]};
                if (!wanted) continue;
                const int64_t apart = wanted[3 * rows_[k] + channel] - predicted(k, channel);
                const int64_t size = (std::abs(apart) + rounding) / step;
                differences_[k] = apart < 0 ? -size : size;
            }
            code_integers(coder, wanted ? differences_.data() : nullptr, uint32_t(level));
            if (is_cut_off(coder)) outcome = CUT_OFF;
            for (size_t k = 0; k < n && outcome == GOOD; ++k)
                if (std::abs(found_[k]) >= int64_t(1) << WIDE_BITS) outcome = OUT_OF_RANGE;
            if (outcome != GOOD) return;
            for (size_t k = 0; k < n; ++k) {
                const int64_t value = std::clamp(predicted(k, channel) + found_[k] * step, -LARGEST - 1, LARGEST);
                known[rows_[k]][channel] = int32_t(value);
                coded_[k] = std::max(coded_[k], uint32_t(classes(CLASS_EDGES, CLASSES - 1, std::abs(found_[k]))));
                if (!is_expected_.data()[rows_[k]]) continue;
                const int64_t correction = around_[k].correction[channel];
                products[channel] += (value - around_[k].base[channel]) * correction;
                squares[channel] += correction * correction;
            }
        }
    }

    int64_t predicted(size_t k, size_t channel) const {
        const int64_t share = is_expected_.data()[rows_[k]] ? shares_.data()[channel] : 0;
        return around_[k].base[channel] + (around_[k].correction[channel] * share >> SHARE_BITS);
    }

    // The surroundings of a point. Points 0, stride, 2 · stride, … are known; stride 0: none.
    Neighbourhood around(size_t row, size_t stride) const {
        Neighbourhood result{};
        const bool is_expected = is_expected_.data()[row];
        if (!stride) result.base = {GREY, 0, 0};
        if (is_expected)
            for (size_t d = 0; d < 3; ++d) result.base[d] = int32_t(expected_.data()[3 * row + d]);
        if (!stride) return result;
        const int64_t count = int64_t((known.size() + stride - 1) / stride), width = std::min(WINDOW, count);
        const int64_t first = std::clamp<int64_t>(int64_t(row / stride) + 1 - WINDOW / 2, 0, count - width);
        Nearest nearest;
        for (size_t at = size_t(first) * stride, end = size_t(first + width) * stride; at < end; at += stride)
            nearest.add(square_between(cells_.data() + 3 * at, cells_.data() + 3 * row), at);
        int64_t total = 0, mean[3] = {0, 0, 0}, error[3] = {0, 0, 0}, magnitude[3] = {0, 0, 0};
        for (size_t k = 0; k < nearest.count; ++k) {
            const int64_t square = nearest.square[k] + CELL_SOFTENING;
            const int64_t weight = square < CELL_WEIGHT ? floor_quotient(CELL_WEIGHT, square) : 1;
            total += weight;
            for (size_t d = 0; d < 3; ++d) {
                const int64_t colour = known[nearest.at[k]][d], own = colour - bases_[nearest.at[k]][d];
                mean[d] += weight * colour;
                error[d] += weight * own;
                magnitude[d] += weight * std::abs(own);
            }
        }
        for (size_t d = 0; d < 3; ++d) {
            const int32_t middle = int32_t(floor_quotient(mean[d], total));
            if (!is_expected) result.base[d] = middle;
            result.correction[d] = int32_t(floor_quotient(error[d], total));
            result.activity[d] = int32_t(floor_quotient(magnitude[d], total));
            for (size_t k = 0; k < nearest.count; ++k)
                result.spread[d] = std::max(result.spread[d], std::abs(known[nearest.at[k]][d] - middle));
        }
        return result;
    }

    // Codes integers of the points with classes in `place_`, one kind of bits after another. wanted: null in the decoder.
    template <class Coder>
    void code_integers(Coder &coder, const int64_t *wanted, uint32_t level) {
        const size_t n = place_.size();
        // Codes a bit of the first `count` integers `rows`, or of all integers; prefetches the counters of a batch.
        const auto code = [&](uint32_t kind, const size_t *rows, size_t count, const auto &bit_of, const auto &take) {
            constexpr size_t BATCH = 32;
            uint32_t counters[BATCH][bits::INPUTS], sets[BATCH];
            for (size_t start = 0; start < count; start += BATCH) {
                const size_t stop = std::min(start + BATCH, count);
                for (size_t i = start; i < stop; ++i) {
                    const auto &[channel, activity, spread, coded] = place_[rows ? rows[i] : i];
                    const uint32_t base = channel * KINDS + kind;
                    const uint32_t contexts[bits::INPUTS] = {
                        base * ACTIVITIES + activity, base * CLASSES + coded, (base * ACTIVITIES + spread) * LEVELS + level,
                        (base * ACTIVITIES + activity) * CLASSES + coded,
                        (base * ACTIVITIES + spread) * ACTIVITIES + activity};
                    bits::Mixer::counters_of(contexts, counters[i - start]);
                    coder.fetch(counters[i - start]);
                    sets[i - start] = base * CLASSES + coded;
                }
                for (size_t i = start; i < stop; ++i) {
                    const size_t row = rows ? rows[i] : i;
                    take(row, coder.code_with(counters[i - start], sets[i - start], bit_of(row)));
                }
            }
        };
        const auto magnitude = [&](size_t row) { return wanted ? std::abs(wanted[row]) : 0; };
        found_.assign(n, 0);
        rest_.clear();
        code(0, nullptr, n, [&](size_t row) { return int(magnitude(row) > 0); }, [&](size_t row, int bit) {
            found_[row] = bit;
            if (bit) rest_.push_back(row);
        });
        negative_.clear();
        code(1, rest_.data(), rest_.size(), [&](size_t row) { return int(wanted && wanted[row] < 0); },
             [&](size_t row, int bit) {
                 if (bit) negative_.push_back(row);
             });
        for (int size = 0; size < UNARY && !rest_.empty(); ++size) {
            size_t left = 0;
            code(uint32_t(FIRST_MAGNITUDE + size), rest_.data(), rest_.size(),
                 [&](size_t row) { return int(magnitude(row) > size + 1); },
                 [&](size_t row, int bit) {
                     if (bit) rest_[left++] = row;
                 });
            rest_.resize(left);
            for (size_t row : rest_) ++found_[row];
        }
        for (int digit = 0; digit < WIDE_BITS; ++digit)
            code(uint32_t(WIDE_KIND + digit), rest_.data(), rest_.size(),
                 [&](size_t row) { return int((magnitude(row) - UNARY - 1) >> digit & 1); },
                 [&](size_t row, int bit) { found_[row] += int64_t(bit) << digit; });
        for (size_t row : negative_) found_[row] = -found_[row];
    }


    const Numbers cells_, expected_;
    const Input<uint8_t, 1> is_expected_;
    const Rows shares_, steps_;
    std::vector<std::array<int32_t, 3>> bases_;
    std::vector<size_t> rows_, rest_, negative_;
    std::vector<Neighbourhood> around_;
    std::vector<std::array<uint32_t, 4>> place_;  // channel; classes of activity, of spread, of earlier channels
    std::vector<uint32_t> coded_;
    std::vector<int64_t> differences_, found_;
};

// (decoded colours, products, squares, 0), or (None, None, None, outcome).
nb::tuple result_of(const Frame &frame) {
    if (frame.outcome != Frame::GOOD) return nb::make_tuple(nb::none(), nb::none(), nb::none(), int(frame.outcome));
    Fresh<int64_t> known(3 * frame.known.size()), products(3), squares(3);
    for (size_t i = 0; i < frame.known.size(); ++i) std::copy_n(frame.known[i].data(), 3, known.data.get() + 3 * i);
    std::copy_n(frame.products.data(), 3, products.data.get());
    std::copy_n(frame.squares.data(), 3, squares.data.get());
    return nb::make_tuple(known.give({frame.known.size(), 3}), products.give({3}), squares.give({3}), 0);
}

nb::tuple encode_frame(bit_arrays::BitArrayEncoder &coder, Numbers wanted, Numbers cells, Numbers expected,
                       Input<uint8_t, 1> is_expected, Rows shares, Rows steps) {
    Frame frame(cells, expected, is_expected, shares, steps);
    require(wanted.shape(0) == cells.shape(0) && wanted.shape(1) == 3, "colour_frame: shapes differ");
    {
        nb::gil_scoped_release release;
        frame.code(coder, wanted.data());
    }
    return result_of(frame);
}

nb::tuple decode_frame(bit_arrays::BitArrayDecoder &coder, Numbers cells, Numbers expected, Input<uint8_t, 1> is_expected,
                       Rows shares, Rows steps) {
    Frame frame(cells, expected, is_expected, shares, steps);
    {
        nb::gil_scoped_release release;
        frame.code(coder, nullptr);
    }
    return result_of(frame);
}

}  // namespace

void bind_point_colours(nb::module_ &m) {
    m.def("expected_colours", &expected_colours);
    m.def("colour_frame_encode", &encode_frame);
    m.def("colour_frame_decode", &decode_frame);
}
