// Serial loops of codecs/tempo/coding: contexts, rate–distortion optimised quantisation, rANS lanes. Bytes depend only
// on integers, and on float operations in the same order as in the NumPy code that each kernel replaces.

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "arrays.h"
#include "contexts.h"

namespace {

using namespace contexts;

using Integers = std::vector<int64_t>;

// contexts.lookup: constants of the table look-up, the first frequency of each group, the shape of each frequency.
struct Lookup {
    const int64_t *numerator_logs, *class_of, *starts, *shapes;
    int64_t numerators, classes, first_class, groups, frequencies;
};

int64_t clipped(const int64_t *table, int64_t size, int64_t at) {
    return table[std::clamp<int64_t>(at, 0, size - 1)];
}

using Table = Input<int64_t, 1>;

Lookup lookup(const Table &numerator_logs, const Table &class_of, int64_t first_class, const Table &starts,
              const Table &shapes, size_t frequencies) {
    if (shapes.shape(0) < frequencies) throw std::invalid_argument("contexts: each frequency needs a shape");
    return {numerator_logs.data(), class_of.data(), starts.data(), shapes.data(), int64_t(numerator_logs.shape(0)),
            int64_t(class_of.shape(0)), first_class, int64_t(starts.shape(0)), int64_t(frequencies)};
}

// Magnitudes with a border of zeros.
class Field {
public:
    Field(size_t frequencies, size_t rows)
        : rows_(rows), pitch_(rows + 2 * BORDER), values_((frequencies + DEPTH) * pitch_, 0) {}

    void set(size_t frequency, size_t row, int64_t magnitude) {
        values_[(frequency + DEPTH) * pitch_ + BORDER + row] = int32_t(std::clamp<int64_t>(magnitude, INT32_MIN, CEILING));
    }

    // The magnitudes `by` frequencies below this one.
    const int32_t *below(size_t frequency, int by) const {
        return values_.data() + (frequency + DEPTH - size_t(by)) * pitch_ + BORDER;
    }

    // Logarithm of the sum of contexts.around, for rows [0, wanted).
    void logs(size_t frequency, size_t wanted, const Lookup &of, Integers &out) const {
        const int32_t *b1 = below(frequency, 1), *b2 = below(frequency, 2), *b3 = below(frequency, 3);
        const int32_t *b4 = below(frequency, 4), *b5 = below(frequency, 5), *b6 = below(frequency, 6);
        const int32_t *b7 = below(frequency, 7);
        int64_t block = 0;
        for (int j = -BORDER; j < BORDER; ++j) block += b1[j] + (j > -BORDER && j < BORDER - 1 ? b2[j] : 0);
        for (size_t r = 0; r < wanted; ++r) {
            const int32_t *c1 = b1 + r, *c2 = b2 + r;
            block += c1[BORDER] + c2[BORDER - 1];
            int64_t sum = BLOCK * block + NEAR * int64_t(c1[0] + c2[0]) + BESIDE * int64_t(c1[-1] + c1[1]);
            sum += BELOW_3 * int64_t(b3[r]) + OLDER * (int64_t(b4[r]) + b5[r] + b6[r] + b7[r]);
            out[r] = clipped(of.numerator_logs, of.numerators, sum) - of.first_class;
            block -= c1[-BORDER] + c2[1 - BORDER];
        }
    }

    size_t rows() const { return rows_; }

private:
    size_t rows_, pitch_;
    std::vector<int32_t> values_;
};

// The table of a coefficient: contexts.tables.
int64_t table_of(const Lookup &of, int64_t log, int64_t base, size_t frequency) {
    return clipped(of.class_of, of.classes, log + base) + of.shapes[frequency];
}

// One past the last frequency of a group.
size_t end_of(const Lookup &of, int64_t group) {
    return size_t(group + 1 < of.groups ? of.starts[group + 1] : of.frequencies);
}

// contexts.all_tables
void all_tables(const Field &field, const int64_t *base, const Lookup &of, int64_t *out) {
    const size_t rows = field.rows();
    Integers logs(rows);
    for (int64_t g = 0; g < of.groups; ++g) {
        field.logs(size_t(of.starts[g]), rows, of, logs);
        for (size_t f = size_t(of.starts[g]); f < end_of(of, g); ++f)
            for (size_t r = 0; r < rows; ++r) out[f * rows + r] = table_of(of, logs[r], base[f * rows + r], f);
    }
}

// quantise.quantise: values (frequencies, rows) up to the last nonzero frequency, threshold of the coded zone, and
// bits. free: the first row with rate–distortion optimised integers.
nb::tuple tempo_quantise(Input<double, 2> scaled, Input<int64_t, 2> base, Input<int64_t, 2> reached,
                         Input<double, 1> price, double slope, double inward, int64_t free, Table numerator_logs,
                         Table class_of, int64_t first_class, Table starts, Table shapes) {
    const size_t frequencies = scaled.shape(0), rows = scaled.shape(1), count = frequencies * rows;
    if (base.shape(0) != frequencies || base.shape(1) != rows || reached.shape(0) != frequencies ||
        reached.shape(1) != rows || !count)
        throw std::invalid_argument("tempo_quantise: shapes differ");
    const Lookup of = lookup(numerator_logs, class_of, first_class, starts, shapes, frequencies);
    struct Choice {
        size_t at;
        double size, low_error, high_error, down, up;
        int64_t low, high;
        int low_symbol, high_symbol;
        bool free, lower;
    };
    std::vector<Choice> choices;
    Field field(frequencies, rows);
    auto error = [inward](double size, int64_t magnitude) {
        const double off = size - (double(magnitude) - (magnitude > 0 ? inward : 0.0));
        return off * off;
    };
    for (size_t at = 0; at < count; ++at) {
        const double size = std::fabs(scaled.data()[at]);
        const int64_t high = int64_t(std::nearbyint(size));
        if (!high) continue;
        Choice c{};
        c.at = at, c.size = size, c.high = high;
        c.free = int64_t(at % rows) >= free;
        c.low = high - (c.free && size < double(high));
        c.high_symbol = symbol_of(high), c.low_symbol = symbol_of(c.low);
        c.high_error = error(size, high), c.low_error = error(size, c.low);
        choices.push_back(c);
        field.set(at / rows, at % rows, first_of(c.high_symbol));
    }
    Integers tables(count);
    for (bool last : {false, true}) {
        all_tables(field, base.data(), of, tables.data());
        for (Choice &c : choices) {
            const double *of_table = price.data() + tables[c.at] * SYMBOLS;
            c.up = of_table[c.high_symbol], c.down = of_table[c.low_symbol];
            c.lower = c.low_error + slope * c.down < c.high_error + slope * c.up;
            if (!last) field.set(c.at / rows, c.at % rows, first_of(c.lower ? c.low_symbol : c.high_symbol));
        }
    }
    const int64_t *height = reached.data();
    const int64_t top = *std::max_element(height, height + rows);
    int64_t highest = top;
    for (const Choice &c : choices)
        if (!c.free && (c.lower ? c.low : c.high) > 0) highest = std::min(highest, height[c.at]);
    int64_t lowest = highest;
    for (const Choice &c : choices)
        if ((c.lower ? c.low : c.high) > 0) lowest = std::min(lowest, height[c.at]);
    std::vector<double> worth(size_t(top - lowest + 2), 0.0), spent(worth.size(), 0.0);
    auto choice = choices.begin();
    for (size_t at = 0; at < count; ++at) {
        const size_t bin = size_t(std::max<int64_t>(height[at] - (lowest - 1), 0));
        double bits = price.data()[tables[at] * SYMBOLS];
        double gain;
        if (choice != choices.end() && choice->at == at) {
            bits = choice->lower ? choice->down : choice->up;
            gain = bits * -slope + (choice->size * choice->size - (choice->lower ? choice->low_error : choice->high_error));
            ++choice;
        } else {
            gain = bits * -slope;
        }
        worth[bin] += gain;
        spent[bin] += bits;
    }
    for (size_t bin = worth.size() - 1; bin-- > 0;) worth[bin] += worth[bin + 1], spent[bin] += spent[bin + 1];
    worth[1] = worth[0];
    const auto best = std::max_element(worth.begin() + 1, worth.begin() + (highest - lowest + 2));
    const int64_t threshold = lowest + (best - worth.begin() - 1);
    Fresh<int64_t> values(count);
    std::fill_n(values.data.get(), count, 0);
    for (const Choice &c : choices)
        if (height[c.at] >= threshold)
            values.data[c.at] = int64_t(std::copysign(double(c.lower ? c.low : c.high), scaled.data()[c.at]));
    return nb::make_tuple(values.give({frequencies, rows}), threshold, spent[size_t(threshold - lowest + 1)]);
}

// Visits the coded coefficients of a chunk in coding order: within a group by frequency, then row, on the lanes in
// turn. Each group begins a new step. Calls visit(step, lane, frequency, row), and group(g) before each group.
template <class Group, class Visit>
size_t in_order(const Lookup &of, const int64_t *reach, size_t rows, size_t lanes, Group group, Visit visit) {
    size_t steps = 0;
    for (int64_t g = 0; g < of.groups; ++g) {
        group(g);
        size_t rank = 0;
        for (size_t f = size_t(of.starts[g]); f < end_of(of, g); ++f)
            for (size_t r = 0; r < rows; ++r)
                if (int64_t(f) < reach[r]) {
                    visit(steps + rank / lanes, rank % lanes, f, r);
                    ++rank;
                }
        steps += (rank + lanes - 1) / lanes;
    }
    return steps;
}

// Slots of a symbol in a table: `frequency` slots from `start` on.
struct Slot {
    uint32_t frequency, start;
};

// symbol_streams.encode for one chunk: final states (lanes,) and words. coder_frequencies, coder_starts (tables,
// symbols); listed, listed_tables (n,): symbols after the coefficients; first (lanes,): initial states.
nb::tuple tempo_encode(Input<int64_t, 2> values, Input<int64_t, 2> base, Table reach, size_t lanes,
                       Input<int64_t, 2> coder_frequencies, Input<int64_t, 2> coder_starts, Table listed,
                       Table listed_tables, Table first, Table numerator_logs, Table class_of, int64_t first_class,
                       Table starts, Table shapes) {
    const size_t frequencies = values.shape(0), rows = values.shape(1), symbols = coder_frequencies.shape(1);
    if (base.shape(0) != frequencies || (frequencies && base.shape(1) != rows) || reach.shape(0) != rows ||
        first.shape(0) != lanes || !lanes || listed.shape(0) != listed_tables.shape(0))
        throw std::invalid_argument("tempo_encode: shapes differ");
    const Lookup of = lookup(numerator_logs, class_of, first_class, starts, shapes, frequencies);
    std::vector<Slot> slots;
    std::vector<size_t> begins;  // first slot of each step; the last lanes of a step may be idle
    auto put = [&](size_t step, int64_t table, int64_t symbol) {
        const size_t at = size_t(table) * symbols + size_t(symbol);
        const Slot slot{uint32_t(coder_frequencies.data()[at]), uint32_t(coder_starts.data()[at])};
        if (!slot.frequency) throw std::invalid_argument("tempo_encode: a symbol of weight zero");
        while (begins.size() <= step) begins.push_back(slots.size());
        slots.push_back(slot);
    };
    Field field(frequencies, rows);
    for (size_t f = 0; f < frequencies; ++f)
        for (size_t r = 0; r < rows; ++r)
            if (const int64_t v = values.data()[f * rows + r]) field.set(f, r, first_of(symbol_of(v < 0 ? -v : v)));
    Integers logs(rows);
    const size_t own_steps = in_order(
        of, reach.data(), rows, lanes, [&](int64_t g) { field.logs(size_t(of.starts[g]), rows, of, logs); },
        [&](size_t step, size_t, size_t f, size_t r) {
            const int64_t v = values.data()[f * rows + r];
            put(step, table_of(of, logs[r], base.data()[f * rows + r], f), symbol_of(v < 0 ? -v : v));
        });
    for (size_t i = 0; i < listed.shape(0); ++i) put(own_steps + i / lanes, listed_tables.data()[i], listed.data()[i]);
    begins.push_back(slots.size());

    Fresh<int64_t> states(lanes);
    std::vector<uint32_t> state(lanes);
    for (size_t lane = 0; lane < lanes; ++lane) state[lane] = uint32_t(first.data()[lane]);
    std::vector<uint16_t> words;
    for (size_t step = begins.size() - 1; step-- > 0;)
        for (size_t at = begins[step + 1]; at-- > begins[step];) {
            const Slot slot = slots[at];
            push(state[at - begins[step]], slot.frequency, slot.start, words);
        }
    for (size_t lane = 0; lane < lanes; ++lane) states.data[lane] = state[lane];
    Fresh<uint16_t> sequence(words.size());
    std::copy(words.rbegin(), words.rend(), sequence.data.get());
    return nb::make_tuple(states.give({lanes}), sequence.give({sequence.size}));
}

// symbol_streams.decode for one chunk: symbols (frequencies, rows), symbols of the lists (n,), final states (lanes,),
// and the number of words read; more than exist means damage. packed, symbols: lanes.StaticTables.
nb::tuple tempo_decode(Input<int64_t, 2> base, Table reach, size_t rows, Table first, Input<uint16_t, 1> words,
                       Table packed, Table symbols, Table listed_tables, Table numerator_logs, Table class_of,
                       int64_t first_class, Table starts, Table shapes) {
    const size_t frequencies = base.shape(0), lanes = first.shape(0), listed = listed_tables.shape(0);
    if ((frequencies && base.shape(1) != rows) || reach.shape(0) != rows || !lanes)
        throw std::invalid_argument("tempo_decode: shapes differ");
    const Lookup of = lookup(numerator_logs, class_of, first_class, starts, shapes, frequencies);
    std::vector<uint32_t> state(lanes);
    for (size_t lane = 0; lane < lanes; ++lane) state[lane] = uint32_t(first.data()[lane]);
    size_t used = 0;
    const size_t known = words.shape(0);
    auto take = [&](size_t lane, int64_t table) {
        uint32_t x = state[lane];
        const size_t place = (size_t(table) << PRECISION) + (x & (TOTAL - 1));
        const uint32_t entry = uint32_t(packed.data()[place]);
        x = (x >> PRECISION) * (entry & 0xFFFF) + (entry >> 16);
        if (x < LOWEST) x = x << 16 | (used < known ? words.data()[used] : 0), ++used;
        state[lane] = x;
        return int(symbols.data()[place]);
    };
    Fresh<uint8_t> found(frequencies * rows);
    std::fill_n(found.data.get(), frequencies * rows, 0);
    Field field(frequencies, rows);
    Integers logs(rows);
    in_order(
        of, reach.data(), rows, lanes, [&](int64_t g) { field.logs(size_t(of.starts[g]), rows, of, logs); },
        [&](size_t, size_t lane, size_t f, size_t r) {
            const int symbol = take(lane, table_of(of, logs[r], base.data()[f * rows + r], f));
            found.data[f * rows + r] = uint8_t(symbol);
            if (symbol) field.set(f, r, first_of(symbol));
        });
    Fresh<int64_t> more(listed);
    for (size_t i = 0; i < listed; ++i) more.data[i] = take(i % lanes, listed_tables.data()[i]);
    Fresh<int64_t> states(lanes);
    for (size_t lane = 0; lane < lanes; ++lane) states.data[lane] = state[lane];
    return nb::make_tuple(found.give({frequencies, rows}), more.give({listed}), states.give({lanes}), used);
}

}  // namespace

void bind_coefficients(nb::module_ &m) {
    m.def("tempo_quantise", &tempo_quantise);
    m.def("tempo_encode", &tempo_encode);
    m.def("tempo_decode", &tempo_decode);
}
