// Kernels of the decoder in WebAssembly, from the code of the compiled module (src/native): the lattice engine, and rotations
// of joints. scripts/wasm compiles them; src/kernels.ts calls them.
//
// There is no C library. `begin` frees all memory of `reserve` and operator new. Sines and other functions come from JavaScript.

#include "../../../src/native/joint_solver.h"
#include "../../../src/native/lattice.h"

#define EXPORT(name) extern "C" __attribute__((export_name(name)))

extern "C" unsigned char __heap_base;

namespace {

constexpr size_t PAGE = 65536;
size_t next = 0;

void *taken(size_t size) {
    const size_t at = (next + 15) / 16 * 16, have = __builtin_wasm_memory_size(0) * PAGE;
    if (size > size_t(-1) - PAGE - at) __builtin_trap();
    next = at + size;
    if (next > have && __builtin_wasm_memory_grow(0, (next - have + PAGE - 1) / PAGE) == size_t(-1)) __builtin_trap();
    return reinterpret_cast<void *>(at);
}

}  // namespace

void *operator new(size_t size) { return taken(size); }
void *operator new(size_t size, std::align_val_t) { return taken(size); }
void operator delete(void *) noexcept {}
void operator delete(void *, std::align_val_t) noexcept {}

extern "C" {
void *memcpy(void *to, const void *from, size_t size) { return __builtin_memcpy(to, from, size); }
void *memmove(void *to, const void *from, size_t size) { return __builtin_memmove(to, from, size); }
void *memset(void *to, int value, size_t size) { return __builtin_memset(to, value, size); }
}

namespace std {
inline namespace __1 {
[[noreturn]] void __libcpp_verbose_abort(char const *, ...) { __builtin_trap(); }

void *align(size_t by, size_t size, void *&at, size_t &room) {
    const size_t skipped = -reinterpret_cast<size_t>(at) % by;
    if (room < skipped + size) return nullptr;
    room -= skipped;
    return at = static_cast<char *>(at) + skipped;
}
}  // namespace __1
}  // namespace std

EXPORT("begin") void begin() { next = reinterpret_cast<size_t>(&__heap_base); }

EXPORT("reserve") void *reserve(size_t size) { return taken(size); }

// Samples (points, frames, 4), the fourth number 0; null for a damaged stream.
EXPORT("lattice")
const double *decode_lattice(const uint8_t *data, size_t size, size_t frames, size_t points, const uint8_t *missing,
                             const int32_t *sequence, const int32_t *neighbours, int stride_log, const int32_t *squash,
                             const int32_t *stretch, const int32_t *rate) {
    bits::Decoder decoder(data, size);
    const lattice::Layout of{frames, points, missing, sequence, neighbours, stride_log};
    auto *chunk = new lattice::Chunk<bits::Decoder>(of, {squash, stretch, rate, nullptr}, decoder, nullptr);
    return chunk->run() && decoder.at_end() ? chunk->decoded[0].v : nullptr;
}

// Local rotations (frames, joints, 4), then positions (frames, joints, 3). integers, floats and carried vectors as in
// codecs/tempo/rotation_layer/compiled.py. values, aimed, hinges: numbers of side values a frame, carried vectors, hinges.
EXPORT("joints")
const double *solve_joints(size_t frames, size_t joints, size_t values, size_t aimed, size_t hinges, const double *targets,
                           const double *side, const void *integers, const void *floats, const int64_t *targets_of,
                           const void *carried, const void *hinge_integers, const void *hinge_floats) {
    using namespace joint_solver;
    auto *out = static_cast<double *>(taken(7 * frames * joints * sizeof(double)));
    const Tables tables{joints,
                        static_cast<const JointIntegers *>(integers),
                        static_cast<const JointFloats *>(floats),
                        targets_of,
                        static_cast<const Carried *>(carried),
                        static_cast<const HingeIntegers *>(hinge_integers),
                        static_cast<const HingeFloats *>(hinge_floats)};
    solve<double>(tables, frames, values, aimed, hinges, targets, side, out, out + 4 * frames * joints);
    return out;
}
