// SPDX-License-Identifier: Apache-2.0
#define GERAF2_SIMD_NAMESPACE simd_baseline
#include "grid_energy/lanes.hpp"

namespace geraf2::detail {

template <>
const GridEnergyKernels<float>& grid_energy_kernels_baseline() noexcept {
    return simd_baseline::grid_energy_kernels<float>;
}
template <>
const GridEnergyKernels<double>& grid_energy_kernels_baseline() noexcept {
    return simd_baseline::grid_energy_kernels<double>;
}

} // namespace geraf2::detail
