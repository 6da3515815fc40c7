// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>

#include "geraf2/types.hpp"

namespace geraf2 {

/// What volume rendering knows of the intervals of its rays; all (n_rays, n_samples).
template <class T>
struct RaySamples {
    std::span<const T> sdf;  ///< signed distance at mid-interval [m]
    std::span<const T> cos;  ///< its derivative along the ray
    std::span<const T> step; ///< length of the interval [m]; intervals of a ray are contiguous
    double inv_s = 0.0;      ///< sharpness of the logistic density [1/m]
    index_t n_samples = 0;
    int power = 1; ///< transmittance enters to this power: 1, or 2 for T^2
};

template <class T>
struct RayWeights {
    std::span<T> alpha;         ///< (n_rays, n_samples)
    std::span<T> transmittance; ///< (n_rays, n_samples), of what lies before the interval
    std::span<T> weight;        ///< (n_rays, n_samples)
    std::span<T> depth;         ///< (n_rays) [m], from the beginning of the first interval
};

/// Opacity, transmittance, weight and depth, docs/math/ray-march-and-lensless.md#ray-march. T:
/// float or double.
template <class T>
void ray_march_fwd(const RaySamples<T>& samples, const RayWeights<T>& out, int num_threads);

/// Gradients of L, given those to the outputs (an empty span is zero) and alpha and transmittance
/// as computed by ray_march_fwd; returns dL/d inv_s. sdf_grad, cos_grad: (n_rays, n_samples).
template <class T>
double ray_march_bwd(const RaySamples<T>& samples, std::span<const T> alpha,
                     std::span<const T> transmittance, const RayWeights<const T>& grad,
                     int num_threads, std::span<T> sdf_grad, std::span<T> cos_grad);

} // namespace geraf2
