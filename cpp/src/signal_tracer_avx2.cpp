// SPDX-License-Identifier: Apache-2.0
#define GERAF2_VECTOR_BYTES 32
#define GERAF2_SIMD_NAMESPACE simd_avx2
#include "signal_tracer/lanes.hpp"

namespace geraf2::detail {

template <>
const SignalTracerKernels<float>& signal_tracer_kernels_avx2() noexcept {
    return simd_avx2::tracer_kernels<float>;
}
template <>
const SignalTracerKernels<double>& signal_tracer_kernels_avx2() noexcept {
    return simd_avx2::tracer_kernels<double>;
}

} // namespace geraf2::detail
