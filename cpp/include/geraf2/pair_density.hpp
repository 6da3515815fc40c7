// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "geraf2/types.hpp"

namespace geraf2 {

/// Points with normals, from peaks of sub-apertures of planes.
struct PeakPoints {
    std::span<const double> positions;     ///< (n, 3) [m]
    std::span<const double> normals;       ///< (n, 3), unit vectors
    std::span<const index_t> planes;       ///< (n)
    std::span<const index_t> subapertures; ///< (n)
};

/// Density of a second point p_j, n_j of a surface that a first one p_i, n_i predicts, with
/// d = |p_i - p_j| and cos a = n_i . n_j (docs/math/echoes.md#labels):
///
///     exp(-(o^2 / s_o^2 + t^2 / s_t^2 + (d^2 - o^2) / spread^2) / 2)
///         / (sqrt(2 pi) s_o 2 pi s_t^2 2 pi spread^2)
///     o = (p_i - p_j) . (n_i + n_j) / |n_i + n_j|,    t^2 = 2 - 2 cos a
///     s_o^2 = offset_variance + (bend d^3)^2,    s_t^2 = turn_variance + (curvature d)^2
struct PairModel {
    double reach = 0.0;           ///< largest d, above 0 [m]
    double least_cosine = 0.0;    ///< of a
    double spread = 0.0;          ///< [m]
    double offset_variance = 0.0; ///< [m^2]
    double bend = 0.0;            ///< [1/m^2]
    double turn_variance = 0.0;   ///< [rad^2]
    double curvature = 0.0;       ///< [rad/m]
    double least_density = 0.0;   ///< what is less is left out [1/(m^3 sr)]
};

/// Matrix (n_points, 2 n_others) in compressed rows: densities by others of other planes, then by
/// those of the point's own plane.
struct PairRows {
    std::vector<index_t> starts;       ///< (n_points + 1), into columns and densities
    std::vector<std::int32_t> columns; ///< (n_pairs)
    std::vector<double> densities;     ///< (n_pairs) [1/(m^3 sr)]
};

/// Densities at points that others within reach predict, but for those of the same sub-aperture.
/// Positions are finite, and 2 n_others is below 2^31. In one thread: a pair takes about 10 ns.
PairRows pair_densities(const PeakPoints& points, const PeakPoints& others, const PairModel& model);

} // namespace geraf2
