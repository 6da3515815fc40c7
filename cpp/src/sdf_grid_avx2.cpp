// SPDX-License-Identifier: Apache-2.0
#define GERAF2_VECTOR_BYTES 32
#define GERAF2_SIMD_NAMESPACE simd_avx2
#include "sdf_grid/lanes.hpp"

namespace geraf2::detail {

template <>
const SdfGridKernels<float>& sdf_grid_kernels_avx2() noexcept {
    return simd_avx2::grid_kernels<float>;
}
template <>
const SdfGridKernels<double>& sdf_grid_kernels_avx2() noexcept {
    return simd_avx2::grid_kernels<double>;
}

} // namespace geraf2::detail
