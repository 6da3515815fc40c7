// SPDX-License-Identifier: Apache-2.0
#define GERAF2_VECTOR_BYTES 16
#define GERAF2_SIMD_NAMESPACE simd_baseline
#include "signal_tracer/lanes.hpp"

namespace geraf2::detail {

template <>
const SignalTracerKernels<float>& signal_tracer_kernels_baseline() noexcept {
    return simd_baseline::tracer_kernels<float>;
}
template <>
const SignalTracerKernels<double>& signal_tracer_kernels_baseline() noexcept {
    return simd_baseline::tracer_kernels<double>;
}

} // namespace geraf2::detail
