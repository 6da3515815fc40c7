// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>

#include "geraf2/types.hpp"

namespace geraf2 {

/// Regular grid of an energy; the last axis runs fastest.
struct EnergyGrid {
    std::array<index_t, 3> shape{};  ///< at least 2 each
    std::array<double, 3> spacing{}; ///< of each axis
};

/// Rows of a sparse symmetric matrix in compressed form; rows that are empty are left out.
struct SparseRows {
    std::span<const index_t> rows;         ///< (n_rows), ascending
    std::span<const index_t> starts;       ///< (n_rows + 1), into columns and values
    std::span<const std::int32_t> columns; ///< (n_entries)
    std::span<const double> values;        ///< (n_entries)
};

/// Weighted Jacobi steps whose weights are those of a Chebyshev polynomial, which is small where
/// the eigenvalues of the scaled matrix lie between low and high.
struct ChebyshevSteps {
    int degree = 1;
    double low = 0.0;
    double high = 0.0;
};

/// Matrix A of a quadratic energy of a field on a grid
/// (docs/math/surface-fit.md#linear-signed-distance):
///
///     A = bending * (mean squared Frobenius norm of the Hessian) + sparse + diagonal
///
/// The Hessian is applied from its stencils: second differences on lines, mixed ones (counted
/// twice) on cell faces, each kind averaged over its own number of stencils; an axis of 2 voxels
/// has no second difference. Every value of a result is summed in one order, so that results do not
/// depend on num_threads, not even in their last bit. T: float or double.
template <class T>
class GridEnergy {
public:
    /// Indices are checked by the caller.
    GridEnergy(const EnergyGrid& grid, double bending, const SparseRows& sparse,
               std::span<const double> diagonal); // (n_voxels)
    ~GridEnergy();
    GridEnergy(GridEnergy&&) noexcept;
    GridEnergy& operator=(GridEnergy&&) noexcept;
    GridEnergy(const GridEnergy&) = delete;
    GridEnergy& operator=(const GridEnergy&) = delete;

    /// product = A field.
    void apply(std::span<const T> field, // (n_voxels)
               std::span<T> product,     // (n_voxels)
               int num_threads) const;

    /// Diagonal of A.
    void diagonal(std::span<T> values) const; // (n_voxels)

    /// Brings `field` nearer to the solution of A field = right.
    void smooth(std::span<const T> right, // (n_voxels)
                const ChebyshevSteps& steps, int num_threads,
                std::span<T> field) const; // (n_voxels), in and out

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

} // namespace geraf2
