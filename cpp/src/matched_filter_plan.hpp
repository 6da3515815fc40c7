// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <complex>
#include <span>

#include "aligned_buffer.hpp"
#include "geraf2/matched_filter.hpp"
#include "geraf2/wave.hpp"
#include "matched_filter_kernels.hpp"
#include "point_blocks.hpp"

namespace geraf2::detail {

/// Kernels of simd_level().
template <class T>
const MatchedFilterKernels<T>& matched_filter_kernels();

/// Tables of one waveform and tolerance, and the rule by which points form blocks.
template <class T>
class MatchedFilterPlan {
public:
    /// At the tier that serves dense grids to options.rtol.
    MatchedFilterPlan(const Waveform& waveform, const MatchedFilterOptions& options);
    /// At a tier of the caller's choice, an index into `tiers`.
    MatchedFilterPlan(const Waveform& waveform, const MatchedFilterOptions& options,
                      int tier_index);

    [[nodiscard]] const MatchedFilterTables<T>& tables() const noexcept { return tables_; }
    [[nodiscard]] const BlockRule& rule() const noexcept { return rule_; }

private:
    AlignedBuffer<T> profile_;
    MatchedFilterTables<T> tables_;
    BlockRule rule_;
};

/// Antennas in the kernels' layout. Owns positions, and a signal when it was given one.
template <class T>
class AntennaPack {
public:
    AntennaPack(const AntennaPositions& antennas, int lanes, index_t n_samples, int num_threads);

    /// From (n_antennas, n_samples) to pairs of samples about mid-band.
    void pack_signal(std::span<const std::complex<T>> signal);

    /// The adjoint of pack_signal.
    void unpack_signal(std::span<std::complex<T>> signal) const;

    [[nodiscard]] PackedAntennas<T> view() const noexcept;
    [[nodiscard]] T* signal() noexcept { return signal_.data(); }
    [[nodiscard]] index_t n_antennas() const noexcept { return n_antennas_; }
    [[nodiscard]] index_t n_groups() const noexcept { return n_groups_; }
    [[nodiscard]] int lanes() const noexcept { return lanes_; }

private:
    index_t n_antennas_;
    index_t n_samples_;
    index_t n_pairs_;
    index_t n_groups_;
    int lanes_;
    int num_threads_;
    AlignedBuffer<double> positions_;
    AlignedBuffer<T> signal_;
};

} // namespace geraf2::detail
