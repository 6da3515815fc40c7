// SPDX-License-Identifier: Apache-2.0
// Selection of the kernels that are compiled once per instruction set.
#pragma once

#include "geraf2/simd.hpp"

namespace geraf2::detail {

// Kernels is the table of a kernel, as SdfGridKernels<float>. Each of these is defined for it in a
// file of its own, which CMake writes from level.cpp.in; only call what simd_level() allows.
template <class Kernels>
const Kernels& kernels_baseline() noexcept;
template <class Kernels>
const Kernels& kernels_avx2() noexcept;
template <class Kernels>
const Kernels& kernels_avx512() noexcept;

/// The table of simd_level().
template <class Kernels>
const Kernels& kernels_for_cpu() {
    switch (simd_level()) {
#if defined(__x86_64__)
    case SimdLevel::avx512:
        return kernels_avx512<Kernels>();
    case SimdLevel::avx2:
        return kernels_avx2<Kernels>();
#endif
    default:
        return kernels_baseline<Kernels>();
    }
}

} // namespace geraf2::detail
