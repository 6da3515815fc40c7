// SPDX-License-Identifier: Apache-2.0
// The exact method: one phasor recurrence over the samples per (antenna, point). Compiled once
// per instruction set.
#pragma once

#include <numbers>

#include "matched_filter/block.hpp"
#include "matched_filter/expand.hpp"

namespace geraf2::GERAF2_SIMD_NAMESPACE {

/// Points side by side: each load of the signal serves this many, as far as registers reach.
inline constexpr int exact_points = vector_bytes == 64 ? 2 : 1;
static_assert(detail::point_quantum % exact_points == 0);

/// Phasors of the offsets 1/2, 3/2, 5/2, 7/2 from the middle of a fold.
inline constexpr int n_offsets = static_cast<int>(detail::pairs_per_fold) / 2;

/// Vectors of one offset of a fold. P and M being sum and difference of the samples of a pair, a
/// and b the pairs above and below the middle: P_a + P_b, M_a - M_b, M_a + M_b, P_a - P_b.
inline constexpr int fold_part = 8;

/// Packed pair m of one group; beyond the last, nothing.
template <class T>
[[gnu::always_inline]] inline Complex<T> pair_part(const T* signal, index_t m, index_t n_pairs,
                                                   int part) {
    if (m >= n_pairs) {
        return {Vec<T>{}, Vec<T>{}};
    }
    const T* s = signal + (m * 4 + 2 * part) * lanes<T>;
    return {load<T>(s), load<T>(s + lanes<T>)};
}

/// Folds the packed pairs of one group: to (n_folds, n_offsets, fold_part, lanes).
template <class T>
void fold_pairs(index_t n_pairs, const T* signal, T* to) {
    for (index_t first = 0; first < n_pairs; first += detail::pairs_per_fold) {
        for (int j = 0; j < n_offsets; ++j) {
            for (int part = 0; part < 2; ++part) {
                const auto a = pair_part(signal, first + n_offsets + j, n_pairs, part);
                const auto b = pair_part(signal, first + n_offsets - 1 - j, n_pairs, part);
                T* plus = to + 4 * part * lanes<T>;
                T* minus = to + (6 - 4 * part) * lanes<T>;
                store<T>(plus, a.re + b.re);
                store<T>(plus + lanes<T>, a.im + b.im);
                store<T>(minus, a.re - b.re);
                store<T>(minus + lanes<T>, a.im - b.im);
            }
            to += fold_part * lanes<T>;
        }
    }
}

/// Adjoint of fold_pairs: adds to the packed pairs.
template <class T>
void unfold_pairs(index_t n_pairs, const T* from, T* signal) {
    for (index_t first = 0; first < n_pairs; first += detail::pairs_per_fold) {
        for (int j = 0; j < n_offsets; ++j) {
            for (int part = 0; part < 4; ++part) {
                const T* plus = from + (4 * (part / 2) + part % 2) * lanes<T>;
                const T* minus = from + (6 - 4 * (part / 2) + part % 2) * lanes<T>;
                const Vec<T> sum = load<T>(plus);
                const Vec<T> difference = load<T>(minus);
                const index_t a = first + n_offsets + j;
                const index_t b = first + n_offsets - 1 - j;
                if (a < n_pairs) {
                    T* to = signal + (4 * a + part) * lanes<T>;
                    store<T>(to, load<T>(to) + (sum + difference));
                }
                if (b < n_pairs) {
                    T* to = signal + (4 * b + part) * lanes<T>;
                    store<T>(to, load<T>(to) + (sum - difference));
                }
            }
            from += fold_part * lanes<T>;
        }
    }
}

/// Paths and phasors of one group at N points.
template <int N, class T>
struct Phasors {
    Doubles<T> path[N];              // d [m]
    Complex<T> carrier[N];           // exp(j phase) at mid-band
    Complex<T> offset[N][n_offsets]; // exp(j (1/2 + i) x), x the phase of a step
    Complex<T> middle[N];            // of the first fold's middle
    Complex<T> step[N];              // exp(j 8 x)

    [[gnu::always_inline]] Phasors(const MatchedFilterTables<T>& tables, const double* positions,
                                   const double* points) {
        find_paths(tables, positions, points);
        Vec<T> half_turns[3 * N];
        for (int i = 0; i < N; ++i) {
            Doubles<T> carrier_turns;
            Doubles<T> step_turns;
            for (int k = 0; k < double_parts<T>; ++k) {
                carrier_turns.part[k] =
                    without_whole_turns(tables.half_turns_per_m * path[i].part[k]);
                // Half a step is wanted: even numbers of whole turns may go.
                step_turns.part[k] =
                    2.0 * without_whole_turns(0.5 * tables.step_half_turns_per_m * path[i].part[k]);
            }
            const Vec<T> by_step = narrow<T>(step_turns);
            half_turns[i] = narrow<T>(carrier_turns);
            half_turns[N + i] = T(0.5) * by_step;
            half_turns[2 * N + i] = static_cast<T>(middle_of(tables, 0)) * by_step;
        }
        SinCos<T> values[3 * N];
        for (int kind = 0; kind < 3; ++kind) {
            sincos_half_turns<full_level<T>, N, T>(half_turns + kind * N, values + kind * N);
        }
        const bool odd = tables.first_pair == 0.0;
        for (int i = 0; i < N; ++i) {
            carrier[i] = {values[i].cos, values[i].sin};
            offset[i][0] = {values[N + i].cos, values[N + i].sin};
            middle[i] = {values[2 * N + i].cos, values[2 * N + i].sin};
            const Complex<T> one = multiply(offset[i][0], offset[i][0]);
            for (int j = 1; j < n_offsets; ++j) {
                offset[i][j] = multiply(offset[i][j - 1], one);
            }
            const Complex<T> twice = multiply(middle[i], middle[i]); // 8 or, if odd, 7 steps
            step[i] = odd ? multiply(twice, one) : twice;
        }
    }

    /// Phasors of the middle of the fold that begins at pair `first`.
    [[nodiscard, gnu::always_inline]] Complex<T> seed(const MatchedFilterTables<T>& tables, int i,
                                                      index_t first) const {
        return path_phasor<T>(tables.step_half_turns_per_m * middle_of(tables, first), path[i]);
    }

    /// Its distance from mid-band [steps].
    [[gnu::always_inline]] static double middle_of(const MatchedFilterTables<T>& tables,
                                                   index_t first) {
        return tables.first_pair + static_cast<double>(first) + 0.5 * (detail::pairs_per_fold - 1);
    }

private:
    [[gnu::always_inline]] void find_paths(const MatchedFilterTables<T>& tables,
                                           const double* positions, const double* points) {
        for (int leg = 0; leg < 2; ++leg) {
            Doubles<T> range[N] = {};
            for (int axis = 0; axis < 3; ++axis) {
                const auto from = load_doubles<T>(positions + (3 * leg + axis) * lanes<T>);
                for (int i = 0; i < N; ++i) {
                    for (int k = 0; k < double_parts<T>; ++k) {
                        const Vec<double> v = points[3 * i + axis] - from.part[k];
                        range[i].part[k] += v * v;
                    }
                }
            }
            square_roots<N, T>(range);
            for (int i = 0; i < N; ++i) {
                for (int k = 0; k < double_parts<T>; ++k) {
                    path[i].part[k] =
                        range[i].part[k] + (leg == 0 ? splat(tables.path_bias_m) : path[i].part[k]);
                }
            }
        }
    }
};

/// sum[i] = sum over pairs of s(+m) z + s(-m) conj z from folded pairs, at N of the points; if
/// Slope, slope[i] = the same with weights m and -m, the derivative to the path but for j pi step.
template <bool Slope, int N, int Points, class T>
[[gnu::always_inline]] inline void sum_samples(const MatchedFilterTables<T>& tables,
                                               const T* folded, const Phasors<Points, T>& phasors,
                                               int point, Complex<T>* sum_out,
                                               Complex<T>* slope_out) {
    Complex<T> sum[N] = {};
    Complex<T> slope[N] = {};
    Complex<T> offset[N][n_offsets];
    Complex<T> middle[N];
    for (int i = 0; i < N; ++i) {
        middle[i] = phasors.middle[point + i];
        for (int j = 0; j < n_offsets; ++j) {
            offset[i][j] = phasors.offset[point + i][j];
        }
    }
    for (index_t first = 0; first < tables.n_pairs; first += detail::pairs_per_fold) {
        if (first > 0 && first % reseed == 0) {
            for (int i = 0; i < N; ++i) {
                middle[i] = phasors.seed(tables, point + i, first);
            }
        }
        // Of the fold: x multiplies the cosine of the middle's phase, j y its sine; the slopes
        // dx, dy are their derivatives to the phase of a step.
        Complex<T> x[N] = {};
        Complex<T> y[N] = {};
        Complex<T> dx[N] = {};
        Complex<T> dy[N] = {};
#pragma GCC unroll 4
        for (int j = 0; j < n_offsets; ++j) {
            const T* s = folded + j * fold_part * lanes<T>;
            const auto at = [s](int k) __attribute__((always_inline)) {
                return load<T>(s + k * lanes<T>);
            };
            const T distance = T(0.5) + static_cast<T>(j);
            for (int i = 0; i < N; ++i) {
                const Complex<T> z = offset[i][j];
                x[i].re += at(0) * z.re;
                x[i].im += at(1) * z.re;
                y[i].re += at(4) * z.re;
                y[i].im += at(5) * z.re;
                x[i].re -= at(3) * z.im;
                x[i].im += at(2) * z.im;
                y[i].re -= at(7) * z.im;
                y[i].im += at(6) * z.im;
                if constexpr (Slope) {
                    const Complex<T> w{distance * z.re, distance * z.im};
                    dx[i].re -= at(0) * w.im + at(3) * w.re;
                    dx[i].im += at(2) * w.re - at(1) * w.im;
                    dy[i].re -= at(4) * w.im + at(7) * w.re;
                    dy[i].im += at(6) * w.re - at(5) * w.im;
                }
            }
        }
        [[maybe_unused]] const T distance =
            static_cast<T>(Phasors<Points, T>::middle_of(tables, first));
        for (int i = 0; i < N; ++i) {
            const Complex<T> z = middle[i];
            sum[i].re += x[i].re * z.re - y[i].im * z.im;
            sum[i].im += x[i].im * z.re + y[i].re * z.im;
            if constexpr (Slope) {
                // d/dphase of the sum is j times the slope.
                const Complex<T> d{(dx[i].re - distance * y[i].im) * z.re -
                                       (dy[i].im + distance * x[i].re) * z.im,
                                   (dx[i].im + distance * y[i].re) * z.re +
                                       (dy[i].re - distance * x[i].im) * z.im};
                slope[i].re += d.im;
                slope[i].im -= d.re;
            }
            middle[i] = multiply(z, phasors.step[point + i]);
        }
        folded += n_offsets * fold_part * lanes<T>;
    }
    for (int i = 0; i < N; ++i) {
        sum_out[i] = sum[i];
        if constexpr (Slope) {
            slope_out[i] = slope[i];
        }
    }
}

/// Adds the adjoint of sum_samples to folded pairs, which gain value[i] conj z[i].
template <int N, class T>
void spread_samples(const MatchedFilterTables<T>& tables, const Phasors<N, T>& phasors,
                    const Complex<T>* value, T* folded) {
    Complex<T> middle[N];
    for (int i = 0; i < N; ++i) {
        middle[i] = phasors.middle[i];
    }
    for (index_t first = 0; first < tables.n_pairs; first += detail::pairs_per_fold) {
        Complex<T> x[N];
        Complex<T> y[N];
        for (int i = 0; i < N; ++i) {
            if (first > 0 && first % reseed == 0) {
                middle[i] = phasors.seed(tables, i, first);
            }
            const Complex<T> z = middle[i];
            x[i] = {value[i].re * z.re, value[i].im * z.re};
            y[i] = {value[i].im * z.im, -(value[i].re * z.im)};
            middle[i] = multiply(z, phasors.step[i]);
        }
        for (int j = 0; j < n_offsets; ++j) {
            // First what x multiplies, then y: cosines, then sines.
            for (int half = 0; half < 2; ++half) {
                const Complex<T>* v = half == 0 ? x : y;
                T* to = folded + 4 * half * lanes<T>;
                Vec<T> part[4];
                for (int k = 0; k < 4; ++k) {
                    part[k] = load<T>(to + k * lanes<T>);
                }
                for (int i = 0; i < N; ++i) {
                    const Complex<T> z = phasors.offset[i][j];
                    part[0] += v[i].re * z.re;
                    part[1] += v[i].im * z.re;
                    part[2] += v[i].im * z.im;
                    part[3] -= v[i].re * z.im;
                }
                for (int k = 0; k < 4; ++k) {
                    store<T>(to + k * lanes<T>, part[k]);
                }
            }
            folded += fold_part * lanes<T>;
        }
    }
}

template <class T>
void exact_fwd(const MatchedFilterTables<T>& tables, const PackedAntennas<T>& antennas,
               index_t group_begin, index_t group_end, const double* points, index_t n_points,
               T* scratch, T* image) {
    constexpr int n = detail::point_quantum;
    const index_t group_size = tables.n_pairs * 4 * lanes<T>;
    const index_t folded_size = detail::folded_vectors(tables.n_pairs) * lanes<T>;
    for (index_t group = group_begin; group < group_end; ++group) {
        const double* positions = antennas.positions + group * 6 * lanes<T>;
        for (index_t s = 0; s < antennas.n_signals; ++s) {
            fold_pairs(tables.n_pairs,
                       antennas.signal + (s * antennas.n_groups + group) * group_size,
                       scratch + s * folded_size);
        }
        for (index_t point = 0; point < n_points; point += n) {
            const Phasors<n, T> phasors(tables, positions, points + 3 * point);
            for (index_t s = 0; s < antennas.n_signals; ++s) {
                for (int first = 0; first < n; first += exact_points) {
                    Complex<T> sum[exact_points];
                    sum_samples<false, exact_points, n, T>(tables, scratch + s * folded_size,
                                                           phasors, first, sum, nullptr);
                    T* to = image + 2 * (s * n_points + point + first) * lanes<T>;
                    for (int i = 0; i < exact_points; ++i, to += 2 * lanes<T>) {
                        const Complex<T> value = multiply(sum[i], phasors.carrier[first + i]);
                        store<T>(to, load<T>(to) + value.re);
                        store<T>(to + lanes<T>, load<T>(to + lanes<T>) + value.im);
                    }
                }
            }
        }
    }
}

/// Sets the folded pairs of one group to zero.
template <class T>
void clear_folded(index_t n_pairs, T* folded) {
    for (index_t i = 0; i < detail::folded_vectors(n_pairs); ++i) {
        store<T>(folded + i * lanes<T>, Vec<T>{});
    }
}

template <class T>
void exact_bwd(const MatchedFilterTables<T>& tables, const PackedAntennas<T>& antennas,
               index_t group_begin, index_t group_end, const double* points, index_t n_points,
               const T* image, T* scratch, T* signal_out) {
    constexpr int n = detail::point_quantum;
    const index_t group_size = tables.n_pairs * 4 * lanes<T>;
    const index_t folded_size = detail::folded_vectors(tables.n_pairs) * lanes<T>;
    for (index_t group = group_begin; group < group_end; ++group) {
        const double* positions = antennas.positions + group * 6 * lanes<T>;
        for (index_t s = 0; s < antennas.n_signals; ++s) {
            clear_folded(tables.n_pairs, scratch + s * folded_size);
        }
        for (index_t point = 0; point < n_points; point += n) {
            const Phasors<n, T> phasors(tables, positions, points + 3 * point);
            for (index_t s = 0; s < antennas.n_signals; ++s) {
                Complex<T> value[n];
                for (int i = 0; i < n; ++i) {
                    const T* from = image + 2 * (s * n_points + point + i);
                    const Complex<T> e = phasors.carrier[i];
                    value[i] = {e.re * from[0] + e.im * from[1], e.re * from[1] - e.im * from[0]};
                }
                spread_samples(tables, phasors, value, scratch + s * folded_size);
            }
        }
        for (index_t s = 0; s < antennas.n_signals; ++s) {
            unfold_pairs(tables.n_pairs, scratch + s * folded_size,
                         signal_out + (s * antennas.n_groups + group) * group_size);
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
                   const T* image_grad, T* scratch, T* points_grad, T* antennas_grad) {
    constexpr double pi = std::numbers::pi;
    const T carrier_slope = static_cast<T>(pi * tables.half_turns_per_m);
    const T sample_slope = static_cast<T>(pi * tables.step_half_turns_per_m);
    for (index_t group = group_begin; group < group_end; ++group) {
        const double* positions = antennas.positions + group * 6 * lanes<T>;
        fold_pairs(tables.n_pairs, antennas.signal + group * tables.n_pairs * 4 * lanes<T>,
                   scratch);
        T* antenna_to = antennas_grad == nullptr ? nullptr : antennas_grad + group * 6 * lanes<T>;
        for (index_t point = 0; point < n_points; point += exact_points) {
            Geometry<T> geometry[exact_points];
            for (int i = 0; i < exact_points; ++i) {
                locate(tables, positions, points + 3 * (point + i), geometry[i]);
            }
            Complex<T> sum[exact_points];
            Complex<T> slope[exact_points];
            const Phasors<exact_points, T> phasors(tables, positions, points + 3 * point);
            sum_samples<true, exact_points, exact_points, T>(tables, scratch, phasors, 0, sum,
                                                             slope);
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

} // namespace geraf2::GERAF2_SIMD_NAMESPACE
