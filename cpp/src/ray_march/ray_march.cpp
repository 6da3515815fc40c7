// SPDX-License-Identifier: Apache-2.0
#include "geraf2/ray_march.hpp"

#include <algorithm>
#include <cassert>
#include <vector>

#include "ray_march/kernels.hpp"
#include "simd/dispatch.hpp"

namespace geraf2 {
namespace {

using detail::RayGradients;
using detail::RayInputs;
using detail::RayMarchKernels;
using detail::RayOutputs;

/// Samples that justify another thread: some 20 us of work, beside some 5 us to start it.
constexpr index_t samples_per_thread = 16384;

int useful_threads(index_t n_values, int num_threads) noexcept {
    return static_cast<int>(std::clamp<index_t>(n_values / samples_per_thread, 1, num_threads));
}

template <class T>
RayInputs<T> inputs_of(const RaySamples<T>& samples) noexcept {
    return {samples.sdf.data(),  samples.cos.data(),
            samples.step.data(), static_cast<T>(samples.inv_s),
            samples.n_samples,   samples.power};
}

template <class T>
T* data_or_null(std::span<T> of) noexcept {
    return of.empty() ? nullptr : of.data();
}

/// Calls work(first, n_rows) for each tile; any thread may have it, as no result depends on it.
template <class Work>
void for_tiles(index_t n_rays, index_t n_samples, int lanes, int num_threads, const Work& work) {
    const index_t n_tiles = (n_rays + lanes - 1) / lanes;
    const int threads = useful_threads(n_rays * n_samples, num_threads);
#pragma omp parallel for num_threads(threads) schedule(static) if (threads > 1)
    for (index_t tile = 0; tile < n_tiles; ++tile) {
        const index_t first = tile * lanes;
        work(first, static_cast<int>(std::min<index_t>(lanes, n_rays - first)));
    }
}

} // namespace

template <class T>
void ray_march_fwd(const RaySamples<T>& samples, const RayWeights<T>& out, int num_threads) {
    const auto n_rays = static_cast<index_t>(out.depth.size());
    assert(static_cast<index_t>(samples.sdf.size()) == n_rays * samples.n_samples);
    const auto& kernels = detail::kernels_for_cpu<RayMarchKernels<T>>();
    const RayInputs<T> in = inputs_of(samples);
    const RayOutputs<T> to{out.alpha.data(), out.transmittance.data(), out.weight.data(),
                           out.depth.data()};
    for_tiles(n_rays, in.n_samples, kernels.lanes, num_threads,
              [&](index_t first, int n_rows) { kernels.fwd(in, first, n_rows, to); });
}

template <class T>
double ray_march_bwd(const RaySamples<T>& samples, std::span<const T> alpha,
                     std::span<const T> transmittance, const RayWeights<const T>& grad,
                     int num_threads, std::span<T> sdf_grad, std::span<T> cos_grad) {
    const index_t n_rays =
        samples.n_samples == 0 ? 0 : static_cast<index_t>(alpha.size()) / samples.n_samples;
    const auto& kernels = detail::kernels_for_cpu<RayMarchKernels<T>>();
    const RayInputs<T> in = inputs_of(samples);
    const RayOutputs<const T> found{alpha.data(), transmittance.data(), nullptr, nullptr};
    const RayOutputs<const T> from{data_or_null(grad.alpha), data_or_null(grad.transmittance),
                                   data_or_null(grad.weight), data_or_null(grad.depth)};
    std::vector<double> inv_s_grad(static_cast<std::size_t>(n_rays));
    const RayGradients<T> to{sdf_grad.data(), cos_grad.data(), inv_s_grad.data()};
    for_tiles(n_rays, in.n_samples, kernels.lanes, num_threads,
              [&](index_t first, int n_rows) { kernels.bwd(in, found, from, first, n_rows, to); });
    double sum = 0.0; // over rays in their order, whatever the number of threads
    for (const double part : inv_s_grad) {
        sum += part;
    }
    return sum;
}

template void ray_march_fwd<float>(const RaySamples<float>&, const RayWeights<float>&, int);
template void ray_march_fwd<double>(const RaySamples<double>&, const RayWeights<double>&, int);
template double ray_march_bwd<float>(const RaySamples<float>&, std::span<const float>,
                                     std::span<const float>, const RayWeights<const float>&, int,
                                     std::span<float>, std::span<float>);
template double ray_march_bwd<double>(const RaySamples<double>&, std::span<const double>,
                                      std::span<const double>, const RayWeights<const double>&, int,
                                      std::span<double>, std::span<double>);

} // namespace geraf2
