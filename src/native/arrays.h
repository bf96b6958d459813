// Arrays that kernels exchange with Python: C-contiguous, in the host's memory.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <memory>

namespace nb = nanobind;

// An array that a kernel reads. nanobind converts arrays of another type or memory order to a copy.
template <class T, int Axes>
using Input = nb::ndarray<const T, nb::ndim<Axes>, nb::c_contig, nb::device::cpu>;

// An array that a kernel writes in place. Bind it with nb::arg().noconvert(): otherwise the kernel may write to a copy.
template <class T, int Axes>
using InPlace = nb::ndarray<T, nb::ndim<Axes>, nb::c_contig, nb::device::cpu>;

template <class T>
using Output = nb::ndarray<nb::numpy, T>;

// Memory for a new NumPy array, not initialised.
template <class T>
struct Fresh {
    std::unique_ptr<T[]> data;
    size_t size;

    explicit Fresh(size_t n) : data(new T[n ? n : 1]), size(n) {}

    // Hands the memory to a NumPy array of this shape, which may be smaller than `size`.
    Output<T> give(std::initializer_list<size_t> shape) {
        T *raw = data.release();
        nb::capsule owner(raw, [](void *p) noexcept { delete[] static_cast<T *>(p); });
        return Output<T>(raw, shape, owner);
    }
};
