// SPDX-License-Identifier: Apache-2.0
#define GERAF2_VECTOR_BYTES 64
#define GERAF2_SIMD_NAMESPACE simd_avx512
#include "matched_filter/exact.hpp"

namespace geraf2::detail {

template <>
const MatchedFilterKernels<float>& matched_filter_kernels_avx512() noexcept {
    return simd_avx512::kernels<float>;
}
template <>
const MatchedFilterKernels<double>& matched_filter_kernels_avx512() noexcept {
    return simd_avx512::kernels<double>;
}

} // namespace geraf2::detail
