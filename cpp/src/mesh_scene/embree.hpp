// SPDX-License-Identifier: Apache-2.0
/// Embree 3 and 4 behind one set of names: handles that release themselves, errors, query contexts.
#pragma once

#include <memory>
#include <new>
#include <string>
#include <type_traits>

#if GERAF2_EMBREE_MAJOR >= 4
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

#include "geraf2/error.hpp"

namespace geraf2 {

struct ReleaseDevice {
    void operator()(RTCDevice d) const noexcept { rtcReleaseDevice(d); }
};
struct ReleaseScene {
    void operator()(RTCScene s) const noexcept { rtcReleaseScene(s); }
};
struct ReleaseGeometry {
    void operator()(RTCGeometry g) const noexcept { rtcReleaseGeometry(g); }
};
using DevicePtr = std::unique_ptr<std::remove_pointer_t<RTCDevice>, ReleaseDevice>;
using ScenePtr = std::unique_ptr<std::remove_pointer_t<RTCScene>, ReleaseScene>;
using GeometryPtr = std::unique_ptr<std::remove_pointer_t<RTCGeometry>, ReleaseGeometry>;

inline const char* describe(RTCError code) noexcept {
    switch (code) {
    case RTC_ERROR_NONE:
        return "no error";
    case RTC_ERROR_INVALID_ARGUMENT:
        return "invalid argument";
    case RTC_ERROR_INVALID_OPERATION:
        return "invalid operation";
    case RTC_ERROR_UNSUPPORTED_CPU:
        return "unsupported CPU";
    case RTC_ERROR_CANCELLED:
        return "cancelled";
    default:
        return "unknown error";
    }
}

[[noreturn]] inline void throw_error(RTCError code, const char* during) {
    // It answers "unknown" where it lacks the memory to note an error.
    if (code == RTC_ERROR_OUT_OF_MEMORY || code == RTC_ERROR_UNKNOWN) {
        throw std::bad_alloc();
    }
    throw EmbreeError(std::string("Embree, while ") + during + ": " + describe(code));
}

inline void throw_device_error(RTCDevice device, const char* during) {
    const RTCError code = rtcGetDeviceError(device);
    if (code != RTC_ERROR_NONE) {
        throw_error(code, during);
    }
}

#if GERAF2_EMBREE_MAJOR >= 4
using QueryContext = RTCRayQueryContext;
#else
using QueryContext = RTCIntersectContext;
#endif

inline void init_context(QueryContext& context) {
#if GERAF2_EMBREE_MAJOR >= 4
    rtcInitRayQueryContext(&context);
#else
    rtcInitIntersectContext(&context);
#endif
}

} // namespace geraf2
