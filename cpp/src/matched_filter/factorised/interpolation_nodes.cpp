// SPDX-License-Identifier: Apache-2.0
// Positions and numbers of the interpolation nodes:
// docs/math/block-and-factorised.md#factorised-method.
#include "matched_filter/factorised/interpolation_nodes.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace geraf2::detail {
namespace {

/// Orders of the Bessel functions of the bend that count: J_9(1) is below 1e-11.
constexpr index_t max_bend_order = 8;

/// Orders beyond the number of nodes that an error is summed over.
constexpr index_t tail = 8;

constexpr double infinity = std::numeric_limits<double>::infinity();

/// Rates over one leg at one point, added to `out`: the clusters' antennas lie within `half` of
/// their centre. `grow` covers what the first order in half / R leaves out.
void add_leg_rates(const double* v, const double* half, double carrier, double band, double grow,
                   PhaseRates& out) noexcept {
    const double range = std::hypot(v[0], v[1], v[2]);
    const double e[3] = {v[0] / range, v[1] / range, v[2] / range};
    for (std::size_t a = 0; a < 3; ++a) {
        double slope = 0.0;
        double bend = 0.0;
        for (std::size_t b = 0; b < 3; ++b) {
            slope += std::abs((a == b ? 1.0 : 0.0) - e[a] * e[b]) * half[b];
            bend += std::abs(a == b ? 3.0 * e[a] * (1.0 - e[a] * e[a])
                                    : e[b] * (1.0 - 3.0 * e[a] * e[a])) *
                    half[b];
        }
        const double sine = std::min(1.0, std::abs(e[a]) + grow);
        out.slope[a] += carrier * slope / range * (1.0 + 1.5 * grow) + band * sine;
        out.bend[a] += carrier * bend / (range * range) * (1.0 + 2.0 * grow) +
                       band * (1.0 - e[a] * e[a]) / range;
    }
}

void keep_largest(const PhaseRates& from, PhaseRates& to) noexcept {
    for (std::size_t a = 0; a < 3; ++a) {
        to.slope[a] = std::max(to.slope[a], from.slope[a]);
        to.bend[a] = std::max(to.bend[a], from.bend[a]);
    }
}

/// Bound of the error of n-node interpolation of exp(j (omega s + q T_2(s))) on [-1, 1]: twice
/// the Chebyshev coefficients from n on, that of T_n itself once, as T_n vanishes at the nodes.
double interpolation_error(index_t n, const double* omega_bessel, const double* q_bessel) noexcept {
    double error = 0.0;
    for (index_t p = n; p < n + tail; ++p) {
        double coefficient = 0.0;
        for (index_t m = -max_bend_order; m <= max_bend_order; ++m) {
            coefficient += q_bessel[std::abs(m)] * omega_bessel[std::abs(p - 2 * m)];
        }
        error += (p == n ? 2.0 : 4.0) * coefficient;
    }
    return error;
}

} // namespace

void PhaseRates::include(const PhaseRates& other) noexcept { keep_largest(other, *this); }

ClusterRates phase_rates(const ParentExtent& parent, const WavePhases& wave,
                         const std::array<double, 3>& center,
                         const std::array<double, 3>& half) noexcept {
    ClusterRates out;
    const double carrier = std::numbers::pi * std::abs(wave.half_turns_per_m);
    const double band = std::numbers::pi * std::abs(wave.step_half_turns_per_m) * wave.last_pair;
    const double radius = std::hypot(half[0], half[1], half[2]);
    const double spread = parent.extent.radius();
    for (std::size_t leg = 0; leg < 2; ++leg) {
        const double* from = parent.extent.center.data() + 3 * leg;
        const double range =
            std::hypot(center[0] - from[0], center[1] - from[1], center[2] - from[2]);
        if (!(range >= 2.0 * (radius + spread))) {
            out.parent.slope.fill(infinity);
            out.child.slope.fill(infinity);
            return out;
        }
    }
    constexpr int stride[3] = {1, 2, 4};
    for (int corner = 0; corner < 9; ++corner) { // the ninth is the middle
        PhaseRates at_parent;
        PhaseRates at_child;
        for (std::size_t leg = 0; leg < 2; ++leg) {
            double v[3];
            for (std::size_t a = 0; a < 3; ++a) {
                const double side = corner == 8 ? 0.0 : corner / stride[a] % 2 == 0 ? -1.0 : 1.0;
                v[a] = center[a] + side * half[a] - parent.extent.center[3 * leg + a];
            }
            const double grow = spread / std::hypot(v[0], v[1], v[2]);
            add_leg_rates(v, parent.extent.half.data() + 3 * leg, carrier, band, grow, at_parent);
            add_leg_rates(v, parent.child_half.data() + 3 * leg, carrier, band, grow, at_child);
        }
        keep_largest(at_parent, out.parent);
        keep_largest(at_child, out.child);
    }
    return out;
}

index_t nodes_needed(double slope, double bend, double half, double limit) noexcept {
    const double omega = slope * half;
    const double q = 0.25 * bend * half * half;
    if (!(omega < 9.0) || !(q < 1.0)) {
        return 0;
    }
    constexpr int n_orders = static_cast<int>(max_nodes + tail + 2 * max_bend_order);
    double omega_bessel[n_orders];
    for (int p = 0; p < n_orders; ++p) {
        omega_bessel[p] = std::abs(bessel_j(p, omega));
    }
    double q_bessel[max_bend_order + 1];
    for (int m = 0; m <= static_cast<int>(max_bend_order); ++m) {
        q_bessel[m] = std::abs(bessel_j(m, q));
    }
    for (index_t n = 1; n <= max_nodes; ++n) {
        if (interpolation_error(n, omega_bessel, q_bessel) <= limit) {
            return n;
        }
    }
    return 0;
}

double chebyshev_node(index_t k, index_t n) noexcept {
    return std::cos((static_cast<double>(k) + 0.5) * std::numbers::pi / static_cast<double>(n));
}

void lagrange_weights(index_t n, double x, double* weights) noexcept {
    // sum_p T_p(node) T_p(x) / norm_p: stable for any x in [-1, 1], on a node too.
    for (index_t k = 0; k < n; ++k) {
        const double node = chebyshev_node(k, n);
        double t[2][2] = {{1.0, node}, {1.0, x}}; // T_(p-1), T_p of node and x
        double sum = 0.5;
        for (index_t p = 1; p < n; ++p) {
            sum += t[0][1] * t[1][1];
            for (int i = 0; i < 2; ++i) {
                const double next = 2.0 * (i == 0 ? node : x) * t[i][1] - t[i][0];
                t[i][0] = t[i][1];
                t[i][1] = next;
            }
        }
        weights[k] = 2.0 * sum / static_cast<double>(n);
    }
}

} // namespace geraf2::detail
