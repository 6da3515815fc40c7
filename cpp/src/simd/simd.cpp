// SPDX-License-Identifier: Apache-2.0
#include "geraf2/simd.hpp"

#include <cstdlib>
#include <stdexcept>
#include <string>

namespace geraf2 {
namespace {

SimdLevel best_level() noexcept {
#if defined(__x86_64__)
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512vl")) {
        return SimdLevel::avx512;
    }
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) {
        return SimdLevel::avx2;
    }
#endif
    return SimdLevel::baseline;
}

} // namespace

const char* simd_level_name(SimdLevel level) noexcept {
    switch (level) {
    case SimdLevel::avx512:
        return "avx512";
    case SimdLevel::avx2:
        return "avx2";
    case SimdLevel::baseline:
        break;
    }
    return "baseline";
}

SimdLevel simd_level() {
    const SimdLevel best = best_level();
    const char* wanted = std::getenv("GERAF2_SIMD");
    if (wanted == nullptr || *wanted == '\0') {
        return best;
    }
    for (const SimdLevel level : {SimdLevel::baseline, SimdLevel::avx2, SimdLevel::avx512}) {
        if (std::string(wanted) == simd_level_name(level)) {
            if (level > best) {
                throw std::invalid_argument(std::string("GERAF2_SIMD=") + wanted +
                                            ", but this CPU has no more than " +
                                            simd_level_name(best));
            }
            return level;
        }
    }
    throw std::invalid_argument(std::string("GERAF2_SIMD must be baseline, avx2 or avx512, got ") +
                                wanted);
}

} // namespace geraf2
