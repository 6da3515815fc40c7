// SPDX-License-Identifier: Apache-2.0
// The block method, docs/math/block-and-factorised.md#block-method. Compiled once per instruction
// set.
#pragma once

#include "matched_filter/kernels.hpp"
#include "matched_filter/tiers.hpp"
#include "simd/vector.hpp"

namespace geraf2::GERAF2_SIMD_NAMESPACE {

using detail::MatchedFilterTables;
using detail::PackedAntennas;
using detail::PointBlock;
using enum detail::Tier;

/// Offsets of the coefficients of one antenna group, counted in vectors.
template <int Tier>
struct Layout {
    static constexpr int degree = detail::tiers[Tier].profile_degree;
    static constexpr int order = detail::tiers[Tier].range_order;
    static constexpr int level = detail::tiers[Tier].sincos_level;
    static constexpr int leg_size = 3 + order; // 2 v, then the series (or R_c^2, R_c, scale)
    static constexpr int profile = 2 * leg_size;
    static constexpr int size = profile + 2 * (degree + 1);
    static_assert(size <= detail::max_coefficients && order >= 3);
};

/// Binomial coefficients of (1 + e)^(1/2) as ratios: term k + 1 = term k * ratio[k] * e.
inline constexpr double sqrt_ratio[] = {0.5,          -0.25,        -0.5,        -0.625,     -0.7,
                                        -0.75,        -11.0 / 14.0, -0.8125,     -5.0 / 6.0, -0.85,
                                        -19.0 / 22.0, -0.875,       -23.0 / 26.0};

/// Double-precision geometry of one group at a block's centre, rounded only at the end.
template <class T>
struct Geometry {
    Vec<T> offset[6];   // centre - tx, centre - rx [m]
    Vec<T> range[2];    // |centre - tx|, |centre - rx| [m]
    Doubles<T> path;    // d_c [m]
    Complex<T> carrier; // exp(j phase) at mid-band
};

/// sine and cosine as good as T can hold.
template <class T>
[[gnu::always_inline]] inline Complex<T> phasor(Vec<T> half_turns) {
    const auto [s, c] = sincos_half_turns<full_level<T>, T>(half_turns);
    return {c, s};
}

/// exp(j pi half_turns_per_m path).
template <class T>
[[gnu::always_inline]] inline Complex<T> path_phasor(double half_turns_per_m,
                                                     const Doubles<T>& path) {
    Doubles<T> half_turns;
    for (int i = 0; i < double_parts<T>; ++i) {
        half_turns.part[i] = without_whole_turns(half_turns_per_m * path.part[i]);
    }
    return phasor<T>(narrow<T>(half_turns));
}

template <class T>
[[gnu::always_inline]] inline void locate(const MatchedFilterTables<T>& tables,
                                          const double* positions, const double* center,
                                          Geometry<T>& out) {
    for (int i = 0; i < double_parts<T>; ++i) {
        out.path.part[i] = splat(tables.path_bias_m);
    }
    for (int leg = 0; leg < 2; ++leg) {
        Doubles<T> range{};
        for (int axis = 0; axis < 3; ++axis) {
            Doubles<T> v = load_doubles<T>(positions + (3 * leg + axis) * lanes<T>);
            for (int i = 0; i < double_parts<T>; ++i) {
                v.part[i] = center[axis] - v.part[i];
                range.part[i] += v.part[i] * v.part[i];
            }
            out.offset[3 * leg + axis] = narrow<T>(v);
        }
        square_roots<1, T>(&range);
        for (int i = 0; i < double_parts<T>; ++i) {
            out.path.part[i] += range.part[i];
        }
        out.range[leg] = narrow<T>(range);
    }
    out.carrier = path_phasor<T>(tables.half_turns_per_m, out.path);
}

/// exp(j x) of the phase x between the sample m steps above mid-band and mid-band itself.
template <class T>
[[gnu::always_inline]] inline Complex<T> sample_phasor(const MatchedFilterTables<T>& tables,
                                                       const Geometry<T>& geometry, double m) {
    return path_phasor<T>(tables.step_half_turns_per_m * m, geometry.path);
}

/// Phasors of the first sample pair and of one step: half steps apart they share one sine.
template <class T>
struct StartAndStep {
    Complex<T> start, step;
};

template <class T>
[[gnu::always_inline]] inline StartAndStep<T> start_and_step(const MatchedFilterTables<T>& tables,
                                                             const Geometry<T>& geometry) {
    const Complex<T> half = sample_phasor(tables, geometry, 0.5);
    if (tables.first_pair > 0.0) {
        return {half, multiply(half, half)};
    }
    return {{splat(T(1)), Vec<T>{}}, multiply(half, half)};
}

/// The recurrence z <- z w is seeded afresh every so many samples: rounding stays below 64 ulp.
inline constexpr index_t reseed = 64;

template <class T>
[[gnu::always_inline]] inline Complex<T> next_phasor(const MatchedFilterTables<T>& tables,
                                                     const Geometry<T>& geometry, index_t m,
                                                     Complex<T> z, Complex<T> w) {
    return m % reseed == 0
               ? sample_phasor(tables, geometry, tables.first_pair + static_cast<double>(m))
               : multiply(z, w);
}

/// Series of h (R - R_c) in q for one leg; returns a bound of its error [rad].
template <int Order, class T>
Vec<T> range_series(const MatchedFilterTables<T>& tables, Vec<T> range, T radius, T* to) {
    const T scale = static_cast<T>(tables.half_turns_per_m);
    const Vec<T> inverse = T(1) / range;
    const Vec<T> inverse_square = inverse * inverse;
    const Vec<T> q_max = (T(2) * range + radius) * radius;
    Vec<T> term = scale * range; // h R_c binomial(1/2, k) / R_c^(2 k)
    Vec<T> series[Order + 1];
    for (int k = 0; k < Order; ++k) {
        term = term * (T(sqrt_ratio[k]) * inverse_square);
        series[k] = term;
    }
    const Vec<T> dropped = term * (T(sqrt_ratio[Order]) * inverse_square);
    // On |q| <= Q, q^(n+1) is nearest to economy Q^2 q^(n-1) among its multiples.
    series[Order - 2] += static_cast<T>(tables.range_economy) * (q_max * q_max) * dropped;
    Vec<T> bound = dropped < T(0) ? -dropped : dropped;
    for (int k = 0; k <= Order; ++k) {
        bound = bound * q_max;
    }
    for (int k = 0; k < Order; ++k) {
        store<T>(to + k * lanes<T>, series[k]);
    }
    // The terms beyond fall at least as fast as powers of Q / R_c^2.
    const Vec<T> ratio = q_max * inverse_square;
    const T residual = static_cast<T>(3.14159265358979 * tables.range_residual);
    const Vec<T> rest = (residual + T(3.2) * ratio) * bound / (T(1) - ratio);
    return ratio < T(0.5) ? rest : splat(T(1e30));
}

/// Range coefficients of one group. 0 in each lane for which the series is good enough, else 1.
template <int Order, class T>
Vec<T> prepare_range(const MatchedFilterTables<T>& tables, const Geometry<T>& geometry,
                     double radius, T* coefficients) {
    Vec<T> error{};
    for (int leg = 0; leg < 2; ++leg) {
        T* to = coefficients + leg * (3 + Order) * lanes<T>;
        for (int axis = 0; axis < 3; ++axis) {
            store<T>(to + axis * lanes<T>, T(2) * geometry.offset[3 * leg + axis]);
        }
        error += range_series<Order, T>(tables, geometry.range[leg], static_cast<T>(radius),
                                        to + 3 * lanes<T>);
    }
    // A comparison with NaN is false: a range of zero counts as bad.
    return error <= static_cast<T>(tables.range_limit) ? Vec<T>{} : splat(T(1));
}

template <class T>
bool any(Vec<T> flags) {
    if constexpr (sizeof(T) == 4) {
        return !all_less(flags, splat(T(1)));
    } else {
        T sum{};
        for (int lane = 0; lane < lanes<T>; ++lane) {
            sum += flags[lane];
        }
        return sum > T(0);
    }
}

/// Coefficients of the fallback h (R - R_c) = h q / (R + R_c), exact at any distance.
template <int LegSize, class T>
void use_square_root(const MatchedFilterTables<T>& tables, const Geometry<T>& geometry,
                     T* coefficients) {
    for (int leg = 0; leg < 2; ++leg) {
        T* to = coefficients + (leg * LegSize + 3) * lanes<T>;
        const Vec<T> range = geometry.range[leg];
        store<T>(to, range * range);
        store<T>(to + lanes<T>, range);
        store<T>(to + 2 * lanes<T>, splat(static_cast<T>(tables.half_turns_per_m)));
    }
}

/// Multiplies by j^p.
template <class T>
[[gnu::always_inline]] inline Complex<T> times_j_power(Complex<T> z, int p) {
    switch (static_cast<unsigned>(p) & 3U) {
    case 1:
        return {-z.im, z.re};
    case 2:
        return {-z.re, -z.im};
    case 3:
        return {z.im, -z.re};
    default:
        return z;
    }
}

/// Polynomial of the demodulated range profile about d_c: C_p = j^p e^(j phi) sum_m c_p(m) y(m).
template <int Tier, class T>
void prepare_profile(const MatchedFilterTables<T>& tables, const Geometry<T>& geometry,
                     const T* signal, T* coefficients) {
    using L = Layout<Tier>;
    constexpr int terms = L::degree + 1;
    Complex<T> sum[terms] = {};
    auto [z, w] = start_and_step(tables, geometry);
    for (index_t m = 0; m < tables.n_pairs; ++m) {
        const T* s = signal + m * 4 * lanes<T>;
        const Complex<T> plus{load<T>(s), load<T>(s + lanes<T>)};
        const Complex<T> minus{load<T>(s + 2 * lanes<T>), load<T>(s + 3 * lanes<T>)};
        const Complex<T> even{plus.re * z.re - minus.im * z.im, plus.im * z.re + minus.re * z.im};
        const Complex<T> odd{minus.re * z.re - plus.im * z.im, minus.im * z.re + plus.re * z.im};
        const T* c = tables.profile + m * terms;
        for (int p = 0; p < terms; ++p) {
            sum[p].re += c[p] * (p % 2 == 0 ? even.re : odd.re);
            sum[p].im += c[p] * (p % 2 == 0 ? even.im : odd.im);
        }
        z = next_phasor(tables, geometry, m + 1, z, w);
    }
    for (int p = 0; p < terms; ++p) {
        const Complex<T> value = times_j_power(multiply(sum[p], geometry.carrier), p);
        T* to = coefficients + (L::profile + 2 * p) * lanes<T>;
        store<T>(to, value.re);
        store<T>(to + lanes<T>, value.im);
    }
}

/// Adds h (R - R_c) at N values of q for one leg, of which `series` are the coefficients, so that
/// each is loaded once.
template <int Order, bool SquareRoot, int N, class T>
[[gnu::always_inline]] inline void add_range(const T* series, const Vec<T>* q, Vec<T>* half_turns) {
    if constexpr (SquareRoot) {
        const Vec<T> center_square = load<T>(series);
        const Vec<T> center = load<T>(series + lanes<T>);
        const Vec<T> scale = load<T>(series + 2 * lanes<T>);
        for (int i = 0; i < N; ++i) {
            const Vec<T> square = center_square + q[i];
            const Vec<T> range = square_root(square > T(0) ? square : Vec<T>{});
            // 1e-30 keeps 0 / 0 away where antenna, centre and point coincide.
            half_turns[i] += scale * q[i] / (range + center + T(1e-30));
        }
    } else {
        Vec<T> sum[N];
        const Vec<T> last = load<T>(series + (Order - 1) * lanes<T>);
        for (int i = 0; i < N; ++i) {
            sum[i] = last;
        }
        for (int k = Order - 2; k >= 0; --k) {
            const Vec<T> term = load<T>(series + k * lanes<T>);
            for (int i = 0; i < N; ++i) {
                sum[i] = sum[i] * q[i] + term;
            }
        }
        for (int i = 0; i < N; ++i) {
            half_turns[i] = sum[i] * q[i] + half_turns[i];
        }
    }
}

/// h (R - R_c) of one leg for N points. offsets: (N, 4), x - centre and its square.
template <int Order, bool SquareRoot, int N, class T>
[[gnu::always_inline]] inline void add_leg(const T* leg, const T* offsets, Vec<T>* half_turns) {
    Vec<T> q[N];
    for (int i = 0; i < N; ++i) {
        q[i] = load<T>(leg) * offsets[4 * i] + offsets[4 * i + 3];
    }
    for (int axis = 1; axis < 3; ++axis) {
        const Vec<T> v = load<T>(leg + axis * lanes<T>);
        for (int i = 0; i < N; ++i) {
            q[i] = v * offsets[4 * i + axis] + q[i];
        }
    }
    add_range<Order, SquareRoot, N, T>(leg + 3 * lanes<T>, q, half_turns);
}

/// carrier_half_turns by the series, both legs at once.
template <int Tier, int N, class T>
[[gnu::always_inline]] inline void carrier_series(const T* coefficients, const T* offsets,
                                                  Vec<T>* half_turns) {
    using L = Layout<Tier>;
    Vec<T> q[2][N];
    Vec<T> sum[2][N];
    for (int leg = 0; leg < 2; ++leg) {
        const Vec<T> v = load<T>(coefficients + leg * L::leg_size * lanes<T>);
        for (int i = 0; i < N; ++i) {
            q[leg][i] = v * offsets[4 * i] + offsets[4 * i + 3];
        }
    }
    for (int axis = 1; axis < 3; ++axis) {
        for (int leg = 0; leg < 2; ++leg) {
            const Vec<T> v = load<T>(coefficients + (leg * L::leg_size + axis) * lanes<T>);
            for (int i = 0; i < N; ++i) {
                q[leg][i] = v * offsets[4 * i + axis] + q[leg][i];
            }
        }
    }
    for (int k = L::order - 1; k >= 0; --k) {
        for (int leg = 0; leg < 2; ++leg) {
            const Vec<T> term = load<T>(coefficients + (leg * L::leg_size + 3 + k) * lanes<T>);
            for (int i = 0; i < N; ++i) {
                sum[leg][i] = k == L::order - 1 ? term : sum[leg][i] * q[leg][i] + term;
            }
        }
    }
    for (int i = 0; i < N; ++i) {
        half_turns[i] = sum[0][i] * q[0][i];
    }
    for (int i = 0; i < N; ++i) {
        half_turns[i] = sum[1][i] * q[1][i] + half_turns[i];
    }
}

/// Carrier phase between each point and the block's centre, both legs [half turns].
template <int Tier, bool SquareRoot, int N, class T>
[[gnu::always_inline]] inline void carrier_half_turns(const T* coefficients, const T* offsets,
                                                      Vec<T>* half_turns) {
    using L = Layout<Tier>;
    if constexpr (!SquareRoot) {
        carrier_series<Tier, N, T>(coefficients, offsets, half_turns);
    } else {
        for (int i = 0; i < N; ++i) {
            half_turns[i] = Vec<T>{};
        }
        add_leg<L::order, SquareRoot, N, T>(coefficients, offsets, half_turns);
        add_leg<L::order, SquareRoot, N, T>(coefficients + L::leg_size * lanes<T>, offsets,
                                            half_turns);
    }
}

/// Points side by side. Two units of multiply-add with a latency of four want eight sums, which
/// four points with two legs give; with AVX-512 two are faster, whose sums stay in registers:
/// out-of-order execution begins the next group meanwhile, unless a high degree makes that long.
template <int Tier>
inline constexpr int points_at_once = vector_bytes == 64 && Layout<Tier>::degree < 6 ? 2 : 4;
static_assert(detail::point_quantum % 4 == 0);

template <int Tier, bool SquareRoot, class T>
void accumulate_image(index_t n_groups, const PointBlock<T>& block, const T* coefficients,
                      T* image) {
    using L = Layout<Tier>;
    constexpr int n = points_at_once<Tier>;
    for (index_t point = 0; point < block.n_points; point += n) {
        const T* offsets = block.offsets + 4 * point;
        T* to = image + 2 * point * lanes<T>;
        Complex<T> sum[n];
        for (int i = 0; i < n; ++i) {
            sum[i] = {load<T>(to + 2 * i * lanes<T>), load<T>(to + (2 * i + 1) * lanes<T>)};
        }
        for (index_t group = 0; group < n_groups; ++group) {
            const T* c = coefficients + group * L::size * lanes<T>;
            const T* profile = c + L::profile * lanes<T>;
            Vec<T> u[n];
            carrier_half_turns<Tier, SquareRoot, n, T>(c, offsets, u);
            Complex<T> value[n];
            const Complex<T> last{load<T>(profile + 2 * L::degree * lanes<T>),
                                  load<T>(profile + (2 * L::degree + 1) * lanes<T>)};
            for (int i = 0; i < n; ++i) {
                value[i] = last;
            }
            for (int p = L::degree - 1; p >= 0; --p) {
                const Vec<T> re = load<T>(profile + 2 * p * lanes<T>);
                const Vec<T> im = load<T>(profile + (2 * p + 1) * lanes<T>);
                for (int i = 0; i < n; ++i) {
                    value[i] = {value[i].re * u[i] + re, value[i].im * u[i] + im};
                }
            }
            SinCos<T> phasor[n];
            sincos_half_turns<L::level, n, T>(u, phasor);
            for (int i = 0; i < n; ++i) {
                const auto [s, e] = phasor[i];
                sum[i].re = sum[i].re + value[i].re * e;
                sum[i].im = sum[i].im + value[i].re * s;
                sum[i].re = sum[i].re - value[i].im * s;
                sum[i].im = sum[i].im + value[i].im * e;
            }
        }
        for (int i = 0; i < n; ++i) {
            store<T>(to + 2 * i * lanes<T>, sum[i].re);
            store<T>(to + (2 * i + 1) * lanes<T>, sum[i].im);
        }
    }
}

/// Geometry and range coefficients of one tile. Returns whether the series may be used; a tile
/// decides as one, so that image and adjoint approximate alike.
template <int Tier, class T>
bool prepare_tile(const MatchedFilterTables<T>& tables, const PackedAntennas<T>& antennas,
                  index_t begin, index_t n_groups, const PointBlock<T>& block,
                  Geometry<T>* geometry, T* coefficients) {
    Vec<T> bad{};
    for (index_t group = 0; group < n_groups; ++group) {
        locate(tables, antennas.positions + (begin + group) * 6 * lanes<T>, block.center,
               geometry[group]);
        T* to = coefficients + group * Layout<Tier>::size * lanes<T>;
        bad += prepare_range<Layout<Tier>::order, T>(tables, geometry[group], block.radius, to);
    }
    const bool series = !any<T>(bad);
    for (index_t group = 0; group < n_groups && !series; ++group) {
        use_square_root<Layout<Tier>::leg_size, T>(
            tables, geometry[group], coefficients + group * Layout<Tier>::size * lanes<T>);
    }
    return series;
}

template <int Tier, class T>
void block_fwd_tier(const MatchedFilterTables<T>& tables, const PackedAntennas<T>& antennas,
                    index_t group_begin, index_t group_end, const PointBlock<T>& block, T* scratch,
                    T* image) {
    using detail::groups_per_tile;
    constexpr index_t size = Layout<Tier>::size * lanes<T>;
    // Two tiles together, where there is room, halve the traffic of sums; each decides for itself.
    constexpr int tiles = 2 * Layout<Tier>::size <= detail::max_coefficients ? 2 : 1;
    Geometry<T> geometry[groups_per_tile];
    for (index_t begin = group_begin; begin < group_end; begin += tiles * groups_per_tile) {
        bool series[2] = {};
        index_t count[2] = {};
        for (int tile = 0; tile < tiles; ++tile) {
            const index_t first = begin + tile * groups_per_tile;
            const index_t left = group_end - first;
            const index_t n = left < groups_per_tile ? (left < 0 ? 0 : left) : groups_per_tile;
            T* to = scratch + tile * groups_per_tile * size;
            count[tile] = n;
            series[tile] = prepare_tile<Tier, T>(tables, antennas, first, n, block, geometry, to);
            for (index_t group = 0; group < n; ++group) {
                const T* signal = antennas.signal + (first + group) * tables.n_pairs * 4 * lanes<T>;
                prepare_profile<Tier, T>(tables, geometry[group], signal, to + group * size);
            }
        }
        const auto add = [&](bool by_series, index_t n, const T* coefficients) {
            by_series ? accumulate_image<Tier, false, T>(n, block, coefficients, image)
                      : accumulate_image<Tier, true, T>(n, block, coefficients, image);
        };
        if (series[0] == series[1] || count[1] == 0) {
            add(series[0], count[0] + count[1], scratch);
        } else {
            add(series[0], count[0], scratch);
            add(series[1], count[1], scratch + groups_per_tile * size);
        }
    }
}

/// One value for all antennas, or one for each lane.
template <bool PerLane, class T>
[[gnu::always_inline]] inline Complex<T> image_value(const T* image, index_t point) {
    if constexpr (PerLane) {
        return {load<T>(image + 2 * point * lanes<T>), load<T>(image + (2 * point + 1) * lanes<T>)};
    } else {
        return {splat(image[2 * point]), splat(image[2 * point + 1])};
    }
}

/// Moments of the points: M_p = sum_x g(x) e^(-j pi u) u^p, (degree + 1) complex vectors.
/// weigh(point) gives g at one point.
template <int Tier, bool SquareRoot, class T, class Weigh>
[[gnu::always_inline]] inline void accumulate_moments(const PointBlock<T>& block,
                                                      const T* coefficients, const Weigh& weigh,
                                                      Complex<T>* moments) {
    using L = Layout<Tier>;
    constexpr int n = detail::point_quantum;
    Complex<T> sum[L::degree + 1] = {};
    for (index_t point = 0; point < block.n_points; point += n) {
        Vec<T> u[n];
        carrier_half_turns<Tier, SquareRoot, n, T>(coefficients, block.offsets + 4 * point, u);
        SinCos<T> phasor[n];
        sincos_half_turns<L::level, n, T>(u, phasor);
        for (int i = 0; i < n; ++i) {
            const auto [s, c] = phasor[i];
            const auto g = weigh(point + i);
            const Complex<T> term{c * g.re + s * g.im, c * g.im - s * g.re};
            sum[0].re += term.re;
            sum[0].im += term.im;
            // Powers of u alone and not of u times the term: three instructions a degree, not four.
            Vec<T> power = u[i];
            for (int p = 1; p <= L::degree; ++p) {
                sum[p].re += term.re * power;
                sum[p].im += term.im * power;
                power *= u[i];
            }
        }
    }
    for (int p = 0; p <= L::degree; ++p) {
        moments[p] = sum[p];
    }
}

/// Adjoint of prepare_profile: adds the moments' part to the packed signal of one group.
template <int Tier, class T>
void spread_moments(const MatchedFilterTables<T>& tables, const Geometry<T>& geometry,
                    Complex<T>* moments, T* signal) {
    constexpr int terms = Layout<Tier>::degree + 1;
    const Complex<T> conjugate{geometry.carrier.re, -geometry.carrier.im};
    for (int p = 0; p < terms; ++p) {
        moments[p] = times_j_power(multiply(moments[p], conjugate), -p);
    }
    auto [z, w] = start_and_step(tables, geometry);
    for (index_t m = 0; m < tables.n_pairs; ++m) {
        const T* coefficient = tables.profile + m * terms;
        Complex<T> part[2] = {}; // even, odd
        for (int p = 0; p < terms; ++p) {
            part[p % 2].re += coefficient[p] * moments[p].re;
            part[p % 2].im += coefficient[p] * moments[p].im;
        }
        const Complex<T> even = part[0];
        const Complex<T> odd = part[1];
        T* to = signal + m * 4 * lanes<T>;
        store<T>(to, load<T>(to) + even.re * z.re + odd.im * z.im);
        store<T>(to + lanes<T>, load<T>(to + lanes<T>) + even.im * z.re - odd.re * z.im);
        to += 2 * lanes<T>;
        store<T>(to, load<T>(to) + odd.re * z.re + even.im * z.im);
        store<T>(to + lanes<T>, load<T>(to + lanes<T>) + odd.im * z.re - even.re * z.im);
        z = next_phasor(tables, geometry, m + 1, z, w);
    }
}

template <int Tier, class T>
void block_bwd_tier(const MatchedFilterTables<T>& tables, const PackedAntennas<T>& antennas,
                    index_t group_begin, index_t group_end, const PointBlock<T>& block,
                    const T* image, T* scratch, T* signal) {
    constexpr index_t size = Layout<Tier>::size * lanes<T>;
    const auto weigh = [image](index_t point) {
        return image_value<(Tier >= detail::first_node_tier), T>(image, point);
    };
    Geometry<T> geometry[detail::groups_per_tile];
    for (index_t begin = group_begin; begin < group_end; begin += detail::groups_per_tile) {
        const index_t left = group_end - begin;
        const index_t n = left < detail::groups_per_tile ? left : detail::groups_per_tile;
        const bool series =
            prepare_tile<Tier, T>(tables, antennas, begin, n, block, geometry, scratch);
        for (index_t group = 0; group < n; ++group) {
            const T* c = scratch + group * size;
            Complex<T> moments[Layout<Tier>::degree + 1];
            if (series) {
                accumulate_moments<Tier, false, T>(block, c, weigh, moments);
            } else {
                accumulate_moments<Tier, true, T>(block, c, weigh, moments);
            }
            spread_moments<Tier, T>(tables, geometry[group], moments,
                                    signal + (begin + group) * tables.n_pairs * 4 * lanes<T>);
        }
    }
}

/// Calls `run` with the tier of a block or of nodes as a constant; float does not use the finest.
template <class T, class Run>
[[gnu::always_inline]] inline void with_tier(int tier, Run run) {
    switch (tier) {
    case narrow_coarse:
        return run.template operator()<narrow_coarse>();
    case narrow_fine:
        return run.template operator()<narrow_fine>();
    case nodes_coarse_low:
        return run.template operator()<nodes_coarse_low>();
    case nodes_coarse_high:
        return run.template operator()<nodes_coarse_high>();
    case nodes_fine_low:
        return run.template operator()<nodes_fine_low>();
    case nodes_fine_high:
        return run.template operator()<nodes_fine_high>();
    default:
        if constexpr (sizeof(T) == 8) {
            return tier == narrow_double ? run.template operator()<narrow_double>()
                                         : run.template operator()<nodes_double>();
        }
    }
}

template <class T>
void block_fwd(const MatchedFilterTables<T>& tables, const PackedAntennas<T>& antennas,
               index_t group_begin, index_t group_end, const PointBlock<T>& block, T* scratch,
               T* image) {
    with_tier<T>(tables.tier, [&]<int Tier>() {
        block_fwd_tier<Tier, T>(tables, antennas, group_begin, group_end, block, scratch, image);
    });
}

template <class T>
void block_bwd(const MatchedFilterTables<T>& tables, const PackedAntennas<T>& antennas,
               index_t group_begin, index_t group_end, const PointBlock<T>& block, const T* image,
               T* scratch, T* signal) {
    with_tier<T>(tables.tier, [&]<int Tier>() {
        block_bwd_tier<Tier, T>(tables, antennas, group_begin, group_end, block, image, scratch,
                                signal);
    });
}

} // namespace geraf2::GERAF2_SIMD_NAMESPACE
