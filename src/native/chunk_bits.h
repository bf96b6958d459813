// Reads and writes bits of a chunk of codecs/tempo.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace chunks {

// Reads bits, highest first; zeros follow the last bit.
class Bits {
public:
    Bits(const uint8_t *data, size_t bytes) : data_(data), bytes_(bytes) {}

    uint64_t get(int width) {
        uint64_t value = 0;
        while (width > 0) {
            const int inside = int(at_ & 7), taken = std::min(8 - inside, width);
            const uint64_t byte = (at_ >> 3) < bytes_ ? data_[at_ >> 3] : 0;
            value = value << taken | ((byte >> (8 - inside - taken)) & ((1u << taken) - 1));
            at_ += size_t(taken), width -= taken;
        }
        return value;
    }

    size_t at() const { return at_; }

    // Whether all remaining bits are 0.
    bool rest_is_zero() {
        if (at_ & 7 && get(8 - int(at_ & 7))) return false;
        return std::all_of(data_ + std::min(at_ >> 3, bytes_), data_ + bytes_, [](uint8_t b) { return b == 0; });
    }

private:
    const uint8_t *data_;
    size_t bytes_, at_ = 0;
};

// Writes bits, highest first.
class BitsOut {
public:
    void put(uint64_t value, int width) {
        while (width > 0) {
            if (!(count_ & 7)) bytes_.push_back(0);
            const int room = 8 - int(count_ & 7), taken = std::min(room, width);
            const uint64_t part = (value >> (width - taken)) & ((1u << taken) - 1);
            bytes_.back() = uint8_t(bytes_.back() | part << (room - taken));
            count_ += size_t(taken), width -= taken;
        }
    }

    size_t count() const { return count_; }
    const std::vector<uint8_t> &bytes() const { return bytes_; }

private:
    std::vector<uint8_t> bytes_;
    size_t count_ = 0;
};

}  // namespace chunks
