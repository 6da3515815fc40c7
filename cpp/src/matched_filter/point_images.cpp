// SPDX-License-Identifier: Apache-2.0
// Several signals at a list of points, without blocks: what a loss compares at points drawn at
// random, which lie too far apart for them.
#include <omp.h>

#include <algorithm>
#include <vector>

#include "common/aligned_buffer.hpp"
#include "geraf2/matched_filter.hpp"
#include "matched_filter/kernels.hpp"
#include "matched_filter/plan.hpp"
#include "simd/dispatch.hpp"

namespace geraf2 {
namespace {

using detail::AlignedBuffer;
using detail::AntennaPack;
using detail::MatchedFilterKernels;
using detail::MatchedFilterPlan;
using detail::point_quantum;

/// Points that a thread takes at once; their sums of 9 signals fill 72 KiB.
constexpr index_t points_per_task = 64;

index_t padded(index_t n_points) noexcept {
    return (n_points + point_quantum - 1) / point_quantum * point_quantum;
}

/// Points `first` to `last`, the last of them repeated up to a multiple of point_quantum.
std::vector<double> padded_points(std::span<const double> points, index_t first, index_t last) {
    std::vector<double> out(static_cast<std::size_t>(3 * padded(last - first)));
    for (index_t i = 0; i < padded(last - first); ++i) {
        std::copy_n(points.data() + 3 * std::min(first + i, last - 1), 3, out.data() + 3 * i);
    }
    return out;
}

/// Memory that one thread writes; allocated before the parallel region.
template <class T>
std::vector<AlignedBuffer<T>> buffers(int n, index_t size) {
    std::vector<AlignedBuffer<T>> out;
    out.reserve(static_cast<std::size_t>(n));
    for (int i = 0; i < n; ++i) {
        out.emplace_back(size);
    }
    return out;
}

int useful_threads(int wanted, index_t pieces) noexcept {
    return static_cast<int>(std::clamp<index_t>(pieces, 1, wanted));
}

} // namespace

template <class T>
void point_images_fwd(std::span<const std::complex<T>> signals, index_t n_signals,
                      const AntennaPositions& antennas, std::span<const double> points,
                      const Waveform& waveform, int num_threads,
                      std::span<std::complex<T>> images) {
    const auto& kernels = detail::kernels_for_cpu<MatchedFilterKernels<T>>();
    const int lanes = kernels.lanes;
    const MatchedFilterPlan<T> plan(waveform, {MatchedFilterMethod::exact, 1e-3, 1});
    AntennaPack<T> pack(antennas, lanes, waveform.n_samples, num_threads, n_signals);
    pack.pack_signal(signals);
    const auto packed = pack.view();
    const auto n_points = static_cast<index_t>(points.size() / 3);
    const index_t n_tasks = (n_points + points_per_task - 1) / points_per_task;
    const int threads = useful_threads(num_threads, n_tasks);
    const index_t folded = detail::folded_vectors(plan.tables().n_pairs);
    auto scratch = buffers<T>(threads, n_signals * folded * lanes);
    auto sums = buffers<T>(threads, n_signals * points_per_task * 2 * lanes);
    auto values = buffers<T>(threads, n_signals * points_per_task * 2);
    const std::vector<double> places = padded_points(points, 0, n_points);
    const T scale = static_cast<T>(1.0 / static_cast<double>(antennas.count()));
#pragma omp parallel for num_threads(threads) schedule(dynamic)
    for (index_t task = 0; task < n_tasks; ++task) {
        const auto own = static_cast<std::size_t>(omp_get_thread_num());
        const index_t first = task * points_per_task;
        const index_t n = std::min(points_per_task, n_points - first);
        const index_t size = n_signals * padded(n) * 2;
        std::fill_n(sums[own].data(), size * lanes, T{});
        kernels.exact_fwd(plan.tables(), packed, 0, packed.n_groups, places.data() + 3 * first,
                          padded(n), scratch[own].data(), sums[own].data());
        kernels.sum_lanes(size, sums[own].data(), values[own].data());
        for (index_t s = 0; s < n_signals; ++s) {
            for (index_t i = 0; i < n; ++i) {
                const T* value = values[own].data() + 2 * (s * padded(n) + i);
                images[static_cast<std::size_t>(s * n_points + first + i)] = {scale * value[0],
                                                                              scale * value[1]};
            }
        }
    }
}

template <class T>
void point_images_bwd(std::span<const std::complex<T>> images, index_t n_signals,
                      const AntennaPositions& antennas, std::span<const double> points,
                      const Waveform& waveform, int num_threads,
                      std::span<std::complex<T>> signals) {
    const auto& kernels = detail::kernels_for_cpu<MatchedFilterKernels<T>>();
    const int lanes = kernels.lanes;
    const MatchedFilterPlan<T> plan(waveform, {MatchedFilterMethod::exact, 1e-3, 1});
    AntennaPack<T> pack(antennas, lanes, waveform.n_samples, num_threads, n_signals);
    const auto packed = pack.view();
    const auto n_points = static_cast<index_t>(points.size() / 3);
    const index_t n_padded = padded(n_points);
    const std::vector<double> places = padded_points(points, 0, n_points);
    const T scale = static_cast<T>(1.0 / static_cast<double>(antennas.count()));
    AlignedBuffer<T> values(n_signals * n_padded * 2); // zero at the padding
    for (index_t s = 0; s < n_signals; ++s) {
        for (index_t i = 0; i < n_points; ++i) {
            const std::complex<T> value = images[static_cast<std::size_t>(s * n_points + i)];
            values.data()[2 * (s * n_padded + i)] = scale * value.real();
            values.data()[2 * (s * n_padded + i) + 1] = scale * value.imag();
        }
    }
    const int threads = useful_threads(num_threads, packed.n_groups);
    const index_t folded = detail::folded_vectors(plan.tables().n_pairs);
    auto scratch = buffers<T>(threads, n_signals * folded * lanes);
    T* sums = pack.signal();
    // A group of antennas belongs to one thread and sees the points in order: no reduction.
#pragma omp parallel for num_threads(threads) schedule(dynamic)
    for (index_t group = 0; group < packed.n_groups; ++group) {
        const auto own = static_cast<std::size_t>(omp_get_thread_num());
        kernels.exact_bwd(plan.tables(), packed, group, group + 1, places.data(), n_padded,
                          values.data(), scratch[own].data(), sums);
    }
    pack.unpack_signal(signals);
}

template void point_images_fwd<float>(std::span<const std::complex<float>>, index_t,
                                      const AntennaPositions&, std::span<const double>,
                                      const Waveform&, int, std::span<std::complex<float>>);
template void point_images_fwd<double>(std::span<const std::complex<double>>, index_t,
                                       const AntennaPositions&, std::span<const double>,
                                       const Waveform&, int, std::span<std::complex<double>>);
template void point_images_bwd<float>(std::span<const std::complex<float>>, index_t,
                                      const AntennaPositions&, std::span<const double>,
                                      const Waveform&, int, std::span<std::complex<float>>);
template void point_images_bwd<double>(std::span<const std::complex<double>>, index_t,
                                       const AntennaPositions&, std::span<const double>,
                                       const Waveform&, int, std::span<std::complex<double>>);

} // namespace geraf2
