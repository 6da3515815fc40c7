// SPDX-License-Identifier: Apache-2.0
// The factorised method: interpolation of the partial images of clusters of antennas, `lanes`
// clusters side by side, docs/math/block-and-factorised.md#factorised-method. Compiled once per
// instruction set.
#pragma once

#include "matched_filter/block.hpp"

namespace geraf2::GERAF2_SIMD_NAMESPACE {

using detail::PointTensor;
using enum detail::CarrierAccuracy;

/// Offsets of the coefficients of the carrier phase of one group of clusters, in vectors: two
/// legs as in Layout, then the phase at the points' centre, without whole turns.
template <int Order>
struct CarrierLayout {
    static constexpr int leg_size = 3 + Order;
    static constexpr int reference = 2 * leg_size;
    static constexpr int size = reference + 1;
};

/// Returns whether the series may be used; if not, or if not wanted, prepares the square root.
template <int Order, class T>
bool prepare_carrier(const MatchedFilterTables<T>& tables, const double* clusters,
                     const PointTensor<T>& points, bool series_wanted, T* coefficients) {
    using L = CarrierLayout<Order>;
    Geometry<T> geometry;
    locate(tables, clusters, points.center, geometry);
    const Vec<T> bad = prepare_range<Order, T>(tables, geometry, points.radius, coefficients);
    Doubles<T> reference;
    for (int i = 0; i < double_parts<T>; ++i) {
        reference.part[i] = without_whole_turns(tables.half_turns_per_m * geometry.path.part[i]);
    }
    store<T>(coefficients + L::reference * lanes<T>, narrow<T>(reference));
    const bool series = series_wanted && !any<T>(bad);
    if (!series) {
        use_square_root<L::leg_size, T>(tables, geometry, coefficients);
    }
    return series;
}

/// Common part of the points of one row: 2 v.d + |d|^2 of both legs without the last axis.
template <class T>
struct RowBase {
    Vec<T> q[2];
};

template <int Order, class T>
[[gnu::always_inline]] inline RowBase<T> row_base(const T* coefficients, T x, T y) {
    RowBase<T> out;
    for (int leg = 0; leg < 2; ++leg) {
        const T* c = coefficients + leg * CarrierLayout<Order>::leg_size * lanes<T>;
        out.q[leg] = load<T>(c) * x + (load<T>(c + lanes<T>) * y + splat(x * x + y * y));
    }
    return out;
}

/// Carrier phase at N points of a row [half turns].
template <int Order, bool SquareRoot, int N, class T>
[[gnu::always_inline]] inline void row_half_turns(const T* coefficients, const RowBase<T>& base,
                                                  const T* z, Vec<T>* half_turns) {
    using L = CarrierLayout<Order>;
    const Vec<T> reference = load<T>(coefficients + L::reference * lanes<T>);
    for (int i = 0; i < N; ++i) {
        half_turns[i] = reference;
    }
    for (int leg = 0; leg < 2; ++leg) {
        const T* c = coefficients + leg * L::leg_size * lanes<T>;
        const Vec<T> slope = load<T>(c + 2 * lanes<T>);
        Vec<T> q[N];
        for (int i = 0; i < N; ++i) {
            q[i] = (slope + z[i]) * z[i] + base.q[leg];
        }
        add_range<Order, SquareRoot, N, T>(c + 3 * lanes<T>, q, half_turns);
    }
}

/// Calls `run` for n things: in fours, then one by one, with the number as a constant.
template <class Run>
[[gnu::always_inline]] inline void in_fours(index_t n, Run run) {
    index_t i = 0;
    for (; i + 4 <= n; i += 4) {
        run.template operator()<4>(i);
    }
    for (; i < n; ++i) {
        run.template operator()<1>(i);
    }
}

/// The three accuracies of carrier_tiers, series or square root.
template <class T, class Run>
[[gnu::always_inline]] inline void with_carrier(int tier, bool series, Run run) {
    if (tier == carrier_coarse) {
        series ? run.template operator()<carrier_coarse, false>()
               : run.template operator()<carrier_coarse, true>();
    } else if (tier == carrier_fine || sizeof(T) == 4) {
        series ? run.template operator()<carrier_fine, false>()
               : run.template operator()<carrier_fine, true>();
    } else if constexpr (sizeof(T) == 8) {
        series ? run.template operator()<carrier_double, false>()
               : run.template operator()<carrier_double, true>();
    }
}

template <int Tier>
inline constexpr int carrier_order = detail::carrier_tiers[Tier].range_order;

template <class T>
bool prepare_carrier_tier(const MatchedFilterTables<T>& tables, const double* clusters,
                          const PointTensor<T>& points, T* coefficients) {
    bool series = false;
    with_carrier<T>(tables.tier, true, [&]<int Tier, bool SquareRoot>() {
        series =
            prepare_carrier<carrier_order<Tier>, T>(tables, clusters, points, true, coefficients);
    });
    return series;
}

inline constexpr int max_carrier_size = CarrierLayout<carrier_order<carrier_double>>::size;

template <int Tier, bool SquareRoot, class T>
void expand_fwd_tier(const T* coefficients, const PointTensor<T>& points, index_t n_nodes,
                     const T* weights, const T* rows, T* sums) {
    constexpr int order = carrier_order<Tier>;
    constexpr int level = detail::carrier_tiers[Tier].sincos_level;
    for (index_t x = 0; x < points.count[0]; ++x) {
        for (index_t y = 0; y < points.count[1]; ++y) {
            const auto base =
                row_base<order, T>(coefficients, points.offsets[0][x], points.offsets[1][y]);
            in_fours(points.count[2], [&]<int N>(index_t z) {
                Vec<T> u[N];
                row_half_turns<order, SquareRoot, N, T>(coefficients, base, points.offsets[2] + z,
                                                        u);
                Complex<T> value[N] = {};
                const T* w = weights + z * n_nodes;
                for (index_t k = 0; k < n_nodes; ++k) {
                    const Vec<T> re = load<T>(rows + 2 * k * lanes<T>);
                    const Vec<T> im = load<T>(rows + (2 * k + 1) * lanes<T>);
                    for (int i = 0; i < N; ++i) {
                        value[i].re += w[i * n_nodes + k] * re;
                        value[i].im += w[i * n_nodes + k] * im;
                    }
                }
                T* to = sums + 2 * z * lanes<T>;
                for (int i = 0; i < N; ++i, to += 2 * lanes<T>) {
                    const auto [s, c] = sincos_half_turns<level, T>(u[i]);
                    const Vec<T> re = load<T>(to) + value[i].re * c;
                    const Vec<T> im = load<T>(to + lanes<T>) + value[i].re * s;
                    store<T>(to, re - value[i].im * s);
                    store<T>(to + lanes<T>, im + value[i].im * c);
                }
            });
            rows += 2 * n_nodes * lanes<T>;
            sums += 2 * points.count[2] * lanes<T>;
        }
    }
}

template <class T>
void expand_fwd(const MatchedFilterTables<T>& tables, const double* clusters,
                const PointTensor<T>& points, index_t n_nodes, const T* weights, const T* rows,
                T* sums) {
    T coefficients[max_carrier_size * lanes<T>];
    const bool series = prepare_carrier_tier(tables, clusters, points, coefficients);
    with_carrier<T>(tables.tier, series, [&]<int Tier, bool SquareRoot>() {
        expand_fwd_tier<Tier, SquareRoot, T>(coefficients, points, n_nodes, weights, rows, sums);
    });
}

template <int Tier, bool SquareRoot, bool PerLane, class T>
void expand_bwd_tier(const T* coefficients, const PointTensor<T>& points, index_t n_nodes,
                     const T* weights, const T* values, T* rows) {
    constexpr int order = carrier_order<Tier>;
    constexpr int level = detail::carrier_tiers[Tier].sincos_level;
    for (index_t x = 0; x < points.count[0]; ++x) {
        for (index_t y = 0; y < points.count[1]; ++y) {
            const auto base =
                row_base<order, T>(coefficients, points.offsets[0][x], points.offsets[1][y]);
            in_fours(points.count[2], [&]<int N>(index_t z) {
                Vec<T> u[N];
                row_half_turns<order, SquareRoot, N, T>(coefficients, base, points.offsets[2] + z,
                                                        u);
                Complex<T> value[N];
                for (int i = 0; i < N; ++i) {
                    const auto [s, c] = sincos_half_turns<level, T>(u[i]);
                    const Complex<T> g = image_value<PerLane, T>(values, z + i);
                    value[i] = {c * g.re + s * g.im, c * g.im - s * g.re};
                }
                const T* w = weights + z * n_nodes;
                for (index_t k = 0; k < n_nodes; ++k) {
                    T* to = rows + 2 * k * lanes<T>;
                    Vec<T> re = load<T>(to);
                    Vec<T> im = load<T>(to + lanes<T>);
                    for (int i = 0; i < N; ++i) {
                        re += w[i * n_nodes + k] * value[i].re;
                        im += w[i * n_nodes + k] * value[i].im;
                    }
                    store<T>(to, re);
                    store<T>(to + lanes<T>, im);
                }
            });
            rows += 2 * n_nodes * lanes<T>;
            values += 2 * points.count[2] * (PerLane ? lanes<T> : 1);
        }
    }
}

template <class T>
void expand_bwd(const MatchedFilterTables<T>& tables, const double* clusters,
                const PointTensor<T>& points, index_t n_nodes, const T* weights, bool per_lane,
                const T* values, T* rows) {
    T coefficients[max_carrier_size * lanes<T>];
    const bool series = prepare_carrier_tier(tables, clusters, points, coefficients);
    with_carrier<T>(tables.tier, series, [&]<int Tier, bool SquareRoot>() {
        if (per_lane) {
            expand_bwd_tier<Tier, SquareRoot, true, T>(coefficients, points, n_nodes, weights,
                                                       values, rows);
        } else {
            expand_bwd_tier<Tier, SquareRoot, false, T>(coefficients, points, n_nodes, weights,
                                                        values, rows);
        }
    });
}

/// By the square root and full sine and cosine: points at nodes are few and spread wide.
template <class T>
void modulate(const MatchedFilterTables<T>& tables, const double* clusters,
              const PointTensor<T>& points, int sign, T* values) {
    constexpr int order = 4; // room for the square root's three coefficients is enough
    T coefficients[CarrierLayout<order>::size * lanes<T>];
    prepare_carrier<order, T>(tables, clusters, points, false, coefficients);
    const T turn = static_cast<T>(sign);
    for (index_t x = 0; x < points.count[0]; ++x) {
        for (index_t y = 0; y < points.count[1]; ++y) {
            const auto base =
                row_base<order, T>(coefficients, points.offsets[0][x], points.offsets[1][y]);
            for (index_t z = 0; z < points.count[2]; ++z, values += 2 * lanes<T>) {
                Vec<T> u[1];
                row_half_turns<order, true, 1, T>(coefficients, base, points.offsets[2] + z, u);
                const Complex<T> value =
                    multiply({load<T>(values), load<T>(values + lanes<T>)}, phasor<T>(turn * u[0]));
                store<T>(values, value.re);
                store<T>(values + lanes<T>, value.im);
            }
        }
    }
}

/// to[0..P) += weights (P, n_from) times from, for V vectors of each row.
template <int P, int V, class T>
[[gnu::always_inline]] inline void contract_tile(index_t n_from, index_t n_values, const T* weights,
                                                 const T* from, T* to) {
    Vec<T> sum[P][V];
    for (int p = 0; p < P; ++p) {
        for (int v = 0; v < V; ++v) {
            sum[p][v] = load<T>(to + p * n_values + v * lanes<T>);
        }
    }
    for (index_t k = 0; k < n_from; ++k) {
        Vec<T> row[V];
        for (int v = 0; v < V; ++v) {
            row[v] = load<T>(from + k * n_values + v * lanes<T>);
        }
        for (int p = 0; p < P; ++p) {
            const T w = weights[p * n_from + k];
            for (int v = 0; v < V; ++v) {
                sum[p][v] = w * row[v] + sum[p][v];
            }
        }
    }
    for (int p = 0; p < P; ++p) {
        for (int v = 0; v < V; ++v) {
            store<T>(to + p * n_values + v * lanes<T>, sum[p][v]);
        }
    }
}

template <class T>
void contract(index_t n_from, index_t n_to, index_t n_values, const T* weights, const T* from,
              T* to) {
    in_fours(n_to, [&]<int P>(index_t p) {
        index_t v = 0;
        for (; v + 2 * lanes<T> <= n_values; v += 2 * lanes<T>) {
            contract_tile<P, 2, T>(n_from, n_values, weights + p * n_from, from + v,
                                   to + p * n_values + v);
        }
        for (; v < n_values; v += lanes<T>) {
            contract_tile<P, 1, T>(n_from, n_values, weights + p * n_from, from + v,
                                   to + p * n_values + v);
        }
    });
}

/// Sum of the lanes, halving their number at each step.
template <int Half, class T, int... Lane>
[[gnu::always_inline]] inline T fold(Vec<T> v, LaneList<Lane...> all) {
    if constexpr (Half == 0) {
        return v[0];
    } else {
        return fold<Half / 2, T>(v + __builtin_shufflevector(v, v, ((Lane + Half) % lanes<T>)...),
                                 all);
    }
}

template <class T>
void sum_lanes(index_t n, const T* from, T* to) {
    for (index_t i = 0; i < n; ++i) {
        to[i] = fold<lanes<T> / 2, T>(load<T>(from + i * lanes<T>),
                                      typename MakeLaneList<lanes<T>>::type{});
    }
}

} // namespace geraf2::GERAF2_SIMD_NAMESPACE
