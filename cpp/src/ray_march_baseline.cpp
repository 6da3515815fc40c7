// SPDX-License-Identifier: Apache-2.0
#define GERAF2_VECTOR_BYTES 16
#define GERAF2_SIMD_NAMESPACE simd_baseline
#include "ray_march/lanes.hpp"

namespace geraf2::detail {

template <>
const RayMarchKernels<float>& ray_march_kernels_baseline() noexcept {
    return simd_baseline::march_kernels<float>;
}
template <>
const RayMarchKernels<double>& ray_march_kernels_baseline() noexcept {
    return simd_baseline::march_kernels<double>;
}

} // namespace geraf2::detail
