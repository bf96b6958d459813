// Bytes that are read from the first to the last: fields/cursor.py.
#pragma once

#include <cstddef>
#include <cstdint>

namespace fields {

struct Damaged {};  // exception for damaged bytes

inline void require(bool is_right) {
    if (!is_right) throw Damaged{};
}

// fields.Cursor
struct Reader {
    const uint8_t *at, *end;

    size_t left() const { return size_t(end - at); }

    const uint8_t *take(size_t count) {
        require(count <= left());
        at += count;
        return at - count;
    }

    int byte() { return *take(1); }

    uint64_t varint() {
        uint64_t number = 0;
        for (int shift = 0; shift < 63; shift += 7) {
            const int byte = this->byte();
            number |= uint64_t(byte & 127) << shift;
            if (byte < 128) {
                require(byte || !shift);
                return number;
            }
        }
        throw Damaged{};
    }

    int64_t folded() {
        const uint64_t number = varint();
        return number & 1 ? -int64_t((number + 1) >> 1) : int64_t(number >> 1);
    }

    Reader blob() {
        const uint64_t size = varint();
        require(size <= left());
        const uint8_t *first = take(size_t(size));
        return {first, first + size};
    }
};

}  // namespace fields
