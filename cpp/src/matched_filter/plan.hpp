// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <complex>
#include <span>
#include <vector>

#include "common/aligned_buffer.hpp"
#include "geraf2/matched_filter.hpp"
#include "geraf2/wave.hpp"
#include "matched_filter/kernels.hpp"
#include "matched_filter/point_blocks.hpp"

namespace geraf2::detail {

/// Frequencies as phases per metre of path.
struct WavePhases {
    double half_turns_per_m = 0.0;      ///< at mid-band
    double step_half_turns_per_m = 0.0; ///< from sample to sample
    double last_pair = 0.0;             ///< distance of the band's edge from mid-band [samples]

    explicit WavePhases(const Waveform& waveform);
};

/// The tolerance that T can hold.
template <class T>
double attainable_rtol(double rtol) noexcept;

/// Index into `tiers` of the block method.
template <class T>
int block_tier(double rtol) noexcept;

/// Cost of one (antenna, point) pair, and of setting up one (antenna, block), in slots of the
/// multiply-add units, fitted to BM_MatchedFilterSpacing at 32 and 64 samples: setting up is bound
/// by latency and takes about twice its multiply-adds.
double exact_point_cost(index_t n_pairs) noexcept;
double block_point_cost(int tier) noexcept;
double block_set_up_cost(int tier, index_t n_pairs) noexcept;

/// Largest phase errors of a block [rad].
struct BlockErrors {
    double profile = 0.0; ///< of the range profile at the band's edge
    double range = 0.0;   ///< of both range series together
};

/// Tables of one waveform and tolerance, and the rule by which points form blocks.
template <class T>
class MatchedFilterPlan {
public:
    /// At the tier that serves dense grids to options.rtol.
    MatchedFilterPlan(const Waveform& waveform, const MatchedFilterOptions& options);
    /// At a tier of the caller's choice, an index into `tiers`.
    MatchedFilterPlan(const Waveform& waveform, const MatchedFilterOptions& options,
                      int tier_index);

    MatchedFilterPlan(const Waveform& waveform, int tier, const BlockErrors& errors);

    [[nodiscard]] const MatchedFilterTables<T>& tables() const noexcept { return tables_; }
    [[nodiscard]] const BlockRule& rule() const noexcept { return rule_; }

    /// Radius up to which the profile's polynomial serves [m].
    [[nodiscard]] double max_radius() const noexcept { return max_radius_; }

private:
    AlignedBuffer<T> profile_;
    MatchedFilterTables<T> tables_;
    BlockRule rule_;
    double max_radius_ = 0.0;
};

/// Tables for the carrier phase of centres of clusters, without path bias and profile; tier is
/// an index into `carrier_tiers`, range_error the largest of both legs together [rad].
template <class T>
MatchedFilterTables<T> carrier_tables(const Waveform& waveform, int tier, double range_error);

/// Bessel function of the first kind by its power series, which is accurate for x below 10.
double bessel_j(int order, double x) noexcept;

/// The slot of an antenna with a zero signal; and the antenna of such a slot.
inline index_t silent(index_t antenna) noexcept { return -1 - antenna; }

/// Antennas in the kernels' layout. Owns positions, and a signal when it was given one.
template <class T>
class AntennaPack {
public:
    /// All antennas in their order.
    AntennaPack(const AntennaPositions& antennas, int lanes, index_t n_samples, int num_threads,
                index_t n_signals = 1);

    /// slots: (n_groups * lanes) antennas; or silent ones.
    AntennaPack(const AntennaPositions& antennas, std::vector<index_t> slots, int lanes,
                index_t n_samples, int num_threads, index_t n_signals = 1);

    /// From (n_signals, n_antennas, n_samples) to pairs of samples about mid-band.
    void pack_signal(std::span<const std::complex<T>> signal);

    /// The adjoint of pack_signal.
    void unpack_signal(std::span<std::complex<T>> signal) const;

    [[nodiscard]] PackedAntennas<T> view() const noexcept;
    [[nodiscard]] T* signal() noexcept { return signal_.data(); }
    [[nodiscard]] index_t n_antennas() const noexcept { return n_antennas_; }
    [[nodiscard]] index_t n_groups() const noexcept { return n_groups_; }
    [[nodiscard]] int lanes() const noexcept { return lanes_; }

    /// Bytes per slot.
    [[nodiscard]] static double slot_bytes(index_t n_samples) noexcept {
        const index_t n_pairs = (n_samples + 1) / 2;
        return static_cast<double>(sizeof(index_t) + 6 * sizeof(double)) +
               static_cast<double>(4 * n_pairs) * sizeof(T);
    }

private:
    index_t n_antennas_;
    std::vector<index_t> slots_;
    index_t n_samples_;
    index_t n_signals_;
    index_t n_pairs_;
    int lanes_;
    index_t n_groups_;
    int num_threads_;
    AlignedBuffer<double> positions_;
    AlignedBuffer<T> signal_;
};

} // namespace geraf2::detail
