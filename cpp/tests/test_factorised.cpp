// SPDX-License-Identifier: Apache-2.0
// Factorised matched filter: clusters, nodes and their error bound, image and adjoint.
#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <random>
#include <stdexcept>
#include <vector>

#include "geraf2/matched_filter.hpp"
#include "matched_filter/factorised/antenna_clusters.hpp"
#include "matched_filter/factorised/interpolation_nodes.hpp"
#include "matched_filter/factorised/plan.hpp"

using namespace geraf2;

namespace {

template <class T>
struct Scan {
    Waveform waveform{77.3704e9, 70.15e12, 1.25e6, 9, 0.15};
    std::vector<double> tx, rx;
    std::vector<std::complex<T>> signal;
    VoxelGrid grid{{-0.02, -0.013, -0.017}, 2e-3, {17, 10, 14}};

    explicit Scan(index_t n_antennas) {
        std::mt19937_64 random(3);
        std::uniform_real_distribution<double> uniform(-1.0, 1.0);
        for (index_t i = 0; i < n_antennas; ++i) {
            tx.insert(tx.end(), {-0.36, 0.07 * uniform(random), 0.1 * uniform(random)});
            rx.insert(rx.end(), {-0.35, 0.07 * uniform(random), 0.1 * uniform(random)});
        }
        signal = noise(n_antennas * waveform.n_samples, 4);
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

    [[nodiscard]] index_t n_voxels() const { return grid.shape[0] * grid.shape[1] * grid.shape[2]; }
    [[nodiscard]] std::vector<std::complex<T>> image(const MatchedFilterOptions& options) const {
        std::vector<std::complex<T>> out(static_cast<std::size_t>(n_voxels()));
        matched_filter_fwd<T>(signal, {tx, rx}, grid, waveform, options, out);
        return out;
    }
};

MatchedFilterOptions factorised(double rtol, int levels, int num_threads) {
    MatchedFilterOptions options{MatchedFilterMethod::factorised, rtol, num_threads};
    options.levels = levels;
    return options;
}

template <class T>
double difference(const std::vector<std::complex<T>>& a, const std::vector<std::complex<T>>& b) {
    double square = 0.0;
    double norm = 0.0;
    for (std::size_t i = 0; i < a.size(); ++i) {
        square += static_cast<double>(std::norm(a[i] - b[i]));
        norm += static_cast<double>(std::norm(b[i]));
    }
    return std::sqrt(square / norm);
}

template <class T>
std::complex<double> dot(const std::vector<std::complex<T>>& a,
                         const std::vector<std::complex<T>>& b) {
    std::complex<double> sum = 0.0;
    for (std::size_t i = 0; i < a.size(); ++i) {
        sum += std::conj(std::complex<double>(a[i])) * std::complex<double>(b[i]);
    }
    return sum;
}

} // namespace

TEST_CASE("clusters hold every antenna once, at any number of lanes") {
    for (const index_t n : {1, 5, 16, 37, 1000}) {
        const Scan<float> scan(n);
        const detail::AntennaClusters clusters({scan.tx, scan.rx}, 32, 3);
        for (const int lanes : {2, 4, 8, 16}) {
            std::vector<index_t> slots = clusters.slots(0, 32, lanes);
            CHECK(static_cast<index_t>(slots.size()) == 32 * 3 * clusters.capacity());
            std::erase_if(slots, [](index_t i) { return i < 0; });
            std::sort(slots.begin(), slots.end());
            REQUIRE(static_cast<index_t>(slots.size()) == n);
            CHECK(slots.front() == 0);
            CHECK(slots.back() == n - 1);
            CHECK(std::adjacent_find(slots.begin(), slots.end()) == slots.end());
        }
    }
}

TEST_CASE("as many nodes as needed keep a phasor within the limit, and not many more") {
    for (const double limit : {1e-2, 1e-4, 1e-9}) {
        for (const double omega : {0.0, 0.3, 1.5, 4.0}) {
            for (const double q : {0.0, 0.05, 0.3}) {
                const index_t n = detail::nodes_needed(omega / 0.02, 4.0 * q / 4e-4, 0.02, limit);
                REQUIRE(n > 0);
                const auto phasor = [&](double s) {
                    return std::polar(1.0, omega * s + q * (2.0 * s * s - 1.0));
                };
                const auto error = [&](index_t count) {
                    std::vector<double> weights(static_cast<std::size_t>(count));
                    double worst = 0.0;
                    for (double s = -1.0; s <= 1.0; s += 0.01) {
                        detail::lagrange_weights(count, s, weights.data());
                        std::complex<double> sum = 0.0;
                        for (index_t k = 0; k < count; ++k) {
                            sum += weights[static_cast<std::size_t>(k)] *
                                   phasor(detail::chebyshev_node(k, count));
                        }
                        worst = std::max(worst, std::abs(sum - phasor(s)));
                    }
                    return worst;
                };
                CHECK(error(n) <= limit + 1e-14);
                if (n > 3) {
                    CHECK(error(n - 3) > limit);
                }
            }
        }
    }
    CHECK(detail::nodes_needed(1e5, 0.0, 1.0, 1e-3) == 0);
    CHECK(detail::nodes_needed(std::nan(""), 0.0, 1.0, 1e-3) == 0);
}

TEST_CASE_TEMPLATE("image is that of the exact method", T, float, double) {
    for (const index_t n : {1, 50, 1700}) {
        const Scan<T> scan(n);
        const auto exact = scan.image({MatchedFilterMethod::exact, 1e-3, 1});
        for (const int levels : {1, 2}) {
            CHECK(difference(scan.image(factorised(1e-3, levels, 1)), exact) < 3e-4);
            CHECK(difference(scan.image(factorised(1e-5, levels, 1)), exact) < 5e-6);
        }
    }
}

TEST_CASE("a small enough rtol reaches double precision") {
    const Scan<double> scan(400);
    const auto exact = scan.image({MatchedFilterMethod::exact, 1e-3, 1});
    CHECK(difference(scan.image(factorised(1e-10, 2, 1)), exact) < 1e-10);
}

TEST_CASE_TEMPLATE("adjoint, and the same bits for any number of threads", T, float, double) {
    for (const index_t n : {50, 1700}) {
        const Scan<T> scan(n);
        const auto values = Scan<T>::noise(scan.n_voxels(), 5);
        const auto image = scan.image(factorised(1e-3, 2, 1));
        CHECK(image == scan.image(factorised(1e-3, 2, 3)));
        std::vector<std::complex<T>> signal(scan.signal.size());
        std::vector<std::complex<T>> other(scan.signal.size());
        matched_filter_bwd_signal<T>(values, {scan.tx, scan.rx}, scan.grid, scan.waveform,
                                     factorised(1e-3, 2, 1), signal);
        matched_filter_bwd_signal<T>(values, {scan.tx, scan.rx}, scan.grid, scan.waveform,
                                     factorised(1e-3, 2, 3), other);
        CHECK(signal == other);
        const auto lhs = dot(values, image);
        const auto rhs = dot(signal, scan.signal);
        const double scale = std::sqrt(dot(values, values).real() * dot(image, image).real());
        CHECK(std::abs(lhs - rhs) <=
              20 * static_cast<double>(std::numeric_limits<T>::epsilon()) * scale);
    }
}

TEST_CASE("the plan cuts a grid into boxes, each voxel once") {
    Scan<float> scan(300);
    scan.grid = {{-0.45, -0.05, -0.05}, 2e-3, {240, 45, 51}};
    const detail::FactorisedPlan<float> plan({scan.tx, scan.rx}, scan.grid, scan.waveform,
                                             factorised(1e-3, 2, 1));
    std::vector<int> seen(static_cast<std::size_t>(scan.n_voxels()));
    for (const detail::BoxPlan& box : plan.boxes()) {
        for (index_t x = 0; x < box.count[0]; ++x) {
            for (index_t y = 0; y < box.count[1]; ++y) {
                for (index_t z = 0; z < box.count[2]; ++z) {
                    const index_t row = (box.first[0] + x) * 45 + box.first[1] + y;
                    ++seen[static_cast<std::size_t>(row * 51 + box.first[2] + z)];
                }
            }
        }
    }
    CHECK(std::all_of(seen.begin(), seen.end(), [](int n) { return n == 1; }));
    CHECK(plan.block_share() > 0.0); // the antennas are in the grid
    CHECK(plan.block_share() < 0.9);
}

TEST_CASE("hostile geometry gives a result or an error") {
    const Scan<float> scan(20);
    std::vector<std::complex<float>> image(static_cast<std::size_t>(scan.n_voxels()));
    for (const double value : {0.0, 1e300, -1e-310, std::nan(""), HUGE_VAL}) {
        std::vector<double> tx = scan.tx;
        tx[4] = value;
        matched_filter_fwd<float>(scan.signal, {tx, scan.rx}, scan.grid, scan.waveform,
                                  factorised(1e-3, 2, 2), image);
        matched_filter_fwd<float>(scan.signal, {tx, tx}, scan.grid, scan.waveform,
                                  factorised(1e-3, 1, 2), image);
    }
    const std::vector<double> points{0.0, 0.0, 0.0};
    image.resize(1);
    CHECK_THROWS_AS(matched_filter_fwd<float>(scan.signal, {scan.tx, scan.rx},
                                              std::span<const double>(points), scan.waveform,
                                              factorised(1e-3, 2, 1), image),
                    std::invalid_argument);
}
