// SPDX-License-Identifier: Apache-2.0
#include "geraf2/matched_filter.hpp"

#include <omp.h>

#include <algorithm>
#include <cassert>
#include <functional>
#include <memory>
#include <stdexcept>
#include <utility>
#include <vector>

#include "common/aligned_buffer.hpp"
#include "matched_filter/factorised/factorised.hpp"
#include "matched_filter/kernels.hpp"
#include "matched_filter/plan.hpp"
#include "matched_filter/point_blocks.hpp"
#include "simd/dispatch.hpp"

namespace geraf2 {
namespace {

using detail::AlignedBuffer;
using detail::AntennaPack;
using detail::BlockPoints;
using detail::groups_per_tile;
using detail::max_block_points;
using detail::PointBlock;
using detail::PointBlocks;
using detail::WaveformPlan;

/// Everything that one thread writes while it works; allocated before the parallel region, so
/// that nothing in there can throw.
template <class T>
struct Workspace {
    BlockPoints points;
    AlignedBuffer<T> offsets{4 * max_block_points};
    AlignedBuffer<T> values{2 * max_block_points}; // image or its gradient at the points
    AlignedBuffer<T> scratch;
    AlignedBuffer<T> sums; // per point and lane

    Workspace(int lanes, index_t n_pairs, index_t sums_per_point)
        : scratch(detail::scratch_vectors(n_pairs) * lanes),
          sums(sums_per_point * max_block_points * lanes) {}

    /// Fetches a block and returns its points for the block kernels.
    PointBlock<T> fetch(const PointBlocks& blocks, index_t block) noexcept {
        blocks.fetch(block, points);
        PointBlock<T> out;
        std::copy_n(points.center, 3, out.center);
        out.radius = points.radius;
        out.n_points = points.n_padded();
        out.offsets = offsets.data();
        for (index_t i = 0; i < out.n_points; ++i) {
            T* to = offsets.data() + 4 * i;
            double square = 0.0;
            for (index_t axis = 0; axis < 3; ++axis) {
                const double d =
                    points.positions[static_cast<std::size_t>(3 * i + axis)] - points.center[axis];
                to[axis] = static_cast<T>(d);
                square += d * d;
            }
            to[3] = static_cast<T>(square);
        }
        return out;
    }

    /// Gathers `image` at the block's points, times `scale`; zero at the padding.
    void gather(std::span<const std::complex<T>> image, T scale) noexcept {
        std::fill_n(values.data(), 2 * points.n_padded(), T{});
        for (index_t i = 0; i < points.n_points(); ++i) {
            const auto at = static_cast<std::size_t>(points.index[static_cast<std::size_t>(i)]);
            values.data()[2 * i] = image[at].real() * scale;
            values.data()[2 * i + 1] = image[at].imag() * scale;
        }
    }
};

/// No more threads than pieces of work: each would allocate a workspace and be idle.
int useful_threads(int wanted, index_t pieces) noexcept {
    return static_cast<int>(std::clamp<index_t>(pieces, 1, wanted));
}

template <class T>
std::vector<Workspace<T>> workspaces(int num_threads, int lanes, index_t n_pairs,
                                     index_t sums_per_point) {
    std::vector<Workspace<T>> out;
    out.reserve(static_cast<std::size_t>(num_threads));
    for (int i = 0; i < num_threads; ++i) {
        out.emplace_back(lanes, n_pairs, sums_per_point);
    }
    return out;
}

/// The plan of the factorised method; null for other methods.
template <class T>
std::unique_ptr<const detail::FactorisedPlan<T>>
factorised_plan(const AntennaPositions& antennas, const PointSet& points, const Waveform& waveform,
                const MatchedFilterOptions& options) {
    const auto* grid = std::get_if<VoxelGrid>(&points);
    if (options.method == MatchedFilterMethod::automatic && grid != nullptr) {
        return detail::plan_choice<T>(antennas, points, waveform, options).plan;
    }
    if (options.method != MatchedFilterMethod::factorised) {
        return nullptr;
    }
    if (grid == nullptr) {
        throw std::invalid_argument("the factorised method needs a grid, got a list of points");
    }
    return std::make_unique<const detail::FactorisedPlan<T>>(antennas, *grid, waveform, options);
}

/// Sum over lanes, in double and always in the same order.
template <class T>
double sum_lanes(const T* from, int lanes) noexcept {
    double sum = 0.0;
    for (int lane = 0; lane < lanes; ++lane) {
        sum += static_cast<double>(from[lane]);
    }
    return sum;
}

/// Image of all antennas at one block of points.
template <class T>
void image_block(const detail::MatchedFilterKernels<T>& kernels,
                 const detail::MatchedFilterTables<T>& tables,
                 const detail::PackedAntennas<T>& antennas, const PointBlocks& blocks, index_t b,
                 T scale, Workspace<T>& space, std::span<std::complex<T>> image) noexcept {
    const PointBlock<T> block = space.fetch(blocks, b);
    T* sums = space.sums.data();
    std::fill_n(sums, 2 * block.n_points * kernels.lanes, T{});
    if (space.points.exact) {
        kernels.exact_fwd(tables, antennas, 0, antennas.n_groups, space.points.positions.data(),
                          block.n_points, space.scratch.data(), sums);
    } else {
        kernels.block_fwd(tables, antennas, 0, antennas.n_groups, block, space.scratch.data(),
                          sums);
    }
    T* values = space.values.data();
    kernels.sum_lanes(2 * space.points.n_points(), sums, values);
    for (index_t i = 0; i < space.points.n_points(); ++i) {
        const auto at = static_cast<std::size_t>(space.points.index[static_cast<std::size_t>(i)]);
        image[at] = {scale * values[2 * i], scale * values[2 * i + 1]};
    }
}

} // namespace

template <class T>
struct MatchedFilterPlan<T>::Impl {
    std::vector<double> tx;
    std::vector<double> rx;
    std::vector<double> list; ///< of points; empty for a grid
    PointSet points;          ///< the grid, or a view of the list
    Waveform waveform;
    MatchedFilterOptions options;
    std::unique_ptr<const detail::FactorisedPlan<T>> factorised; ///< null where not used
    std::unique_ptr<const WaveformPlan<T>> plan;                 ///< null where factorised is not
    std::unique_ptr<const PointBlocks> blocks;                   ///< as `plan`

    Impl(const AntennaPositions& antennas, const PointSet& given, const Waveform& chirp,
         MatchedFilterOptions asked)
        : tx(antennas.tx.begin(), antennas.tx.end()), rx(antennas.rx.begin(), antennas.rx.end()),
          points(given), waveform(chirp), options(std::move(asked)) {
        if (const auto* places = std::get_if<std::span<const double>>(&given)) {
            list.assign(places->begin(), places->end());
            points = std::span<const double>(list);
        }
        factorised = factorised_plan<T>(this->antennas(), points, waveform, options);
        if (!factorised) {
            plan = std::make_unique<const WaveformPlan<T>>(waveform, options);
            blocks = std::make_unique<const PointBlocks>(points, plan->rule(), options.num_threads);
        }
    }

    [[nodiscard]] AntennaPositions antennas() const noexcept { return {tx, rx}; }

    [[nodiscard]] index_t n_points() const noexcept {
        if (const auto* grid = std::get_if<VoxelGrid>(&points)) {
            return grid->shape[0] * grid->shape[1] * grid->shape[2];
        }
        return static_cast<index_t>(list.size() / 3);
    }
};

template <class T>
MatchedFilterPlan<T>::MatchedFilterPlan(const AntennaPositions& antennas, const PointSet& points,
                                        const Waveform& waveform,
                                        const MatchedFilterOptions& options)
    : impl_(std::make_unique<const Impl>(antennas, points, waveform, options)) {}

template <class T>
MatchedFilterPlan<T>::~MatchedFilterPlan() = default;
template <class T>
MatchedFilterPlan<T>::MatchedFilterPlan(MatchedFilterPlan&&) noexcept = default;
template <class T>
MatchedFilterPlan<T>& MatchedFilterPlan<T>::operator=(MatchedFilterPlan&&) noexcept = default;

template <class T>
index_t MatchedFilterPlan<T>::n_antennas() const noexcept {
    return impl_->antennas().count();
}

template <class T>
index_t MatchedFilterPlan<T>::n_samples() const noexcept {
    return impl_->waveform.n_samples;
}

template <class T>
index_t MatchedFilterPlan<T>::n_points() const noexcept {
    return impl_->n_points();
}

template <class T>
void MatchedFilterPlan<T>::image(std::span<const std::complex<T>> signal,
                                 const std::function<void(double)>& progress,
                                 std::span<std::complex<T>> image) const {
    const Impl& here = *impl_;
    if (here.factorised) {
        MatchedFilterOptions options = here.options;
        options.progress = progress;
        return detail::factorised_fwd<T>(signal, *here.factorised, here.antennas(),
                                         std::get<VoxelGrid>(here.points), here.waveform, options,
                                         image);
    }
    const PointBlocks& blocks = *here.blocks;
    const auto& kernels = detail::kernels_for_cpu<detail::MatchedFilterKernels<T>>();
    AntennaPack<T> pack(here.antennas(), kernels.lanes, here.waveform.n_samples,
                        here.options.num_threads);
    pack.pack_signal(signal);
    assert(static_cast<index_t>(image.size()) == blocks.n_points());
    const int threads = useful_threads(here.options.num_threads, blocks.n_blocks());
    auto spaces = workspaces<T>(threads, kernels.lanes, here.plan->tables().n_pairs, 2);
    const auto packed = pack.view();
    const T scale = static_cast<T>(1.0 / static_cast<double>(here.antennas().count()));

    const index_t n_blocks = blocks.n_blocks();
    const index_t step = progress ? std::max<index_t>(8 * threads, n_blocks / 100) : n_blocks;
    for (index_t begin = 0; begin < n_blocks; begin += step) {
        const index_t end = std::min(begin + step, n_blocks);
#pragma omp parallel for num_threads(threads) schedule(dynamic)
        for (index_t b = begin; b < end; ++b) {
            image_block(kernels, here.plan->tables(), packed, blocks, b, scale,
                        spaces[static_cast<std::size_t>(omp_get_thread_num())], image);
        }
        if (progress) {
            progress(static_cast<double>(end) / static_cast<double>(n_blocks));
        }
    }
}

template <class T>
void MatchedFilterPlan<T>::adjoint(std::span<const std::complex<T>> image,
                                   std::span<std::complex<T>> signal) const {
    const Impl& here = *impl_;
    if (here.factorised) {
        return detail::factorised_bwd<T>(image, *here.factorised, here.antennas(),
                                         std::get<VoxelGrid>(here.points), here.waveform,
                                         here.options, signal);
    }
    const PointBlocks& blocks = *here.blocks;
    const auto& kernels = detail::kernels_for_cpu<detail::MatchedFilterKernels<T>>();
    AntennaPack<T> pack(here.antennas(), kernels.lanes, here.waveform.n_samples,
                        here.options.num_threads);
    assert(static_cast<index_t>(image.size()) == blocks.n_points());
    const int threads = useful_threads(here.options.num_threads, pack.n_groups());
    auto spaces = workspaces<T>(threads, kernels.lanes, here.plan->tables().n_pairs, 0);
    const auto packed = pack.view();
    T* sums = pack.signal();
    const T scale = static_cast<T>(1.0 / static_cast<double>(here.antennas().count()));

    // A tile of antennas belongs to one thread and sees the blocks in order: no reduction.
#pragma omp parallel for num_threads(threads) schedule(dynamic)
    for (index_t begin = 0; begin < packed.n_groups; begin += groups_per_tile) {
        auto& space = spaces[static_cast<std::size_t>(omp_get_thread_num())];
        const index_t end = std::min(begin + groups_per_tile, packed.n_groups);
        for (index_t b = 0; b < blocks.n_blocks(); ++b) {
            const PointBlock<T> block = space.fetch(blocks, b);
            space.gather(image, scale);
            if (space.points.exact) {
                kernels.exact_bwd(here.plan->tables(), packed, begin, end,
                                  space.points.positions.data(), block.n_points,
                                  space.values.data(), space.scratch.data(), sums);
            } else {
                kernels.block_bwd(here.plan->tables(), packed, begin, end, block,
                                  space.values.data(), space.scratch.data(), sums);
            }
        }
    }
    pack.unpack_signal(signal);
}

template <class T>
void matched_filter_fwd(std::span<const std::complex<T>> signal, const AntennaPositions& antennas,
                        const PointSet& points, const Waveform& waveform,
                        const MatchedFilterOptions& options, std::span<std::complex<T>> image) {
    MatchedFilterPlan<T>(antennas, points, waveform, options)
        .image(signal, options.progress, image);
}

template <class T>
void matched_filter_bwd_signal(std::span<const std::complex<T>> image,
                               const AntennaPositions& antennas, const PointSet& points,
                               const Waveform& waveform, const MatchedFilterOptions& options,
                               std::span<std::complex<T>> signal) {
    MatchedFilterPlan<T>(antennas, points, waveform, options).adjoint(image, signal);
}

template <class T>
void matched_filter_bwd_positions(std::span<const std::complex<T>> image_grad,
                                  std::span<const std::complex<T>> signal,
                                  const AntennaPositions& antennas, const PointSet& points,
                                  const Waveform& waveform, int num_threads,
                                  const PositionGradients& gradients) {
    const auto& kernels = detail::kernels_for_cpu<detail::MatchedFilterKernels<T>>();
    const int lanes = kernels.lanes;
    const WaveformPlan<T> plan(waveform, {MatchedFilterMethod::exact, 1e-3, 1});
    const index_t n_antennas = antennas.count();
    AntennaPack<T> pack(antennas, lanes, waveform.n_samples, num_threads);
    pack.pack_signal(signal);
    const PointBlocks blocks(points, plan.rule(), num_threads);
    const int threads = useful_threads(num_threads, std::max(blocks.n_blocks(), pack.n_groups()));
    auto spaces = workspaces<T>(threads, lanes, plan.tables().n_pairs, 3);
    const auto packed = pack.view();
    const T scale = static_cast<T>(1.0 / static_cast<double>(n_antennas));

    if (!gradients.points.empty()) {
#pragma omp parallel for num_threads(threads) schedule(dynamic)
        for (index_t b = 0; b < blocks.n_blocks(); ++b) {
            auto& space = spaces[static_cast<std::size_t>(omp_get_thread_num())];
            const index_t n_points = space.fetch(blocks, b).n_points;
            space.gather(image_grad, scale);
            std::fill_n(space.sums.data(), 3 * n_points * lanes, T{});
            kernels.positions_bwd(plan.tables(), packed, 0, packed.n_groups,
                                  space.points.positions.data(), n_points, space.values.data(),
                                  space.scratch.data(), space.sums.data(), nullptr);
            for (index_t i = 0; i < 3 * space.points.n_points(); ++i) {
                const index_t point = space.points.index[static_cast<std::size_t>(i / 3)];
                gradients.points[static_cast<std::size_t>(3 * point + i % 3)] =
                    sum_lanes(space.sums.data() + i * lanes, lanes);
            }
        }
    }
    if (gradients.tx.empty() && gradients.rx.empty()) {
        return;
    }
    AlignedBuffer<T> sums(packed.n_groups * 6 * lanes);
#pragma omp parallel for num_threads(threads) schedule(dynamic)
    for (index_t begin = 0; begin < packed.n_groups; begin += groups_per_tile) {
        auto& space = spaces[static_cast<std::size_t>(omp_get_thread_num())];
        const index_t end = std::min(begin + groups_per_tile, packed.n_groups);
        for (index_t b = 0; b < blocks.n_blocks(); ++b) {
            const index_t n_points = space.fetch(blocks, b).n_points;
            space.gather(image_grad, scale);
            kernels.positions_bwd(plan.tables(), packed, begin, end, space.points.positions.data(),
                                  n_points, space.values.data(), space.scratch.data(), nullptr,
                                  sums.data());
        }
    }
    for (index_t i = 0; i < 3 * n_antennas; ++i) {
        const index_t antenna = i / 3;
        const index_t tx = (antenna / lanes * 6 + i % 3) * lanes + antenna % lanes;
        if (!gradients.tx.empty()) {
            gradients.tx[static_cast<std::size_t>(i)] = static_cast<double>(sums.data()[tx]);
        }
        if (!gradients.rx.empty()) {
            gradients.rx[static_cast<std::size_t>(i)] =
                static_cast<double>(sums.data()[tx + 3 * lanes]);
        }
    }
}

template class MatchedFilterPlan<float>;
template class MatchedFilterPlan<double>;
template void matched_filter_fwd<float>(std::span<const std::complex<float>>,
                                        const AntennaPositions&, const PointSet&, const Waveform&,
                                        const MatchedFilterOptions&,
                                        std::span<std::complex<float>>);
template void matched_filter_fwd<double>(std::span<const std::complex<double>>,
                                         const AntennaPositions&, const PointSet&, const Waveform&,
                                         const MatchedFilterOptions&,
                                         std::span<std::complex<double>>);
template void matched_filter_bwd_signal<float>(std::span<const std::complex<float>>,
                                               const AntennaPositions&, const PointSet&,
                                               const Waveform&, const MatchedFilterOptions&,
                                               std::span<std::complex<float>>);
template void matched_filter_bwd_signal<double>(std::span<const std::complex<double>>,
                                                const AntennaPositions&, const PointSet&,
                                                const Waveform&, const MatchedFilterOptions&,
                                                std::span<std::complex<double>>);
template void matched_filter_bwd_positions<float>(std::span<const std::complex<float>>,
                                                  std::span<const std::complex<float>>,
                                                  const AntennaPositions&, const PointSet&,
                                                  const Waveform&, int, const PositionGradients&);
template void matched_filter_bwd_positions<double>(std::span<const std::complex<double>>,
                                                   std::span<const std::complex<double>>,
                                                   const AntennaPositions&, const PointSet&,
                                                   const Waveform&, int, const PositionGradients&);

} // namespace geraf2
