// SPDX-License-Identifier: Apache-2.0
// Antennas of a block, and the nodes from which they are interpolated.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numbers>
#include <span>
#include <vector>

#include "geraf2/physical_optics.hpp"
#include "geraf2/types.hpp"
#include "physical_optics/cells.hpp"

namespace geraf2::detail {

using Vec = Vec3<double>;
inline double dot(const Vec& a, const Vec& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vec load(std::span<const double> rows, index_t row) {
    const auto i = static_cast<std::size_t>(3 * row);
    return {rows[i], rows[i + 1], rows[i + 2]};
}
template <class T>
inline void store(T (&out)[3], const Vec& v, double scale = 1.0) {
    out[0] = static_cast<T>(scale * v.x);
    out[1] = static_cast<T>(scale * v.y);
    out[2] = static_cast<T>(scale * v.z);
}
inline Vec mean_row(std::span<const double> rows, index_t begin, index_t end) {
    Vec sum{};
    for (index_t i = begin; i < end; ++i) {
        const Vec v = load(rows, i);
        sum = {sum.x + v.x, sum.y + v.y, sum.z + v.z};
    }
    const auto n = static_cast<double>(end - begin);
    return {sum.x / n, sum.y / n, sum.z / n};
}

inline double middle_wavenumber(const Waveform& wave) {
    const double middle_hz = 0.5 * (wave.frequency_hz(0) + wave.frequency_hz(wave.n_samples - 1));
    return 2.0 * std::numbers::pi * middle_hz / speed_of_light;
}

// Antennas of a block, and its nodes.
template <class T>
struct Aperture {
    index_t begin, end;
    Vec tx_center, rx_center;
    double half_side_m; // largest offset of a node along a side; 0: no nodes
    Block<T> block;
};

template <class T>
void set_lane(Lanes<T>& lanes, std::size_t l, const Vec& tx, const Vec& rx) {
    const double offsets[2][3] = {{tx.x, tx.y, tx.z}, {rx.x, rx.y, rx.z}};
    for (std::size_t axis = 0; axis < 3; ++axis) {
        lanes.tx[axis][l] = static_cast<T>(offsets[0][axis]);
        lanes.rx[axis][l] = static_cast<T>(offsets[1][axis]);
    }
}

inline Vec minus(const Vec& a, const Vec& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vec cross(const Vec& a, const Vec& b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
inline Vec combine(double p, const Vec& a, double q, const Vec& b) {
    return {p * a.x + q * b.x, p * a.y + q * b.y, p * a.z + q * b.z};
}

// Rectangle across the boresight that holds the antennas' offsets from their centres.
struct Rectangle {
    Vec along[2]; // unit vectors
    double middle[2], half[2];
    [[nodiscard]] double size() const { return half[0] + half[1]; }
    [[nodiscard]] Vec at(double u, double v) const {
        return combine(middle[0] + u * half[0], along[0], middle[1] + v * half[1], along[1]);
    }
};

inline Rectangle smallest_rectangle(const std::vector<Vec>& offsets, const Vec& boresight) {
    const Vec other = std::abs(boresight.z) < 0.5 ? Vec{0.0, 0.0, 1.0} : Vec{1.0, 0.0, 0.0};
    Vec side = cross(boresight, other);
    side = combine(1.0 / std::sqrt(dot(side, side)), side, 0.0, side);
    const Vec up = cross(side, boresight);
    Rectangle best{};
    constexpr int n_turns = 16; // turned by 3 degrees from its sides, it is 5 % too large
    for (int i = 0; i < n_turns; ++i) {
        const double turn = 0.5 * std::numbers::pi * i / n_turns;
        Rectangle found{{combine(std::cos(turn), side, std::sin(turn), up),
                         combine(-std::sin(turn), side, std::cos(turn), up)},
                        {},
                        {}};
        for (int axis = 0; axis < 2; ++axis) {
            double low = std::numeric_limits<double>::infinity();
            double high = -low;
            for (const Vec& offset : offsets) {
                low = std::min(low, dot(offset, found.along[axis]));
                high = std::max(high, dot(offset, found.along[axis]));
            }
            found.middle[axis] = 0.5 * (low + high);
            found.half[axis] = 0.5 * (high - low);
        }
        if (i == 0 || found.size() < best.size()) {
            best = found;
        }
    }
    return best;
}

// Chebyshev nodes, stretched to the ends: what all nodes see through the same sides, all antennas
// do.
inline constexpr double nodes_at[n_nodes] = {-1.0, 1.0 - std::numbers::sqrt2,
                                             std::numbers::sqrt2 - 1.0, 1.0};

inline double node_share(int node, double u) {
    double share = 1.0;
    for (int other = 0; other < n_nodes; ++other) {
        share *= other == node ? 1.0 : (u - nodes_at[other]) / (nodes_at[node] - nodes_at[other]);
    }
    return share;
}

template <class T>
Aperture<T> make_aperture(std::span<const double> tx_rows, std::span<const double> rx_rows,
                          const EchoParams& params, index_t begin, index_t end) {
    Aperture<T> found{begin, end, mean_row(tx_rows, begin, end), mean_row(rx_rows, begin, end),
                      0.0,   {}};
    const auto n_antennas = static_cast<std::size_t>(end - begin);
    std::vector<Vec> tx;
    std::vector<Vec> rx;
    std::vector<Vec> middles;
    for (index_t a = begin; a < end; ++a) {
        tx.push_back(minus(load(tx_rows, a), found.tx_center));
        rx.push_back(minus(load(rx_rows, a), found.rx_center));
        middles.push_back(combine(0.5, tx.back(), 0.5, rx.back()));
    }
    const Rectangle area = smallest_rectangle(middles, params.boresight);
    // Transmitters and receivers must be one raster, for which a quarter of a wave is much:
    // relative to the cell's middle it turns an element of a smooth cell by 0.05 rad. Nor do few
    // antennas need it.
    double off_m = 0.0;
    found.block.groups.resize((n_antennas + n_lanes - 1) / n_lanes);
    for (std::size_t i = 0; i < found.block.groups.size() * n_lanes; ++i) {
        const std::size_t a = std::min(i, n_antennas - 1); // spare lanes repeat the last antenna
        auto& group = found.block.groups[i / n_lanes];
        set_lane(group.lanes, i % n_lanes, tx[a], rx[a]);
        double uv[2];
        for (int axis = 0; axis < 2; ++axis) {
            uv[axis] = (dot(middles[a], area.along[axis]) - area.middle[axis]) /
                       std::max(area.half[axis], 1e-9);
        }
        const Vec place = area.at(uv[0], uv[1]);
        for (const Vec& offset : {minus(tx[a], place), minus(rx[a], place)}) {
            off_m = std::max(off_m, std::sqrt(dot(offset, offset)));
        }
        for (int n = 0; n < n_lanes; ++n) {
            group.shares[n][i % n_lanes] =
                static_cast<T>(node_share(n / n_nodes, uv[0]) * node_share(n % n_nodes, uv[1]));
        }
    }
    for (int n = 0; n < n_lanes; ++n) {
        const Vec place = area.at(nodes_at[n / n_nodes], nodes_at[n % n_nodes]);
        set_lane(found.block.nodes, static_cast<std::size_t>(n), place, place);
    }
    const double wave_m = 2.0 * std::numbers::pi / middle_wavenumber(params.waveform);
    if (sizeof(T) == 4 && n_antennas > 2 * n_lanes && off_m < 0.25 * wave_m) {
        found.half_side_m = std::max(area.half[0], area.half[1]);
    }
    return found;
}

} // namespace geraf2::detail
