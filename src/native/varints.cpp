// Reads many varints at once, for the index of a long file: fields/cursor.py, Cursor.plain.

#include "arrays.h"

namespace {

// Values and ends (n,) of the first varints of `bytes`: at most `most`, and only before one that takes more than four
// bytes, has a last byte of zero, or does not end.
nb::tuple plain_varints(Input<uint8_t, 1> bytes, size_t most) {
    const uint8_t *data = bytes.data();
    const size_t size = bytes.shape(0), room = most < size ? most : size;
    Fresh<int64_t> values(room), ends(room);
    size_t count = 0;
    for (size_t at = 0; count < room; ++count) {
        int64_t value = 0;
        size_t length = 0;
        do {
            if (at + length >= size || length == 4) break;
            value |= int64_t(data[at + length] & 127) << (7 * length);
        } while (data[at + length++] & 128);
        if (!length || data[at + length - 1] & 128 || (length > 1 && !data[at + length - 1])) break;
        at += length;
        values.data[count] = value;
        ends.data[count] = int64_t(at);
    }
    return nb::make_tuple(values.give({count}), ends.give({count}));
}

}  // namespace

void bind_varints(nb::module_ &m) { m.def("plain_varints", &plain_varints); }
