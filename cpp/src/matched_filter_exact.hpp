// SPDX-License-Identifier: Apache-2.0
// The exact method: one phasor recurrence over the samples per (antenna, point). Compiled once
// per instruction set.
#pragma once

#include "matched_filter_block.hpp"
#include "matched_filter_expand.hpp"

namespace geraf2::GERAF2_SIMD_NAMESPACE {

/// Points side by side: each load of the signal serves this many, as far as registers reach.
inline constexpr int exact_points = vector_bytes == 64 ? 4 : 2;
static_assert(detail::point_quantum % exact_points == 0);

/// The recurrences of one group at all points, in registers.
template <class T>
struct Phasors {
    Complex<T> z[exact_points];
    Complex<T> step[exact_points];

    [[gnu::always_inline]] Phasors(const MatchedFilterTables<T>& tables,
                                   const Geometry<T>* geometry) {
        for (int i = 0; i < exact_points; ++i) {
            const auto [first, by] = start_and_step(tables, geometry[i]);
            z[i] = first;
            step[i] = by;
        }
    }

    [[gnu::always_inline]] void seed(const MatchedFilterTables<T>& tables,
                                     const Geometry<T>* geometry, index_t m) {
        for (int i = 0; i < exact_points; ++i) {
            z[i] = sample_phasor(tables, geometry[i], tables.first_pair + static_cast<double>(m));
        }
    }

    [[gnu::always_inline]] void advance() {
#pragma GCC unroll 4
        for (int i = 0; i < exact_points; ++i) {
            z[i] = multiply(z[i], step[i]);
        }
    }
};

/// End of the stretch of sample pairs that begins at `first` and needs no new seed.
inline index_t stretch_end(index_t first, index_t n_pairs) {
    return n_pairs - first < reseed ? n_pairs : first + reseed;
}

/// sum[i] = sum over pairs of s(+m) z + s(-m) conj z; if Slope, slope[i] = the same with weights
/// m and -m, the derivative to the path but for j pi step.
template <bool Slope, class T>
void sum_samples(const MatchedFilterTables<T>& tables, const T* signal, const Geometry<T>* geometry,
                 Complex<T>* sum_out, Complex<T>* slope_out) {
    Complex<T> sum[exact_points] = {};
    Complex<T> slope[exact_points] = {};
    Phasors<T> phasors(tables, geometry);
    for (index_t first = 0; first < tables.n_pairs; first += reseed) {
        if (first > 0) {
            phasors.seed(tables, geometry, first);
        }
        const index_t last = stretch_end(first, tables.n_pairs);
        for (index_t m = first; m < last; ++m) {
            const T* s = signal + m * 4 * lanes<T>;
            const Complex<T> plus{load<T>(s), load<T>(s + lanes<T>)};
            const Complex<T> minus{load<T>(s + 2 * lanes<T>), load<T>(s + 3 * lanes<T>)};
            const T weight = static_cast<T>(tables.first_pair + static_cast<double>(m));
#pragma GCC unroll 4
            for (int i = 0; i < exact_points; ++i) {
                const Complex<T> z = phasors.z[i];
                sum[i].re = sum[i].re + plus.re * z.re;
                sum[i].im = sum[i].im + plus.im * z.re;
                sum[i].re = sum[i].re - minus.im * z.im;
                sum[i].im = sum[i].im + minus.re * z.im;
                if constexpr (Slope) {
                    slope[i].re += weight * (minus.re * z.re - plus.im * z.im);
                    slope[i].im += weight * (minus.im * z.re + plus.re * z.im);
                }
            }
            phasors.advance();
        }
    }
    for (int i = 0; i < exact_points; ++i) {
        sum_out[i] = sum[i];
        if constexpr (Slope) {
            slope_out[i] = slope[i];
        }
    }
}

/// Adds the adjoint of sum_samples: the packed signal of one group gains value[i] conj z[i].
template <class T>
void spread_samples(const MatchedFilterTables<T>& tables, const Geometry<T>* geometry,
                    const Complex<T>* value_in, T* signal) {
    Complex<T> value[exact_points];
    for (int i = 0; i < exact_points; ++i) {
        value[i] = value_in[i];
    }
    Phasors<T> phasors(tables, geometry);
    for (index_t first = 0; first < tables.n_pairs; first += reseed) {
        if (first > 0) {
            phasors.seed(tables, geometry, first);
        }
        const index_t last = stretch_end(first, tables.n_pairs);
        for (index_t m = first; m < last; ++m) {
            T* to = signal + m * 4 * lanes<T>;
            Vec<T> part[4];
            for (int k = 0; k < 4; ++k) {
                part[k] = load<T>(to + k * lanes<T>);
            }
#pragma GCC unroll 4
            for (int i = 0; i < exact_points; ++i) {
                const Complex<T> z = phasors.z[i];
                part[0] = part[0] + value[i].re * z.re;
                part[1] = part[1] + value[i].im * z.re;
                part[2] = part[2] + value[i].im * z.im;
                part[3] = part[3] - value[i].re * z.im;
            }
            for (int k = 0; k < 4; ++k) {
                store<T>(to + k * lanes<T>, part[k]);
            }
            phasors.advance();
        }
    }
}

template <class T>
void exact_fwd(const MatchedFilterTables<T>& tables, const PackedAntennas<T>& antennas,
               index_t group_begin, index_t group_end, const double* points, index_t n_points,
               T* image) {
    for (index_t group = group_begin; group < group_end; ++group) {
        const double* positions = antennas.positions + group * 6 * lanes<T>;
        const T* signal = antennas.signal + group * tables.n_pairs * 4 * lanes<T>;
        for (index_t point = 0; point < n_points; point += exact_points) {
            Geometry<T> geometry[exact_points];
            for (int i = 0; i < exact_points; ++i) {
                locate(tables, positions, points + 3 * (point + i), geometry[i]);
            }
            Complex<T> sum[exact_points];
            sum_samples<false, T>(tables, signal, geometry, sum, nullptr);
            for (int i = 0; i < exact_points; ++i) {
                const Complex<T> value = multiply(sum[i], geometry[i].carrier);
                T* to = image + 2 * (point + i) * lanes<T>;
                store<T>(to, load<T>(to) + value.re);
                store<T>(to + lanes<T>, load<T>(to + lanes<T>) + value.im);
            }
        }
    }
}

template <class T>
void exact_bwd(const MatchedFilterTables<T>& tables, const PackedAntennas<T>& antennas,
               index_t group_begin, index_t group_end, const double* points, index_t n_points,
               const T* image, T* signal_out) {
    for (index_t group = group_begin; group < group_end; ++group) {
        const double* positions = antennas.positions + group * 6 * lanes<T>;
        T* signal = signal_out + group * tables.n_pairs * 4 * lanes<T>;
        for (index_t point = 0; point < n_points; point += exact_points) {
            Geometry<T> geometry[exact_points];
            for (int i = 0; i < exact_points; ++i) {
                locate(tables, positions, points + 3 * (point + i), geometry[i]);
            }
            Complex<T> value[exact_points];
            for (int i = 0; i < exact_points; ++i) {
                const T re = image[2 * (point + i)];
                const T im = image[2 * (point + i) + 1];
                const Complex<T> e = geometry[i].carrier;
                value[i] = {e.re * re + e.im * im, e.re * im - e.im * re};
            }
            spread_samples(tables, geometry, value, signal);
        }
    }
}

/// Adds w v / |v| of one leg, v = point - antenna; a point on the antenna adds nothing.
template <class T>
[[gnu::always_inline]] inline void add_direction(const Geometry<T>& geometry, int leg, Vec<T> w,
                                                 T* point_grad, T* antenna_grad) {
    const Vec<T> range = geometry.range[leg];
    const Vec<T> slope = range > T(0) ? w / range : Vec<T>{};
    for (int axis = 0; axis < 3; ++axis) {
        const Vec<T> part = slope * geometry.offset[3 * leg + axis];
        if (point_grad != nullptr) {
            T* to = point_grad + axis * lanes<T>;
            store<T>(to, load<T>(to) + part);
        }
        if (antenna_grad != nullptr) {
            T* to = antenna_grad + (3 * leg + axis) * lanes<T>;
            store<T>(to, load<T>(to) - part);
        }
    }
}

template <class T>
void positions_bwd(const MatchedFilterTables<T>& tables, const PackedAntennas<T>& antennas,
                   index_t group_begin, index_t group_end, const double* points, index_t n_points,
                   const T* image_grad, T* points_grad, T* antennas_grad) {
    constexpr double pi = 3.14159265358979323846;
    const T carrier_slope = static_cast<T>(pi * tables.half_turns_per_m);
    const T sample_slope = static_cast<T>(pi * tables.step_half_turns_per_m);
    for (index_t group = group_begin; group < group_end; ++group) {
        const double* positions = antennas.positions + group * 6 * lanes<T>;
        const T* signal = antennas.signal + group * tables.n_pairs * 4 * lanes<T>;
        T* antenna_to = antennas_grad == nullptr ? nullptr : antennas_grad + group * 6 * lanes<T>;
        for (index_t point = 0; point < n_points; point += exact_points) {
            Geometry<T> geometry[exact_points];
            for (int i = 0; i < exact_points; ++i) {
                locate(tables, positions, points + 3 * (point + i), geometry[i]);
            }
            Complex<T> sum[exact_points];
            Complex<T> slope[exact_points];
            sum_samples<true, T>(tables, signal, geometry, sum, slope);
            for (int i = 0; i < exact_points; ++i) {
                // dP/dd = j (carrier sum + sample slope) e^(j phi), and Re(conj(g) j z) =
                // g.im z.re - g.re z.im.
                const Complex<T> z =
                    multiply({carrier_slope * sum[i].re + sample_slope * slope[i].re,
                              carrier_slope * sum[i].im + sample_slope * slope[i].im},
                             geometry[i].carrier);
                const T re = image_grad[2 * (point + i)];
                const T im = image_grad[2 * (point + i) + 1];
                const Vec<T> w = im * z.re - re * z.im;
                T* point_to =
                    points_grad == nullptr ? nullptr : points_grad + 3 * (point + i) * lanes<T>;
                for (int leg = 0; leg < 2; ++leg) {
                    add_direction(geometry[i], leg, w, point_to, antenna_to);
                }
            }
        }
    }
}

template <class T>
inline constexpr detail::MatchedFilterKernels<T> kernels{
    lanes<T>,     &block_fwd<T>,  &exact_fwd<T>,  &block_bwd<T>, &exact_bwd<T>, &positions_bwd<T>,
    &contract<T>, &expand_fwd<T>, &expand_bwd<T>, &modulate<T>,  &sum_lanes<T>};

} // namespace geraf2::GERAF2_SIMD_NAMESPACE
