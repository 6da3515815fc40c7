// SPDX-License-Identifier: Apache-2.0
#define GERAF2_VECTOR_BYTES 16
#define GERAF2_SIMD_NAMESPACE simd_baseline
#include "sdf_grid/lanes.hpp"

namespace geraf2::detail {

template <>
const SdfGridKernels<float>& sdf_grid_kernels_baseline() noexcept {
    return simd_baseline::grid_kernels<float>;
}
template <>
const SdfGridKernels<double>& sdf_grid_kernels_baseline() noexcept {
    return simd_baseline::grid_kernels<double>;
}

} // namespace geraf2::detail
