// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace geraf2::detail {

/// Degrees of the block method's three approximations, the error of the last, and how far blocks
/// may reach.
struct MatchedFilterTier {
    int profile_degree;  ///< of the range profile, as a polynomial of the carrier phase
    int range_order;     ///< of R - R_c, as a polynomial of q = |d|^2 + 2 v.d
    int sincos_level;    ///< see SinCosTerms
    double sincos_error; ///< largest
    /// Carrier phase from centre to rim of a block, both legs [half turns]. Eight are 7.7 mm at
    /// 77 GHz; with many points a block, rounding in float and the range series cost more beyond
    /// than larger blocks save.
    double max_half_turns;
};

/// Indices into `tiers`. Coarse ones serve rtol 1e-3, fine ones smaller, the double ones double
/// precision only (float rounds at about 5e-6).
enum Tier : int {
    // narrow blocks: the matched filter's
    narrow_coarse,
    narrow_fine,
    narrow_double,
    // wide blocks for points far apart: a tracer's
    wide_coarse,
    wider_coarse,
    wide_fine,
    // nodes of the factorised method: a low degree, and a high one for boxes where that falls short
    nodes_coarse_low,
    nodes_coarse_high,
    nodes_fine_low,
    nodes_fine_high,
    nodes_double,
    n_tiers,
};
inline constexpr int first_node_tier = nodes_coarse_low;

inline constexpr MatchedFilterTier tiers[] = {
    {3, 3, 0, 7.5e-5, 8.0},     {5, 4, 1, 6.0e-7, 8.0},      {8, 7, 3, 8.0e-14, 8.0},
    {4, 5, 0, 7.5e-5, 14.0},    {6, 6, 0, 7.5e-5, 30.0},     {7, 7, 1, 6.0e-7, 22.0},
    {6, 6, 0, 7.5e-5, 128.0},   {10, 12, 0, 7.5e-5, 128.0},  {8, 7, 1, 6.0e-7, 128.0},
    {13, 12, 1, 6.0e-7, 128.0}, {16, 12, 3, 8.0e-14, 128.0},
};
static_assert(sizeof(tiers) / sizeof(tiers[0]) == n_tiers);

/// Carrier phase of a cluster's centre at the points of a part of a box.
struct CarrierTier {
    int range_order;
    int sincos_level;
};

/// Indices into `carrier_tiers`: for nodes of the same accuracy.
enum CarrierAccuracy : int { carrier_coarse, carrier_fine, carrier_double };

inline constexpr CarrierTier carrier_tiers[] = {{4, 0}, {6, 1}, {10, 3}};

} // namespace geraf2::detail
