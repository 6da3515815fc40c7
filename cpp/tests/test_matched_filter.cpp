// SPDX-License-Identifier: Apache-2.0
// Matched filter in both precisions: against the plain double sum, adjointness, threads.
#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <limits>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "geraf2/matched_filter.hpp"
#include "geraf2/simd.hpp"
#include "matched_filter/point_blocks.hpp"

using namespace geraf2;

namespace {

template <class T>
struct Case {
    Waveform waveform{77.3704e9, 70.15e12, 1.25e6, 0, 0.15};
    std::vector<double> tx, rx, points;
    std::vector<std::complex<T>> signal;

    Case(index_t n_antennas, index_t n_samples, index_t n_points) {
        waveform.n_samples = n_samples;
        std::mt19937_64 random(3);
        std::uniform_real_distribution<double> uniform(-1.0, 1.0);
        for (index_t i = 0; i < n_antennas; ++i) {
            tx.insert(tx.end(), {-0.36, 0.07 * uniform(random), 0.1 * uniform(random)});
            rx.insert(rx.end(), {-0.35, 0.07 * uniform(random), 0.1 * uniform(random)});
        }
        for (index_t i = 0; i < 3 * n_points; ++i) {
            points.push_back(0.015 * uniform(random));
        }
        signal = noise(n_antennas * n_samples, 4);
    }

    static std::vector<std::complex<T>> noise(index_t n, unsigned seed) {
        std::mt19937_64 random(seed);
        std::normal_distribution<double> normal;
        std::vector<std::complex<T>> out;
        for (index_t i = 0; i < n; ++i) {
            out.emplace_back(static_cast<T>(normal(random)), static_cast<T>(normal(random)));
        }
        return out;
    }

    [[nodiscard]] AntennaPositions antennas() const { return {tx, rx}; }
    [[nodiscard]] std::size_t n_points() const { return points.size() / 3; }

    [[nodiscard]] std::vector<std::complex<T>> image(const MatchedFilterOptions& options) const {
        std::vector<std::complex<T>> out(n_points());
        matched_filter_fwd<T>(signal, antennas(), std::span<const double>(points), waveform,
                              options, out);
        return out;
    }
};

double distance(const double* a, const double* b) {
    return std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}

template <class T>
std::vector<std::complex<T>> direct_sum(const Case<T>& c) {
    std::vector<std::complex<T>> out;
    const std::size_t n_antennas = c.tx.size() / 3;
    for (std::size_t point = 0; point < c.n_points(); ++point) {
        std::complex<double> sum;
        for (std::size_t i = 0; i < n_antennas; ++i) {
            const double* x = c.points.data() + 3 * point;
            const double path = distance(x, c.tx.data() + 3 * i) +
                                distance(x, c.rx.data() + 3 * i) + c.waveform.path_bias_m;
            for (index_t t = 0; t < c.waveform.n_samples; ++t) {
                const double phase = -phase_sign * 2.0 * 3.14159265358979323846 *
                                     c.waveform.frequency_hz(t) * path / speed_of_light;
                const auto at = i * static_cast<std::size_t>(c.waveform.n_samples) +
                                static_cast<std::size_t>(t);
                sum += std::complex<double>(c.signal[at]) * std::polar(1.0, phase);
            }
        }
        out.emplace_back(sum / static_cast<double>(n_antennas));
    }
    return out;
}

template <class T>
double relative_error(const std::vector<std::complex<T>>& got,
                      const std::vector<std::complex<T>>& want) {
    double difference = 0.0;
    double norm = 0.0;
    for (std::size_t i = 0; i < want.size(); ++i) {
        difference += std::norm(std::complex<double>(got[i] - want[i]));
        norm += std::norm(std::complex<double>(want[i]));
    }
    return std::sqrt(difference / norm);
}

template <class T>
std::complex<double> dot(const std::vector<std::complex<T>>& a,
                         const std::vector<std::complex<T>>& b) {
    std::complex<double> sum;
    for (std::size_t i = 0; i < a.size(); ++i) {
        sum += std::conj(std::complex<double>(a[i])) * std::complex<double>(b[i]);
    }
    return sum;
}

} // namespace

TEST_CASE_TEMPLATE("image is the direct sum", T, float, double) {
    for (const index_t n_samples : {1, 15, 16, 150}) {
        const Case<T> c(21, n_samples, 90);
        const auto want = direct_sum(c);
        // Ten roundings of the phase; in double those of 2e3 rad of reference phase.
        const double rounding = sizeof(T) == 4 ? 1e-5 : 1e-11;
        CHECK(relative_error(c.image({MatchedFilterMethod::exact, 1e-3, 1}), want) < rounding);
        CHECK(relative_error(c.image({MatchedFilterMethod::block, 1e-3, 1}), want) < 1e-3);
        CHECK(relative_error(c.image({MatchedFilterMethod::block, 1e-5, 1}), want) < 1e-5);
        CHECK(relative_error(c.image({MatchedFilterMethod::automatic, 1e-3, 1}), want) < 1e-3);
    }
}

TEST_CASE_TEMPLATE("backward is the adjoint of forward", T, float, double) {
    const Case<T> c(21, 16, 90);
    const auto y = Case<T>::noise(90, 9);
    for (const auto method : {MatchedFilterMethod::exact, MatchedFilterMethod::block}) {
        const MatchedFilterOptions options{method, 1e-3, 2};
        const auto image = c.image(options);
        std::vector<std::complex<T>> back(c.signal.size());
        matched_filter_bwd_signal<T>(y, c.antennas(), std::span<const double>(c.points), c.waveform,
                                     options, back);
        // Both sides round their products by up to 100 ulp; 90 points share the error's root.
        const double scale = std::sqrt(dot(image, image).real() * dot(y, y).real());
        const double eps = static_cast<double>(std::numeric_limits<T>::epsilon());
        CHECK(std::abs(dot(y, image) - dot(back, c.signal)) < 20.0 * eps * scale);
    }
}

TEST_CASE_TEMPLATE("gradient to a position is the slope of the image", T, float, double) {
    Case<T> c(5, 16, 4);
    const auto y = Case<T>::noise(4, 9);
    std::vector<double> tx_grad(c.tx.size());
    std::vector<double> points_grad(c.points.size());
    matched_filter_bwd_positions<T>(y, c.signal, c.antennas(), std::span<const double>(c.points),
                                    c.waveform, 1, {tx_grad, {}, points_grad});
    const Case<double> twin(5, 16, 4);
    const auto slope = [&](std::vector<double> Case<double>::* which, std::size_t at) {
        double side[2];
        for (const int sign : {0, 1}) {
            Case<double> moved = twin;
            std::transform(c.signal.begin(), c.signal.end(), moved.signal.begin(),
                           [](const auto& s) { return std::complex<double>(s); });
            (moved.*which)[at] += sign == 0 ? -1e-7 : 1e-7;
            const std::vector<std::complex<double>> weight(y.begin(), y.end());
            side[sign] = dot(weight, direct_sum(moved)).real();
        }
        return (side[1] - side[0]) / 2e-7;
    };
    const double tolerance = sizeof(T) == 4 ? 1e-4 : 1e-6;
    for (const std::size_t at : {0U, 4U, 11U}) {
        CHECK(points_grad[at] ==
              doctest::Approx(slope(&Case<double>::points, at)).epsilon(tolerance));
        CHECK(tx_grad[at] == doctest::Approx(slope(&Case<double>::tx, at)).epsilon(tolerance));
    }
}

TEST_CASE_TEMPLATE("calls may run side by side, with any number of threads", T, float, double) {
    const Case<T> c(70, 16, 300);
    const auto want = c.image({MatchedFilterMethod::automatic, 1e-3, 1});
    std::vector<std::complex<T>> found[2];
    std::thread other([&] { found[0] = c.image({MatchedFilterMethod::automatic, 1e-3, 2}); });
    found[1] = c.image({MatchedFilterMethod::automatic, 1e-3, 3});
    other.join();
    CHECK(found[0] == want);
    CHECK(found[1] == want);
}

TEST_CASE("blocks of points cover every point once and stay within their radius") {
    const Case<float> c(1, 1, 3000);
    const VoxelGrid grid{{0.0, -0.1, 0.2}, 0.002, {13, 1, 22}};
    // an extent whose inverse overflows
    const std::array<double, 6> close{0.0, 0.0, 0.3, 5e-324, 0.0, 0.3};
    const std::array<PointSet, 3> sets{std::span<const double>(c.points), grid,
                                       std::span<const double>(close)};
    for (const PointSet& points : sets) {
        for (const double radius : {0.0, 0.0005, 0.008}) {
            const detail::PointBlocks blocks(points, {radius, 3});
            detail::BlockPoints block;
            std::vector<int> seen(static_cast<std::size_t>(blocks.n_points()), 0);
            const double* memory = block.positions.data();
            for (index_t b = 0; b < blocks.n_blocks(); ++b) {
                blocks.fetch(b, block);
                CHECK(block.n_points() > 0);
                CHECK((block.exact || block.radius <= radius));
                for (index_t i = 0; i < block.n_points(); ++i) {
                    ++seen[static_cast<std::size_t>(block.index[static_cast<std::size_t>(i)])];
                    CHECK(distance(block.positions.data() + 3 * i, block.center) <=
                          block.radius * (1.0 + 1e-12) + 1e-300);
                }
            }
            CHECK(block.positions.data() == memory); // no allocation in a parallel region
            CHECK(std::all_of(seen.begin(), seen.end(), [](int n) { return n == 1; }));
        }
    }
}

TEST_CASE("names of the instruction sets") {
    CHECK(std::string(simd_level_name(SimdLevel::baseline)) == "baseline");
    CHECK(simd_level() >= SimdLevel::baseline);
}
