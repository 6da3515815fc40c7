// SPDX-License-Identifier: Apache-2.0
#include "geraf2/pair_density.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>

namespace geraf2 {
namespace {

using Triple = std::array<double, 3>;

Triple triple(std::span<const double> rows, index_t row) noexcept {
    const auto at = static_cast<std::size_t>(3 * row);
    return {rows[at], rows[at + 1], rows[at + 2]};
}

double dot(const Triple& a, const Triple& b) noexcept {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/// Points in cells of the reach's length, those of a row of cells along z one after the other.
class Cells {
public:
    using Cell = std::array<index_t, 3>;

    Cells(std::span<const double> positions, double side) : side_(side) {
        const auto n_points = static_cast<index_t>(positions.size() / 3);
        sorted_.reserve(static_cast<std::size_t>(n_points));
        for (index_t point = 0; point < n_points; ++point) {
            sorted_.emplace_back(key(cell_of(triple(positions, point))), point);
        }
        std::sort(sorted_.begin(), sorted_.end());
    }

    /// Calls visit(point) for all points of the cells around a position.
    template <class Visit>
    void around(const Triple& position, Visit visit) const {
        const Cell middle = cell_of(position);
        for (index_t x = middle[0] - 1; x <= middle[0] + 1; ++x) {
            for (index_t y = middle[1] - 1; y <= middle[1] + 1; ++y) {
                const std::pair first{key({x, y, middle[2] - 1}), index_t{0}};
                const index_t last = key({x, y, middle[2] + 1});
                for (auto at = std::lower_bound(sorted_.begin(), sorted_.end(), first);
                     at != sorted_.end() && at->first <= last; ++at) {
                    visit(at->second);
                }
            }
        }
    }

private:
    static constexpr index_t n_a_side = 1'000'000;

    /// Farther cells are one with the last one, which costs time and changes nothing.
    [[nodiscard]] Cell cell_of(const Triple& position) const noexcept {
        constexpr double most = 0.5 * static_cast<double>(n_a_side) - 2.0;
        Cell cell{};
        for (std::size_t axis = 0; axis < 3; ++axis) {
            const double number = std::floor(position[axis] / side_);
            cell[axis] = static_cast<index_t>(std::clamp(number, -most, most) + most) + 1;
        }
        return cell;
    }

    static index_t key(const Cell& cell) noexcept {
        return (cell[0] * n_a_side + cell[1]) * n_a_side + cell[2];
    }

    double side_;
    std::vector<std::pair<index_t, index_t>> sorted_; // key of the cell, point
};

/// Density of a point at a step from another, whose normals have a cosine and a sum.
double density_of(const Triple& step, double square, const Triple& sum, double cosine,
                  const PairModel& model) noexcept {
    constexpr double turn = 2.0 * std::numbers::pi;
    const double along = dot(step, sum);
    const double offset2 = along * along / (2.0 + 2.0 * cosine);
    const double s_offset2 =
        model.offset_variance + model.bend * model.bend * square * square * square;
    const double s_turn2 = model.turn_variance + model.curvature * model.curvature * square;
    const double spread2 = model.spread * model.spread;
    const double exponent = offset2 / s_offset2 + std::max(2.0 - 2.0 * cosine, 0.0) / s_turn2 +
                            std::max(square - offset2, 0.0) / spread2;
    return std::exp(-0.5 * exponent) /
           (std::sqrt(turn * s_offset2) * (turn * s_turn2) * turn * spread2);
}

} // namespace

PairRows pair_densities(const PeakPoints& points, const PeakPoints& others,
                        const PairModel& model) {
    const Cells cells(others.positions, model.reach);
    const auto n_points = static_cast<index_t>(points.planes.size());
    const auto n_others = static_cast<index_t>(others.planes.size());
    PairRows rows;
    rows.starts.push_back(0);
    for (index_t i = 0; i < n_points; ++i) {
        const Triple position = triple(points.positions, i);
        const Triple normal = triple(points.normals, i);
        const auto own = static_cast<std::size_t>(i);
        cells.around(position, [&](index_t j) {
            const auto other = static_cast<std::size_t>(j);
            const Triple to = triple(others.positions, j);
            const Triple step{to[0] - position[0], to[1] - position[1], to[2] - position[2]};
            const double square = dot(step, step);
            const Triple facing = triple(others.normals, j);
            const double cosine = dot(normal, facing);
            if (square > model.reach * model.reach || !(cosine > model.least_cosine) ||
                points.subapertures[own] == others.subapertures[other]) {
                return;
            }
            const Triple sum{normal[0] + facing[0], normal[1] + facing[1], normal[2] + facing[2]};
            const double density = density_of(step, square, sum, cosine, model);
            if (density > model.least_density) {
                const bool is_own = points.planes[own] == others.planes[other];
                rows.columns.push_back(static_cast<std::int32_t>(j + (is_own ? n_others : 0)));
                rows.densities.push_back(density);
            }
        });
        rows.starts.push_back(static_cast<index_t>(rows.columns.size()));
    }
    return rows;
}

} // namespace geraf2
