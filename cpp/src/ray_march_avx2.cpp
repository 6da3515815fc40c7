// SPDX-License-Identifier: Apache-2.0
#define GERAF2_VECTOR_BYTES 32
#define GERAF2_SIMD_NAMESPACE simd_avx2
#include "ray_march/lanes.hpp"

namespace geraf2::detail {

template <>
const RayMarchKernels<float>& ray_march_kernels_avx2() noexcept {
    return simd_avx2::march_kernels<float>;
}
template <>
const RayMarchKernels<double>& ray_march_kernels_avx2() noexcept {
    return simd_avx2::march_kernels<double>;
}

} // namespace geraf2::detail
