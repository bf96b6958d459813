// Reads the records of channels in a chunk of signals (signals/chunks.py), without decoding them.
#pragma once

#include <cstdint>
#include <cstdlib>
#include <vector>

#include "arrays.h"
#include "cursor.h"
#include "signal_values.h"

namespace signals {

enum Code { KEPT, REPEATS, SPECIAL };
constexpr int HAS_REMOVED = 1, SAME_REMOVED = 2, EQUAL_SPECIALS = 4, HAS_PREDICTOR = 8, ITEMS = 16;
constexpr size_t MAX_ORDER = 32, MAX_REFERENCES = 16, REFERENCE_TAPS = 3;
constexpr int MAX_SHIFT = 48;
constexpr int64_t MAX_INTEGER = int64_t(1) << 29, MAX_TAP = int64_t(1) << 52;

using fields::Damaged;
using fields::Reader;
using fields::require;

struct Lane {
    int start;
    uint32_t state;
    const uint8_t *words;
    size_t word_count;
    Reader raw;
};

struct Reference {
    size_t channel;
    int64_t taps[REFERENCE_TAPS];
};

// chunks._Record. integers, corrections: of the kept samples; held: of all samples, if other channels refer to them.
struct Record {
    bool is_there = false, is_items = false, has_codes = false, has_predictor = false, is_referred = false;
    std::vector<uint8_t> codes, specials;
    size_t kept = 0;
    int64_t first = 0, bias = 0;
    int shift = 0;
    std::vector<int64_t> own;
    std::vector<Reference> references;
    std::vector<Lane> lanes;
    Reader lower{nullptr, nullptr}, items{nullptr, nullptr};
    std::vector<int64_t> integers, corrections, held;

    const int64_t *samples() const { return has_codes ? held.data() : integers.data(); }
};

inline Lane read_lane(Reader &reader) {
    Lane lane;
    lane.start = reader.byte();
    lane.state = 0;
    for (int i = 0; i < 4; ++i) lane.state |= uint32_t(reader.byte()) << 8 * i;
    require(lane.start < START_CODES && lane.state >= LOWEST);
    const uint64_t count = reader.varint();
    require(count <= reader.left() / 2);
    lane.word_count = size_t(count);
    lane.words = reader.take(2 * lane.word_count);
    lane.raw = reader.blob();
    return lane;
}

// Calls a decompressor of Python: (data, size of the result, name for errors) to bytes.
inline nb::bytes unpacked(const nb::callable &unpack, Reader packed, size_t size) {
    const nb::bytes data(reinterpret_cast<const char *>(packed.at), packed.left());
    try {
        return nb::cast<nb::bytes>(unpack(data, size, "a chunk of signals"));
    } catch (nb::python_error &) {
        throw Damaged{};
    }
}

// Reads the records of a chunk. item: bytes of an item.
struct RecordReader {
    const std::vector<Form> &forms;
    size_t samples, item;
    const nb::callable &inflate;

    std::vector<Record> read_all(Reader reader) {
        std::vector<Record> records(forms.size());
        std::vector<uint8_t> before(samples);
        for (size_t i = 0; i < forms.size(); ++i) {
            if (forms[i].kind == CONSTANT || forms[i].kind == COPY) continue;
            Record &record = records[i];
            read(reader, record, forms[i], before);
            if (record.has_codes) before = record.codes;
        }
        require(!reader.left());
        return records;
    }

    void read(Reader &reader, Record &record, const Form &form, const std::vector<uint8_t> &before) {
        record.is_there = true;
        const int flags = reader.byte();
        if (flags == ITEMS) {
            record.is_items = true;
            record.items = reader.blob();
            return;
        }
        require(flags < ITEMS && (flags & HAS_REMOVED || !(flags & (SAME_REMOVED | EQUAL_SPECIALS))));
        record.kept = samples;
        if (flags & HAS_REMOVED) read_removed(reader, record, flags, before);
        if (!record.kept) {
            require(!(flags & HAS_PREDICTOR) && !(samples && record.codes[0] == REPEATS));
            return;
        }
        record.first = reader.folded();
        require(std::abs(record.first) < MAX_INTEGER);
        if (flags & HAS_PREDICTOR) read_predictor(reader, record);
        for (int i = 0; i < (form.kind == CORRECTED ? 2 : 1); ++i) record.lanes.push_back(read_lane(reader));
        if (form.kind == GRID) record.lower = reader.blob();
    }

    void read_removed(Reader &reader, Record &record, int flags, const std::vector<uint8_t> &before) {
        if (flags & SAME_REMOVED) {
            record.codes = before;
        } else {
            const nb::bytes codes = unpacked(inflate, reader.blob(), samples);
            require(codes.size() == samples);
            const auto *data = reinterpret_cast<const uint8_t *>(codes.c_str());
            record.codes.assign(data, data + samples);
        }
        size_t counts[SPECIAL + 1] = {};
        for (uint8_t code : record.codes) {
            require(code <= SPECIAL);
            ++counts[code];
        }
        record.kept = counts[KEPT];
        record.has_codes = counts[KEPT] < samples;
        const size_t count = counts[SPECIAL];
        if (flags & EQUAL_SPECIALS) {
            const uint8_t *special = reader.take(count ? item : 0);
            for (size_t i = 0; i < count; ++i) record.specials.insert(record.specials.end(), special, special + item);
        } else {
            const nb::bytes items = unpacked(inflate, reader.blob(), count * item);
            require(items.size() == count * item);
            const auto *data = reinterpret_cast<const uint8_t *>(items.c_str());
            record.specials.assign(data, data + count * item);
        }
    }

    void read_predictor(Reader &reader, Record &record) {
        record.has_predictor = true;
        record.shift = reader.byte();
        const auto order = size_t(reader.byte()), count = size_t(reader.byte());
        require(record.shift <= MAX_SHIFT && order <= MAX_ORDER && count <= MAX_REFERENCES);
        for (size_t i = 0; i < count; ++i) {
            const uint64_t channel = reader.varint();
            require(channel < forms.size());
            record.references.push_back({size_t(channel), {}});
        }
        record.bias = reader.folded();
        const auto tap = [&] {
            const int64_t number = reader.folded();
            require(std::abs(number) <= MAX_TAP);
            return number;
        };
        for (size_t i = 0; i < order; ++i) record.own.push_back(tap());
        for (Reference &reference : record.references)
            for (int64_t &number : reference.taps) number = tap();
    }
};

}  // namespace signals
