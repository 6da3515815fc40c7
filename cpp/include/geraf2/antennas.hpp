// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>

#include "geraf2/types.hpp"

namespace geraf2 {

/// One transmitter and one receiver per antenna, double precision whatever the signal's.
struct AntennaPositions {
    std::span<const double> tx; ///< (n_antennas, 3) [m]
    std::span<const double> rx; ///< (n_antennas, 3) [m]

    [[nodiscard]] index_t count() const noexcept { return static_cast<index_t>(tx.size() / 3); }
};

} // namespace geraf2
