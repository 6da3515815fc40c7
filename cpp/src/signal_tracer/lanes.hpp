// SPDX-License-Identifier: Apache-2.0
// The signal tracer, docs/math/signal-tracer.md#signal-tracer: the matched filter's adjoint, with
// amplitudes that may depend on the antenna, and its backward. Compiled once per instruction set.
#pragma once

#include <numbers>

#include "matched_filter/exact.hpp"
#include "signal_tracer/kernels.hpp"

namespace geraf2::GERAF2_SIMD_NAMESPACE {

using detail::AmplitudeKind;
using detail::ReflectorBlock;
using detail::ReflectorSums;

/// Amplitude of one point at one group of antennas.
template <class T>
[[gnu::always_inline]] inline Complex<T> amplitude_at(const ReflectorBlock<T>& r, index_t group,
                                                      index_t point) {
    const index_t at = r.kind == AmplitudeKind::shared ? 0 : group * r.stride + r.place[point];
    switch (r.kind) {
    case AmplitudeKind::antenna_real:
        return {load<T>(r.amplitude + at * lanes<T>), Vec<T>{}};
    case AmplitudeKind::antenna_complex:
        return {load<T>(r.amplitude + 2 * at * lanes<T>),
                load<T>(r.amplitude + (2 * at + 1) * lanes<T>)};
    default:
        return {splat(r.amplitude[2 * point]), splat(r.amplitude[2 * point + 1])};
    }
}

/// x - tx and x - rx [m], (6).
template <class T>
struct Legs {
    Vec<T> v[6];
};

template <class T>
[[gnu::always_inline]] inline Legs<T> legs_at(const Geometry<T>& geometry, const T* offset) {
    Legs<T> out;
    for (int i = 0; i < 6; ++i) {
        out.v[i] = geometry.offset[i] + offset[i % 3];
    }
    return out;
}

template <class T>
[[gnu::always_inline]] inline Vec<T> dot(const Vec<T>* a, const Vec<T>* b) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/// 1 / |v|, or zero for v = 0 (and where the square of |v| underflows).
template <class T>
[[gnu::always_inline]] inline Vec<T> inverse_length(const Vec<T>* v) {
    const Vec<T> square = dot<T>(v, v);
    const T smallest = sizeof(T) == 4 ? T(1e-30) : T(1e-200);
    return square > smallest ? inverse_square_root(square) : Vec<T>{};
}

/// Terms of the specular factor, a and b the unit vectors from tx and rx to the point.
template <class T>
struct Mirror {
    Vec<T> inverse_range[2];
    Vec<T> along[2]; // n . a, n . b
    Vec<T> factor;   // 2 (n . a) (n . b) - a . b, of any sign

    [[gnu::always_inline]] Mirror(const Legs<T>& legs, const T* normal) {
        for (int leg = 0; leg < 2; ++leg) {
            const Vec<T>* v = legs.v + 3 * leg;
            inverse_range[leg] = inverse_length<T>(v);
            along[leg] =
                (v[0] * normal[0] + v[1] * normal[1] + v[2] * normal[2]) * inverse_range[leg];
        }
        factor = T(2) * along[0] * along[1] -
                 dot<T>(legs.v, legs.v + 3) * (inverse_range[0] * inverse_range[1]);
    }

    /// (w_o . w_r)+; NaN stays NaN.
    [[gnu::always_inline]] [[nodiscard]] Vec<T> positive() const {
        return factor < T(0) ? Vec<T>{} : factor;
    }
};

template <int Tier, bool SquareRoot, bool Specular, class T>
void trace_block(const MatchedFilterTables<T>& tables, const ReflectorBlock<T>& r, index_t group,
                 const Geometry<T>& geometry, const T* coefficients, T* signal) {
    Complex<T> moments[Layout<Tier>::degree + 1];
    accumulate_moments<Tier, SquareRoot, T>(
        r.block, coefficients,
        [&](index_t point) __attribute__((always_inline)) {
            Complex<T> amplitude = amplitude_at(r, group, point);
            if constexpr (Specular) {
                const Legs<T> legs = legs_at(geometry, r.block.offsets + 4 * point);
                const Vec<T> q = Mirror<T>(legs, r.normals + 3 * point).positive();
                amplitude = {amplitude.re * q, amplitude.im * q};
            }
            return amplitude;
        },
        moments);
    spread_moments<Tier, T>(tables, geometry, moments, signal);
}

template <int Tier, class T>
void trace_blocks(const MatchedFilterTables<T>& tables, const PackedAntennas<T>& antennas,
                  index_t begin, index_t end, const ReflectorBlock<T>& r, T* scratch, T* signal) {
    for (index_t group = begin; group < end; ++group) {
        Geometry<T> geometry;
        const bool series =
            prepare_tile<Tier, T>(tables, antennas, group, 1, r.block, &geometry, scratch);
        T* to = signal + (group - begin) * tables.n_pairs * 4 * lanes<T>;
        const auto trace =
            r.normals != nullptr
                ? (series ? &trace_block<Tier, false, true, T> : &trace_block<Tier, true, true, T>)
                : (series ? &trace_block<Tier, false, false, T>
                          : &trace_block<Tier, true, false, T>);
        trace(tables, r, group - begin, geometry, scratch, to);
    }
}

template <class T>
[[gnu::always_inline]] inline Legs<T> legs_of(const Geometry<T>& geometry) {
    Legs<T> out;
    for (int i = 0; i < 6; ++i) {
        out.v[i] = geometry.offset[i];
    }
    return out;
}

template <class T>
void trace_points(const MatchedFilterTables<T>& tables, const PackedAntennas<T>& antennas,
                  index_t begin, index_t end, const ReflectorBlock<T>& r, T* scratch, T* signal) {
    constexpr int n = detail::point_quantum;
    for (index_t group = begin; group < end; ++group) {
        const double* positions = antennas.positions + group * 6 * lanes<T>;
        clear_folded(tables.n_pairs, scratch);
        for (index_t point = 0; point < r.block.n_points; point += n) {
            Geometry<T> geometry[n];
            Complex<T> value[n];
            for (int i = 0; i < n; ++i) {
                locate(tables, positions, r.positions + 3 * (point + i), geometry[i]);
                Complex<T> amplitude = amplitude_at(r, group - begin, point + i);
                if (r.normals != nullptr) {
                    const Mirror<T> mirror(legs_of(geometry[i]), r.normals + 3 * (point + i));
                    const Vec<T> q = mirror.positive();
                    amplitude = {amplitude.re * q, amplitude.im * q};
                }
                value[i] = multiply(amplitude, {geometry[i].carrier.re, -geometry[i].carrier.im});
            }
            const Phasors<n, T> phasors(tables, positions, r.positions + 3 * point);
            spread_samples(tables, phasors, value, scratch);
        }
        unfold_pairs(tables.n_pairs, scratch,
                     signal + (group - begin) * tables.n_pairs * 4 * lanes<T>);
    }
}

/// Sum over lanes, always in the same order.
template <class T>
[[gnu::always_inline]] inline double sum_lanes(Vec<T> v) {
    T part[lanes<T>];
    store<T>(part, v);
    for (int half = lanes<T> / 2; half > 0; half /= 2) {
        for (int lane = 0; lane < half; ++lane) {
            part[lane] += part[lane + half];
        }
    }
    return static_cast<double>(part[0]);
}

/// Sums over lanes of as many vectors as there are lanes.
template <class T>
[[gnu::always_inline]] inline Vec<T> sum_each(const T* from) {
    Vec<T> square[lanes<T>];
    for (int i = 0; i < lanes<T>; ++i) {
        square[i] = load<T>(from + i * lanes<T>);
    }
    transpose<T>(square);
    Vec<T> sum = square[0];
    for (int i = 1; i < lanes<T>; ++i) {
        sum += square[i];
    }
    return sum;
}

/// Gradients of a few points, accumulated over the groups of a tile.
template <class T>
struct PointGradients {
    Vec<T> sum[detail::sums_per_point] = {};

    /// Gradients to both legs, dL/d(x - tx) and dL/d(x - rx): `along_path` is dL/dd, `by_factor`
    /// dL/d(factor).
    template <bool Specular>
    [[gnu::always_inline]] void add_legs(const Legs<T>& legs, const Mirror<T>* mirror,
                                         const T* normal, Vec<T> along_path, Vec<T> by_factor,
                                         T* antennas) {
        Vec<T> inverse[2];
        Vec<T> unit[6];
        for (int leg = 0; leg < 2; ++leg) {
            inverse[leg] =
                Specular ? mirror->inverse_range[leg] : inverse_length<T>(legs.v + 3 * leg);
            for (int axis = 0; axis < 3; ++axis) {
                unit[3 * leg + axis] = legs.v[3 * leg + axis] * inverse[leg];
            }
        }
        for (int leg = 0; leg < 2; ++leg) {
            Vec<T> own = along_path;
            Vec<T> turned{};
            if constexpr (Specular) {
                turned = by_factor * inverse[leg];
                own -= turned * mirror->factor;
            }
            for (int axis = 0; axis < 3; ++axis) {
                Vec<T> slope = own * unit[3 * leg + axis];
                if constexpr (Specular) {
                    slope += turned * (T(2) * mirror->along[1 - leg] * normal[axis] -
                                       unit[3 * (1 - leg) + axis]);
                }
                sum[5 + axis] += slope;
                if (antennas != nullptr) {
                    T* to = antennas + (3 * leg + axis) * lanes<T>;
                    store<T>(to, load<T>(to) - slope);
                }
            }
        }
    }

    /// image: sum over samples of g e^(+j phase) at the point; slope: its derivative to the path.
    template <bool Specular, bool Positions>
    [[gnu::always_inline]] void add(const ReflectorBlock<T>& r, const ReflectorSums<T>& sums,
                                    index_t group, index_t point, const Legs<T>& legs,
                                    Complex<T> image, Complex<T> slope, T* antennas) {
        [[maybe_unused]] const T* normal = Specular ? r.normals + 3 * point : nullptr;
        Complex<T> amplitude_grad = image;
        if constexpr (Specular || Positions) {
            const Complex<T> amplitude = amplitude_at(r, group, point);
            const auto real_product = [&](Complex<T> z) {
                return amplitude.re * z.re + amplitude.im * z.im;
            };
            if constexpr (Specular) {
                const Mirror<T> mirror(legs, normal);
                const Vec<T> q = mirror.positive();
                amplitude_grad = {image.re * q, image.im * q};
                // Zero where the factor is cut off; the kink itself counts as lit.
                const Vec<T> by_factor = mirror.factor < T(0) ? Vec<T>{} : real_product(image);
                const Vec<T> by_a = T(2) * by_factor * mirror.along[1] * mirror.inverse_range[0];
                const Vec<T> by_b = T(2) * by_factor * mirror.along[0] * mirror.inverse_range[1];
                for (int axis = 0; axis < 3; ++axis) {
                    sum[2 + axis] += by_a * legs.v[axis] + by_b * legs.v[3 + axis];
                }
                if constexpr (Positions) {
                    add_legs<true>(legs, &mirror, normal, q * real_product(slope), by_factor,
                                   antennas);
                }
            } else {
                add_legs<false>(legs, nullptr, nullptr, real_product(slope), Vec<T>{}, antennas);
            }
        }
        if (r.kind == AmplitudeKind::shared) {
            sum[0] += amplitude_grad.re;
            sum[1] += amplitude_grad.im;
        } else if (sums.amplitude != nullptr) {
            const index_t at = group * r.stride + r.place[point];
            if (r.kind == AmplitudeKind::antenna_real) {
                store<T>(sums.amplitude + at * lanes<T>, amplitude_grad.re);
            } else {
                store<T>(sums.amplitude + 2 * at * lanes<T>, amplitude_grad.re);
                store<T>(sums.amplitude + (2 * at + 1) * lanes<T>, amplitude_grad.im);
            }
        }
    }

    /// Adds the sums over lanes of those gradients that are wanted.
    [[gnu::always_inline]] void reduce(const ReflectorSums<T>& sums, double* to) const {
        const bool wanted[] = {sums.shared, sums.normals, sums.positions};
        constexpr int first[] = {0, 2, 5, 8};
        for (int kind = 0; kind < 3; ++kind) {
            for (int k = first[kind]; wanted[kind] && k < first[kind + 1]; ++k) {
                to[k] += sum_lanes<T>(sum[k]);
            }
        }
    }
};

/// Value of the range profile, and its derivative to u, at N points.
template <int Tier, bool Slope, int N, class T>
[[gnu::always_inline]] inline void profile_at(const T* profile, const Vec<T>* u, Complex<T>* value,
                                              Complex<T>* slope) {
    constexpr int degree = Layout<Tier>::degree;
    for (int i = 0; i < N; ++i) {
        value[i] = {load<T>(profile + 2 * degree * lanes<T>),
                    load<T>(profile + (2 * degree + 1) * lanes<T>)};
        slope[i] = Complex<T>{};
    }
    for (int p = degree - 1; p >= 0; --p) {
        const Vec<T> re = load<T>(profile + 2 * p * lanes<T>);
        const Vec<T> im = load<T>(profile + (2 * p + 1) * lanes<T>);
        for (int i = 0; i < N; ++i) {
            if constexpr (Slope) {
                slope[i] = {slope[i].re * u[i] + value[i].re, slope[i].im * u[i] + value[i].im};
            }
            value[i] = {value[i].re * u[i] + re, value[i].im * u[i] + im};
        }
    }
}

template <int Tier, bool SquareRoot, bool Specular, bool Positions, class T>
void gather_block(const MatchedFilterTables<T>& tables, index_t first, index_t last,
                  const ReflectorBlock<T>& r, const Geometry<T>* geometry, const T* coefficients,
                  const ReflectorSums<T>& sums) {
    using L = Layout<Tier>;
    constexpr int n = detail::point_quantum;
    const T per_m = static_cast<T>(tables.half_turns_per_m);
    const T pi = static_cast<T>(std::numbers::pi);
    for (index_t point = 0; point < r.block.n_points; point += n) {
        const T* offsets = r.block.offsets + 4 * point;
        PointGradients<T> gradients[n];
        for (index_t group = first; group < last; ++group) {
            const T* c = coefficients + group * L::size * lanes<T>;
            Vec<T> u[n];
            carrier_half_turns<Tier, SquareRoot, n, T>(c, offsets, u);
            Complex<T> value[n];
            Complex<T> slope[n];
            profile_at<Tier, Positions, n, T>(c + L::profile * lanes<T>, u, value, slope);
            for (int i = 0; i < n; ++i) {
                const auto [sine, cosine] = sincos_half_turns<L::level, T>(u[i]);
                const Complex<T> e{cosine, sine};
                Complex<T> by_path{};
                Legs<T> legs{};
                if constexpr (Positions) {
                    // d/dd of e^(j pi u) G(u), u = per_m (d - d_c)
                    by_path = multiply({per_m * (slope[i].re - pi * value[i].im),
                                        per_m * (slope[i].im + pi * value[i].re)},
                                       e);
                }
                if constexpr (Specular || Positions) {
                    legs = legs_at(geometry[group], offsets + 4 * i);
                }
                T* antennas = Positions && sums.antennas != nullptr
                                  ? sums.antennas + group * 6 * lanes<T>
                                  : nullptr;
                gradients[i].template add<Specular, Positions>(
                    r, sums, group, point + i, legs, multiply(value[i], e), by_path, antennas);
            }
        }
        for (int i = 0; i < n; ++i) {
            gradients[i].reduce(sums, sums.points + (point + i) * detail::sums_per_point);
        }
    }
}

/// One point after another for each group, so that a group's pairs are folded once.
template <bool Specular, bool Positions, class T>
void gather_points(const MatchedFilterTables<T>& tables, const PackedAntennas<T>& antennas,
                   index_t begin, index_t end, const ReflectorBlock<T>& r, T* scratch,
                   const ReflectorSums<T>& sums) {
    constexpr double pi = std::numbers::pi;
    constexpr int n = exact_points;
    const T carrier_slope = static_cast<T>(pi * tables.half_turns_per_m);
    const T sample_slope = static_cast<T>(pi * tables.step_half_turns_per_m);
    for (index_t group = begin; group < end; ++group) {
        const double* positions = antennas.positions + group * 6 * lanes<T>;
        fold_pairs(tables.n_pairs, antennas.signal + group * tables.n_pairs * 4 * lanes<T>,
                   scratch);
        for (index_t point = 0; point < r.block.n_points; point += n) {
            PointGradients<T> gradients[n];
            Geometry<T> geometry[n];
            for (int i = 0; i < n; ++i) {
                locate(tables, positions, r.positions + 3 * (point + i), geometry[i]);
            }
            Complex<T> sum[n];
            Complex<T> slope[n] = {};
            const Phasors<n, T> phasors(tables, positions, r.positions + 3 * point);
            sum_samples<Positions, n, n, T>(tables, scratch, phasors, 0, sum, slope);
            for (int i = 0; i < n; ++i) {
                const Complex<T> e = geometry[i].carrier;
                // d/dd = j pi (carrier sum + sample slope)
                const Complex<T> by_path =
                    multiply({-carrier_slope * sum[i].im - sample_slope * slope[i].im,
                              carrier_slope * sum[i].re + sample_slope * slope[i].re},
                             e);
                T* to = Positions && sums.antennas != nullptr
                            ? sums.antennas + (group - begin) * 6 * lanes<T>
                            : nullptr;
                gradients[i].template add<Specular, Positions>(r, sums, group - begin, point + i,
                                                               legs_of(geometry[i]),
                                                               multiply(sum[i], e), by_path, to);
                gradients[i].reduce(sums, sums.points + (point + i) * detail::sums_per_point);
            }
        }
    }
}

/// The simple case, shared amplitudes and no other gradient: the image of the matched filter.
template <int Tier, class T>
void gather_image(index_t n_groups, bool series, const ReflectorBlock<T>& r, const T* coefficients,
                  double* to) {
    constexpr index_t chunk = 16 * detail::point_quantum;
    T image[2 * chunk * lanes<T>];
    for (index_t first = 0; first < r.block.n_points; first += chunk) {
        PointBlock<T> part = r.block;
        const index_t left = r.block.n_points - first;
        part.n_points = left < chunk ? left : chunk;
        part.offsets += 4 * first;
        __builtin_memset(image, 0, sizeof(image));
        if (series) {
            accumulate_image<Tier, false, T>(n_groups, part, coefficients, image);
        } else {
            accumulate_image<Tier, true, T>(n_groups, part, coefficients, image);
        }
        for (index_t i = 0; i < 2 * part.n_points; i += lanes<T>) {
            T sum[lanes<T>];
            store<T>(sum, sum_each<T>(image + i * lanes<T>));
            for (index_t k = i; k < i + lanes<T> && k < 2 * part.n_points; ++k) {
                to[(first + k / 2) * detail::sums_per_point + k % 2] +=
                    static_cast<double>(sum[k - i]);
            }
        }
    }
}

/// Groups first to last of a tile, which all use the series or all the square root.
template <int Tier, class T>
void gather_run(const MatchedFilterTables<T>& tables, index_t first, index_t last, bool series,
                const ReflectorBlock<T>& r, const Geometry<T>* geometry, const T* coefficients,
                const ReflectorSums<T>& sums) {
    using Gather =
        void (*)(const MatchedFilterTables<T>&, index_t, index_t, const ReflectorBlock<T>&,
                 const Geometry<T>*, const T*, const ReflectorSums<T>&);
    static constexpr Gather gather[2][2][2] = {
        {{&gather_block<Tier, true, false, false, T>, &gather_block<Tier, true, false, true, T>},
         {&gather_block<Tier, true, true, false, T>, &gather_block<Tier, true, true, true, T>}},
        {{&gather_block<Tier, false, false, false, T>, &gather_block<Tier, false, false, true, T>},
         {&gather_block<Tier, false, true, false, T>, &gather_block<Tier, false, true, true, T>}}};
    if (r.kind == AmplitudeKind::shared && r.normals == nullptr && !sums.positions) {
        return gather_image<Tier, T>(last - first, series, r,
                                     coefficients + first * Layout<Tier>::size * lanes<T>,
                                     sums.points);
    }
    gather[series ? 1 : 0][r.normals != nullptr ? 1 : 0][sums.positions ? 1 : 0](
        tables, first, last, r, geometry, coefficients, sums);
}

template <int Tier, class T>
void gather_blocks(const MatchedFilterTables<T>& tables, const PackedAntennas<T>& antennas,
                   index_t begin, index_t end, const ReflectorBlock<T>& r, T* scratch,
                   const ReflectorSums<T>& sums) {
    constexpr index_t size = Layout<Tier>::size * lanes<T>;
    static_assert(detail::groups_per_gather * Layout<Tier>::size <=
                  detail::groups_per_tile * detail::max_coefficients); // the room in scratch
    Geometry<T> geometry[detail::groups_per_gather];
    bool series[detail::groups_per_gather];
    const index_t n = end - begin;
    for (index_t group = 0; group < n; ++group) {
        // One by one as in trace_blocks, so that forward and backward approximate alike.
        series[group] = prepare_tile<Tier, T>(tables, antennas, begin + group, 1, r.block,
                                              geometry + group, scratch + group * size);
    }
    // In a loop of its own: the long chains of one group's geometry overlap with the next's.
    for (index_t group = 0; group < n; ++group) {
        prepare_profile<Tier, T>(tables, geometry[group],
                                 antennas.signal + (begin + group) * tables.n_pairs * 4 * lanes<T>,
                                 scratch + group * size);
    }
    for (index_t first = 0; first < n;) {
        index_t last = first + 1;
        while (last < n && series[last] == series[first]) {
            ++last;
        }
        gather_run<Tier, T>(tables, first, last, series[first], r, geometry, scratch, sums);
        first = last;
    }
}

/// Tiers a tracer may choose, see make_plan.
template <class T>
void tracer_fwd(const MatchedFilterTables<T>& tables, const PackedAntennas<T>& antennas,
                index_t begin, index_t end, const ReflectorBlock<T>& r, T* scratch, T* signal) {
    if (r.exact) {
        return trace_points(tables, antennas, begin, end, r, scratch, signal);
    }
    switch (tables.tier) {
    case wide_coarse:
        return trace_blocks<wide_coarse, T>(tables, antennas, begin, end, r, scratch, signal);
    case wider_coarse:
        return trace_blocks<wider_coarse, T>(tables, antennas, begin, end, r, scratch, signal);
    case wide_fine:
        return trace_blocks<wide_fine, T>(tables, antennas, begin, end, r, scratch, signal);
    default:
        if constexpr (sizeof(T) == 8) {
            return trace_blocks<narrow_double, T>(tables, antennas, begin, end, r, scratch, signal);
        }
    }
}

template <class T>
void tracer_bwd(const MatchedFilterTables<T>& tables, const PackedAntennas<T>& antennas,
                index_t begin, index_t end, const ReflectorBlock<T>& r, T* scratch,
                const ReflectorSums<T>& sums) {
    if (r.exact) {
        const auto gather =
            r.normals != nullptr
                ? (sums.positions ? &gather_points<true, true, T> : &gather_points<true, false, T>)
                : (sums.positions ? &gather_points<false, true, T>
                                  : &gather_points<false, false, T>);
        return gather(tables, antennas, begin, end, r, scratch, sums);
    }
    switch (tables.tier) {
    case wide_coarse:
        return gather_blocks<wide_coarse, T>(tables, antennas, begin, end, r, scratch, sums);
    case wider_coarse:
        return gather_blocks<wider_coarse, T>(tables, antennas, begin, end, r, scratch, sums);
    case wide_fine:
        return gather_blocks<wide_fine, T>(tables, antennas, begin, end, r, scratch, sums);
    default:
        if constexpr (sizeof(T) == 8) {
            return gather_blocks<narrow_double, T>(tables, antennas, begin, end, r, scratch, sums);
        }
    }
}

template <class T>
void pack_rows(const T* rows, index_t n_values, int n_rows, T* to) {
    constexpr int n = lanes<T>;
    const T* row[n];
    for (int lane = 0; lane < n; ++lane) {
        row[lane] = rows + n_values * (lane < n_rows ? lane : n_rows - 1);
    }
    index_t at = 0;
    for (; at + n <= n_values; at += n) {
        Vec<T> square[n];
        for (int lane = 0; lane < n; ++lane) {
            square[lane] = load<T>(row[lane] + at);
        }
        transpose<T>(square);
        for (int i = 0; i < n; ++i) {
            store<T>(to + (at + i) * n, square[i]);
        }
    }
    for (; at < n_values; ++at) {
        for (int lane = 0; lane < n; ++lane) {
            to[at * n + lane] = row[lane][at];
        }
    }
}

template <class T>
void unpack_rows(const T* from, index_t n_values, int n_rows, T* rows) {
    constexpr int n = lanes<T>;
    index_t at = 0;
    for (; at + n <= n_values; at += n) {
        Vec<T> square[n];
        for (int i = 0; i < n; ++i) {
            square[i] = load<T>(from + (at + i) * n);
        }
        transpose<T>(square);
        for (int lane = 0; lane < n_rows; ++lane) {
            store<T>(rows + lane * n_values + at, square[lane]);
        }
    }
    for (; at < n_values; ++at) {
        for (int lane = 0; lane < n_rows; ++lane) {
            rows[lane * n_values + at] = from[at * n + lane];
        }
    }
}

template <class T>
inline constexpr detail::SignalTracerKernels<T> signal_tracer_kernels{
    lanes<T>, &tracer_fwd<T>, &tracer_bwd<T>, &pack_rows<T>, &unpack_rows<T>};

} // namespace geraf2::GERAF2_SIMD_NAMESPACE
