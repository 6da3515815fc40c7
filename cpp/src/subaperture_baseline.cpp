// SPDX-License-Identifier: Apache-2.0
#define GERAF2_VECTOR_BYTES 16
#define GERAF2_SIMD_NAMESPACE simd_baseline
#include "subaperture/lanes.hpp"

namespace geraf2::detail {

template <>
const SubapertureKernels<float>& subaperture_kernels_baseline() noexcept {
    return simd_baseline::subaperture_kernels<float>;
}
template <>
const SubapertureKernels<double>& subaperture_kernels_baseline() noexcept {
    return simd_baseline::subaperture_kernels<double>;
}

} // namespace geraf2::detail
