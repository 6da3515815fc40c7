// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "arrays.hpp"
#include "geraf2/antennas.hpp"

namespace geraf2::bindings {

/// View of the arrays, which must outlive it.
inline AntennaPositions antennas_of(const Array<double>& tx, const Array<double>& rx) {
    require_shape("tx", tx, {-1, 3});
    require_shape("rx", rx, {tx.shape(0), 3});
    return {view(tx), view(rx)};
}

} // namespace geraf2::bindings
