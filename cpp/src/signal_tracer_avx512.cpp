// SPDX-License-Identifier: Apache-2.0
#define GERAF2_VECTOR_BYTES 64
#define GERAF2_SIMD_NAMESPACE simd_avx512
#include "signal_tracer/lanes.hpp"

namespace geraf2::detail {

template <>
const SignalTracerKernels<float>& signal_tracer_kernels_avx512() noexcept {
    return simd_avx512::tracer_kernels<float>;
}
template <>
const SignalTracerKernels<double>& signal_tracer_kernels_avx512() noexcept {
    return simd_avx512::tracer_kernels<double>;
}

} // namespace geraf2::detail
