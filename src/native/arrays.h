// Arrays as kernels take and give them: C-contiguous, on the host, owned by Python.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <memory>

namespace nb = nanobind;

// What a kernel reads. Another type or order of axes is copied into this one.
template <class T, int Axes>
using Input = nb::ndarray<const T, nb::ndim<Axes>, nb::c_contig, nb::device::cpu>;

// What a kernel writes in place: bind it with nb::arg().noconvert(), or what is written may go into a copy.
template <class T, int Axes>
using InPlace = nb::ndarray<T, nb::ndim<Axes>, nb::c_contig, nb::device::cpu>;

template <class T>
using Output = nb::ndarray<nb::numpy, T>;

// A new NumPy array that owns its memory, not initialised.
template <class T>
struct Fresh {
    std::unique_ptr<T[]> data;
    size_t size;

    explicit Fresh(size_t n) : data(new T[n ? n : 1]), size(n) {}

    // The first rows of it, with this shape.
    Output<T> give(std::initializer_list<size_t> shape) {
        T *raw = data.release();
        nb::capsule owner(raw, [](void *p) noexcept { delete[] static_cast<T *>(p); });
        return Output<T>(raw, shape, owner);
    }
};
