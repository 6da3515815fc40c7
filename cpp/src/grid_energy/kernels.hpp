// SPDX-License-Identifier: Apache-2.0
// Interface between grid_energy.cpp (portable) and the row loops (one copy per instruction set).
#pragma once

#include "geraf2/types.hpp"

namespace geraf2::detail {

/// Rows around the middle one: itself, one and two away along x and y, and the four diagonals.
inline constexpr int n_stencil_rows = 13;
/// Rows whose first differences along x or y meet those along z: the middle and its four nearest.
inline constexpr int n_mixed_rows = 5;
/// Zeros on both sides of a padded row.
inline constexpr index_t row_margin = 2;

/// Bending of one line of voxels along z.
template <class T>
struct BendingRow {
    index_t n = 0;                   ///< voxels
    const T* rows[n_stencil_rows]{}; ///< the first n_mixed_rows also enter the mixed terms
    const T* weights = nullptr; ///< of each row, 0 where it lies outside the grid; then those of
                                ///< the n_mixed_rows before the first difference along z
    const T* first = nullptr;   ///< (3, n) squared first difference along z
    const T* second = nullptr;  ///< (5, n) squared second difference along z, weighted
};

/// Inputs and outputs of one Chebyshev step on a row; see `smooth_row`.
template <class T>
struct SmoothRow {
    const T* product = nullptr; ///< (n) A field
    const T* right = nullptr;   ///< (n)
    const T* inverse = nullptr; ///< (n) of the diagonal
    const T* field = nullptr;   ///< (n)
    T momentum{};
    T step{};
};

template <class T>
struct GridEnergyKernels {
    /// product = bending of the row; `scratch`: 2 (n + 2 row_margin), its margins zero.
    void (*bend_row)(const BendingRow<T>& row, T* scratch, T* product);

    /// change = momentum change + step inverse (right - product); moved = field + change.
    void (*smooth_row)(const SmoothRow<T>& row, index_t n, T* change, T* moved);
};

} // namespace geraf2::detail
