// SPDX-License-Identifier: Apache-2.0
#define GERAF2_SIMD_NAMESPACE simd_avx2
#include "grid_energy/lanes.hpp"

namespace geraf2::detail {

template <>
const GridEnergyKernels<float>& grid_energy_kernels_avx2() noexcept {
    return simd_avx2::grid_energy_kernels<float>;
}
template <>
const GridEnergyKernels<double>& grid_energy_kernels_avx2() noexcept {
    return simd_avx2::grid_energy_kernels<double>;
}

} // namespace geraf2::detail
