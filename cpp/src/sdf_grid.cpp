// SPDX-License-Identifier: Apache-2.0
#include "geraf2/sdf_grid.hpp"

#include <algorithm>
#include <cmath>

namespace geraf2 {
namespace {

/// Weights along one axis: of the value, of its first and of its second derivative.
struct Taps {
    int n = 2;
    index_t at[4] = {};
    double weight[3][4] = {};

    Taps(double place, index_t length, double spacing, GridInterpolation interpolation) noexcept {
        const auto last = static_cast<double>(length - 1);
        const double p = std::clamp(place, 0.0, last);
        const auto cell = static_cast<index_t>(std::min(std::floor(p), std::max(last - 1.0, 0.0)));
        const double f = p - static_cast<double>(cell);
        if (interpolation == GridInterpolation::linear) {
            set(0, {1.0 - f, f}, {-1.0, 1.0}, {0.0, 0.0});
        } else {
            n = 4;
            set(0, {0.5 * f * (f * (2.0 - f) - 1.0), 1.0 + 0.5 * f * f * (3.0 * f - 5.0)},
                {0.5 * (f * (4.0 - 3.0 * f) - 1.0), 0.5 * f * (9.0 * f - 10.0)},
                {2.0 - 3.0 * f, 9.0 * f - 5.0});
            set(2, {0.5 * f * (1.0 + f * (4.0 - 3.0 * f)), 0.5 * f * f * (f - 1.0)},
                {0.5 * (1.0 + f * (8.0 - 9.0 * f)), 0.5 * f * (3.0 * f - 2.0)},
                {4.0 - 9.0 * f, 3.0 * f - 1.0});
        }
        const bool inside = place >= 0.0 && place <= last;
        const index_t first = cell - (n == 4 ? 1 : 0);
        for (int i = 0; i < n; ++i) {
            at[i] = std::clamp<index_t>(first + i, 0, length - 1);
            weight[1][i] *= inside ? 1.0 / spacing : 0.0;
            weight[2][i] *= inside ? 1.0 / (spacing * spacing) : 0.0;
        }
    }

private:
    struct Pair {
        double low, high;
    };
    void set(int i, Pair value, Pair slope, Pair curvature) noexcept {
        const Pair pairs[] = {value, slope, curvature};
        for (int k = 0; k < 3; ++k) {
            weight[k][i] = pairs[k].low;
            weight[k][i + 1] = pairs[k].high;
        }
    }
};

Taps taps_of(const VoxelGrid& grid, const double* point, std::size_t axis,
             GridInterpolation interpolation) noexcept {
    return {(point[axis] - grid.origin[axis]) / grid.spacing, grid.shape[axis], grid.spacing,
            interpolation};
}

/// Derivatives of order i, j, k along x, y and z with i + j + k <= 2, as sum[i][j][k].
template <class T>
void interpolate(const T* values, const VoxelGrid& grid, const Taps& x, const Taps& y,
                 const Taps& z, double (&sum)[3][3][3]) noexcept {
    for (int a = 0; a < x.n; ++a) {
        double plane[3][3] = {};
        for (int b = 0; b < y.n; ++b) {
            const T* row = values + (x.at[a] * grid.shape[1] + y.at[b]) * grid.shape[2];
            double line[3] = {};
            for (int c = 0; c < z.n; ++c) {
                const auto v = static_cast<double>(row[z.at[c]]);
                for (int k = 0; k < 3; ++k) {
                    line[k] += z.weight[k][c] * v;
                }
            }
            for (int j = 0; j < 3; ++j) {
                for (int k = 0; j + k < 3; ++k) {
                    plane[j][k] += y.weight[j][b] * line[k];
                }
            }
        }
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; i + j < 3; ++j) {
                for (int k = 0; i + j + k < 3; ++k) {
                    sum[i][j][k] += x.weight[i][a] * plane[j][k];
                }
            }
        }
    }
}

} // namespace

template <class T>
void sdf_grid_fwd(std::span<const T> values, const VoxelGrid& grid, std::span<const double> points,
                  GridInterpolation interpolation, int num_threads, const GridSamples<T>& out) {
    const auto n_points = static_cast<index_t>(points.size() / 3);
#pragma omp parallel for num_threads(num_threads) schedule(static)
    for (index_t point = 0; point < n_points; ++point) {
        const double* at = points.data() + 3 * point;
        double sum[3][3][3] = {};
        interpolate(values.data(), grid, taps_of(grid, at, 0, interpolation),
                    taps_of(grid, at, 1, interpolation), taps_of(grid, at, 2, interpolation), sum);
        if (!out.value.empty()) {
            out.value[static_cast<std::size_t>(point)] = static_cast<T>(sum[0][0][0]);
        }
        if (!out.gradient.empty()) {
            const double gradient[] = {sum[1][0][0], sum[0][1][0], sum[0][0][1]};
            std::transform(gradient, gradient + 3, out.gradient.begin() + 3 * point,
                           [](double v) { return static_cast<T>(v); });
        }
        if (!out.hessian.empty()) {
            const double hessian[] = {sum[2][0][0], sum[1][1][0], sum[1][0][1],
                                      sum[0][2][0], sum[0][1][1], sum[0][0][2]};
            std::transform(hessian, hessian + 6, out.hessian.begin() + 6 * point,
                           [](double v) { return static_cast<T>(v); });
        }
    }
}

template <class T>
void sdf_grid_bwd(std::span<const T> value_grad, std::span<const T> gradient_grad,
                  const VoxelGrid& grid, std::span<const double> points,
                  GridInterpolation interpolation, int num_threads, std::span<T> values_grad) {
    const auto n_points = static_cast<index_t>(points.size() / 3);
    const index_t n_slabs = std::clamp<index_t>(grid.shape[0], 1, num_threads);
    // Each thread owns a slab of the grid and sees all points in their order: every voxel is summed
    // in that order, whatever the number of threads.
#pragma omp parallel for num_threads(num_threads) schedule(static)
    for (index_t slab = 0; slab < n_slabs; ++slab) {
        const index_t begin = slab * grid.shape[0] / n_slabs;
        const index_t end = (slab + 1) * grid.shape[0] / n_slabs;
        for (index_t point = 0; point < n_points; ++point) {
            const double* at = points.data() + 3 * point;
            const Taps x = taps_of(grid, at, 0, interpolation);
            if (x.at[x.n - 1] < begin || x.at[0] >= end) {
                continue;
            }
            const Taps y = taps_of(grid, at, 1, interpolation);
            const Taps z = taps_of(grid, at, 2, interpolation);
            const auto i = static_cast<std::size_t>(point);
            const double g = value_grad.empty() ? 0.0 : static_cast<double>(value_grad[i]);
            double d[3] = {};
            for (std::size_t axis = 0; axis < 3 && !gradient_grad.empty(); ++axis) {
                d[axis] = static_cast<double>(gradient_grad[3 * i + axis]);
            }
            for (int a = 0; a < x.n; ++a) {
                if (x.at[a] < begin || x.at[a] >= end) {
                    continue;
                }
                const double of_value = g * x.weight[0][a] + d[0] * x.weight[1][a];
                for (int b = 0; b < y.n; ++b) {
                    T* row =
                        values_grad.data() + (x.at[a] * grid.shape[1] + y.at[b]) * grid.shape[2];
                    const double even =
                        of_value * y.weight[0][b] + d[1] * x.weight[0][a] * y.weight[1][b];
                    const double odd = d[2] * x.weight[0][a] * y.weight[0][b];
                    for (int c = 0; c < z.n; ++c) {
                        row[z.at[c]] +=
                            static_cast<T>(even * z.weight[0][c] + odd * z.weight[1][c]);
                    }
                }
            }
        }
    }
}

template void sdf_grid_fwd<float>(std::span<const float>, const VoxelGrid&, std::span<const double>,
                                  GridInterpolation, int, const GridSamples<float>&);
template void sdf_grid_fwd<double>(std::span<const double>, const VoxelGrid&,
                                   std::span<const double>, GridInterpolation, int,
                                   const GridSamples<double>&);
template void sdf_grid_bwd<float>(std::span<const float>, std::span<const float>, const VoxelGrid&,
                                  std::span<const double>, GridInterpolation, int,
                                  std::span<float>);
template void sdf_grid_bwd<double>(std::span<const double>, std::span<const double>,
                                   const VoxelGrid&, std::span<const double>, GridInterpolation,
                                   int, std::span<double>);

} // namespace geraf2
