// SPDX-License-Identifier: Apache-2.0
// One scattering element against the antennas of a block, n_lanes of them side by side: the
// arithmetic of physical_optics.cpp, compiled once per instruction set.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <vector>

#include "geraf2/physical_optics.hpp"
#include "geraf2/types.hpp"

#if defined(__GNUC__)
#define GERAF2_INLINE [[gnu::always_inline]] inline
#else
#define GERAF2_INLINE inline
#endif

namespace geraf2::detail {

inline constexpr int n_lanes =
    16; // antennas side by side: two AVX2 or one AVX-512 register of float

// Elements of one block that are not hidden, seen from the block's centre.
template <class T>
struct Element {
    T from_tx[3], from_rx[3]; // element minus centre of the block's transmitters, receivers [m]
    T range_tx, range_rx;     // their lengths [m]
    T lead;                   // path to the block's centres less the cell's reference path [m]
    T normal[3];
    T position[3];          // [m]
    T edge_1[3], edge_2[3]; // half sides of a rectangle times 2 pi f_mid / c [rad per unit slope]
    T weight_re, weight_im;
};

template <class T>
struct Wall {
    T center[3], half[3], thickness;
    T contrast, inverse_contrast; // permittivity - 1, and its inverse; 0 of air
};

template <class T>
struct Constants {
    T turns_per_m;                         // at mid-band
    T turns_start_per_m, turns_step_per_m; // at sample 0, and per sample
    T radians_per_m;                       // last sample less mid-band
    T slab_contrast, inverse_slab_contrast, slab_thickness;
    T slab_crossings; // of two
    T boresight[3];
    T detune;    // (f - f_mid) / f_mid at the last sample
    T curvature; // 1 / (6 (2 pi f_mid / c)^2): edges are stored times 2 pi f_mid / c
    bool has_normals, has_edges;
    int n_faces; // 2 of a slab
    int pattern_exponent;
    index_t n_samples;
};

template <class T>
struct Lanes {
    T tx[3][n_lanes], rx[3][n_lanes]; // offset from the block's centres [m]
};

// sin and cos of 2 pi x. Taylor to x^12 at half the angle, |x / 2| <= 1/4 turn: error 6e-8.
template <class T>
GERAF2_INLINE void sincos_turns(T x, T& sine, T& cosine) {
    if constexpr (sizeof(T) == 4) {
        // Rounds to nearest by pushing the fraction out of the mantissa; |x| < 2^22.
        constexpr T magic = T(12582912);
        const T whole = (x + magic) - magic;
        const T y = (x - whole) * std::numbers::pi_v<T>;
        const T y2 = y * y;
        const T s =
            y * (T(1) + y2 * (T(-1.0 / 6) +
                              y2 * (T(1.0 / 120) +
                                    y2 * (T(-1.0 / 5040) +
                                          y2 * (T(1.0 / 362880) + y2 * T(-1.0 / 39916800))))));
        const T c =
            T(1) +
            y2 * (T(-0.5) + y2 * (T(1.0 / 24) +
                                  y2 * (T(-1.0 / 720) +
                                        y2 * (T(1.0 / 40320) + y2 * (T(-1.0 / 3628800) +
                                                                     y2 * T(1.0 / 479001600))))));
        sine = T(2) * s * c;
        cosine = T(1) - T(2) * s * s;
    } else {
        const T angle = (x - std::round(x)) * (T(2) * std::numbers::pi_v<T>);
        sine = std::sin(angle);
        cosine = std::cos(angle);
    }
}

// sinc a = sin a / a, and a d(sinc a)/da = cos a - sinc a.
template <class T>
GERAF2_INLINE void sinc_and_slope(T radians, T& value, T& slope) {
    T sine;
    T cosine;
    sincos_turns(radians * (T(0.5) / std::numbers::pi_v<T>), sine, cosine);
    // Below 0.03 rad the series is exact to 1e-7, and 0/0 is avoided.
    const bool small = std::abs(radians) < T(0.03);
    const T safe = small ? T(1) : radians;
    value = small ? T(1) - radians * radians / T(6) : sine / safe;
    slope = cosine - value;
}

// One end (transmitter or receiver) of all lanes, seen from an element.
template <class T>
struct End {
    T along[3][n_lanes]; // antenna minus element [m]
    T inverse[n_lanes];  // 1 / its length
    T growth[n_lanes];   // its length minus that from the block's centre [m]
};

template <class T>
GERAF2_INLINE T squared(const T (&v)[3]) {
    return v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
}

template <class T>
GERAF2_INLINE void look_from(const T (&offset)[3][n_lanes], const T (&from)[3], T range,
                             End<T>& end) {
#pragma omp simd
    for (int l = 0; l < n_lanes; ++l) {
        // R = |o - v|, R^2 - R_c^2 = o . (o - 2 v): no cancellation in the difference of paths.
        const T x = offset[0][l];
        const T y = offset[1][l];
        const T z = offset[2][l];
        const T grow =
            x * (x - T(2) * from[0]) + y * (y - T(2) * from[1]) + z * (z - T(2) * from[2]);
        const T along[3] = {x - from[0], y - from[1], z - from[2]};
        // Not from grow: where antennas lie much farther apart than the element is, that cancels.
        const T length = std::sqrt(squared(along));
        const T both = length + range;
        const T share = T(1) / (length * both); // one quotient, as it costs twenty products
        end.growth[l] = grow * length * share;
        end.inverse[l] = both * share;
        end.along[0][l] = along[0];
        end.along[1][l] = along[1];
        end.along[2][l] = along[2];
    }
}

// Cosine between a direction and the unit vectors to the antennas.
template <class T>
GERAF2_INLINE T cosine_to(const T (&direction)[3], const End<T>& end, int l) {
    return (direction[0] * end.along[0][l] + direction[1] * end.along[1][l] +
            direction[2] * end.along[2][l]) *
           end.inverse[l];
}

// One crossing of a wall at a cosine of incidence; `met` is 1, or 0 for none.
template <class T>
GERAF2_INLINE void cross_face(const Wall<T>& wall, T cosine, T met, T& path, T& amplitude) {
    const T bend = std::sqrt(wall.contrast + cosine * cosine) - cosine;
    // r = (c - q) / (c + q) = -(q - c)^2 / (permittivity - 1), without the quotient
    const T r = bend * bend * wall.inverse_contrast;
    path += met * wall.thickness * bend;
    amplitude *= T(1) - met * r * r;
}

// Whether all lanes hold the same.
template <class T>
GERAF2_INLINE bool all_same(const T* values) {
    T spread = T(0);
#pragma omp simd reduction(+ : spread)
    for (int l = 0; l < n_lanes; ++l) {
        spread += std::abs(values[l] - values[0]);
    }
    return spread == T(0);
}

// Whether all ends lie beyond the side of the wall that the element lies beyond: no ray crosses it.
template <class T>
GERAF2_INLINE bool stays_outside(const Wall<T>& wall, const T (&at)[3], const End<T>& end) {
    for (int axis = 0; axis < 3; ++axis) {
        const T side = at[axis] < T(0) ? T(-1) : T(1);
        T count = T(0);
#pragma omp simd reduction(+ : count)
        for (int l = 0; l < n_lanes; ++l) {
            count += side * (at[axis] + end.along[axis][l]) > wall.half[axis] ? T(1) : T(0);
        }
        if (side * at[axis] > wall.half[axis] && count == T(n_lanes)) {
            return true;
        }
    }
    return false;
}

// Wall crossed between the element and one end: excess path added, transmission multiplied. Returns
// whether all rays cross the same sides.
template <class T>
GERAF2_INLINE bool cross_wall(const Wall<T>& wall, const Element<T>& element, const End<T>& end,
                              T* path, T* amplitude) {
    constexpr T tiny = T(1e-20); // keeps 0/0 out of a ray along a wall
    alignas(64) T crossed[n_lanes];
    T at[3];
    bool inside = true;
    for (int axis = 0; axis < 3; ++axis) {
        at[axis] = element.position[axis] - wall.center[axis];
        inside = inside && std::abs(at[axis]) < wall.half[axis];
    }
    if (inside) { // the ray can only leave, by the side that it meets first
#pragma omp simd
        for (int l = 0; l < n_lanes; ++l) {
            T room = T(1);
            T size = T(0); // room / size is the share of the ray up to the side
            T side = T(0);
            for (int axis = 0; axis < 3; ++axis) {
                const T d = end.along[axis][l];
                const T one = std::abs(d);
                const T left = wall.half[axis] - (d < T(0) ? -at[axis] : at[axis]);
                const bool nearer = left * size < room * one;
                room = nearer ? left : room;
                size = nearer ? one : size;
                side = nearer ? T(2 * axis + 1) + (d < T(0) ? T(1) : T(0)) : side;
            }
            const T leaves = room < size ? T(1) : T(0);
            crossed[l] = leaves * side;
            cross_face(wall, size * end.inverse[l], leaves, path[l], amplitude[l]);
        }
        return all_same(crossed);
    }
    if (stays_outside(wall, at, end)) {
        return true;
    }
#pragma omp simd
    for (int l = 0; l < n_lanes; ++l) {
        T near = T(-1e30);
        T far = T(1e30);
        T near_size = T(0);
        T far_size = T(0);
        T near_side = T(0);
        T far_side = T(0);
        for (int axis = 0; axis < 3; ++axis) {
            const T d = end.along[axis][l] == T(0) ? tiny : end.along[axis][l];
            const T inverse = T(1) / d;
            const T one = (-wall.half[axis] - at[axis]) * inverse;
            const T two = (wall.half[axis] - at[axis]) * inverse;
            const T low = one < two ? one : two;
            const T high = one < two ? two : one;
            const T size = std::abs(d);
            const T side = T(2 * axis + 1) + (d < T(0) ? T(1) : T(0));
            near_size = low > near ? size : near_size;
            near_side = low > near ? side : near_side;
            near = low > near ? low : near;
            far_size = high < far ? size : far_size;
            far_side = high < far ? side : far_side;
            far = high < far ? high : far;
        }
        const T meets = far > near ? T(1) : T(0);
        const T enters = (near > T(0) ? meets : T(0)) * (near < T(1) ? T(1) : T(0));
        const T leaves = (far > T(0) ? meets : T(0)) * (far < T(1) ? T(1) : T(0));
        crossed[l] = enters * near_side + T(8) * leaves * far_side;
        cross_face(wall, near_size * end.inverse[l], enters, path[l], amplitude[l]);
        cross_face(wall, far_size * end.inverse[l], leaves, path[l], amplitude[l]);
    }
    return all_same(crossed);
}

// The farther face of a slab against the nearer one.
template <class T>
struct Farther {
    T amplitude[n_lanes], delay[n_lanes]; // [m]
};

// Obliquity and reflection coefficient of the element. Returns the number of lanes that it faces.
template <class T>
GERAF2_INLINE T reflect(const Element<T>& e, const Constants<T>& c, const End<T>& tx,
                        const End<T>& rx, T* amplitude, Farther<T>& farther) {
    alignas(64) T cosine[n_lanes];
    T n_lit = T(0);
#pragma omp simd reduction(+ : n_lit)
    for (int l = 0; l < n_lanes; ++l) {
        const T cos_tx = cosine_to(e.normal, tx, l);
        const T cos_rx = cosine_to(e.normal, rx, l);
        const T lit = (cos_tx > T(0) ? T(1) : T(0)) * (cos_rx > T(0) ? T(1) : T(0));
        cosine[l] = T(0.5) * (cos_tx + cos_rx);
        amplitude[l] *= lit * cosine[l];
        n_lit += lit;
    }
    if (c.n_faces == 1 || n_lit == T(0)) {
        return n_lit;
    }
#pragma omp simd
    for (int l = 0; l < n_lanes; ++l) {
        const T q = std::sqrt(c.slab_contrast + cosine[l] * cosine[l]);
        const T bend = q - cosine[l];
        const T r = -bend * bend * c.inverse_slab_contrast; // see cross_face
        // The conductor's -1 is in the amplitude already.
        amplitude[l] *= -r;
        farther.amplitude[l] = (r * r - T(1)) * c.slab_crossings;
        farther.delay[l] = T(2) * c.slab_thickness * q;
    }
    return n_lit;
}

// How an element is seen over a block.
enum class View { dark, smooth, broken };

// One face in all lanes: its phasor at mid-band relative to the cell's middle, and the change of
// its phase over half the band.
template <class T>
struct Wave {
    T re[n_lanes], im[n_lanes];
    T radians[n_lanes];
};

// One element in all lanes: its faces, its gain, and the change of that over half the band.
template <class T>
struct Phasors {
    Wave<T> waves[2]; // of both faces of a slab, else one
    T gain[n_lanes], slope[n_lanes];
};

template <class T>
GERAF2_INLINE void start_wave(const Element<T>& e, const Constants<T>& c, const T* path,
                              const T* amplitude, const T* middle, Wave<T>& wave) {
#pragma omp simd
    for (int l = 0; l < n_lanes; ++l) {
        T sine;
        T cosine;
        const T more = e.lead + path[l] - middle[l];
        sincos_turns(more * c.turns_per_m, sine, cosine);
        wave.re[l] = amplitude[l] * (e.weight_re * cosine - e.weight_im * sine);
        wave.im[l] = amplitude[l] * (e.weight_re * sine + e.weight_im * cosine);
        wave.radians[l] = more * c.radians_per_m;
    }
}

// middle: growth of the path to the cell's middle, (n_lanes) [m]. Broken where some lanes see
// another side of the element, or through another side of a wall, than others.
template <class T>
GERAF2_INLINE View start_phasors(const Element<T>& e, const Lanes<T>& lanes,
                                 const std::vector<Wall<T>>& walls, const Constants<T>& c,
                                 const T* middle, Phasors<T>& out) {
    alignas(64) End<T> tx;
    alignas(64) End<T> rx;
    alignas(64) T path[n_lanes];
    alignas(64) T amplitude[n_lanes];
    alignas(64) Farther<T> farther;
    look_from(lanes.tx, e.from_tx, e.range_tx, tx);
    look_from(lanes.rx, e.from_rx, e.range_rx, rx);
#pragma omp simd
    for (int l = 0; l < n_lanes; ++l) {
        path[l] = tx.growth[l] + rx.growth[l];
        amplitude[l] = -tx.inverse[l] * rx.inverse[l];
    }
    bool same = true;
    if (c.has_normals) {
        const T n_lit = reflect(e, c, tx, rx, amplitude, farther);
        if (n_lit == T(0)) {
            return View::dark;
        }
        same = n_lit == T(n_lanes);
    }
    if (c.has_edges) {
        const T length_2 = squared(e.edge_1) + squared(e.edge_2);
#pragma omp simd
        for (int l = 0; l < n_lanes; ++l) {
            const T tx_1 = cosine_to(e.edge_1, tx, l);
            const T tx_2 = cosine_to(e.edge_2, tx, l);
            const T rx_1 = cosine_to(e.edge_1, rx, l);
            const T rx_2 = cosine_to(e.edge_2, rx, l);
            T one;
            T two;
            T slope_1;
            T slope_2;
            sinc_and_slope(tx_1 + rx_1, one, slope_1);
            sinc_and_slope(tx_2 + rx_2, two, slope_2);
            // Linear in frequency: the null at mid-band would else be one at every frequency, and
            // patches of 8 mm would leave 12 % of a wall's specular return where they add up in
            // phase.
            const T slope = one * slope_2 + two * slope_1;
            out.gain[l] = one * two;
            out.slope[l] = slope * c.detune;
            // Mean of the quadratic part of the path: 0.07 rad for 8 mm patches at 0.25 m.
            path[l] += c.curvature * ((length_2 - tx_1 * tx_1 - tx_2 * tx_2) * tx.inverse[l] +
                                      (length_2 - rx_1 * rx_1 - rx_2 * rx_2) * rx.inverse[l]);
        }
    }
    for (int n = 0; n < c.pattern_exponent; ++n) {
#pragma omp simd
        for (int l = 0; l < n_lanes; ++l) {
            const T aim_tx = -cosine_to(c.boresight, tx, l);
            const T aim_rx = -cosine_to(c.boresight, rx, l);
            amplitude[l] *= (aim_tx > T(0) ? aim_tx : T(0)) * (aim_rx > T(0) ? aim_rx : T(0));
        }
    }
    for (const Wall<T>& wall : walls) {
        same = cross_wall(wall, e, tx, path, amplitude) && same;
        same = cross_wall(wall, e, rx, path, amplitude) && same;
    }
    start_wave(e, c, path, amplitude, middle, out.waves[0]);
    if (c.n_faces == 2) {
        for (int l = 0; l < n_lanes; ++l) {
            path[l] += farther.delay[l];
            amplitude[l] *= farther.amplitude[l];
        }
        start_wave(e, c, path, amplitude, middle, out.waves[1]);
    }
    return same ? View::smooth : View::broken;
}

} // namespace geraf2::detail
