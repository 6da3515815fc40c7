// SPDX-License-Identifier: Apache-2.0
// Kernels of the matched filter for one instruction set:
// docs/math/matched-filter.md#matched-filter.
#pragma once

#include "matched_filter/block.hpp"
#include "matched_filter/exact.hpp"
#include "matched_filter/expand.hpp"

namespace geraf2::GERAF2_SIMD_NAMESPACE {

template <class T>
inline constexpr detail::MatchedFilterKernels<T> matched_filter_kernels{
    lanes<T>,     &block_fwd<T>,  &exact_fwd<T>,  &block_bwd<T>, &exact_bwd<T>, &positions_bwd<T>,
    &contract<T>, &expand_fwd<T>, &expand_bwd<T>, &modulate<T>,  &sum_lanes<T>};

} // namespace geraf2::GERAF2_SIMD_NAMESPACE
