// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace geraf2 {

/// Instruction sets that the kernels are compiled for. One binary holds all of them.
enum class SimdLevel {
    baseline, ///< whatever the compiler may assume (x86-64: SSE2)
    avx2,     ///< AVX2 and FMA, 32-byte vectors
    avx512,   ///< AVX-512 F, DQ and VL, 64-byte vectors
};

/// Best level of this CPU, or the one that the environment variable GERAF2_SIMD names.
///
/// The variable is read at each call, so that it is no state of the library. Throws
/// std::invalid_argument if it names no level, or one that this CPU or build lacks.
SimdLevel simd_level();

/// "baseline", "avx2" or "avx512".
const char* simd_level_name(SimdLevel level) noexcept;

} // namespace geraf2
