// SPDX-License-Identifier: Apache-2.0
#include "geraf2/ray_march.hpp"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <vector>

namespace geraf2 {
namespace {

/// 1 / (1 + e^-x) without overflow.
template <class T>
T logistic(T x) noexcept {
    const T e = std::exp(-std::abs(x));
    return (x >= T(0) ? T(1) : e) / (T(1) + e);
}

/// One interval: the logistic's arguments at its ends.
template <class T>
struct Interval {
    T near; // inv_s (f - cos step / 2)
    T far;  // inv_s (f + cos step / 2)
    T drop; // near - far, without cancellation

    Interval(T sdf, T cosine, T step, T inv_s) noexcept {
        // A ray that leaves a surface (cos > 0) sees none; NaN stays.
        const T entering = cosine > T(0) ? T(0) : cosine;
        const T half = T(0.5) * entering * step;
        near = inv_s * (sdf - half);
        far = inv_s * (sdf + half);
        drop = T(-2) * inv_s * half;
    }

    /// (Phi(near) - Phi(far)) / Phi(near) = (1 - Phi(far)) (1 - e^-drop)
    [[nodiscard]] T alpha() const noexcept { return logistic(-far) * -std::expm1(-drop); }
};

} // namespace

template <class T>
void ray_march_fwd(const RaySamples<T>& samples, const RayWeights<T>& out, int num_threads) {
    const index_t n = samples.n_samples;
    const auto n_rays = static_cast<index_t>(out.depth.size());
    const T inv_s = static_cast<T>(samples.inv_s);
    assert(static_cast<index_t>(samples.sdf.size()) == n_rays * n);
#pragma omp parallel for num_threads(num_threads) schedule(static)
    for (index_t ray = 0; ray < n_rays; ++ray) {
        T one_way = T(1);
        double begin = 0.0;
        double depth = 0.0;
        for (index_t i = ray * n; i < (ray + 1) * n; ++i) {
            const auto at = static_cast<std::size_t>(i);
            const T step = samples.step[at];
            const T alpha = Interval<T>(samples.sdf[at], samples.cos[at], step, inv_s).alpha();
            const T transmittance = samples.power == 2 ? one_way * one_way : one_way;
            out.alpha[at] = alpha;
            out.transmittance[at] = transmittance;
            out.weight[at] = transmittance * alpha;
            depth +=
                static_cast<double>(out.weight[at]) * (begin + 0.5 * static_cast<double>(step));
            begin += static_cast<double>(step);
            one_way *= T(1) - alpha;
        }
        out.depth[static_cast<std::size_t>(ray)] = static_cast<T>(depth);
    }
}

template <class T>
double ray_march_bwd(const RaySamples<T>& samples, std::span<const T> alpha,
                     std::span<const T> transmittance, const RayWeights<const T>& grad,
                     int num_threads, std::span<T> sdf_grad, std::span<T> cos_grad) {
    const index_t n = samples.n_samples;
    const index_t n_rays = n == 0 ? 0 : static_cast<index_t>(alpha.size()) / n;
    const T inv_s = static_cast<T>(samples.inv_s);
    std::vector<double> inv_s_grad(static_cast<std::size_t>(n_rays), 0.0);
    const auto value = [](std::span<const T> of, std::size_t at) {
        return of.empty() ? T(0) : of[at];
    };
#pragma omp parallel for num_threads(num_threads) schedule(static)
    for (index_t ray = 0; ray < n_rays; ++ray) {
        const T depth_grad = value(grad.depth, static_cast<std::size_t>(ray));
        double end = 0.0;
        for (index_t i = ray * n; i < (ray + 1) * n; ++i) {
            end += static_cast<double>(samples.step[static_cast<std::size_t>(i)]);
        }
        double behind = 0.0; // sum over later intervals of transmittance dL/d transmittance
        double total = 0.0;
        for (index_t i = (ray + 1) * n - 1; i >= ray * n; --i) {
            const auto at = static_cast<std::size_t>(i);
            const T step = samples.step[at];
            const Interval<T> interval(samples.sdf[at], samples.cos[at], step, inv_s);
            const T middle = static_cast<T>(end - 0.5 * static_cast<double>(step));
            end -= static_cast<double>(step);
            const T weight_grad = value(grad.weight, at) + depth_grad * middle;
            const T alpha_grad = value(grad.alpha, at) + weight_grad * transmittance[at];
            // To log(1 - alpha), which stays finite where alpha reaches one.
            const T log_grad =
                static_cast<T>(samples.power * behind) - (T(1) - alpha[at]) * alpha_grad;
            behind += static_cast<double>(
                transmittance[at] * (value(grad.transmittance, at) + weight_grad * alpha[at]));
            // log(1 - alpha) = log Phi(far) - log Phi(near)
            const T near_grad = -log_grad * logistic(-interval.near);
            const T far_grad = log_grad * logistic(-interval.far);
            sdf_grad[at] = inv_s * (near_grad + far_grad);
            const T entering = samples.cos[at] > T(0) ? T(0) : T(0.5) * inv_s * step;
            cos_grad[at] = entering * (far_grad - near_grad);
            total +=
                static_cast<double>((near_grad * interval.near + far_grad * interval.far) / inv_s);
        }
        inv_s_grad[static_cast<std::size_t>(ray)] = total;
    }
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
