// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <cmath>
#include <complex>
#include <numbers>
#include <vector>

#include "geraf2/physical_optics.hpp"

using geraf2::EchoParams;
using geraf2::index_t;

namespace {

EchoParams make_params() {
    EchoParams params;
    params.waveform = {77.3704e9, 70.15e12, 625e3, 32, 0.15};
    params.boresight = {-1.0, 0.0, 0.0};
    return params;
}

template <class T>
std::vector<std::complex<T>> echo_of_points(const std::vector<double>& points, index_t n_antennas,
                                            int num_threads) {
    std::vector<double> tx;
    std::vector<double> rx;
    for (index_t a = 0; a < n_antennas; ++a) {
        const double y = 0.001 * static_cast<double>(a);
        tx.insert(tx.end(), {0.4, y, 0.01});
        rx.insert(rx.end(), {0.41, y, -0.03});
    }
    const std::vector<index_t> offsets{0, n_antennas / 2, n_antennas};
    const std::vector<std::complex<T>> weights(2 * points.size() / 3, T(1));
    const EchoParams params = make_params();
    std::vector<std::complex<T>> signal(static_cast<std::size_t>(n_antennas) * 32);
    geraf2::physical_optics<T>(points, {}, {}, weights, tx, rx, offsets, {}, params, signal,
                               num_threads);
    return signal;
}

} // namespace

TEST_CASE_TEMPLATE("a point echoes with the phase of its path", T, float, double) {
    const auto signal = echo_of_points<T>({0.01, 0.02, 0.03}, 19, 1);
    for (index_t a = 0; a < 19; ++a) {
        const double y = 0.001 * static_cast<double>(a) - 0.02;
        const double r_t = std::sqrt(0.39 * 0.39 + y * y + 0.02 * 0.02);
        const double r_r = std::sqrt(0.40 * 0.40 + y * y + 0.06 * 0.06);
        for (index_t t = 0; t < 32; ++t) {
            const double phase = -2.0 * std::numbers::pi * make_params().waveform.frequency_hz(t) *
                                 (r_t + r_r + 0.15) / geraf2::speed_of_light;
            const std::complex<double> expected = std::complex<double>(0.0, -1.0) *
                                                  std::polar(1.0, phase) /
                                                  (4.0 * std::numbers::pi * r_t * r_r);
            const std::complex<double> got(signal[static_cast<std::size_t>(32 * a + t)]);
            // float: the step is known to 3e-8 turns, 31 steps add up to 6e-6 rad, and as much
            // again from the products
            const double tolerance = sizeof(T) == 4 ? 2e-5 : 1e-9;
            CHECK(std::abs(got / expected - 1.0) < tolerance);
        }
    }
}

TEST_CASE_TEMPLATE("an odd number of elements adds up, with any number of threads", T, float,
                   double) {
    const std::vector<double> three{0.01, 0.02, 0.03, -0.02, 0.0, 0.01, 0.03, -0.04, 0.0};
    const auto together = echo_of_points<T>(three, 40, 4);
    std::vector<std::complex<T>> sum(together.size());
    for (std::size_t p = 0; p < 3; ++p) {
        const auto one =
            echo_of_points<T>({three[3 * p], three[3 * p + 1], three[3 * p + 2]}, 40, 1);
        for (std::size_t i = 0; i < sum.size(); ++i) {
            sum[i] += one[i];
        }
    }
    for (std::size_t i = 0; i < sum.size(); ++i) {
        CHECK(std::abs(together[i] - sum[i]) < T(2e-6));
    }
}
