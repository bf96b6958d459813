// Chooses predictors for all channels of a chunk, for signals/fitting.py, which has the same code in NumPy.

#include <stdexcept>
#include <utility>

#include "arrays.h"
#include "integers.h"
#include "signal_least_squares.h"
#include "signal_prediction.h"

namespace {

using namespace signals;

// fitting.py has the same constants and explains them.
constexpr size_t FIT_SAMPLES = 2048, PURSUIT_SAMPLES = 640, MIN_SAMPLES = 24, MOST_REFERENCES = 8;
constexpr int MAX_DEPTHS[] = {6, 3};  // for channels on a grid, and for counts
constexpr int MOST_SUM_BITS = 58;
constexpr double MAX_TAP = double(int64_t(1) << 52);

struct Reference {
    size_t place;  // index of the channel in the chunk
    int64_t taps[REFERENCE_TAPS];
};

// prediction.Predictor
struct Predictor {
    int shift = 0;
    int64_t bias = 0;
    std::vector<int64_t> own;
    std::vector<Reference> references;
};

struct Channel {
    std::vector<int64_t> own;  // kept samples
    std::vector<size_t> places;  // their indices in the chunk
    int64_t rank;
    bool is_counts;
};

// fitting._rows
std::vector<size_t> rows_of(size_t count, size_t most) {
    const size_t blocks = (count + BLOCK - 1) / BLOCK, step = (blocks * BLOCK + most - 1) / most;
    std::vector<size_t> rows;
    for (size_t block = 0; block < blocks; block += step)
        for (size_t t = block * BLOCK; t < std::min(count, (block + 1) * BLOCK); ++t) rows.push_back(t);
    return rows;
}

Matrix design(const Channel &channel, const Samples &samples, const std::vector<size_t> &others,
              const std::vector<size_t> &rows, size_t order) {
    Matrix matrix{2 + REFERENCE_TAPS * others.size() + order, {}};
    matrix.data.resize(rows.size() * matrix.width);
    const int64_t *own = channel.own.data(), first = own[0];
    double *out = matrix.data.data();
    for (const size_t t : rows) {
        const size_t place = channel.places[t];
        *out++ = 1;
        for (const size_t other : others) {
            const int64_t *line = samples.line(other);
            for (size_t j = 0; j < REFERENCE_TAPS; ++j) *out++ = double(line[place > j ? place - j : 0] - line[0]);
        }
        for (size_t j = 1; j <= order; ++j) *out++ = t >= j ? double(own[t - j] - first) : 0.0;
        *out++ = double(own[t] - first);
    }
    return matrix;
}

// fitting._Fit
struct Fit {
    Floats taps;
    double size_log2, largest;
};

Fit fit(const Matrix &matrix, const Columns &columns, const Floats &gram, const Floats &largest, size_t order,
        size_t count) {
    const Triangle of = cholesky(gram, columns.size());
    Fit result{taps_of(of, best_size(of, columns.size() - 1 - order, order, count)), 0, 1};
    const Floats left = left_of(matrix, columns, result.taps);
    for (size_t j = 1; j < result.taps.size(); ++j) result.largest = std::max(result.largest, largest[columns[j]]);
    result.largest = std::max(result.largest, largest[columns.back()]);
    result.size_log2 =
        code_bits(left.size(), [&](size_t t) { return std::abs(left[t]); }) / double(left.size());
    return result;
}

// fitting._fits_in_numpy
std::vector<Fit> fits(const Matrix &matrix, size_t others, size_t order, size_t count) {
    const size_t past = 1 + REFERENCE_TAPS * others, short_order = std::min(FIRST_ORDER, order);
    Columns all(matrix.width), alone{0}, shorter{0};
    for (size_t j = 0; j < matrix.width; ++j) all[j] = j;
    for (size_t j = past; j < matrix.width; ++j) {
        alone.push_back(j);
        if (j < past + short_order || j + 1 == matrix.width) shorter.push_back(j);
    }
    Floats largest(matrix.width);
    for (size_t i = 0; i < matrix.rows(); ++i)
        for (size_t j = 0; j < matrix.width; ++j) {
            const double size = std::abs(matrix.row(i)[j]);
            largest[j] = largest[j] < size ? size : largest[j];
        }
    const Triangle of = cholesky(gram_of(matrix, shorter, {}), shorter.size());
    const Floats gram = gram_of(matrix, all, weights_of(left_of(matrix, shorter, taps_of(of, shorter.size() - 1))));
    std::vector<Fit> result{fit(matrix, all, gram, largest, order, count)};
    if (others) {
        Floats inside;
        for (const size_t j : alone)
            for (const size_t k : alone) inside.push_back(gram[j * matrix.width + k]);
        result.push_back(fit(matrix, alone, inside, largest, order, count));
    }
    return result;
}

uint64_t size_of(int64_t x) { return x < 0 ? 0 - uint64_t(x) : uint64_t(x); }

// Sets the fields of a predictor that a fit and a shift determine; false if its numbers are too large.
bool scale(const Fit &fit, const std::vector<size_t> &others, const Samples &samples, int64_t first, int shift,
           Predictor &out) {
    const double unit = std::ldexp(1.0, shift);
    std::vector<int64_t> whole;
    bool is_small = true;
    for (size_t j = 0; j < fit.taps.size(); ++j) {
        const double tap = std::nearbyint(fit.taps[j] * unit);
        is_small = is_small && std::abs(tap) < (j ? MAX_TAP : 256 * MAX_TAP * 2);
        whole.push_back(is_small ? int64_t(tap) : 0);
    }
    if (!is_small) return false;
    const size_t split = 1 + REFERENCE_TAPS * others.size();
    out = {shift, 0, {whole.begin() + std::ptrdiff_t(split), whole.end()}, {}};
    uint64_t bias = uint64_t(whole[0]) + (uint64_t(first) << shift);  // modulo 2^64
    double about = double(whole[0]) + double(first) * unit;
    const auto subtract = [&](int64_t sample, int64_t tap) {
        bias -= uint64_t(sample) * uint64_t(tap);
        about -= double(sample) * double(tap);
    };
    for (const int64_t tap : out.own) subtract(first, tap);
    for (size_t i = 0; i < others.size(); ++i) {
        Reference reference{others[i], {}};
        for (size_t j = 0; j < REFERENCE_TAPS; ++j) {
            reference.taps[j] = whole[1 + REFERENCE_TAPS * i + j];
            subtract(samples.line(others[i])[0], reference.taps[j]);
        }
        out.references.push_back(reference);
    }
    out.bias = int64_t(bias);
    return std::abs(about) < 256 * MAX_TAP;
}

// fitting._rounded
Predictor rounded(const Fit &fit, const std::vector<size_t> &others, const Samples &samples, int64_t first) {
    uint64_t reach = size_of(first);
    for (const size_t other : others)
        for (size_t t = 0; t < samples.count; ++t) reach = std::max(reach, size_of(samples.line(other)[t]));
    reach += uint64_t(fit.largest);
    const double wanted = std::ceil(log2_of(fit.largest) - fit.size_log2) + 3;
    int shift = int(std::min(std::max(wanted, 4.0), double(MOST_SUM_BITS - bit_length(reach))));
    Predictor result;
    while (!scale(fit, others, samples, first, shift, result) && shift > 0) --shift;
    return result;
}

size_t varint_bytes(int64_t number) {
    uint64_t folded = number >= 0 ? uint64_t(number) << 1 : (size_of(number) << 1) - 1;
    size_t bytes = 1;
    for (; folded > 127; folded >>= 7) ++bytes;
    return bytes;
}

// Number of bytes of prediction.pack. numbers: of the channels in the signal.
size_t packed_bytes(const Predictor &predictor, const int64_t *numbers) {
    size_t bytes = 3 + varint_bytes(predictor.bias);
    for (const int64_t tap : predictor.own) bytes += varint_bytes(tap);
    for (const Reference &reference : predictor.references) {
        for (uint64_t number = uint64_t(numbers[reference.place]); ; number >>= 7) {
            ++bytes;
            if (number < 128) break;
        }
        for (const int64_t tap : reference.taps) bytes += varint_bytes(tap);
    }
    return bytes;
}

// prediction.known_sums and prediction.forward
std::vector<int64_t> residuals_of(const Predictor &predictor, const Channel &channel, const Samples &samples) {
    const uint64_t half = uint64_t(1) << predictor.shift >> 1;
    std::vector<int64_t> sums(samples.count, int64_t(uint64_t(predictor.bias) + half));
    for (const Reference &reference : predictor.references)
        add_taps(sums.data(), samples.line(reference.place), samples.count, reference.taps, REFERENCE_TAPS, 0);
    const size_t count = channel.own.size();
    for (size_t t = 0; t < count; ++t) sums[t] = sums[channel.places[t]];
    sums.resize(count);
    add_taps(sums.data(), channel.own.data(), count, predictor.own.data(), predictor.own.size(), 1);
    for (size_t t = 0; t < count; ++t)
        sums[t] = channel.own[t] - clamp_prediction(uint64_t(sums[t]), predictor.shift);
    return sums;
}

double bits_of(const std::vector<int64_t> &residuals) {
    return code_bits(residuals.size(), [&](size_t t) { return std::abs(double(residuals[t])); });
}

// fitting._pursuit
std::vector<size_t> explaining(const Samples &samples, size_t target, const std::vector<size_t> &candidates,
                               const Channel &channel) {
    std::vector<size_t> usable;
    for (size_t i = 0; i < channel.places.size(); ++i)
        if (!channel.places[i] || (i && channel.places[i - 1] + 1 == channel.places[i]))
            usable.push_back(channel.places[i]);
    std::vector<size_t> rows;
    for (const size_t i : rows_of(usable.size(), PURSUIT_SAMPLES)) rows.push_back(usable[i]);
    if (candidates.empty() || rows.size() < MIN_SAMPLES) return {};
    const double least = TAP_BITS * REFERENCE_TAPS / (double(samples.count) / 2);
    return pursuit(samples, target, candidates, rows, least, std::min(MOST_REFERENCES, candidates.size()));
}

template <class T>
nb::object array_of(const std::vector<T> &values) {
    Fresh<T> out(values.size());
    std::copy(values.begin(), values.end(), out.data.get());
    return nb::cast(out.give({values.size()}));
}

// fitting._fit: the predictor as a tuple, or None, and the residuals.
nb::tuple choose_one(const Channel &channel, const std::vector<size_t> &others, const Samples &samples,
                     const int64_t *numbers, bool &has_references) {
    const int64_t first = channel.own[0];
    const size_t count = channel.own.size();
    std::vector<int64_t> best(channel.own);
    for (int64_t &sample : best) sample -= first;
    double best_bits = bits_of(best);
    Predictor chosen;
    bool is_chosen = false;
    size_t order = 1;
    for (const size_t p : ORDERS)
        if (p && p <= std::max<size_t>(1, count / 8)) order = p;
    const Matrix matrix = design(channel, samples, others, rows_of(count, FIT_SAMPLES), order);
    const std::vector<Fit> found = fits(matrix, others.size(), order, count);
    for (size_t i = 0; i < found.size(); ++i) {
        const Predictor predictor = rounded(found[i], i ? std::vector<size_t>{} : others, samples, first);
        std::vector<int64_t> residuals = residuals_of(predictor, channel, samples);
        const double bits = bits_of(residuals) + double(8 * packed_bytes(predictor, numbers));
        if (bits < best_bits) best_bits = bits, best = std::move(residuals), chosen = predictor, is_chosen = true;
    }
    has_references = is_chosen && !chosen.references.empty();
    if (!is_chosen) return nb::make_tuple(nb::none(), array_of(best));
    nb::list references;
    for (const Reference &reference : chosen.references)
        references.append(nb::make_tuple(numbers[reference.place],
                                         nb::make_tuple(reference.taps[0], reference.taps[1], reference.taps[2])));
    nb::list own;
    for (const int64_t tap : chosen.own) own.append(tap);
    return nb::make_tuple(nb::make_tuple(chosen.shift, chosen.bias, nb::tuple(own), nb::tuple(references)),
                          array_of(best));
}

// fitting.choose. samples, kept: (channels, samples); numbers: of the channels in the signal; alone: no references.
nb::list signals_choose(Input<int64_t, 2> samples, Input<uint8_t, 2> kept, Input<int64_t, 1> numbers,
                        Input<int64_t, 1> ranks, Input<uint8_t, 1> is_counts, bool alone) {
    const size_t channels = samples.shape(0), count = samples.shape(1);
    if (kept.shape(0) != channels || kept.shape(1) != count || numbers.shape(0) != channels ||
        ranks.shape(0) != channels || is_counts.shape(0) != channels)
        throw std::invalid_argument("signals_choose: shapes differ");
    const Samples all{samples.data(), count};
    std::vector<size_t> by_rank(channels);
    std::vector<int> depth(channels);
    for (size_t i = 0; i < channels; ++i) by_rank[i] = i;
    std::stable_sort(by_rank.begin(), by_rank.end(),
                     [&](size_t a, size_t b) { return ranks.data()[a] < ranks.data()[b]; });
    std::vector<nb::object> result(channels);
    for (const size_t i : by_rank) {
        Channel channel{{}, {}, ranks.data()[i], is_counts.data()[i] != 0};
        for (size_t t = 0; t < count; ++t)
            if (kept.data()[i * count + t]) channel.own.push_back(all.line(i)[t]), channel.places.push_back(t);
        if (channel.own.empty()) throw std::invalid_argument("signals_choose: a channel without samples");
        std::vector<size_t> earlier;
        for (size_t j = 0; j < channels && !alone; ++j)
            if (ranks.data()[j] < channel.rank && depth[j] < MAX_DEPTHS[channel.is_counts]) earlier.push_back(j);
        const std::vector<size_t> others = explaining(all, i, earlier, channel);
        bool has_references = false;
        result[i] = choose_one(channel, others, all, numbers.data(), has_references);
        for (const size_t j : others)
            if (has_references) depth[i] = std::max(depth[i], depth[j] + 1);
    }
    nb::list out;
    for (const nb::object &choice : result) out.append(choice);
    return out;
}

}  // namespace

void bind_signal_fitting(nb::module_ &m) { m.def("signals_choose", &signals_choose); }
