// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <algorithm>
#include <initializer_list>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "geraf2/types.hpp"

namespace geraf2::bindings {

namespace py = pybind11;

/// C-contiguous array without conversion: a binding never copies its input in silence.
template <class T>
using Array = py::array_t<T, py::array::c_style>;
using Doubles = Array<double>;
using Indices = Array<index_t>;

/// Throws ValueError unless `array` has the shape; -1 allows any length.
template <class T>
void require_shape(const char* name, const Array<T>& array,
                   std::initializer_list<py::ssize_t> shape) {
    bool ok = array.ndim() == static_cast<py::ssize_t>(shape.size());
    py::ssize_t axis = 0;
    for (const py::ssize_t length : shape) {
        ok = ok && (length < 0 || array.shape(axis) == length);
        ++axis;
    }
    if (!ok) {
        throw py::value_error(std::string(name) + " has the wrong shape");
    }
}

template <class T>
std::span<const T> view(const Array<T>& array) {
    return {array.data(), static_cast<std::size_t>(array.size())};
}

template <class T>
std::span<T> mutable_view(Array<T>& array) {
    return {array.mutable_data(), static_cast<std::size_t>(array.size())};
}

template <class T>
Array<T> make_array(std::initializer_list<py::ssize_t> shape) {
    return Array<T>(py::array::ShapeContainer(shape));
}

template <class T>
Array<T> copy_array(const std::vector<T>& values, std::initializer_list<py::ssize_t> shape) {
    auto array = make_array<T>(shape);
    std::copy(values.begin(), values.end(), array.mutable_data());
    return array;
}

template <class T>
Array<T> copy_array(const std::vector<T>& values) {
    return copy_array(values, {static_cast<py::ssize_t>(values.size())});
}

} // namespace geraf2::bindings
