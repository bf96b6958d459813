// Decodes what an encoder of bits writes, while it writes.
//
//     bits with their probabilities ─► wait for bytes ─► decoded ─► the same bits?
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "adaptive_bits.h"

namespace bits {

// Decodes what an encoder writes, with the probabilities that the encoder had: a decoder that has found the same bits so
// far has the same ones. It follows the encoder, since bytes come later than the bits that they hold.
class Follower {
public:
    // A bit with its probability.
    void expect(int bit, int32_t p) { waiting_.push_back(uint32_t(p) << 1 | uint32_t(bit)); }

    size_t waiting() const { return waiting_.size() - next_; }

    // Decodes the bits that the bytes so far determine; all bits if the bytes are complete.
    void follow(const std::vector<uint8_t> &bytes, bool are_complete) {
        if (!has_started_) {
            if (bytes.size() < size_t(Decoder::HELD) && !are_complete) return;
            decoder_ = Decoder(bytes.data(), bytes.size());
            has_started_ = true;
        }
        decoder_.extend(bytes.data(), bytes.size());
        for (; next_ < waiting_.size() && (are_complete || decoder_.has_bytes()); ++next_)
            agrees_ &= decoder_.bit(int32_t(waiting_[next_] >> 1)) == int(waiting_[next_] & 1);
        if (2 * next_ < waiting_.size()) return;
        waiting_.erase(waiting_.begin(), waiting_.begin() + std::ptrdiff_t(next_));
        next_ = 0;
    }

    // Whether all bits were decoded, from all bytes.
    bool has_found_all() const { return agrees_ && !waiting() && has_started_ && decoder_.at_end(); }

private:
    std::vector<uint32_t> waiting_;
    size_t next_ = 0;
    Decoder decoder_{nullptr, 0};
    bool has_started_ = false, agrees_ = true;
};

}  // namespace bits
