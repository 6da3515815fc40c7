// SPDX-License-Identifier: Apache-2.0
// Ray march over tiles of lanes x lanes values, rays x samples. What belongs to one interval is
// computed on rows, samples side by side, as they lie in memory; what runs along a ray on columns,
// rays side by side, after a transpose in registers.
#pragma once

#include "ray_march/kernels.hpp"
#include "simd/exp.hpp"

namespace geraf2::GERAF2_SIMD_NAMESPACE {

using detail::RayGradients;
using detail::RayInputs;
using detail::RayOutputs;

/// Where a tile lies: rows beyond n_rows repeat the last, columns beyond `width` are zero.
struct Tile {
    index_t first_ray;
    int n_rows;
    index_t n_samples;
    index_t column = 0;
    int width = 0;

    [[nodiscard, gnu::always_inline]] index_t at(int row) const {
        return (first_ray + (row < n_rows ? row : n_rows - 1)) * n_samples + column;
    }
};

/// Full: all columns are there. As a template, since the rest in the same loop halves its speed.
template <bool Full, class T>
[[gnu::always_inline]] inline Vec<T> load_row(const T* from, const Tile& tile, int row) {
    if constexpr (Full) {
        return load<T>(from + tile.at(row));
    }
    T part[lanes<T>] = {};
    for (int i = 0; i < tile.width; ++i) {
        part[i] = from[tile.at(row) + i];
    }
    return load<T>(part);
}

/// Zero where there is nothing.
template <bool Full, class T>
[[gnu::always_inline]] inline Vec<T> load_row_if(const T* from, const Tile& tile, int row) {
    return from == nullptr ? Vec<T>{} : load_row<Full, T>(from, tile, row);
}

template <bool Full, class T>
[[gnu::always_inline]] inline void store_row(T* to, const Tile& tile, int row, Vec<T> v) {
    if constexpr (Full) {
        return store<T>(to + tile.at(row), v);
    }
    T part[lanes<T>];
    store<T>(part, v);
    for (int i = 0; i < tile.width; ++i) {
        to[tile.at(row) + i] = part[i];
    }
}

/// state.block<Full>(tile) for each block of columns, from the near or the far end of the rays.
template <class T, class State>
[[gnu::always_inline]] inline void forward_blocks(State& state, Tile tile) {
    tile.width = lanes<T>;
    for (; tile.column + lanes<T> <= tile.n_samples; tile.column += lanes<T>) {
        state.template block<true>(tile);
    }
    tile.width = static_cast<int>(tile.n_samples - tile.column);
    if (tile.width > 0) {
        state.template block<false>(tile);
    }
}

template <class T, class State>
[[gnu::always_inline]] inline void backward_blocks(State& state, Tile tile) {
    tile.width = static_cast<int>(tile.n_samples % lanes<T>);
    tile.column = tile.n_samples - tile.width;
    if (tile.width > 0) {
        state.template block<false>(tile);
    }
    tile.width = lanes<T>;
    for (tile.column -= lanes<T>; tile.column >= 0; tile.column -= lanes<T>) {
        state.template block<true>(tile);
    }
}

template <class V, int... Lane>
[[gnu::always_inline]] inline auto lanes_from(V v, LaneList<Lane...> /*of the half*/, bool high) {
    constexpr int n = sizeof...(Lane);
    return high ? __builtin_shufflevector(v, v, (n + Lane)...)
                : __builtin_shufflevector(v, v, Lane...);
}

template <class T>
[[gnu::always_inline]] inline Doubles<T> widen(Vec<T> v) {
    if constexpr (sizeof(T) == 8) {
        return {{v}};
    } else {
        const typename MakeLaneList<lanes<double>>::type half;
        return {{__builtin_convertvector(lanes_from(v, half, false), Vec<double>),
                 __builtin_convertvector(lanes_from(v, half, true), Vec<double>)}};
    }
}

/// to += factor * v
template <class T>
[[gnu::always_inline]] inline void add(Doubles<T>& to, const Doubles<T>& v, double factor = 1.0) {
    for (int i = 0; i < double_parts<T>; ++i) {
        to.part[i] += factor * v.part[i];
    }
}

/// The logistic's arguments at the ends of one interval each.
template <class T>
struct Intervals {
    Vec<T> near, far, drop; // inv_s (f -+ cos step / 2); near - far, without cancellation
    Vec<T> slope;           // of far to cos: inv_s step / 2, or 0 where the ray leaves

    [[gnu::always_inline]] Intervals(T inv_s, Vec<T> sdf, Vec<T> cosine, Vec<T> step) {
        const Vec<T> half = T(0.5) * step;
        // A ray that leaves a surface (cos > 0) sees none; NaN stays.
        const Vec<T> entering = cosine > Vec<T>{} ? Vec<T>{} : cosine;
        slope = cosine > Vec<T>{} ? Vec<T>{} : inv_s * half;
        near = inv_s * (sdf - entering * half);
        far = inv_s * (sdf + entering * half);
        drop = T(-2) * inv_s * (entering * half);
    }

    /// (Phi(near) - Phi(far)) / Phi(near) = (1 - Phi(far)) (1 - e^-drop)
    [[nodiscard, gnu::always_inline]] Vec<T> alpha() const {
        return logistic_negative<T>(far) * -expm1_negative<T>(-drop);
    }
};

template <bool Full, class T>
[[gnu::always_inline]] inline Intervals<T> intervals_at(const RayInputs<T>& in, const Tile& tile,
                                                        int row) {
    return {in.inv_s, load_row<Full>(in.sdf, tile, row), load_row<Full>(in.cos, tile, row),
            load_row<Full>(in.step, tile, row)};
}

/// Walks along its rays.
template <class T>
struct ForwardMarch {
    RayInputs<T> in;
    RayOutputs<T> out;
    Vec<T> one_way = splat(T(1));
    Doubles<T> begin{};
    Doubles<T> depth{};

    template <bool Full>
    [[gnu::always_inline]] void block(const Tile& tile) {
        constexpr int n = lanes<T>;
        // Less is zero: the product would continue for hundreds of samples in denormal numbers, at
        // a hundred times the cost each.
        constexpr T least = sizeof(T) == 4 ? T(1e-37) : T(1e-307);
        Vec<T> alpha[n];
        Vec<T> across[n];
        Vec<T> step[n];
        for (int row = 0; row < n; ++row) {
            alpha[row] = intervals_at<Full>(in, tile, row).alpha();
            across[row] = alpha[row];
            step[row] = load_row<Full>(in.step, tile, row);
        }
        transpose<T>(across);
        transpose<T>(step);
        for (int i = 0; i < n; ++i) {
            const Vec<T> transmittance = in.power == 2 ? one_way * one_way : one_way;
            const Doubles<T> weight = widen<T>(transmittance * across[i]);
            const Doubles<T> length = widen<T>(step[i]);
            for (int k = 0; k < double_parts<T>; ++k) {
                depth.part[k] += weight.part[k] * (begin.part[k] + 0.5 * length.part[k]);
            }
            add<T>(begin, length);
            one_way = or_below<T>(one_way * (T(1) - across[i]), least, T(0));
            across[i] = transmittance;
        }
        transpose<T>(across);
        for (int row = 0; row < tile.n_rows; ++row) {
            store_row<Full>(out.alpha, tile, row, alpha[row]);
            store_row<Full>(out.transmittance, tile, row, across[row]);
            store_row<Full>(out.weight, tile, row, across[row] * alpha[row]);
        }
    }
};

template <class T>
void march_fwd(const RayInputs<T>& in, index_t first, int n_rows, const RayOutputs<T>& out) {
    ForwardMarch<T> march{in, out};
    forward_blocks<T>(march, {first, n_rows, in.n_samples});
    T of_ray[lanes<T>];
    store<T>(of_ray, narrow<T>(march.depth));
    for (int row = 0; row < n_rows; ++row) {
        out.depth[first + row] = of_ray[row];
    }
}

/// Lengths of rays.
template <class T>
struct RayEnds {
    const T* step;
    Doubles<T> end{};

    template <bool Full>
    [[gnu::always_inline]] void block(const Tile& tile) {
        Vec<T> across[lanes<T>];
        for (int row = 0; row < lanes<T>; ++row) {
            across[row] = load_row<Full>(step, tile, row);
        }
        transpose<T>(across);
        for (int i = 0; i < lanes<T>; ++i) {
            add<T>(end, widen<T>(across[i]));
        }
    }
};

/// What depth gives to the gradients of the weights, walked from the far end of the rays.
template <class T>
struct DepthGradient {
    const T* step = nullptr;
    Vec<T> grad{};    // dL/d depth of each ray
    Doubles<T> end{}; // where the last interval not yet seen ends
    bool wanted = false;

    [[gnu::always_inline]] DepthGradient(const T* depth_grad, const RayInputs<T>& in,
                                         const Tile& tile)
        : step(in.step) {
        T of_ray[lanes<T>] = {};
        for (int row = 0; row < tile.n_rows && depth_grad != nullptr; ++row) {
            of_ray[row] = depth_grad[tile.first_ray + row];
            wanted = wanted || of_ray[row] != T(0);
        }
        grad = load<T>(of_ray);
        if (wanted) {
            RayEnds<T> ends{step};
            forward_blocks<T>(ends, tile);
            end = ends.end;
        }
    }

    /// dL/d depth times mid-interval, by rows.
    template <bool Full>
    [[gnu::always_inline]] void take(const Tile& tile, Vec<T>* rows) {
        for (int row = 0; row < lanes<T>; ++row) {
            rows[row] = wanted ? load_row<Full>(step, tile, row) : Vec<T>{};
        }
        if (!wanted) {
            return;
        }
        transpose<T>(rows);
        for (int i = lanes<T> - 1; i >= 0; --i) {
            const Doubles<T> length = widen<T>(rows[i]);
            Doubles<T> middle = end;
            add<T>(middle, length, -0.5);
            add<T>(end, length, -1.0);
            rows[i] = grad * narrow<T>(middle);
        }
        transpose<T>(rows);
    }
};

/// Walks back along its rays.
template <class T>
struct BackwardMarch {
    RayInputs<T> in;
    RayOutputs<const T> found;
    RayOutputs<const T> grad;
    RayGradients<T> out;
    DepthGradient<T> depth;
    Doubles<T> behind{}; // sum over later intervals of transmittance dL/d transmittance
    Doubles<T> total[lanes<T>]{};

    template <bool Full>
    [[gnu::always_inline]] void block(const Tile& tile) {
        constexpr int n = lanes<T>;
        Vec<T> weight_grad[n];
        Vec<T> own[n]; // (1 - alpha) dL/d alpha
        Vec<T> later[n];
        depth.template take<Full>(tile, weight_grad);
        for (int row = 0; row < n; ++row) {
            const Vec<T> alpha = load_row<Full>(found.alpha, tile, row);
            const Vec<T> transmittance = load_row<Full>(found.transmittance, tile, row);
            const Vec<T> to_weight = weight_grad[row] + load_row_if<Full>(grad.weight, tile, row);
            own[row] = (T(1) - alpha) *
                       (load_row_if<Full>(grad.alpha, tile, row) + to_weight * transmittance);
            later[row] = transmittance *
                         (load_row_if<Full>(grad.transmittance, tile, row) + to_weight * alpha);
        }
        transpose<T>(later);
        for (int i = n - 1; i >= 0; --i) {
            const Doubles<T> here = widen<T>(later[i]);
            later[i] = narrow<T>(behind);
            add<T>(behind, here);
        }
        transpose<T>(later);
        for (int row = 0; row < tile.n_rows; ++row) {
            const Intervals<T> interval = intervals_at<Full>(in, tile, row);
            // To log(1 - alpha) = log Phi(far) - log Phi(near), which stays finite where alpha
            // reaches one.
            const Vec<T> log_grad = static_cast<T>(in.power) * later[row] - own[row];
            const Vec<T> near_grad = -log_grad * logistic_negative<T>(interval.near);
            const Vec<T> far_grad = log_grad * logistic_negative<T>(interval.far);
            store_row<Full>(out.sdf, tile, row, in.inv_s * (near_grad + far_grad));
            store_row<Full>(out.cos, tile, row, interval.slope * (far_grad - near_grad));
            add<T>(total[row], widen<T>(near_grad * interval.near + far_grad * interval.far));
        }
    }
};

template <class T>
void march_bwd(const RayInputs<T>& in, const RayOutputs<const T>& found,
               const RayOutputs<const T>& grad, index_t first, int n_rows,
               const RayGradients<T>& out) {
    const Tile tile{first, n_rows, in.n_samples};
    BackwardMarch<T> march{in, found, grad, out, DepthGradient<T>(grad.depth, in, tile)};
    backward_blocks<T>(march, tile);
    for (int row = 0; row < n_rows; ++row) {
        double sum = 0.0;
        for (int i = 0; i < lanes<T>; ++i) {
            sum += march.total[row].part[i / lanes<double>][i % lanes<double>];
        }
        out.inv_s[first + row] = sum / static_cast<double>(in.inv_s);
    }
}

template <class T>
inline constexpr detail::RayMarchKernels<T> ray_march_kernels{lanes<T>, &march_fwd<T>,
                                                              &march_bwd<T>};

} // namespace geraf2::GERAF2_SIMD_NAMESPACE
