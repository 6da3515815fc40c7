// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <complex>
#include <cstdint>
#include <span>

namespace geraf2 {

/// Signed 64-bit index, everywhere: differences of indices are then never a surprise.
using index_t = std::int64_t;

template <class T>
struct Vec3 {
    T x{}, y{}, z{};
};

} // namespace geraf2
