// SPDX-License-Identifier: Apache-2.0
#include "geraf2/grid_energy.hpp"

#include <omp.h>

#include <algorithm>
#include <cassert>
#include <cstddef>
#include <cstdlib>
#include <utility>
#include <vector>

#include "common/aligned_buffer.hpp"
#include "grid_energy/kernels.hpp"
#include "simd/dispatch.hpp"

namespace geraf2 {
namespace {

using detail::AlignedBuffer;
using detail::BendingRow;
using detail::GridEnergyKernels;
using detail::row_margin;

std::size_t at(index_t i) noexcept { return static_cast<std::size_t>(i); }

/// Bands of D^T D for the difference D with the given coefficients on a line of n voxels:
/// value of (i, i + d) at [(d + order) n + i].
std::vector<double> gram_bands(index_t n, const std::vector<double>& difference) {
    const auto order = static_cast<index_t>(difference.size()) - 1;
    std::vector<double> bands(at((2 * order + 1) * n), 0.0);
    for (index_t start = 0; start + order < n; ++start) {
        for (index_t a = 0; a <= order; ++a) {
            for (index_t b = 0; b <= order; ++b) {
                bands[at((b - a + order) * n + start + a)] += difference[at(a)] * difference[at(b)];
            }
        }
    }
    return bands;
}

/// What bending needs along one axis, and how many differences of each order fit on a line.
struct Axis {
    std::vector<double> first;  ///< (3, n)
    std::vector<double> second; ///< (5, n)
    index_t n = 0;

    Axis(index_t length, double spacing)
        : first(gram_bands(length, {-1.0 / spacing, 1.0 / spacing})),
          second(gram_bands(length, {1.0 / (spacing * spacing), -2.0 / (spacing * spacing),
                                     1.0 / (spacing * spacing)})),
          n(length) {}

    [[nodiscard]] double first_at(index_t i, int d) const { return first[at((d + 1) * n + i)]; }
    [[nodiscard]] double second_at(index_t i, int d) const { return second[at((d + 2) * n + i)]; }
};

/// Weight of one kind of difference: `count` over its number of stencils.
double mean_weight(double count, index_t n_a, index_t n_b, index_t n_c) {
    const double n = static_cast<double>(n_a) * static_cast<double>(n_b) * static_cast<double>(n_c);
    return n > 0.0 ? count / n : 0.0;
}

template <class T>
std::vector<T> scaled(const std::vector<double>& values, double factor) {
    std::vector<T> out;
    out.reserve(values.size());
    for (const double value : values) {
        out.push_back(static_cast<T>(factor * value));
    }
    return out;
}

/// Neighbour of a line of voxels, in the order of BendingRow::rows.
struct Neighbor {
    int x, y;
};
constexpr Neighbor neighbors[detail::n_stencil_rows] = {
    {0, 0},  {-1, 0}, {1, 0},   {0, -1}, {0, 1},  {-2, 0}, {2, 0},
    {0, -2}, {0, 2},  {-1, -1}, {-1, 1}, {1, -1}, {1, 1}};

} // namespace

template <class T>
struct GridEnergy<T>::Impl {
    index_t nx, ny, nz;
    Axis x, y, z;
    double xx, yy, zz, xy, xz, yz; ///< weights of the six kinds of second derivatives
    std::vector<T> first_z, second_z;
    std::vector<T> diagonal; ///< without bending
    std::vector<T> inverse;  ///< of the whole diagonal
    std::vector<index_t> rows, starts;
    std::vector<std::int32_t> columns;
    std::vector<T> values;
    std::vector<index_t> line_starts; ///< (nx ny + 1), into rows
    std::vector<T> line_weights;      ///< (nx ny, n_stencil_rows + n_mixed_rows)

    Impl(const EnergyGrid& grid, double bending, const SparseRows& sparse,
         std::span<const double> diagonal_values)
        : nx(grid.shape[0]), ny(grid.shape[1]), nz(grid.shape[2]), x(nx, grid.spacing[0]),
          y(ny, grid.spacing[1]), z(nz, grid.spacing[2]), xx(mean_weight(bending, nx - 2, ny, nz)),
          yy(mean_weight(bending, nx, ny - 2, nz)), zz(mean_weight(bending, nx, ny, nz - 2)),
          xy(mean_weight(2.0 * bending, nx - 1, ny - 1, nz)),
          xz(mean_weight(2.0 * bending, nx - 1, ny, nz - 1)),
          yz(mean_weight(2.0 * bending, nx, ny - 1, nz - 1)), first_z(scaled<T>(z.first, 1.0)),
          second_z(scaled<T>(z.second, zz)),
          diagonal(diagonal_values.begin(), diagonal_values.end()),
          rows(sparse.rows.begin(), sparse.rows.end()),
          starts(sparse.starts.begin(), sparse.starts.end()),
          columns(sparse.columns.begin(), sparse.columns.end()),
          values(sparse.values.begin(), sparse.values.end()) {
        for (index_t line = 0; line <= nx * ny; ++line) {
            line_starts.push_back(std::lower_bound(rows.begin(), rows.end(), line * nz) -
                                  rows.begin());
        }
        tabulate_weights();
        tabulate_inverse();
    }

    [[nodiscard]] index_t n_voxels() const noexcept { return nx * ny * nz; }
    /// Threads to start: below 8,192 voxels each they wait longer than they work.
    [[nodiscard]] int useful_threads(int wanted) const noexcept {
        const index_t worth = std::min(nx, n_voxels() / 8192);
        return static_cast<int>(std::clamp<index_t>(worth, 1, wanted));
    }
    /// For each thread: the two rows of bend_row and one of a product.
    [[nodiscard]] std::vector<AlignedBuffer<T>> scratch(int threads) const {
        std::vector<AlignedBuffer<T>> out;
        out.reserve(static_cast<std::size_t>(threads));
        for (int i = 0; i < threads; ++i) {
            out.emplace_back(3 * nz + 4 * row_margin);
        }
        return out;
    }

    /// Weight of a neighbouring line in the pure and mixed terms of x and y.
    [[nodiscard]] double weight(index_t i, index_t j, Neighbor to) const {
        double sum = 0.0;
        sum += to.y == 0 ? xx * x.second_at(i, to.x) : 0.0;
        sum += to.x == 0 ? yy * y.second_at(j, to.y) : 0.0;
        if (std::abs(to.x) <= 1 && std::abs(to.y) <= 1) {
            sum += xy * x.first_at(i, to.x) * y.first_at(j, to.y);
        }
        return sum;
    }

    [[nodiscard]] double mixed_weight(index_t i, index_t j, Neighbor to) const {
        return (to.y == 0 ? xz * x.first_at(i, to.x) : 0.0) +
               (to.x == 0 ? yz * y.first_at(j, to.y) : 0.0);
    }

    void tabulate_weights() {
        for (index_t i = 0; i < nx; ++i) {
            for (index_t j = 0; j < ny; ++j) {
                for (const Neighbor& to : neighbors) {
                    const bool in = inside(i, j, to);
                    line_weights.push_back(in ? static_cast<T>(weight(i, j, to)) : T{});
                }
                for (int r = 0; r < detail::n_mixed_rows; ++r) {
                    const bool in = inside(i, j, neighbors[r]);
                    line_weights.push_back(in ? static_cast<T>(mixed_weight(i, j, neighbors[r]))
                                              : T{});
                }
            }
        }
    }

    void whole_diagonal(std::span<T> out) const {
        for (index_t i = 0; i < nx; ++i) {
            for (index_t j = 0; j < ny; ++j) {
                const double lines = weight(i, j, {0, 0});
                const double mixed = mixed_weight(i, j, {0, 0});
                for (index_t k = 0; k < nz; ++k) {
                    const index_t voxel = (i * ny + j) * nz + k;
                    const double bending =
                        lines + mixed * z.first_at(k, 0) + zz * z.second_at(k, 0);
                    out[at(voxel)] = static_cast<T>(bending) + diagonal[at(voxel)];
                }
            }
        }
        for (std::size_t r = 0; r < rows.size(); ++r) {
            for (index_t entry = starts[r]; entry < starts[r + 1]; ++entry) {
                if (columns[at(entry)] == rows[r]) {
                    out[at(rows[r])] += values[at(entry)];
                }
            }
        }
    }

    void tabulate_inverse() {
        inverse.resize(at(n_voxels()));
        whole_diagonal(inverse);
        for (T& value : inverse) {
            value = value > T{} ? T{1} / value : T{}; // a voxel that nothing holds stays as it is
        }
    }

    [[nodiscard]] bool inside(index_t i, index_t j, Neighbor to) const {
        return i + to.x >= 0 && i + to.x < nx && j + to.y >= 0 && j + to.y < ny;
    }

    [[nodiscard]] BendingRow<T> row(const T* field, index_t i, index_t j) const {
        BendingRow<T> out;
        out.n = nz;
        out.first = first_z.data();
        out.second = second_z.data();
        out.weights =
            line_weights.data() + (i * ny + j) * (detail::n_stencil_rows + detail::n_mixed_rows);
        const bool inner = i >= 2 && i < nx - 2 && j >= 2 && j < ny - 2;
        const T* const middle = field + (i * ny + j) * nz;
        for (int r = 0; r < detail::n_stencil_rows; ++r) {
            const Neighbor to = neighbors[r];
            // Outside, the weight is zero, and any row will do.
            out.rows[r] = inner || inside(i, j, to) ? middle + (to.x * ny + to.y) * nz : middle;
        }
        return out;
    }

    /// product = A field on one line of voxels.
    void line(const GridEnergyKernels<T>& kernel, const T* field, index_t i, index_t j, T* scratch,
              T* product) const {
        kernel.bend_row(row(field, i, j), scratch, product);
        const index_t begin = (i * ny + j) * nz;
        for (index_t k = 0; k < nz; ++k) {
            product[k] += diagonal[at(begin + k)] * field[begin + k];
        }
        for (index_t r = line_starts[at(i * ny + j)]; r < line_starts[at(i * ny + j + 1)]; ++r) {
            T sum{};
            for (index_t entry = starts[at(r)]; entry < starts[at(r + 1)]; ++entry) {
                sum += values[at(entry)] * field[columns[at(entry)]];
            }
            product[rows[at(r)] - begin] += sum;
        }
    }
};

template <class T>
GridEnergy<T>::GridEnergy(const EnergyGrid& grid, double bending, const SparseRows& sparse,
                          std::span<const double> diagonal)
    : impl_(std::make_unique<Impl>(grid, bending, sparse, diagonal)) {
    assert(static_cast<index_t>(diagonal.size()) == impl_->n_voxels());
}

template <class T>
GridEnergy<T>::~GridEnergy() = default;
template <class T>
GridEnergy<T>::GridEnergy(GridEnergy&&) noexcept = default;
template <class T>
GridEnergy<T>& GridEnergy<T>::operator=(GridEnergy&&) noexcept = default;

template <class T>
void GridEnergy<T>::apply(std::span<const T> field, std::span<T> product, int num_threads) const {
    const Impl& s = *impl_;
    const auto& kernel = detail::kernels_for_cpu<GridEnergyKernels<T>>();
    const int threads = s.useful_threads(num_threads);
    auto scratch = s.scratch(threads);
#pragma omp parallel for num_threads(threads) schedule(static)
    for (index_t i = 0; i < s.nx; ++i) {
        T* const own = scratch[at(omp_get_thread_num())].data();
        for (index_t j = 0; j < s.ny; ++j) {
            s.line(kernel, field.data(), i, j, own, product.data() + (i * s.ny + j) * s.nz);
        }
    }
}

template <class T>
void GridEnergy<T>::diagonal(std::span<T> values) const {
    impl_->whole_diagonal(values);
}

template <class T>
void GridEnergy<T>::smooth(std::span<const T> right, const ChebyshevSteps& steps, int num_threads,
                           std::span<T> field) const {
    const Impl& s = *impl_;
    const auto& kernel = detail::kernels_for_cpu<GridEnergyKernels<T>>();
    const index_t n = s.n_voxels();
    const int threads = s.useful_threads(num_threads);
    auto scratch = s.scratch(threads);
    auto change = AlignedBuffer<T>::uninitialised(n);
    auto moved = AlignedBuffer<T>::uninitialised(n);
    // The three-term recurrence of Saad, Iterative methods for sparse linear systems, 2003,
    // algorithm 12.1.
    const double theta = 0.5 * (steps.high + steps.low);
    const double delta = 0.5 * (steps.high - steps.low);
    const double sigma = theta / delta;
    double rho = 1.0 / sigma;
    T* from = field.data();
    T* to = moved.data();
    for (int step = 0; step < steps.degree; ++step) {
        const double next = step == 0 ? rho : 1.0 / (2.0 * sigma - rho);
        const auto momentum = static_cast<T>(step == 0 ? 0.0 : next * rho);
        const auto length = static_cast<T>(step == 0 ? 1.0 / theta : 2.0 * next / delta);
        rho = next;
#pragma omp parallel for num_threads(threads) schedule(static)
        for (index_t i = 0; i < s.nx; ++i) {
            T* const own = scratch[at(omp_get_thread_num())].data();
            T* const product = own + 2 * (s.nz + 2 * row_margin);
            if (step == 0) { // here and not before, by the thread that continues with it
                std::fill_n(change.data() + i * s.ny * s.nz, s.ny * s.nz, T{});
            }
            for (index_t j = 0; j < s.ny; ++j) {
                const index_t begin = (i * s.ny + j) * s.nz;
                s.line(kernel, from, i, j, own, product);
                kernel.smooth_row({product, right.data() + begin, s.inverse.data() + begin,
                                   from + begin, momentum, length},
                                  s.nz, change.data() + begin, to + begin);
            }
        }
        std::swap(from, to);
    }
    if (from != field.data()) {
        std::copy_n(from, n, field.data());
    }
}

template class GridEnergy<float>;
template class GridEnergy<double>;

} // namespace geraf2
