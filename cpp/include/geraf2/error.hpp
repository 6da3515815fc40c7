// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <stdexcept>

namespace geraf2 {

/// The ray tracer reported an error other than a lack of memory.
struct EmbreeError : std::runtime_error {
    using std::runtime_error::runtime_error;
};

} // namespace geraf2
