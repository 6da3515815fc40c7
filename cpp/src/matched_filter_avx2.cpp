// SPDX-License-Identifier: Apache-2.0
#define GERAF2_VECTOR_BYTES 32
#define GERAF2_SIMD_NAMESPACE simd_avx2
#include "matched_filter/exact.hpp"

namespace geraf2::detail {

template <>
const MatchedFilterKernels<float>& matched_filter_kernels_avx2() noexcept {
    return simd_avx2::kernels<float>;
}
template <>
const MatchedFilterKernels<double>& matched_filter_kernels_avx2() noexcept {
    return simd_avx2::kernels<double>;
}

} // namespace geraf2::detail
