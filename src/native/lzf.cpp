// LZF decompression: formats/lzf.py.

#include <cstring>
#include <stdexcept>

#include "arrays.h"

namespace {

// The `size` bytes that `packed` was made of. Throws std::invalid_argument (ValueError) for damaged data.
Output<uint8_t> lzf_decompress(Input<uint8_t, 1> packed, size_t size) {
    const uint8_t *from = packed.data(), *end = from + packed.shape(0);
    Fresh<uint8_t> result(size);
    uint8_t *to = result.data.get();
    size_t room = size;
    while (from < end) {
        const size_t control = *from++;
        size_t length = control + 1;
        if (control < 32) {
            if (length > size_t(end - from)) throw std::invalid_argument("another number of bytes");
            if (length > room) throw std::invalid_argument("more bytes than the size");
            std::memcpy(to, from, length);
            from += length;
        } else {
            length = (control >> 5) + 2;
            const bool is_long = length == 9;
            if (size_t(end - from) < size_t(is_long) + 1) throw std::invalid_argument("cut off within a reference");
            if (is_long) length += *from++;
            const size_t back = ((control & 31) << 8) + *from++ + 1;
            if (back > size - room) throw std::invalid_argument("a reference before the start");
            if (length > room) throw std::invalid_argument("more bytes than the size");
            const uint8_t *copied = to - back;
            if (back >= length)
                std::memcpy(to, copied, length);
            else  // the reference overlaps what it writes
                for (size_t i = 0; i < length; ++i) to[i] = copied[i];
        }
        to += length;
        room -= length;
    }
    if (room) throw std::invalid_argument("another number of bytes");
    return result.give({size});
}

}  // namespace

void bind_lzf(nb::module_ &m) { m.def("lzf_decompress", &lzf_decompress); }
