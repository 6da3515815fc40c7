// SPDX-License-Identifier: Apache-2.0
// Interface between subaperture.cpp (portable) and the kernels (one copy per instruction set).
#pragma once

#include "geraf2/types.hpp"

namespace geraf2::detail {

/// Antennas whose range profiles are computed together.
inline constexpr index_t antennas_per_group = 4;

/// From samples to ranges. A line holds a complex profile: real parts, then imaginary parts, each
/// padded to n_ranges, a multiple of the lanes.
template <class T>
struct RangeTables {
    index_t n_pairs = 0;  ///< of samples at equal distance from mid-band, a multiple of the lanes
    index_t n_ranges = 0; ///< padded
    T first_pair{};       ///< distance of the first pair: 1/2, or 0 (odd count)
    const T* cosine = nullptr; ///< (n_pairs, n_ranges), window included
    const T* sine = nullptr;   ///< (n_pairs, n_ranges)
};

/// Antennas about to be focused.
template <class T>
struct FocusGroup {
    const T* signal[antennas_per_group]{}; ///< (4, n_pairs) each: re, im of s(+m) + s(-m), of the
                                           ///< difference s(+m) - s(-m)
    T gain_re[antennas_per_group]{};       ///< weight times the phasor at mid-band
    T gain_im[antennas_per_group]{};
    T step_half_turns[antennas_per_group]{}; ///< phase from sample to sample
};

/// Sum over one axis of a lattice whose rows are folded: row p holds the sum of rows p and
/// n - 1 - p, row n - 1 - p their difference (higher row minus lower).
template <class T>
struct AxisSum {
    index_t n_rows = 0;
    index_t n_cosines = 0;     ///< distinct absolute values
    index_t count = 0;         ///< rows of the result
    index_t mirror_sum = 0;    ///< see CosineAxis
    const T* cosine = nullptr; ///< (blocks of cosines, n_rows / 2, cosines_per_block)
    const T* sine = nullptr;
    const T* middle = nullptr; ///< (n_cosines, padded to blocks) of the middle row, odd n_rows
};

template <class T>
struct SubapertureKernels {
    int lanes;
    int cosines_per_block;

    /// profiles: (antennas_per_group, line). scratch: (antennas_per_group, 4, n_pairs).
    void (*focus_profiles)(const RangeTables<T>& tables, const FocusGroup<T>& group, T* scratch,
                           T* profiles);

    /// lattice[i, j] += h[i] v[j] profile, rows of the lattice row_stride apart.
    void (*spread)(const T* profile, index_t line, const T* h, int n_h, const T* v, int n_v,
                   index_t row_stride, T* lattice);

    /// Folds rows of the given width in place.
    void (*fold)(T* rows, index_t n_rows, index_t row_stride, index_t width);

    /// out(u) = sum over rows of row exp(-j u x), n_lines lines of complex values a row.
    void (*axis_sum)(const AxisSum<T>& axis, const T* rows, index_t row_stride, index_t n_lines,
                     index_t n_ranges, T* out, index_t out_stride);

    /// The same for one line a row; out: magnitudes, (count, n_ranges).
    void (*axis_magnitude)(const AxisSum<T>& axis, const T* rows, index_t row_stride,
                           index_t n_ranges, T* out);

    /// Of each column, the value of rank n_rows / 2 from 0, and the one before it (if there is
    /// one). columns: not negative, (n_rows, width), width a multiple of the lanes.
    void (*middle_values)(const T* columns, index_t n_rows, index_t width, T* middle, T* before);
};

} // namespace geraf2::detail
