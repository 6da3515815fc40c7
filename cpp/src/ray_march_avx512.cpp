// SPDX-License-Identifier: Apache-2.0
#define GERAF2_VECTOR_BYTES 64
#define GERAF2_SIMD_NAMESPACE simd_avx512
#include "ray_march/lanes.hpp"

namespace geraf2::detail {

template <>
const RayMarchKernels<float>& ray_march_kernels_avx512() noexcept {
    return simd_avx512::march_kernels<float>;
}
template <>
const RayMarchKernels<double>& ray_march_kernels_avx512() noexcept {
    return simd_avx512::march_kernels<double>;
}

} // namespace geraf2::detail
