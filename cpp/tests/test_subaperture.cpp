// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include <cmath>
#include <complex>
#include <numbers>
#include <vector>

#include "geraf2/subaperture.hpp"

using geraf2::index_t;

namespace {

/// A point straight ahead of a square raster, seen by one sub-aperture.
template <class T>
struct Setup {
    geraf2::Waveform waveform{77.3704e9, 70.15e12, 625e3, 32, 0.15};
    geraf2::SubapertureBins bins{
        {21, -0.2, 0.02, false}, {19, -0.18, 0.02, false}, {9, 0.32, 0.02}};
    geraf2::SubapertureLattice lattice{11, 11, 0.003, 0.003, 1, 0.0};
    std::vector<double> positions, weights, places;
    std::vector<index_t> offsets{0, 121}, antennas;
    std::vector<double> focus{0.4, 0.0, 0.0}, focus_range{0.4};
    std::vector<std::complex<T>> signal;

    Setup() {
        for (index_t i = 0; i < 121; ++i) {
            const double y = 0.003 * (static_cast<double>(i / 11) - 5.0);
            const double z = 0.003 * (static_cast<double>(i % 11) - 5.0);
            positions.insert(positions.end(), {0.0, y, z});
            places.insert(places.end(), {y, z});
            weights.push_back(1.0 / 121.0);
            antennas.push_back(i);
            const double path = 2.0 * std::hypot(0.4, y, z) + 0.15;
            for (index_t t = 0; t < 32; ++t) {
                const double phase = -2.0 * std::numbers::pi * waveform.frequency_hz(t) * path /
                                     geraf2::speed_of_light;
                signal.emplace_back(std::polar(1.0, phase));
            }
        }
    }

    [[nodiscard]] geraf2::SubapertureMembers members() const {
        return {offsets, antennas, weights, places, focus, focus_range};
    }

    [[nodiscard]] std::vector<T> image(int num_threads) const {
        std::vector<T> out(static_cast<std::size_t>(bins.size()));
        geraf2::subaperture_images<T>(signal, positions, positions, waveform, members(), lattice,
                                      bins, num_threads, out);
        return out;
    }
};

} // namespace

TEST_CASE_TEMPLATE("a point ahead has magnitude one in its bin", T, float, double) {
    const Setup<T> setup;
    const auto image = setup.image(1);
    const double tolerance = sizeof(T) == 4 ? 1e-5 : 1e-12;
    CHECK(std::abs(static_cast<double>(image[(10 * 19 + 9) * 9 + 4]) - 1.0) < tolerance);
    for (const T value : image) {
        CHECK(static_cast<double>(value) < 1.0 + tolerance);
    }
}

TEST_CASE_TEMPLATE("the peak of a point is where the point is", T, float, double) {
    const Setup<T> setup;
    const auto peaks =
        geraf2::subaperture_peaks<T>(setup.signal, setup.positions, setup.positions, setup.waveform,
                                     setup.members(), setup.lattice, setup.bins, {0.5, 0.0}, 2);
    REQUIRE(peaks.ranges_m.size() == 1);
    const double tolerance = sizeof(T) == 4 ? 1e-4 : 1e-9;
    CHECK(std::abs(peaks.cosines[0]) < tolerance);
    CHECK(std::abs(peaks.cosines[1]) < tolerance);
    CHECK(std::abs(peaks.ranges_m[0] - 0.4) < 1e-4);
    CHECK(peaks.tops[0] == doctest::Approx(peaks.magnitudes[0]));
}

TEST_CASE_TEMPLATE("spread over a finer lattice the image is the same", T, float, double) {
    Setup<T> setup;
    const auto expected = setup.image(1);
    // 3.84 mm wavelength, cosines up to 0.2, oversampled 1.5 times
    setup.lattice = {21, 21, 0.0032, 0.0032, 8, 0.976 * std::numbers::pi * 8.0 * 2.0 / 3.0};
    const auto image = setup.image(3);
    for (std::size_t i = 0; i < image.size(); ++i) {
        CHECK(std::abs(static_cast<double>(image[i] - expected[i])) < 2e-6);
    }
}

TEST_CASE("the vertical axis of one bin and one range make no peak") {
    Setup<double> setup;
    setup.bins = {{1, 0.0, 0.02, false}, {1, 0.0, 0.02, false}, {1, 0.4, 0.02}};
    CHECK(setup.image(1)[0] == doctest::Approx(1.0));
    const auto peaks = geraf2::subaperture_peaks<double>(
        setup.signal, setup.positions, setup.positions, setup.waveform, setup.members(),
        setup.lattice, setup.bins, {0.5, 0.0}, 1);
    CHECK(peaks.ranges_m.empty());
}
