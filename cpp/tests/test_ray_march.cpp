// SPDX-License-Identifier: Apache-2.0
// Ray march in both precisions: closed forms, and gradients against slopes.
#include <doctest/doctest.h>

#include <cmath>
#include <vector>

#include "geraf2/ray_march.hpp"

using namespace geraf2;

namespace {

template <class T>
struct Out {
    std::vector<T> alpha, transmittance, weight, depth;
};

template <class T>
Out<T> march(const RaySamples<T>& samples, std::size_t n_rays, int num_threads) {
    const std::size_t n = samples.sdf.size();
    Out<T> out{std::vector<T>(n), std::vector<T>(n), std::vector<T>(n), std::vector<T>(n_rays)};
    ray_march_fwd<T>(samples, {out.alpha, out.transmittance, out.weight, out.depth}, num_threads);
    return out;
}

} // namespace

TEST_CASE_TEMPLATE("a plane is seen where it is", T, float, double) {
    constexpr std::size_t n = 100;
    std::vector<T> sdf;
    const std::vector<T> cos(n, T(-1));
    const std::vector<T> step(n, T(0.01));
    for (std::size_t i = 0; i < n; ++i) {
        sdf.push_back(static_cast<T>(0.6 - (0.01 * static_cast<double>(i) + 0.005)));
    }
    for (const int power : {1, 2}) {
        const auto out = march<T>({sdf, cos, step, 200.0, n, power}, 1, 1);
        for (std::size_t i = 0; i < n; ++i) {
            const double before = 0.6 - 0.01 * static_cast<double>(i);
            const double phi = 1.0 / (1.0 + std::exp(-200.0 * before));
            CHECK(static_cast<double>(out.transmittance[i]) ==
                  doctest::Approx(std::pow(phi, power)).epsilon(1e-4));
        }
        if (power == 1) {
            CHECK(static_cast<double>(out.depth[0]) == doctest::Approx(0.6).epsilon(1e-4));
        }
    }
}

TEST_CASE("gradients are the slopes of the depth") {
    std::vector<double> sdf{0.05, 0.02, -0.004, -0.03};
    const std::vector<double> cos{-0.9, -0.5, -0.7, 0.2};
    const std::vector<double> step{0.02, 0.03, 0.02, 0.01};
    const std::vector<double> one{1.0};
    for (const int power : {1, 2}) {
        const auto out = march<double>({sdf, cos, step, 60.0, 4, power}, 1, 1);
        std::vector<double> sdf_grad(4);
        std::vector<double> cos_grad(4);
        ray_march_bwd<double>({sdf, cos, step, 60.0, 4, power}, out.alpha, out.transmittance,
                              {{}, {}, {}, one}, 1, sdf_grad, cos_grad);
        for (std::size_t i = 0; i < 4; ++i) {
            double side[2];
            for (const int sign : {0, 1}) {
                std::vector<double> moved = sdf;
                moved[i] += sign == 0 ? -1e-6 : 1e-6;
                side[sign] = march<double>({moved, cos, step, 60.0, 4, power}, 1, 1).depth[0];
            }
            CHECK(sdf_grad[i] == doctest::Approx((side[1] - side[0]) / 2e-6).epsilon(1e-6));
        }
        CHECK(cos_grad[3] == 0.0);
    }
}

TEST_CASE_TEMPLATE("many rays give the same bits with any number of threads", T, float, double) {
    constexpr std::size_t n_rays = 101;
    constexpr std::size_t n = 20 * n_rays;
    std::vector<T> sdf;
    std::vector<T> cos;
    for (std::size_t i = 0; i < n; ++i) {
        sdf.push_back(static_cast<T>(0.05 * std::sin(static_cast<double>(i))));
        cos.push_back(static_cast<T>(std::cos(3.0 * static_cast<double>(i))));
    }
    const std::vector<T> step(n, T(0.01));
    const RaySamples<T> samples{sdf, cos, step, 84.0, 20, 2};
    const auto one = march<T>(samples, n_rays, 1);
    std::vector<T> sdf_grad(n);
    std::vector<T> cos_grad(n);
    const double inv_s_grad =
        ray_march_bwd<T>(samples, one.alpha, one.transmittance, {{}, {}, one.weight, one.depth}, 1,
                         sdf_grad, cos_grad);
    for (const int threads : {2, 4}) {
        CHECK(march<T>(samples, n_rays, threads).depth == one.depth);
        std::vector<T> sdf_again(n);
        std::vector<T> cos_again(n);
        CHECK(ray_march_bwd<T>(samples, one.alpha, one.transmittance,
                               {{}, {}, one.weight, one.depth}, threads, sdf_again,
                               cos_again) == inv_s_grad);
        CHECK(sdf_again == sdf_grad);
        CHECK(cos_again == cos_grad);
    }
}
