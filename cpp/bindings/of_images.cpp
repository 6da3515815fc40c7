// SPDX-License-Identifier: Apache-2.0
// Bindings that are compiled together, see cpp/CMakeLists.txt.
#include "bind_matched_filter.cpp"
#include "bind_physical_optics.cpp"
#include "bind_signal_tracer.cpp"
#include "bind_subaperture.cpp"
