// SPDX-License-Identifier: Apache-2.0
// The n-th allocation of a kernel fails, for all n up to the end of a small call: std::bad_alloc
// leaves it, whatever the thread, and the next call gives the bits of one without a fault.
#include <doctest/doctest.h>

#include <cmath>
#include <complex>
#include <cstdlib>
#include <new>
#include <vector>

#include "failing_allocations.hpp"
#include "geraf2/grid_energy.hpp"
#include "geraf2/lensless.hpp"
#include "geraf2/matched_filter.hpp"
#include "geraf2/physical_optics.hpp"
#include "geraf2/signal_tracer.hpp"
#include "geraf2/subaperture.hpp"

namespace {

void count_allocation() {
    if (faults.after.load() >= 0 && faults.after.fetch_sub(1) == 0) {
        faults.met = true;
        throw std::bad_alloc();
    }
}

void* checked(void* memory) {
    if (memory == nullptr) {
        throw std::bad_alloc();
    }
    return memory;
}

} // namespace

// Those of arrays, of sizes and without exceptions call these four.
void* operator new(std::size_t size) {
    count_allocation();
    return checked(std::malloc(size == 0 ? 1 : size));
}

void* operator new(std::size_t size, std::align_val_t alignment) {
    count_allocation();
    const auto step = static_cast<std::size_t>(alignment);
    return checked(std::aligned_alloc(step, (size + step - 1) / step * step + (size == 0) * step));
}

void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t /*size*/) noexcept { std::free(memory); }
void operator delete(void* memory, std::align_val_t /*alignment*/) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t /*size*/, std::align_val_t /*alignment*/) noexcept {
    std::free(memory);
}

namespace {

using geraf2::index_t;
using Complex = std::complex<float>;

std::vector<double> wave(std::size_t n, double scale, double turn) {
    std::vector<double> out(n);
    for (std::size_t i = 0; i < n; ++i) {
        out[i] = scale * std::sin(turn * static_cast<double>(i + 1));
    }
    return out;
}

/// Antennas before a few points, with a signal.
struct Scan {
    geraf2::Waveform waveform{77.3704e9, 70.15e12, 1.25e6, 8, 0.15};
    std::vector<double> tx = wave(3 * n_antennas, 0.08, 1.7), rx = wave(3 * n_antennas, 0.08, 2.3);
    std::vector<double> points = wave(3 * n_points, 0.02, 0.7);
    std::vector<Complex> signal = std::vector<Complex>(8 * n_antennas, Complex(1.0F, 0.5F));
    geraf2::VoxelGrid grid{{-0.01, -0.01, -0.01}, 0.002, {10, 10, 10}};
    static constexpr std::size_t n_antennas = 40;
    static constexpr std::size_t n_points = 300;

    Scan() {
        for (std::size_t i = 0; i < n_antennas; ++i) {
            tx[3 * i] = -0.36;
            rx[3 * i] = -0.35;
        }
    }
    [[nodiscard]] geraf2::AntennaPositions antennas() const { return {tx, rx}; }
};

geraf2::MatchedFilterOptions options(geraf2::MatchedFilterMethod method, int num_threads) {
    geraf2::MatchedFilterOptions out;
    out.method = method;
    out.num_threads = num_threads;
    return out;
}

} // namespace

TEST_CASE("each allocation of a matched filter fails once") {
    const Scan scan;
    using Method = geraf2::MatchedFilterMethod;
    const int threads = 3;
    for (const auto method : {Method::exact, Method::block, Method::factorised}) {
        const auto choice = options(method, threads);
        const long of_image = fail_each_allocation([&] {
            std::vector<Complex> image(1000);
            geraf2::matched_filter_fwd<float>(scan.signal, scan.antennas(), scan.grid,
                                              scan.waveform, choice, image);
            return image;
        });
        CHECK(of_image > 5);
        const std::vector<Complex> image(1000, Complex(0.5F, -1.0F));
        CHECK(fail_each_allocation([&] {
                  std::vector<Complex> signal(scan.signal.size());
                  geraf2::matched_filter_bwd_signal<float>(image, scan.antennas(), scan.grid,
                                                           scan.waveform, choice, signal);
                  return signal;
              }) > 5);
    }
    CHECK(fail_each_allocation([&] {
              std::vector<Complex> image(Scan::n_points);
              geraf2::matched_filter_fwd<float>(scan.signal, scan.antennas(),
                                                std::span<const double>(scan.points), scan.waveform,
                                                options(Method::automatic, threads), image);
              return image;
          }) > 5);
    CHECK(fail_each_allocation([&] {
              std::vector<double> tx(scan.tx.size());
              std::vector<double> at(scan.points.size());
              geraf2::matched_filter_bwd_positions<float>(
                  std::vector<Complex>(Scan::n_points, Complex(1.0F)), scan.signal, scan.antennas(),
                  std::span<const double>(scan.points), scan.waveform, threads, {tx, {}, at});
              tx.insert(tx.end(), at.begin(), at.end());
              return tx;
          }) > 5);
    CHECK(fail_each_allocation([&] {
              std::vector<Complex> image(Scan::n_points);
              geraf2::point_images_fwd<float>(scan.signal, 1, scan.antennas(), scan.points,
                                              scan.waveform, threads, image);
              return image;
          }) > 5);
}

TEST_CASE("each allocation of a signal tracer fails once") {
    const Scan scan;
    std::vector<float> normals(scan.points.size(), 0.0F);
    for (std::size_t i = 0; i < normals.size(); i += 3) {
        normals[i] = -1.0F;
    }
    for (const int threads : {1, 3}) {
        for (const index_t rows : {index_t{1}, static_cast<index_t>(Scan::n_antennas)}) {
            const std::vector<float> amplitude(static_cast<std::size_t>(rows) * Scan::n_points,
                                               1.0F);
            const geraf2::Reflectors<float> all{scan.points, normals, amplitude, rows, 1};
            CHECK(fail_each_allocation([&] {
                      std::vector<Complex> signal(scan.signal.size());
                      geraf2::signal_tracer_fwd<float>(all, scan.antennas(), scan.waveform,
                                                       {1e-3, threads}, signal);
                      return signal;
                  }) > 5);
            CHECK(fail_each_allocation([&] {
                      std::vector<float> grad(amplitude.size());
                      std::vector<double> tx(scan.tx.size());
                      geraf2::signal_tracer_bwd<float>(scan.signal, all, scan.antennas(),
                                                       scan.waveform, {1e-3, threads},
                                                       {grad, {}, {}, tx, {}});
                      tx.insert(tx.end(), grad.begin(), grad.end());
                      return tx;
                  }) > 5);
        }
        const std::vector<float> amplitude(Scan::n_points, 1.0F);
        const std::vector<index_t> reflectors{0, 100, 300};
        const std::vector<index_t> groups{0, 40};
        std::vector<index_t> order(Scan::n_antennas);
        for (std::size_t i = 0; i < order.size(); ++i) {
            order[i] = static_cast<index_t>(i);
        }
        CHECK(fail_each_allocation([&] {
                  std::vector<Complex> signal(2 * scan.signal.size());
                  geraf2::trace_parts_fwd<float>({scan.points, normals, amplitude, 1, 1},
                                                 scan.antennas(), {reflectors, order, groups, 2},
                                                 scan.waveform, {1e-3, threads}, signal);
                  return signal;
              }) > 10);
    }
}

TEST_CASE("each allocation of sub-apertures and their peaks fails once") {
    const Scan scan;
    const geraf2::SubapertureBins bins{
        {9, -0.2, 0.05, false}, {9, -0.2, 0.05, false}, {9, 0.3, 0.02}};
    const geraf2::SubapertureLattice lattice{32, 32, 0.006, 0.006, 8, 6.4};
    std::vector<index_t> antennas(Scan::n_antennas);
    std::vector<double> places;
    for (std::size_t i = 0; i < antennas.size(); ++i) {
        antennas[i] = static_cast<index_t>(i);
        places.insert(places.end(), {scan.tx[3 * i + 1], scan.tx[3 * i + 2]});
    }
    const std::vector<index_t> offsets{0, 20, 40};
    const std::vector<double> weights(Scan::n_antennas, 0.05);
    const std::vector<double> focus(6, 0.0);
    const std::vector<double> focus_range(2, 0.36);
    const geraf2::SubapertureMembers members{offsets, antennas, weights,
                                             places,  focus,    focus_range};
    for (const int threads : {1, 2}) {
        CHECK(fail_each_allocation([&] {
                  return geraf2::subaperture_peaks<float>(scan.signal, scan.tx, scan.rx,
                                                          scan.waveform, members, lattice, bins,
                                                          {0.1, 0.0}, threads)
                      .magnitudes;
              }) > 10);
        CHECK(fail_each_allocation([&] {
                  std::vector<float> image(2 * 729);
                  geraf2::subaperture_images<float>(scan.signal, scan.tx, scan.rx, scan.waveform,
                                                    members, lattice, bins, threads, image);
                  return image;
              }) > 5);
    }
}

TEST_CASE("each allocation of physical optics fails once") {
    const Scan scan;
    geraf2::EchoParams params;
    params.waveform = scan.waveform;
    params.boresight = {1.0, 0.0, 0.0};
    const std::vector<index_t> blocks{0, 20, 40};
    const std::vector<Complex> weights(2 * Scan::n_points, Complex(1.0F));
    const std::vector<geraf2::DielectricBox> walls{{{}, {0.1, 0.1, 0.1}, 0.004, 1.6}};
    for (const int threads : {1, 2}) {
        CHECK(fail_each_allocation([&] {
                  std::vector<Complex> signal(scan.signal.size());
                  geraf2::physical_optics<float>(scan.points, {}, {}, weights, scan.tx, scan.rx,
                                                 blocks, walls, params, signal, threads);
                  return signal;
              }) > 1);
    }
}

TEST_CASE("each allocation of a grid energy fails once") {
    const std::vector<index_t> rows{3};
    const std::vector<index_t> starts{0, 1};
    const std::vector<std::int32_t> columns{3};
    const std::vector<double> values{2.0};
    const std::vector<float> field(210, 1.0F);
    for (const int threads : {1, 3}) {
        CHECK(fail_each_allocation([&] {
                  const geraf2::GridEnergy<float> energy({{5, 6, 7}, {0.5, 0.4, 0.3}}, 0.7,
                                                         {rows, starts, columns, values},
                                                         std::vector<double>(210, 0.1));
                  std::vector<float> product(210);
                  energy.apply(field, product, threads);
                  energy.smooth(field, {3, 0.3, 5.0}, threads, product);
                  return product;
              }) > 5);
    }
}

TEST_CASE("each allocation of facing samples fails once") {
    const std::vector<float> alpha(60, 0.5F);
    const std::vector<float> gradient(180, -1.0F);
    const std::vector<double> points = wave(180, 0.02, 0.7);
    const std::vector<double> centers{-0.3, 0.0, 0.0, 0.0, -0.3, 0.0};
    CHECK(fail_each_allocation([&] {
              return geraf2::facing_samples<float>({alpha, alpha, gradient, points},
                                                   {centers, {}, 1.0, 1}, 6, 3, 2)
                  .sample;
          }) >= 4);
}
