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
#include "geraf2/simd.hpp"
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
    T normal[3];
    T position[3];          // [m]
    T edge_1[3], edge_2[3]; // half sides of a rectangle times 2 pi f_mid / c [rad per unit slope]
    T weight_re, weight_im;
    T turns, turns_step; // phase of the reference path at sample 0 and per sample [turns]
};

template <class T>
struct Wall {
    T center[3], half[3], thickness, permittivity;
};

template <class T>
struct Constants {
    T turns_per_m, turns_step_per_m;
    T slab_permittivity, slab_thickness;
    T boresight[3];
    T detune, detune_step; // (f - f_mid) / f_mid at sample 0, and its step
    T curvature;           // 1 / (6 (2 pi f_mid / c)^2): edges are stored times 2 pi f_mid / c
    bool has_normals, has_edges;
    Reflector reflector;
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
    T range[n_lanes];    // its length [m]
    T inverse[n_lanes];  // 1 / range
    T growth[n_lanes];   // range minus the range of the block's centre [m]
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
        end.range[l] = std::sqrt(squared(along));
        end.growth[l] = grow / (end.range[l] + range);
        end.inverse[l] = T(1) / end.range[l];
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

// Wall crossed between the element and one end: excess path added, transmission multiplied.
template <class T>
GERAF2_INLINE void cross_wall(const Wall<T>& wall, const Element<T>& element, const End<T>& end,
                              T* path, T* amplitude) {
    constexpr T tiny = T(1e-20); // keeps 0/0 out of a ray along a wall
    const T contrast = wall.permittivity - T(1);
#pragma omp simd
    for (int l = 0; l < n_lanes; ++l) {
        T near = T(-1e30);
        T far = T(1e30);
        T near_side = T(0);
        T far_side = T(0);
        for (int axis = 0; axis < 3; ++axis) {
            const T d = end.along[axis][l] == T(0) ? tiny : end.along[axis][l];
            const T inverse = T(1) / d;
            const T x = element.position[axis] - wall.center[axis];
            const T one = (-wall.half[axis] - x) * inverse;
            const T two = (wall.half[axis] - x) * inverse;
            const T low = one < two ? one : two;
            const T high = one < two ? two : one;
            const T size = std::abs(d);
            near_side = low > near ? size : near_side;
            near = low > near ? low : near;
            far_side = high < far ? size : far_side;
            far = high < far ? high : far;
        }
        const T meets = far > near ? T(1) : T(0);
        const T enters = (near > T(0) ? meets : T(0)) * (near < T(1) ? T(1) : T(0));
        const T leaves = (far > T(0) ? meets : T(0)) * (far < T(1) ? T(1) : T(0));
        const T c1 = near_side * end.inverse[l];
        const T c2 = far_side * end.inverse[l];
        const T q1 = std::sqrt(contrast + c1 * c1);
        const T q2 = std::sqrt(contrast + c2 * c2);
        const T r1 = (c1 - q1) / (c1 + q1);
        const T r2 = (c2 - q2) / (c2 + q2);
        path[l] += wall.thickness * (enters * (q1 - c1) + leaves * (q2 - c2));
        amplitude[l] *= (T(1) - enters * r1 * r1) * (T(1) - leaves * r2 * r2);
    }
}

// Obliquity and reflection coefficient of the element.
template <class T>
GERAF2_INLINE void reflect(const Element<T>& e, const Constants<T>& c, const End<T>& tx,
                           const End<T>& rx, T* path, T* amplitude) {
    alignas(64) T cosine[n_lanes];
#pragma omp simd
    for (int l = 0; l < n_lanes; ++l) {
        const T cos_tx = cosine_to(e.normal, tx, l);
        const T cos_rx = cosine_to(e.normal, rx, l);
        const T lit = (cos_tx > T(0) ? T(1) : T(0)) * (cos_rx > T(0) ? T(1) : T(0));
        cosine[l] = T(0.5) * (cos_tx + cos_rx);
        amplitude[l] *= lit * cosine[l];
    }
    if (c.reflector == Reflector::conductor) {
        return;
    }
    const bool first = c.reflector == Reflector::first_face;
    const T delay = first ? T(0) : T(2) * c.slab_thickness;
#pragma omp simd
    for (int l = 0; l < n_lanes; ++l) {
        const T q = std::sqrt(c.slab_permittivity - T(1) + cosine[l] * cosine[l]);
        const T r = (cosine[l] - q) / (cosine[l] + q);
        // The conductor's -1 is in the amplitude already.
        amplitude[l] *= first ? -r : r * (T(1) - r * r);
        path[l] += delay * q;
    }
}

// One element in all lanes: phasor at sample 0, its step from sample to sample, and a real gain.
template <class T>
struct Phasors {
    T z_re[n_lanes], z_im[n_lanes];
    T w_re[n_lanes], w_im[n_lanes];
    T gain[n_lanes], gain_step[n_lanes];
};

template <class T>
GERAF2_INLINE void start_phasors(const Element<T>& e, const Lanes<T>& lanes,
                                 const std::vector<Wall<T>>& walls, const Constants<T>& c,
                                 Phasors<T>& out) {
    alignas(64) End<T> tx;
    alignas(64) End<T> rx;
    alignas(64) T path[n_lanes];
    alignas(64) T amplitude[n_lanes];
    look_from(lanes.tx, e.from_tx, e.range_tx, tx);
    look_from(lanes.rx, e.from_rx, e.range_rx, rx);
#pragma omp simd
    for (int l = 0; l < n_lanes; ++l) {
        path[l] = tx.growth[l] + rx.growth[l];
        amplitude[l] = -tx.inverse[l] * rx.inverse[l];
    }
    if (c.has_normals) {
        reflect(e, c, tx, rx, path, amplitude);
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
            out.gain[l] = one * two + slope * c.detune;
            out.gain_step[l] = slope * c.detune_step;
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
        cross_wall(wall, e, tx, path, amplitude);
        cross_wall(wall, e, rx, path, amplitude);
    }
#pragma omp simd
    for (int l = 0; l < n_lanes; ++l) {
        T sine;
        T cosine;
        sincos_turns(e.turns + path[l] * c.turns_per_m, sine, cosine);
        out.z_re[l] = amplitude[l] * (e.weight_re * cosine - e.weight_im * sine);
        out.z_im[l] = amplitude[l] * (e.weight_re * sine + e.weight_im * cosine);
        sincos_turns(e.turns_step + path[l] * c.turns_step_per_m, sine, cosine);
        out.w_re[l] = cosine;
        out.w_im[l] = sine;
    }
}

// Adds two elements to the accumulators. `graded`: their gain changes with frequency.
template <class T, bool graded, int register_bytes>
GERAF2_INLINE void add_pair(const Phasors<T>& a, const Phasors<T>& b, index_t n_samples, T* sum) {
    constexpr int width = register_bytes / static_cast<int>(sizeof(T));
    // may_alias: these registers are loaded from and stored to plain arrays of T.
    using Register [[gnu::vector_size(register_bytes), gnu::may_alias]] = T;
    for (int l = 0; l < n_lanes; l += width) {
        Register ar = *reinterpret_cast<const Register*>(&a.z_re[l]);
        Register ai = *reinterpret_cast<const Register*>(&a.z_im[l]);
        Register br = *reinterpret_cast<const Register*>(&b.z_re[l]);
        Register bi = *reinterpret_cast<const Register*>(&b.z_im[l]);
        const Register awr = *reinterpret_cast<const Register*>(&a.w_re[l]);
        const Register awi = *reinterpret_cast<const Register*>(&a.w_im[l]);
        const Register bwr = *reinterpret_cast<const Register*>(&b.w_re[l]);
        const Register bwi = *reinterpret_cast<const Register*>(&b.w_im[l]);
        Register ag = *reinterpret_cast<const Register*>(&a.gain[l]);
        Register bg = *reinterpret_cast<const Register*>(&b.gain[l]);
        const Register ag_step = *reinterpret_cast<const Register*>(&a.gain_step[l]);
        const Register bg_step = *reinterpret_cast<const Register*>(&b.gain_step[l]);
        for (index_t t = 0; t < n_samples; ++t) {
            auto* re = reinterpret_cast<Register*>(sum + 2 * t * n_lanes + l);
            auto* im = reinterpret_cast<Register*>(sum + (2 * t + 1) * n_lanes + l);
            if constexpr (graded) {
                *re += ag * ar + bg * br;
                *im += ag * ai + bg * bi;
                ag += ag_step;
                bg += bg_step;
            } else {
                *re += ar + br;
                *im += ai + bi;
            }
            const Register an = ar * awr - ai * awi;
            ai = ar * awi + ai * awr;
            ar = an;
            const Register bn = br * bwr - bi * bwi;
            bi = br * bwi + bi * bwr;
            br = bn;
        }
    }
}

// Adds all elements to the accumulators of n_lanes antennas, sum[(t * 2 + part) * n_lanes + l].
template <class T, int register_bytes>
GERAF2_INLINE void accumulate(const std::vector<Element<T>>& elements, const Lanes<T>& lanes,
                              const std::vector<Wall<T>>& walls, const Constants<T>& c, T* sum) {
    alignas(64) Phasors<T> pair[2];
    for (std::size_t first = 0; first < elements.size(); first += 2) {
        start_phasors(elements[first], lanes, walls, c, pair[0]);
        if (first + 1 < elements.size()) {
            start_phasors(elements[first + 1], lanes, walls, c, pair[1]);
        } else {
            pair[1] = Phasors<T>{};
        }
        if (c.has_edges) {
            add_pair<T, true, register_bytes>(pair[0], pair[1], c.n_samples, sum);
        } else {
            add_pair<T, false, register_bytes>(pair[0], pair[1], c.n_samples, sum);
        }
    }
}

#if defined(__x86_64__) && defined(__GNUC__)
#define GERAF2_X86_PATHS 1
template <class T>
[[gnu::target("avx2,fma")]] void
accumulate_avx2(const std::vector<Element<T>>& elements, const Lanes<T>& lanes,
                const std::vector<Wall<T>>& walls, const Constants<T>& c, T* sum) {
    accumulate<T, 32>(elements, lanes, walls, c, sum);
}

template <class T>
[[gnu::target("avx512f,avx512dq,avx512vl,fma")]] void
accumulate_avx512(const std::vector<Element<T>>& elements, const Lanes<T>& lanes,
                  const std::vector<Wall<T>>& walls, const Constants<T>& c, T* sum) {
    accumulate<T, 64>(elements, lanes, walls, c, sum);
}
#endif

template <class T>
void accumulate_best(const std::vector<Element<T>>& elements, const Lanes<T>& lanes,
                     const std::vector<Wall<T>>& walls, const Constants<T>& c, T* sum) {
#ifdef GERAF2_X86_PATHS
    switch (simd_level()) {
    case SimdLevel::avx512:
        accumulate_avx512(elements, lanes, walls, c, sum);
        return;
    case SimdLevel::avx2:
        accumulate_avx2(elements, lanes, walls, c, sum);
        return;
    case SimdLevel::baseline:
        break;
    }
#endif
    accumulate<T, 16>(elements, lanes, walls, c, sum);
}

} // namespace geraf2::detail
