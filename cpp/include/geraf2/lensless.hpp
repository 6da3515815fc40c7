// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

#include "geraf2/types.hpp"

namespace geraf2 {

/// Contiguous intervals of parallel rays, and what they begin with.
template <class T>
struct RayIntervals {
    std::span<T> starts; ///< where the rays enter, (n_rays, 3) [m]
    std::span<T> points; ///< mid-intervals, (n_rays, n, 3) [m]
    std::span<T> step;   ///< lengths, (n_rays, n) [m]
    std::span<T> offset; ///< from the start to the first interval, (n_rays) [m]
};

/// n intervals whose n + 1 ends are jittered within their share of the ray.
template <class T>
void ray_intervals(std::span<const double> origins, // (n_rays, 3) [m]
                   const Vec3<double>& direction,   // of all rays
                   std::span<const double> near,    // where the ray enters, (n_rays) [m]
                   std::span<const double> far,     // where it leaves, (n_rays) [m]
                   std::span<const double> jitter,  // in [0, 1), (n_rays, n + 1)
                   int num_threads, const RayIntervals<T>& out);

/// Samples of all rays, ray after ray.
template <class T>
struct VolumeSamples {
    std::span<const T> alpha;         ///< opacity, (n_samples)
    std::span<const T> transmittance; ///< one-way, (n_samples); not read by facing_samples
    std::span<const T> gradient;      ///< of the distance, (n_samples, 3)
    std::span<const double> points;   ///< (n_samples, 3) [m]
};

/// Pairs of a sample and a group of antennas, part after part; part = group n_looks + look.
struct SamplePairs {
    std::vector<index_t> sample;  ///< ascending within a part
    std::vector<index_t> offsets; ///< (n_parts + 1): where each part begins
};

/// What of an amplitude belongs to a group of antennas.
struct EchoForm {
    std::span<const double> centers;    ///< middles of the groups, (n_groups, 3) [m]
    std::span<const double> references; ///< distance of amplitude one, (n_groups) [m]; or empty
    double lobe_power = 1.0;            ///< p; 1 leaves the lobe out
    int two_way_power = 1;              ///< m: 2 for equation 4 of the paper
};

/// Samples with an opacity whose lobe reaches a group of antennas, distributed over looks:
/// neighbours along a ray and from ray to ray go to different ones.
template <class T>
SamplePairs facing_samples(const VolumeSamples<T>& samples, const EchoForm& form,
                           index_t samples_per_ray, index_t n_looks, int num_threads);

/// Pairs as their amplitudes are computed.
struct PairsView {
    std::span<const index_t> sample;  ///< (n_pairs)
    std::span<const index_t> offsets; ///< (n_parts + 1)
    index_t n_looks = 1;
};

/// Amplitude of each pair, docs/math/ray-march-and-lensless.md#lensless-amplitude:
///     A = alpha F,  F = (T + shift)+^m lobe^(p - 1) (reference / w)^2,
///     lobe = (2 (n . w / |w|)^2 - 1)+,  n = gradient / |gradient|,  w from the centre to the
///     point.
template <class T>
void echo_amplitudes_fwd(const VolumeSamples<T>& samples, const PairsView& pairs,
                         std::span<const T> shift, // (n_pairs)
                         const EchoForm& form, int num_threads,
                         std::span<T> amplitude, // (n_pairs)
                         std::span<T> factor,    // F, (n_pairs)
                         std::span<T> normals);  // (n_pairs, 3)

/// Gradients to the samples, which are added to.
template <class T>
struct SampleGradients {
    std::span<T> alpha;         ///< (n_samples)
    std::span<T> transmittance; ///< (n_samples)
    std::span<T> gradient;      ///< (n_samples, 3), or empty: not wanted
};

/// Backward of echo_amplitudes_fwd; with its `factor`.
template <class T>
void echo_amplitudes_bwd(const VolumeSamples<T>& samples, const PairsView& pairs,
                         std::span<const T> shift, const EchoForm& form, std::span<const T> factor,
                         std::span<const T> amplitude_grad, // (n_pairs)
                         std::span<const T> normals_grad,   // (n_pairs, 3)
                         const SampleGradients<T>& out);

/// Mean of (|g| - 1)^2 over gradients (n, 3), and its slope to each of them. The roots are of
/// |g|^2 + 1e-12, which has a derivative at zero. The result does not depend on num_threads.
template <class T>
double length_defect(std::span<const T> gradients, int num_threads, std::span<T> slope);

} // namespace geraf2
