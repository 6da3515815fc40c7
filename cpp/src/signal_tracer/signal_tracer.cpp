// SPDX-License-Identifier: Apache-2.0
#include "geraf2/signal_tracer.hpp"

#include <omp.h>

#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>
#include <vector>

#include "common/aligned_buffer.hpp"
#include "matched_filter/plan.hpp"
#include "matched_filter/point_blocks.hpp"
#include "matched_filter/tiers.hpp"
#include "signal_tracer/kernels.hpp"
#include "simd/dispatch.hpp"

namespace geraf2 {
namespace {

using detail::AlignedBuffer;
using detail::AmplitudeKind;
using detail::AntennaPack;
using detail::BlockPoints;
using detail::groups_per_gather;
using detail::groups_per_tile;
using detail::PackedAntennas;
using detail::point_quantum;
using detail::PointBlocks;
using detail::ReflectorBlock;
using detail::ReflectorSums;
using detail::SignalTracerKernels;
using detail::sums_per_point;
using detail::WaveformPlan;

/// Distance between the nearest antenna and the box around all points [m].
double clearance(std::span<const double> points, const AntennaPositions& antennas,
                 int num_threads) noexcept {
    const detail::Extent extent = detail::extent_of(points, num_threads);
    double nearest = std::numeric_limits<double>::infinity();
    for (const auto positions : {antennas.tx, antennas.rx}) {
        for (std::size_t i = 0; i + 2 < positions.size() && !points.empty(); i += 3) {
            double square = 0.0;
            for (std::size_t axis = 0; axis < 3; ++axis) {
                const double x = positions[i + axis];
                const double out = std::max({extent.low[axis] - x, x - extent.high[axis], 0.0});
                square += out * out;
            }
            nearest = std::min(nearest, square);
        }
    }
    return std::sqrt(nearest);
}

/// How points are gathered, and the tables for it.
template <class T>
struct Plan {
    WaveformPlan<T> tables;
    detail::BlockRule rule;

    Plan(const Waveform& waveform, const SignalTracerOptions& options, int tier)
        : tables(waveform, {MatchedFilterMethod::automatic, options.rtol, options.num_threads},
                 tier),
          rule(tables.rule()) {}
};

/// Blocks of at most this share of the distance stay within the range series' bound, rtol/4, at the
/// tiers from wide_coarse to wide_fine; the guard sees to it for each tile.
constexpr double widest_share[] = {0.095, 0.11, 0.08};

/// Points of a tracer lie some millimetres apart: wide blocks of a high degree share the spreading
/// of the moments over the samples among more of them than narrow ones of a low degree do. Near
/// antennas smaller blocks are cheaper than the square root.
template <class T>
Plan<T> make_plan(const Reflectors<T>& reflectors, const AntennaPositions& antennas,
                  const Waveform& waveform, const SignalTracerOptions& options) {
    const bool loose = options.rtol >= 5e-4;
    if (!loose && sizeof(T) == 8 && options.rtol < 1e-5) {
        return {waveform, options, detail::narrow_double};
    }
    const double distance = clearance(reflectors.points, antennas, options.num_threads);
    const int first = loose ? detail::wider_coarse : detail::wide_fine;
    const int last = loose ? detail::wide_coarse : detail::wide_fine;
    for (int tier = first; tier >= last; --tier) {
        Plan<T> plan(waveform, options, tier);
        const double limit = widest_share[tier - detail::wide_coarse] * distance;
        if (limit >= 0.5 * plan.rule.max_radius) {
            plan.rule.max_radius = std::min(plan.rule.max_radius, limit);
            return plan;
        }
    }
    return {waveform, options, last};
}

/// The reflecting points block after block, each padded to point_quantum with zero amplitude.
template <class T>
class ReflectorList {
public:
    ReflectorList(const Reflectors<T>& reflectors, const detail::BlockRule& rule, int num_threads)
        : reflectors_(reflectors), blocks_(reflectors.points, rule, num_threads),
          first_(static_cast<std::size_t>(blocks_.n_blocks()) + 1, 0),
          list_(static_cast<std::size_t>(blocks_.n_blocks())) {
        for (index_t b = 0; b < blocks_.n_blocks(); ++b) {
            const index_t padded =
                (blocks_.block_size(b) + point_quantum - 1) / point_quantum * point_quantum;
            first_[static_cast<std::size_t>(b) + 1] = first_slot(b) + padded;
        }
        offsets_ = AlignedBuffer<T>::uninitialised(4 * n_slots());
        positions_ = AlignedBuffer<double>::uninitialised(3 * n_slots());
        normals_ = AlignedBuffer<T>::uninitialised(reflectors.normals.empty() ? 0 : 3 * n_slots());
        shared_ = AlignedBuffer<T>::uninitialised(reflectors.rows == 1 ? 2 * n_slots() : 0);
        point_of_slot_.resize(static_cast<std::size_t>(n_slots()));
        const int threads =
            static_cast<int>(std::clamp<index_t>(blocks_.n_blocks(), 1, num_threads));
        std::vector<BlockPoints> points(static_cast<std::size_t>(threads));
#pragma omp parallel for num_threads(threads) schedule(static)
        for (index_t b = 0; b < blocks_.n_blocks(); ++b) {
            auto& own = points[static_cast<std::size_t>(omp_get_thread_num())];
            blocks_.fetch(b, own);
            set_block(b, own);
        }
    }

    [[nodiscard]] index_t n_blocks() const noexcept { return static_cast<index_t>(list_.size()); }
    [[nodiscard]] index_t n_slots() const noexcept { return first_.back(); }
    [[nodiscard]] AmplitudeKind kind() const noexcept {
        if (reflectors_.rows == 1) {
            return AmplitudeKind::shared;
        }
        return reflectors_.parts == 1 ? AmplitudeKind::antenna_real
                                      : AmplitudeKind::antenna_complex;
    }

    /// Points of a block at most, with padding.
    [[nodiscard]] index_t largest_block() const noexcept {
        index_t out = 0;
        for (index_t b = 0; b < n_blocks(); ++b) {
            out = std::max(out, first_[static_cast<std::size_t>(b) + 1] - first_slot(b));
        }
        return out;
    }

    /// Index of the block's first point in the list.
    [[nodiscard]] index_t first_slot(index_t block) const noexcept {
        return first_[static_cast<std::size_t>(block)];
    }

    /// The point that lies there, or n_points() for padding.
    [[nodiscard]] index_t point_of_slot(index_t slot) const noexcept {
        return point_of_slot_[static_cast<std::size_t>(slot)];
    }
    [[nodiscard]] index_t n_points() const noexcept { return blocks_.n_points(); }

    /// A block; `per_antenna` as made by pack_amplitude.
    [[nodiscard]] ReflectorBlock<T> block(index_t b, const T* per_antenna) const noexcept {
        ReflectorBlock<T> out = list_[static_cast<std::size_t>(b)];
        const index_t first = first_slot(b);
        out.kind = kind();
        out.stride = n_points() + 1;
        out.place = point_of_slot_.data() + first;
        out.amplitude =
            out.kind == AmplitudeKind::shared ? shared_.data() + 2 * first : per_antenna;
        return out;
    }

    /// Values of one antenna group in the native layout: its amplitudes, and zeros for the padding.
    [[nodiscard]] index_t group_size(int lanes) const noexcept {
        return kind() == AmplitudeKind::shared ? 0 : (row() + reflectors_.parts) * lanes;
    }

    /// Amplitudes of one antenna group, from (n_antennas, n_points, parts) to
    /// (n_points, parts, lanes).
    void pack_amplitude(const SignalTracerKernels<T>& kernels, index_t group, index_t n_antennas,
                        T* to) const noexcept {
        const index_t first = group * kernels.lanes;
        kernels.pack_rows(reflectors_.amplitude.data() + first * row(), row(),
                          rows_of(kernels, first, n_antennas), to);
    }

    /// The adjoint, into a gradient.
    void unpack_amplitude(const SignalTracerKernels<T>& kernels, const T* from, index_t group,
                          index_t n_antennas, std::span<T> to) const noexcept {
        const index_t first = group * kernels.lanes;
        kernels.unpack_rows(from, row(), rows_of(kernels, first, n_antennas),
                            to.data() + first * row());
    }

private:
    /// Values from one antenna's amplitudes to the next's.
    [[nodiscard]] index_t row() const noexcept { return blocks_.n_points() * reflectors_.parts; }

    static int rows_of(const SignalTracerKernels<T>& kernels, index_t first, index_t n_antennas) {
        return static_cast<int>(std::min<index_t>(kernels.lanes, n_antennas - first));
    }

    void set_block(index_t b, const BlockPoints& points) noexcept {
        const index_t first = first_slot(b);
        ReflectorBlock<T>& out = list_[static_cast<std::size_t>(b)];
        std::copy_n(points.center, 3, out.block.center);
        out.block.radius = points.radius;
        out.block.n_points = points.n_padded();
        out.block.offsets = offsets_.data() + 4 * first;
        out.positions = positions_.data() + 3 * first;
        out.normals = reflectors_.normals.empty() ? nullptr : normals_.data() + 3 * first;
        out.exact = points.exact;
        for (index_t i = 0; i < points.n_padded(); ++i) {
            const index_t point =
                i < points.n_points() ? points.index[static_cast<std::size_t>(i)] : n_points();
            set_point(first + i, point, points.positions.data() + 3 * i, points.center);
        }
    }

    void set_point(index_t slot, index_t point, const double* position,
                   const double* center) noexcept {
        double square = 0.0;
        for (index_t axis = 0; axis < 3; ++axis) {
            const double d = position[axis] - center[axis];
            positions_.data()[3 * slot + axis] = position[axis];
            offsets_.data()[4 * slot + axis] = static_cast<T>(d);
            square += d * d;
        }
        offsets_.data()[4 * slot + 3] = static_cast<T>(square);
        point_of_slot_[static_cast<std::size_t>(slot)] = point;
        const bool padding = point == n_points(); // whose normals and amplitudes are zero
        const auto from = static_cast<std::size_t>(point);
        for (std::size_t axis = 0; axis < 3 && !reflectors_.normals.empty(); ++axis) {
            normals_.data()[3 * slot + static_cast<index_t>(axis)] =
                padding ? T{} : reflectors_.normals[3 * from + axis];
        }
        if (reflectors_.rows == 1) {
            T* to = shared_.data() + 2 * slot;
            to[0] = to[1] = T{};
            for (index_t part = 0; part < reflectors_.parts && !padding; ++part) {
                to[part] =
                    reflectors_
                        .amplitude[static_cast<std::size_t>(reflectors_.parts * point + part)];
            }
        }
    }

    Reflectors<T> reflectors_;
    PointBlocks blocks_;
    std::vector<index_t> first_; ///< slot of each block, then their number
    AlignedBuffer<T> offsets_{0};
    AlignedBuffer<double> positions_{0};
    AlignedBuffer<T> normals_{0};
    AlignedBuffer<T> shared_{0};
    std::vector<index_t> point_of_slot_;
    std::vector<ReflectorBlock<T>> list_;
};

/// What one thread writes; allocated before the parallel region, so that nothing in there can
/// throw.
template <class T>
struct Workspace {
    AlignedBuffer<T> scratch;
    AlignedBuffer<T> amplitude;      // of one tile, in the kernels' layout
    AlignedBuffer<T> amplitude_grad; // likewise
    AlignedBuffer<double> sums;      // (n_slots, sums_per_point)
    AlignedBuffer<T> signal{0};      // of one group, as PackedAntennas::signal
};

} // namespace

template <class T>
void signal_tracer_fwd(const Reflectors<T>& reflectors, const AntennaPositions& antennas,
                       const Waveform& waveform, const SignalTracerOptions& options,
                       std::span<std::complex<T>> signal) {
    const auto& kernels = detail::kernels_for_cpu<SignalTracerKernels<T>>();
    const int lanes = kernels.lanes;
    const Plan<T> plan = make_plan<T>(reflectors, antennas, waveform, options);
    const ReflectorList<T> list(reflectors, plan.rule, options.num_threads);
    AntennaPack<T> pack(antennas, lanes, waveform.n_samples, options.num_threads);
    const PackedAntennas<T> packed = pack.view();
    const int threads =
        static_cast<int>(std::clamp<index_t>(packed.n_groups, 1, options.num_threads));
    const index_t n_pairs = plan.tables.tables().n_pairs;
    const index_t scratch_size = detail::scratch_vectors(n_pairs) * lanes;
    std::vector<Workspace<T>> spaces;
    spaces.reserve(static_cast<std::size_t>(threads));
    for (int i = 0; i < threads; ++i) {
        spaces.push_back({AlignedBuffer<T>(scratch_size), AlignedBuffer<T>(list.group_size(lanes)),
                          AlignedBuffer<T>(0), AlignedBuffer<double>(0),
                          AlignedBuffer<T>(n_pairs * 4 * lanes)});
    }

    // Each antenna belongs to one thread, which sees the blocks in their order: no reduction. It
    // sums in memory of its own: that of the pack was zeroed, and is in the cache of, another core.
#pragma omp parallel for num_threads(threads) schedule(dynamic)
    for (index_t group = 0; group < packed.n_groups; ++group) {
        auto& space = spaces[static_cast<std::size_t>(omp_get_thread_num())];
        if (list.kind() != AmplitudeKind::shared) {
            list.pack_amplitude(kernels, group, pack.n_antennas(), space.amplitude.data());
        }
        std::fill_n(space.signal.data(), space.signal.size(), T{});
        for (index_t b = 0; b < list.n_blocks(); ++b) {
            kernels.fwd(plan.tables.tables(), packed, group, group + 1,
                        list.block(b, space.amplitude.data()), space.scratch.data(),
                        space.signal.data());
        }
        std::copy_n(space.signal.data(), space.signal.size(),
                    pack.signal() + group * space.signal.size());
    }
    pack.unpack_signal(signal);
}

namespace {

template <class T>
ReflectorSums<T> wanted_sums(const Reflectors<T>& reflectors,
                             const SignalTracerGradients<T>& gradients) {
    ReflectorSums<T> out;
    out.positions = !gradients.points.empty() || !gradients.tx.empty() || !gradients.rx.empty();
    out.shared = reflectors.rows == 1 && !gradients.amplitude.empty();
    out.normals = !gradients.normals.empty();
    return out;
}

/// Common part of the two orders of a backward: by tiles of antennas, and by blocks of points.
template <class T>
struct Backward {
    const SignalTracerKernels<T>& kernels;
    const detail::MatchedFilterTables<T>& tables;
    const ReflectorList<T>& list;
    const AntennaPack<T>& pack;
    PackedAntennas<T> packed;
    const Reflectors<T>& reflectors;
    const SignalTracerGradients<T>& gradients;
    ReflectorSums<T> wanted;
    int num_threads;

    [[nodiscard]] index_t scratch_size() const noexcept {
        return detail::scratch_vectors(tables.n_pairs) * kernels.lanes;
    }

    /// Stores the sums of one point at its position in the list.
    void set_point(index_t slot, const double* total) const noexcept {
        const index_t point = list.point_of_slot(slot);
        if (point == list.n_points()) { // padding
            return;
        }
        const index_t parts = reflectors.parts;
        for (index_t part = 0; wanted.shared && part < parts; ++part) {
            gradients.amplitude[static_cast<std::size_t>(point * parts + part)] =
                static_cast<T>(total[part]);
        }
        for (index_t axis = 0; axis < 3; ++axis) {
            const auto at = static_cast<std::size_t>(3 * point + axis);
            if (!gradients.normals.empty()) {
                gradients.normals[at] = total[2 + axis];
            }
            if (!gradients.points.empty()) {
                gradients.points[at] = total[5 + axis];
            }
        }
    }
};

/// Adds up the threads' sums, in the order of the threads.
template <class T>
void collect_sums(const Backward<T>& call, const std::vector<Workspace<T>>& spaces) {
#pragma omp parallel for num_threads(call.num_threads) schedule(static)
    for (index_t slot = 0; slot < call.list.n_slots(); ++slot) {
        double total[sums_per_point] = {};
        for (const auto& space : spaces) {
            for (index_t k = 0; k < sums_per_point; ++k) {
                total[k] += space.sums.data()[slot * sums_per_point + k];
            }
        }
        call.set_point(slot, total);
    }
}

/// From the kernels' layout to (n_antennas, 3) each.
template <class T>
void collect_antennas(const T* sums, index_t n_antennas, int lanes,
                      const SignalTracerGradients<T>& gradients) {
    for (index_t i = 0; i < 3 * n_antennas; ++i) {
        const index_t antenna = i / 3;
        const index_t tx = (antenna / lanes * 6 + i % 3) * lanes + antenna % lanes;
        if (!gradients.tx.empty()) {
            gradients.tx[static_cast<std::size_t>(i)] = static_cast<double>(sums[tx]);
        }
        if (!gradients.rx.empty()) {
            gradients.rx[static_cast<std::size_t>(i)] = static_cast<double>(sums[tx + 3 * lanes]);
        }
    }
}

/// Most bytes of signals that are read again for every block of points: the second-level cache.
constexpr index_t resident_bytes = 1'048'576;

/// Whether the gradients of a block's points depend on that block alone: no sums over points for
/// the antennas, and no amplitudes of their own, which are packed antenna by antenna.
template <class T>
bool blocks_are_apart(const Backward<T>& call) noexcept {
    const index_t values = call.packed.n_groups * call.tables.n_pairs * 4 * call.kernels.lanes;
    return call.reflectors.rows == 1 && call.gradients.tx.empty() && call.gradients.rx.empty() &&
           values * static_cast<index_t>(sizeof(T)) <= resident_bytes;
}

/// A block belongs to one thread and sees the antennas in their order: no reduction.
template <class T>
void gather_by_blocks(const Backward<T>& call) {
    const index_t n_blocks = call.list.n_blocks();
    const int threads = static_cast<int>(std::clamp<index_t>(n_blocks, 1, call.num_threads));
    std::vector<Workspace<T>> spaces;
    spaces.reserve(static_cast<std::size_t>(threads));
    for (int i = 0; i < threads; ++i) {
        spaces.push_back({AlignedBuffer<T>(call.scratch_size()), AlignedBuffer<T>(0),
                          AlignedBuffer<T>(0),
                          AlignedBuffer<double>(call.list.largest_block() * sums_per_point)});
    }
#pragma omp parallel for num_threads(threads) schedule(dynamic)
    for (index_t b = 0; b < n_blocks; ++b) {
        auto& space = spaces[static_cast<std::size_t>(omp_get_thread_num())];
        const ReflectorBlock<T> block = call.list.block(b, nullptr);
        ReflectorSums<T> to = call.wanted;
        to.points = space.sums.data();
        std::fill_n(to.points, block.block.n_points * sums_per_point, 0.0);
        for (index_t begin = 0; begin < call.packed.n_groups; begin += groups_per_gather) {
            const index_t end = std::min(begin + groups_per_gather, call.packed.n_groups);
            call.kernels.bwd(call.tables, call.packed, begin, end, block, space.scratch.data(), to);
        }
        for (index_t i = 0; i < block.block.n_points; ++i) {
            call.set_point(call.list.first_slot(b) + i, to.points + i * sums_per_point);
        }
    }
}

/// A tile of antennas belongs to one thread and sees the blocks in their order; the threads' sums
/// over antennas are added up at the end.
template <class T>
void gather_by_tiles(const Backward<T>& call) {
    const auto& kernels = call.kernels;
    const auto& list = call.list;
    const auto& packed = call.packed;
    const auto& gradients = call.gradients;
    const index_t tile =
        std::clamp<index_t>(packed.n_groups / call.num_threads, 1, groups_per_tile);
    const index_t n_tiles = (packed.n_groups + tile - 1) / tile;
    const int threads = static_cast<int>(std::clamp<index_t>(n_tiles, 1, call.num_threads));
    const bool per_antenna = call.reflectors.rows != 1;
    const bool reads_amplitude = !call.reflectors.normals.empty() || call.wanted.positions;
    const index_t group_size = list.group_size(kernels.lanes);
    std::vector<Workspace<T>> spaces;
    spaces.reserve(static_cast<std::size_t>(threads));
    for (int i = 0; i < threads; ++i) {
        spaces.push_back({AlignedBuffer<T>(call.scratch_size()),
                          AlignedBuffer<T>(reads_amplitude ? tile * group_size : 0),
                          AlignedBuffer<T>(gradients.amplitude.empty() ? 0 : tile * group_size),
                          AlignedBuffer<double>::uninitialised(list.n_slots() * sums_per_point)});
    }
    AlignedBuffer<T> antenna_sums(call.wanted.positions ? packed.n_groups * 6 * kernels.lanes : 0);

#pragma omp parallel for num_threads(threads) schedule(static)
    for (int i = 0; i < threads; ++i) {
        auto& sums = spaces[static_cast<std::size_t>(i)].sums;
        std::fill_n(sums.data(), sums.size(), 0.0);
    }
    // The same tiles go to the same threads each time, so that the sums over antennas repeat.
#pragma omp parallel for num_threads(threads) schedule(static)
    for (index_t t = 0; t < n_tiles; ++t) {
        auto& space = spaces[static_cast<std::size_t>(omp_get_thread_num())];
        const index_t begin = t * tile;
        const index_t end = std::min(begin + tile, packed.n_groups);
        for (index_t group = begin; group < end && per_antenna && reads_amplitude; ++group) {
            list.pack_amplitude(kernels, group, call.pack.n_antennas(),
                                space.amplitude.data() + (group - begin) * group_size);
        }
        for (index_t b = 0; b < list.n_blocks(); ++b) {
            ReflectorSums<T> to = call.wanted;
            to.points = space.sums.data() + list.first_slot(b) * sums_per_point;
            if (per_antenna && !gradients.amplitude.empty()) {
                to.amplitude = space.amplitude_grad.data();
            }
            if (call.wanted.positions) {
                to.antennas = antenna_sums.data() + begin * 6 * kernels.lanes;
            }
            kernels.bwd(call.tables, packed, begin, end, list.block(b, space.amplitude.data()),
                        space.scratch.data(), to);
        }
        for (index_t group = begin; group < end && space.amplitude_grad.size() > 0; ++group) {
            list.unpack_amplitude(kernels,
                                  space.amplitude_grad.data() + (group - begin) * group_size, group,
                                  call.pack.n_antennas(), gradients.amplitude);
        }
    }
    collect_sums(call, spaces);
    if (call.wanted.positions) {
        collect_antennas(antenna_sums.data(), call.pack.n_antennas(), kernels.lanes, gradients);
    }
}

} // namespace

template <class T>
void signal_tracer_bwd(std::span<const std::complex<T>> signal_grad,
                       const Reflectors<T>& reflectors, const AntennaPositions& antennas,
                       const Waveform& waveform, const SignalTracerOptions& options,
                       const SignalTracerGradients<T>& gradients) {
    const auto& kernels = detail::kernels_for_cpu<SignalTracerKernels<T>>();
    const Plan<T> plan = make_plan<T>(reflectors, antennas, waveform, options);
    const ReflectorList<T> list(reflectors, plan.rule, options.num_threads);
    AntennaPack<T> pack(antennas, kernels.lanes, waveform.n_samples, options.num_threads);
    pack.pack_signal(signal_grad);
    const Backward<T> call{kernels,
                           plan.tables.tables(),
                           list,
                           pack,
                           pack.view(),
                           reflectors,
                           gradients,
                           wanted_sums(reflectors, gradients),
                           options.num_threads};
    blocks_are_apart(call) ? gather_by_blocks(call) : gather_by_tiles(call);
}

template void signal_tracer_fwd<float>(const Reflectors<float>&, const AntennaPositions&,
                                       const Waveform&, const SignalTracerOptions&,
                                       std::span<std::complex<float>>);
template void signal_tracer_fwd<double>(const Reflectors<double>&, const AntennaPositions&,
                                        const Waveform&, const SignalTracerOptions&,
                                        std::span<std::complex<double>>);
template void signal_tracer_bwd<float>(std::span<const std::complex<float>>,
                                       const Reflectors<float>&, const AntennaPositions&,
                                       const Waveform&, const SignalTracerOptions&,
                                       const SignalTracerGradients<float>&);
template void signal_tracer_bwd<double>(std::span<const std::complex<double>>,
                                        const Reflectors<double>&, const AntennaPositions&,
                                        const Waveform&, const SignalTracerOptions&,
                                        const SignalTracerGradients<double>&);

} // namespace geraf2
