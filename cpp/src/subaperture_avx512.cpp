// SPDX-License-Identifier: Apache-2.0
#define GERAF2_VECTOR_BYTES 64
#define GERAF2_SIMD_NAMESPACE simd_avx512
#include "subaperture/lanes.hpp"

namespace geraf2::detail {

template <>
const SubapertureKernels<float>& subaperture_kernels_avx512() noexcept {
    return simd_avx512::subaperture_kernels<float>;
}
template <>
const SubapertureKernels<double>& subaperture_kernels_avx512() noexcept {
    return simd_avx512::subaperture_kernels<double>;
}

} // namespace geraf2::detail
