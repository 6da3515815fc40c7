// SPDX-License-Identifier: Apache-2.0
#define GERAF2_VECTOR_BYTES 16
#define GERAF2_SIMD_NAMESPACE simd_baseline
#include "matched_filter/exact.hpp"

namespace geraf2::detail {

template <>
const MatchedFilterKernels<float>& matched_filter_kernels_baseline() noexcept {
    return simd_baseline::kernels<float>;
}
template <>
const MatchedFilterKernels<double>& matched_filter_kernels_baseline() noexcept {
    return simd_baseline::kernels<double>;
}

} // namespace geraf2::detail
