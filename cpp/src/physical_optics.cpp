// SPDX-License-Identifier: Apache-2.0
#include "geraf2/physical_optics.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <exception>
#include <memory>
#include <numbers>
#include <vector>

#include "geraf2/simd.hpp"

#if defined(__GNUC__)
#define GERAF2_INLINE [[gnu::always_inline]] inline
#else
#define GERAF2_INLINE inline
#endif

namespace geraf2 {
namespace {

constexpr int n_lanes = 16; // antennas side by side: two AVX2 or one AVX-512 register of float

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
        end.range[l] = std::sqrt(range * range + grow);
        end.growth[l] = grow / (end.range[l] + range);
        end.inverse[l] = T(1) / end.range[l];
        end.along[0][l] = x - from[0];
        end.along[1][l] = y - from[1];
        end.along[2][l] = z - from[2];
    }
}

template <class T>
GERAF2_INLINE T squared(const T (&v)[3]) {
    return v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
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
            // patches of 8 mm would leave 12 % of a wall's flash where they add up in phase.
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

using Vec = Vec3<double>;
double dot(const Vec& a, const Vec& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
Vec load(std::span<const double> rows, index_t row) {
    const auto i = static_cast<std::size_t>(3 * row);
    return {rows[i], rows[i + 1], rows[i + 2]};
}
template <class T>
void store(T (&out)[3], const Vec& v, double scale = 1.0) {
    out[0] = static_cast<T>(scale * v.x);
    out[1] = static_cast<T>(scale * v.y);
    out[2] = static_cast<T>(scale * v.z);
}
Vec mean_row(std::span<const double> rows, index_t begin, index_t end) {
    Vec sum{};
    for (index_t i = begin; i < end; ++i) {
        const Vec v = load(rows, i);
        sum = {sum.x + v.x, sum.y + v.y, sum.z + v.z};
    }
    const auto n = static_cast<double>(end - begin);
    return {sum.x / n, sum.y / n, sum.z / n};
}

// Mean of exp(-j phase) over a triangle whose phase is linear, given at its corners relative to
// the centroid: 2 sum_n (-j)^n h_n / (n + 2)!, h_n the complete symmetric polynomials. 16 terms
// are exact to 1e-9 for phases up to 3 rad (edges of lambda / 3 seen at grazing incidence: 2.8).
std::complex<double> triangle_form_factor(double a, double b) {
    const double c = -a - b;
    const double e2 = a * b + b * c + c * a;
    const double e3 = a * b * c;
    std::array<double, 17> h{};
    h[0] = 1.0;
    h[1] = 0.0;
    h[2] = -e2;
    double re = 1.0;
    double im = 0.0;
    double factorial = 2.0; // (n + 2)!
    for (std::size_t n = 1; n < h.size(); ++n) {
        if (n > 2) {
            h[n] = -e2 * h[n - 2] + e3 * h[n - 3];
        }
        factorial *= static_cast<double>(n + 2);
        const double term = 2.0 * h[n] / factorial;
        switch (n % 4) {
        case 0:
            re += term;
            break;
        case 1:
            im -= term;
            break;
        case 2:
            re -= term;
            break;
        default:
            im += term;
            break;
        }
    }
    return {re, im};
}

double middle_wavenumber(const Waveform& wave) {
    const double middle_hz = 0.5 * (wave.frequency_hz(0) + wave.frequency_hz(wave.n_samples - 1));
    return 2.0 * std::numbers::pi * middle_hz / speed_of_light;
}

struct Inputs {
    std::span<const double> points, normals, edges, tx, rx;
    const EchoParams& params;
};

// Elements of one block, with the double-precision phase of the path to the block's centres.
template <class T>
std::vector<Element<T>> gather_elements(const Inputs& in, std::span<const std::complex<T>> weights,
                                        const Vec& tx_center, const Vec& rx_center) {
    const Waveform& wave = in.params.waveform;
    const double wavenumber = middle_wavenumber(wave);
    const double step_hz = wave.chirp_slope_hz_per_s / wave.sample_rate_hz;
    std::vector<Element<T>> elements;
    for (std::size_t p = 0; p < weights.size(); ++p) {
        if (weights[p] == std::complex<T>{}) {
            continue;
        }
        const auto row = static_cast<index_t>(p);
        const Vec x = load(in.points, row);
        const Vec from_tx{x.x - tx_center.x, x.y - tx_center.y, x.z - tx_center.z};
        const Vec from_rx{x.x - rx_center.x, x.y - rx_center.y, x.z - rx_center.z};
        const double range_tx = std::sqrt(dot(from_tx, from_tx));
        const double range_rx = std::sqrt(dot(from_rx, from_rx));
        std::complex<double> weight{static_cast<double>(weights[p].real()),
                                    static_cast<double>(weights[p].imag())};
        Element<T> e{};
        if (in.params.shape == ElementShape::triangle) {
            const Vec slope{from_tx.x / range_tx + from_rx.x / range_rx,
                            from_tx.y / range_tx + from_rx.y / range_rx,
                            from_tx.z / range_tx + from_rx.z / range_rx};
            weight *= triangle_form_factor(wavenumber * dot(slope, load(in.edges, 2 * row)),
                                           wavenumber * dot(slope, load(in.edges, 2 * row + 1)));
        } else if (in.params.shape == ElementShape::rectangle) {
            store(e.edge_1, load(in.edges, 2 * row), wavenumber);
            store(e.edge_2, load(in.edges, 2 * row + 1), wavenumber);
        }
        store(e.from_tx, from_tx);
        store(e.from_rx, from_rx);
        e.range_tx = static_cast<T>(range_tx);
        e.range_rx = static_cast<T>(range_rx);
        store(e.position, x);
        if (!in.normals.empty()) {
            store(e.normal, load(in.normals, row));
        }
        e.weight_re = static_cast<T>(weight.real());
        e.weight_im = static_cast<T>(weight.imag());
        // Whole turns are dropped in double: at 77 GHz one float32 ulp of a 2 m path is 2.4e-4 rad.
        const double delay = (range_tx + range_rx + wave.path_bias_m) / speed_of_light;
        const double turns = phase_sign * wave.start_frequency_hz * delay;
        const double turns_step = phase_sign * step_hz * delay;
        e.turns = static_cast<T>(turns - std::round(turns));
        e.turns_step = static_cast<T>(turns_step - std::round(turns_step));
        elements.push_back(e);
    }
    return elements;
}

template <class T>
Constants<T> make_constants(const Inputs& in) {
    const Waveform& wave = in.params.waveform;
    const double per_m = phase_sign / speed_of_light;
    Constants<T> c{};
    c.turns_per_m = static_cast<T>(per_m * wave.start_frequency_hz);
    c.turns_step_per_m = static_cast<T>(per_m * wave.chirp_slope_hz_per_s / wave.sample_rate_hz);
    c.slab_permittivity = static_cast<T>(in.params.slab_permittivity);
    c.slab_thickness = static_cast<T>(in.params.slab_thickness_m);
    store(c.boresight, in.params.boresight);
    const double wavenumber = middle_wavenumber(wave);
    const double middle_hz = wavenumber * speed_of_light / (2.0 * std::numbers::pi);
    c.detune = static_cast<T>(wave.frequency_hz(0) / middle_hz - 1.0);
    c.detune_step = static_cast<T>(wave.chirp_slope_hz_per_s / wave.sample_rate_hz / middle_hz);
    c.curvature = static_cast<T>(1.0 / (6.0 * wavenumber * wavenumber));
    c.has_normals = !in.normals.empty();
    c.has_edges = in.params.shape == ElementShape::rectangle;
    c.reflector = in.params.reflector;
    c.pattern_exponent = in.params.pattern_exponent;
    c.n_samples = wave.n_samples;
    return c;
}

template <class T>
void echo_of_block(const Inputs& in, std::span<const std::complex<T>> weights, index_t begin,
                   index_t end, const std::vector<Wall<T>>& walls,
                   std::span<std::complex<T>> signal) {
    const Vec tx_center = mean_row(in.tx, begin, end);
    const Vec rx_center = mean_row(in.rx, begin, end);
    const std::vector<Element<T>> elements = gather_elements(in, weights, tx_center, rx_center);
    const Constants<T> c = make_constants<T>(in);
    const auto n_values = static_cast<std::size_t>(2 * c.n_samples * n_lanes);
    // Over-allocated by one 64-byte line and aligned by hand: registers are stored to it.
    std::vector<T> buffer(n_values + 64 / sizeof(T));
    void* aligned = buffer.data();
    std::size_t space = buffer.size() * sizeof(T);
    auto* sum = static_cast<T*>(std::align(64, n_values * sizeof(T), aligned, space));
    const T scale = static_cast<T>(1.0 / (4.0 * std::numbers::pi));
    for (index_t first = begin; first < end; first += n_lanes) {
        Lanes<T> lanes;
        for (index_t l = 0; l < n_lanes; ++l) {
            const index_t a = std::min(first + l, end - 1); // spare lanes repeat the last antenna
            const Vec tx = load(in.tx, a);
            const Vec rx = load(in.rx, a);
            const double tx_offset[3] = {tx.x - tx_center.x, tx.y - tx_center.y,
                                         tx.z - tx_center.z};
            const double rx_offset[3] = {rx.x - rx_center.x, rx.y - rx_center.y,
                                         rx.z - rx_center.z};
            for (int axis = 0; axis < 3; ++axis) {
                lanes.tx[axis][l] = static_cast<T>(tx_offset[axis]);
                lanes.rx[axis][l] = static_cast<T>(rx_offset[axis]);
            }
        }
        std::fill(sum, sum + n_values, T(0));
        accumulate_best<T>(elements, lanes, walls, c, sum);
        for (index_t l = 0; l < std::min<index_t>(n_lanes, end - first); ++l) {
            for (index_t t = 0; t < c.n_samples; ++t) {
                const T re = sum[2 * t * n_lanes + l];
                const T im = sum[(2 * t + 1) * n_lanes + l];
                signal[static_cast<std::size_t>((first + l) * c.n_samples + t)] = {-scale * im,
                                                                                   scale * re};
            }
        }
    }
}

} // namespace

template <class T>
void physical_optics(std::span<const double> points, std::span<const double> normals,
                     std::span<const double> edges, std::span<const std::complex<T>> weights,
                     std::span<const double> tx, std::span<const double> rx,
                     std::span<const index_t> block_offsets, std::span<const DielectricBox> walls,
                     const EchoParams& params, std::span<std::complex<T>> signal, int num_threads) {
    const Inputs in{points, normals, edges, tx, rx, params};
    const std::size_t n_points = points.size() / 3;
    std::vector<Wall<T>> wall_list;
    for (const DielectricBox& box : walls) {
        Wall<T> wall{};
        store(wall.center, box.center);
        store(wall.half, box.half_size);
        wall.thickness = static_cast<T>(box.thickness_m);
        wall.permittivity = static_cast<T>(box.permittivity);
        wall_list.push_back(wall);
    }
    const auto n_blocks = static_cast<index_t>(block_offsets.size()) - 1;
    std::exception_ptr error;
#pragma omp parallel for schedule(dynamic, 1) num_threads(num_threads)
    for (index_t b = 0; b < n_blocks; ++b) {
        try {
            const auto block = static_cast<std::size_t>(b);
            if (block_offsets[block] < block_offsets[block + 1]) {
                echo_of_block<T>(in, weights.subspan(block * n_points, n_points),
                                 block_offsets[block], block_offsets[block + 1], wall_list, signal);
            }
        } catch (...) {
#pragma omp critical(geraf2_physical_optics_error)
            if (!error) {
                error = std::current_exception();
            }
        }
    }
    if (error) {
        std::rethrow_exception(error);
    }
}

template void physical_optics<float>(std::span<const double>, std::span<const double>,
                                     std::span<const double>, std::span<const std::complex<float>>,
                                     std::span<const double>, std::span<const double>,
                                     std::span<const index_t>, std::span<const DielectricBox>,
                                     const EchoParams&, std::span<std::complex<float>>, int);
template void physical_optics<double>(std::span<const double>, std::span<const double>,
                                      std::span<const double>,
                                      std::span<const std::complex<double>>,
                                      std::span<const double>, std::span<const double>,
                                      std::span<const index_t>, std::span<const DielectricBox>,
                                      const EchoParams&, std::span<std::complex<double>>, int);

} // namespace geraf2
