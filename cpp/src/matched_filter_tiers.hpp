// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace geraf2::detail {

/// Degrees of the block method's three approximations, and the error of the last.
struct MatchedFilterTier {
    int profile_degree;  ///< of the range profile, as a polynomial of the carrier phase
    int range_order;     ///< of R - R_c, as a polynomial of q = |d|^2 + 2 v.d
    int sincos_level;    ///< see SinCosTerms
    double sincos_error; ///< largest
};

/// The first serves rtol 1e-3; the third is for double only (float rounds at about 5e-6).
inline constexpr MatchedFilterTier tiers[] = {
    {3, 3, 0, 7.5e-5},
    {5, 4, 1, 6.0e-7},
    {8, 7, 3, 8.0e-14},
};

} // namespace geraf2::detail
