// Decodes whole chunks of signals in one call, for signals/chunks.py, which has the same code in NumPy.
//
//   payload ─► records ─► lanes of residuals ─► integers, referred channels first ─► values ─► rows of the caller's array
//
// For damaged bytes it returns false; the NumPy code then raises the error.

#include <nanobind/stl/string.h>

#include <algorithm>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>

#include "signal_prediction.h"
#include "signal_records.h"

namespace {

using namespace signals;

// Copies columns (columns, count) of items to rows of `out`.
template <class T>
void to_rows(const std::vector<const uint8_t *> &columns, size_t count, uint8_t *out) {
    constexpr size_t ROWS = 64;  // rows of a block; its columns fit into the cache
    const size_t width = columns.size();
    for (size_t start = 0; start < count; start += ROWS) {
        const size_t end = std::min(count, start + ROWS);
        for (size_t column = 0; column < width; ++column)
            for (size_t t = start; t < end; ++t)
                std::memcpy(out + (t * width + column) * sizeof(T), columns[column] + t * sizeof(T), sizeof(T));
    }
}

class SignalDecoder {
public:
    // For each channel: kinds; steps (channels, 2): step and offset; places: exponent, or the copied channel; constants
    // (channels, bytes of an item); palette_starts: start in `palettes`. type: letter of NumPy's kind of type.
    SignalDecoder(Input<uint8_t, 1> kinds, Input<double, 2> steps, Input<int64_t, 1> places, Input<uint8_t, 2> constants,
                  Input<uint64_t, 1> palettes, Input<int64_t, 1> palette_starts, const std::string &type,
                  nb::callable inflate, nb::callable unlzma2, Input<int16_t, 2> high, Input<int16_t, 3> low)
        : item_(constants.shape(1)), type_(type.at(0)), constants_(constants.data(), constants.data() + constants.size()),
          palettes_(palettes.data(), palettes.data() + palettes.size()), high_(high.data(), high.data() + high.size()),
          low_(low.data(), low.data() + low.size()), inflate_(inflate), unlzma2_(unlzma2) {
        const size_t channels = kinds.shape(0);
        if (steps.shape(0) != channels || steps.shape(1) != 2 || places.shape(0) != channels ||
            constants.shape(0) != channels || palette_starts.shape(0) != channels + 1 ||
            high_.size() != CONTEXTS * HIGH || low_.size() != CONTEXTS * HIGH * LOW)
            throw std::invalid_argument("SignalDecoder: shapes differ");
        for (size_t i = 0; i < channels; ++i) {
            const int64_t start = palette_starts.data()[i], end = palette_starts.data()[i + 1];
            if (start < 0 || end < start || uint64_t(end) > palettes_.size() ||
                (kinds.data()[i] == COPY && uint64_t(places.data()[i]) >= channels) ||
                (kinds.data()[i] == PALETTE && start == end))
                throw std::invalid_argument("SignalDecoder: a form is out of range");
            forms_.push_back({kinds.data()[i], steps.data()[2 * i], steps.data()[2 * i + 1], places.data()[i],
                              palettes_.data() + start, size_t(end - start)});
        }
    }

    // Decodes rows [first, first + rows) of the wanted channels in a chunk of `samples` samples. out: (rows, wanted ·
    // bytes of an item).
    bool decode(nb::bytes payload, size_t samples, size_t first, Input<int64_t, 1> wanted, InPlace<uint8_t, 2> out) {
        const size_t width = wanted.shape(0), rows = out.shape(0);
        if (out.shape(1) != width * item_ || first > samples || rows > samples - first)
            throw std::invalid_argument("SignalDecoder: rows are out of range");
        for (size_t i = 0; i < width; ++i)
            if (uint64_t(wanted.data()[i]) >= forms_.size())
                throw std::invalid_argument("SignalDecoder: a channel is out of range");
        try {
            const auto *bytes = reinterpret_cast<const uint8_t *>(payload.c_str());
            records_ = RecordReader{forms_, samples, item_, inflate_}.read_all({bytes, bytes + payload.size()});
            std::vector<std::vector<uint8_t>> columns(forms_.size());
            std::vector<const uint8_t *> shown;
            std::vector<size_t> origins;
            for (size_t i = 0; i < width; ++i) {
                const auto channel = size_t(wanted.data()[i]);
                origins.push_back(forms_[channel].kind == COPY ? size_t(forms_[channel].exponent) : channel);
            }
            std::vector<size_t> coded;
            for (size_t origin : origins)
                if (records_[origin].is_there && !records_[origin].is_items) coded.push_back(origin);
            restore_all(in_order(coded), samples);
            for (size_t origin : origins) {
                if (columns[origin].empty()) columns[origin] = column(origin, samples);
                shown.push_back(columns[origin].data() + first * item_);
            }
            if (item_ == 1) to_rows<uint8_t>(shown, rows, out.data());
            else if (item_ == 2) to_rows<uint16_t>(shown, rows, out.data());
            else if (item_ == 4) to_rows<uint32_t>(shown, rows, out.data());
            else to_rows<uint64_t>(shown, rows, out.data());
        } catch (const Damaged &) {
            records_.clear();
            return false;
        }
        records_.clear();
        return true;
    }

private:
    size_t item_;
    char type_;
    std::vector<uint8_t> constants_;
    std::vector<uint64_t> palettes_;
    std::vector<int16_t> high_, low_;
    nb::callable inflate_, unlzma2_;
    std::vector<Form> forms_;
    std::vector<Record> records_;

    // Topological order: the wanted channels and the channels that they refer to, each after its references.
    std::vector<size_t> in_order(const std::vector<size_t> &wanted) {
        std::vector<size_t> order, stack(wanted.rbegin(), wanted.rend());
        std::vector<uint8_t> state(forms_.size());  // 1: its references are on the stack, 2: in order
        while (!stack.empty()) {
            const size_t i = stack.back();
            if (state[i]) {
                if (state[i] == 1) order.push_back(i), state[i] = 2;
                stack.pop_back();
                continue;
            }
            state[i] = 1;
            for (const Reference &reference : records_[i].references) {
                Record &other = records_[reference.channel];
                require(other.is_there && !other.is_items && state[reference.channel] != 1);
                other.is_referred = true;
                if (!state[reference.channel]) stack.push_back(reference.channel);
            }
        }
        return order;
    }

    void restore_all(const std::vector<size_t> &order, size_t samples) {
        std::vector<std::pair<const Lane *, std::vector<int64_t> *>> lanes;
        for (size_t i : order)
            for (size_t j = 0; j < records_[i].lanes.size(); ++j)
                lanes.emplace_back(&records_[i].lanes[j], j ? &records_[i].corrections : &records_[i].integers);
        for (size_t i : order)
            for (auto *out : {&records_[i].integers, &records_[i].corrections}) out->resize(records_[i].kept);
        std::vector<LaneDecoder> decoders;
        std::vector<size_t> counts;
        for (size_t i = 0; i < lanes.size(); ++i) {
            const Lane &lane = *lanes[i].first;
            decoders.emplace_back(Model(high_.data(), low_.data(), start_of(lane.start)), lanes[i].second->data(), lane.state,
                                  lane.words, lane.word_count, BitReader{lane.raw.at, lane.raw.left()});
            counts.push_back(lanes[i].second->size());
            if (decoders.size() < 4 && i + 1 < lanes.size()) continue;
            require(decode_lanes(decoders, counts));
            decoders.clear();
            counts.clear();
        }
        std::vector<int64_t> sums;
        for (size_t i : order) {
            Record &record = records_[i];
            if (record.kept) restore_one(record, samples, sums);
            if (record.is_referred && record.has_codes) hold(record, samples);
        }
    }

    void restore_one(Record &record, size_t samples, std::vector<int64_t> &sums) {
        if (!record.has_predictor) {
            for (int64_t &integer : record.integers) integer = int64_t(uint64_t(integer) + uint64_t(record.first));
            return;
        }
        const uint64_t half = uint64_t(1) << record.shift >> 1;
        sums.assign(samples, int64_t(uint64_t(record.bias) + half));
        for (const Reference &reference : record.references)
            add_taps(sums.data(), records_[reference.channel].samples(), samples, reference.taps, REFERENCE_TAPS, 0);
        if (record.has_codes) {
            size_t place = 0;
            for (size_t t = 0; t < samples; ++t)
                if (record.codes[t] == KEPT) sums[place++] = sums[t];
        }
        restore(record.integers.data(), sums.data(), record.kept, record.own.data(), record.own.size(), record.shift,
                record.first);
    }

    // chunks._held
    void hold(Record &record, size_t samples) {
        record.held.assign(samples, 0);
        size_t place = 0, distinct = 0;
        for (size_t t = 0; t < samples; ++t) {
            if (record.codes[t] == REPEATS) record.held[t] = t ? record.held[t - 1] : 0;
            else record.held[t] = record.codes[t] == KEPT ? record.integers[place++] : 0, ++distinct;
            if (distinct == 1 && record.codes[t] != REPEATS) std::fill_n(record.held.begin(), t, record.held[t]);
        }
    }

    template <class T>
    bool kept_values(const Form &form, const Record &record, uint8_t *out) const {
        auto *values = reinterpret_cast<T *>(out);
        if constexpr (std::is_floating_point_v<T>) {
            const BitReader lower{record.lower.at, record.lower.left()};
            return !record.kept || float_values(form, record.integers.data(), record.corrections.data(), lower,
                                                record.kept, values);
        } else {
            integer_values(form, record.integers.data(), record.kept, values);
            return true;
        }
    }

    bool kept_items(const Form &form, const Record &record, uint8_t *out) const {
        if (type_ == 'f') return item_ == 4 ? kept_values<float>(form, record, out) : kept_values<double>(form, record, out);
        if (type_ == 'b') return kept_values<bool>(form, record, out);
        if (item_ == 1) return kept_values<uint8_t>(form, record, out);
        if (item_ == 2) return kept_values<uint16_t>(form, record, out);
        if (item_ == 4) return kept_values<uint32_t>(form, record, out);
        return kept_values<uint64_t>(form, record, out);
    }

    // All items of a channel that is not a copy.
    std::vector<uint8_t> column(size_t channel, size_t samples) {
        std::vector<uint8_t> out(std::max<size_t>(1, samples * item_));
        const Record &record = records_[channel];
        if (forms_[channel].kind == CONSTANT) {
            for (size_t t = 0; t < samples; ++t) std::memcpy(&out[t * item_], &constants_[channel * item_], item_);
        } else if (record.is_items) {
            const nb::bytes items = unpacked(unlzma2_, record.items, samples * item_);
            require(items.size() == samples * item_);
            if (samples) std::memcpy(out.data(), items.c_str(), items.size());
        } else if (!record.has_codes) {
            require(kept_items(forms_[channel], record, out.data()));
        } else {
            std::vector<uint8_t> kept(std::max<size_t>(1, record.kept * item_));
            require(kept_items(forms_[channel], record, kept.data()));
            const uint8_t *next[] = {kept.data(), nullptr, record.specials.data()};
            const size_t start = size_t(std::find_if(record.codes.begin(), record.codes.end(),
                                                     [](uint8_t code) { return code != REPEATS; }) -
                                        record.codes.begin());
            const uint8_t *item = start < samples ? next[record.codes[start]] : nullptr;
            require(item != nullptr);
            for (size_t t = 0; t < samples; ++t) {
                if (record.codes[t] != REPEATS) {
                    item = next[record.codes[t]];
                    next[record.codes[t]] += item_;
                }
                std::memcpy(&out[t * item_], item, item_);
            }
        }
        return out;
    }
};

}  // namespace

void bind_signal_chunks(nb::module_ &m) {
    nb::class_<SignalDecoder>(m, "SignalDecoder")
        .def(nb::init<Input<uint8_t, 1>, Input<double, 2>, Input<int64_t, 1>, Input<uint8_t, 2>, Input<uint64_t, 1>,
                      Input<int64_t, 1>, const std::string &, nb::callable, nb::callable, Input<int16_t, 2>,
                      Input<int16_t, 3>>())
        .def("decode", &SignalDecoder::decode, nb::arg("payload"), nb::arg("samples"), nb::arg("first"),
             nb::arg("wanted"), nb::arg("out").noconvert());
}
