// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <limits>

#include "matched_filter/factorised/antenna_clusters.hpp"
#include "matched_filter/plan.hpp"

namespace geraf2::detail {

inline constexpr index_t max_nodes = 24;

/// Largest rates at which the demodulated phase of any antenna and sample of a set of clusters
/// changes along the axes of a block; bounds, not estimates.
struct PhaseRates {
    std::array<double, 3> slope{}; ///< [rad / m]
    std::array<double, 3> bend{};  ///< [rad / m^2]

    void include(const PhaseRates& other) noexcept;
    [[nodiscard]] bool finite() const noexcept {
        return slope[0] < std::numeric_limits<double>::infinity();
    }
};

/// Rates of one parent and of its children over a block; infinite where the block lies nearer
/// than its own radius, as seen from anywhere in the parent.
struct ClusterRates {
    PhaseRates parent;
    PhaseRates child;
};

/// Geometry of a parent that determines the rates.
struct ParentExtent {
    ClusterExtent extent;
    std::array<double, 6> child_half{}; ///< largest half sides of its children
};

ClusterRates phase_rates(const ParentExtent& parent, const WavePhases& wave,
                         const std::array<double, 3>& center,
                         const std::array<double, 3>& half) noexcept;

/// Nodes with which interpolation over [-half, half] errs by at most `limit` in any phasor along
/// one axis; 0 if that takes more than max_nodes.
index_t nodes_needed(double slope, double bend, double half, double limit) noexcept;

/// Chebyshev node k of n on [-1, 1].
double chebyshev_node(index_t k, index_t n) noexcept;

/// Weights of the n Chebyshev nodes at x.
void lagrange_weights(index_t n, double x, double* weights) noexcept;

} // namespace geraf2::detail
