// SPDX-License-Identifier: Apache-2.0
// Grid interpolation by chunks of points: first the cells of all of them, so that their values are
// being loaded when, one point after the other, taps along z are summed as a vector. A gather over
// points would load the same values one by one.
#pragma once

#include <cstdint>

#include "sdf_grid/kernels.hpp"
#include "simd/vector.hpp"

namespace geraf2::GERAF2_SIMD_NAMESPACE {

using detail::GridAxes;
using detail::GridPointers;

/// N values, whatever the width of this instruction set's vectors.
template <class T, int N>
struct RowOf {
    using type [[gnu::vector_size(N * sizeof(T))]] = T;
};

/// N doubles along z, in vectors that exist: the compiler would handle wider ones through memory.
template <int N>
struct Row {
    static constexpr int width = N < lanes<double> ? N : lanes<double>;
    static constexpr int parts = N / width;
    typename RowOf<double, width>::type part[parts];

    [[gnu::always_inline]] static Row from(const double* values) {
        Row out;
        __builtin_memcpy(&out, values, sizeof(out));
        return out;
    }
    [[gnu::always_inline]] double operator[](int i) const { return part[i / width][i % width]; }

    [[gnu::always_inline]] friend Row operator+(Row a, const Row& b) {
        for (int i = 0; i < parts; ++i) {
            a.part[i] += b.part[i];
        }
        return a;
    }
    [[gnu::always_inline]] friend Row operator*(Row a, const Row& b) {
        for (int i = 0; i < parts; ++i) {
            a.part[i] *= b.part[i];
        }
        return a;
    }
    [[gnu::always_inline]] friend Row operator*(double factor, Row a) {
        for (int i = 0; i < parts; ++i) {
            a.part[i] *= factor;
        }
        return a;
    }
};

/// Polynomials in the coordinate r between two voxels, lowest power first: docs/math/grid.md.
template <int N>
struct TapTerms;
template <>
struct TapTerms<2> {
    static constexpr int degree = 1;
    static constexpr double terms[][2] = {{1.0, 0.0}, {-1.0, 1.0}};
};
template <>
struct TapTerms<4> {
    static constexpr int degree = 3;
    static constexpr double terms[][4] = {{0.0, 1.0, 0.0, 0.0},
                                          {-0.5, 0.0, 0.5, 0.0},
                                          {1.0, -2.5, 2.0, -0.5},
                                          {-0.5, 1.5, -1.5, 0.5}};
};

/// Weights of the taps along one axis for the derivative of an order, per voxel.
template <int N, int Order>
[[gnu::always_inline]] inline Row<N> weights(double r) {
    Row<N> out{};
#pragma GCC unroll 4
    for (int power = TapTerms<N>::degree; power >= Order; --power) {
        double factor = 1.0; // of the derivative of r^power
        for (int k = 0; k < Order; ++k) {
            factor *= power - k;
        }
        const Row<N> term = factor * Row<N>::from(TapTerms<N>::terms[power]);
        out = power == TapTerms<N>::degree ? term : r * out + term;
    }
    return out;
}

template <int N>
[[gnu::always_inline]] inline double sum_row(const Row<N>& v) {
    double sum = v[0];
    for (int i = 1; i < N; ++i) {
        sum += v[i];
    }
    return sum;
}

[[gnu::always_inline]] inline index_t inside(index_t i, index_t length) {
    const index_t low = i < 0 ? 0 : i;
    return low < length ? low : length - 1;
}

/// Points whose cells are found together.
inline constexpr int chunk = 32;
static_assert(chunk % lanes<double> == 0);

/// Where points lie, (chunk, 3) as their coordinates do.
struct Cells {
    double cell[3 * chunk];  // index along the axis
    double place[3 * chunk]; // within the cell, 0 to 1
    double per_m[3 * chunk]; // from derivatives per voxel to per metre, 0 beyond the rim
};

/// The grid, with its axes as often as points fit side by side.
struct Lattice {
    index_t shape[3];
    index_t stride[2]; // NOLINT(modernize-use-default-member-init): along x and y, in values
    double spacing, per_m;
    double origin[3 * lanes<double>];
    double last[3 * lanes<double>];
    double last_cell[3 * lanes<double>];

    explicit Lattice(const GridAxes& axes)
        : stride{axes.shape[1] * axes.shape[2], axes.shape[2]}, spacing(axes.spacing),
          per_m(1.0 / axes.spacing) {
        __builtin_memcpy(shape, axes.shape, sizeof(shape));
        for (int i = 0; i < 3 * lanes<double>; ++i) {
            origin[i] = axes.origin[i % 3];
            last[i] = axes.last[i % 3];
            last_cell[i] = axes.last_cell[i % 3];
        }
    }

    [[gnu::always_inline]] void locate(const double* points, Cells& to) const {
        using V = Vec<double>;
        const V zero{};
        for (int i = 0; i < 3 * chunk; i += lanes<double>) {
            const int axes = i % (3 * lanes<double>);
            const V end = load<double>(last + axes);
            const V limit = load<double>(last_cell + axes);
            const V free_place = (load<double>(points + i) - load<double>(origin + axes)) / spacing;
            // NaN stays in the coordinate, and counts as 0 in finding the cell.
            V place = free_place < zero ? zero : free_place;
            place = place > end ? end : place;
            const V low = place > zero ? place : zero;
            const V nearest = round_nearest<double>(low);
            const V whole = nearest > low ? nearest - 1.0 : nearest;
            const V cell = whole > limit ? limit : whole;
            store<double>(to.cell + i, cell);
            store<double>(to.place + i, place - cell);
            store<double>(to.per_m + i, place == free_place ? splat(per_m) : zero);
        }
    }
};

template <int N, int Order>
struct Taps {
    index_t x[N], y[N];          // index along the axis; taps outside repeat the rim
    index_t first_z;             // of the first tap along z; may lie outside
    bool contiguous;             // all taps along z are inside
    Row<N> weight[3][Order + 1]; // by axis and order of the derivative
    double per_m[3];             // as Cells::per_m

    [[gnu::always_inline]] Taps(const Lattice& grid, const Cells& cells, int point) {
        for (int axis = 0; axis < 3; ++axis) {
            const double r = cells.place[3 * point + axis];
            weight[axis][0] = weights<N, 0>(r);
            if constexpr (Order >= 1) {
                weight[axis][1] = weights<N, 1>(r);
            }
            if constexpr (Order >= 2) {
                weight[axis][2] = weights<N, 2>(r);
            }
            per_m[axis] = cells.per_m[3 * point + axis];
        }
        set_taps(static_cast<index_t>(cells.cell[3 * point]), grid.shape[0], x);
        set_taps(static_cast<index_t>(cells.cell[3 * point + 1]), grid.shape[1], y);
        first_z = static_cast<index_t>(cells.cell[3 * point + 2]) - (N == 4 ? 1 : 0);
        contiguous = first_z >= 0 && first_z + N <= grid.shape[2];
    }

private:
    [[gnu::always_inline]] static void set_taps(index_t cell, index_t length, index_t* to) {
        if constexpr (N == 2) {
            to[0] = cell;
            to[1] = cell + (length > 1 ? 1 : 0);
        } else {
            for (int i = 0; i < N; ++i) {
                to[i] = inside(cell + i - 1, length);
            }
        }
    }
};

/// N values along z from the beginning of a row of the grid.
template <class T, int N>
[[gnu::always_inline]] inline Row<N> load_taps(const T* row, index_t first, index_t length,
                                               bool contiguous) {
    T values[N];
    if (contiguous) {
        __builtin_memcpy(values, row + first, sizeof(values));
    } else {
        for (int i = 0; i < N; ++i) {
            values[i] = row[inside(first + i, length)];
        }
    }
    Row<N> out;
    for (int i = 0; i < Row<N>::parts; ++i) {
        typename RowOf<T, Row<N>::width>::type part;
        __builtin_memcpy(&part, values + i * Row<N>::width, sizeof(part));
        out.part[i] = __builtin_convertvector(part, typename RowOf<double, Row<N>::width>::type);
    }
    return out;
}

/// Sums over x and y of the rows of taps, for derivatives of order i along x and j along y.
template <int N, int Order>
struct Planes {
    Row<N> sum[Order + 1][Order + 1];

    template <class T>
    [[gnu::always_inline]] Planes(const T* values, const Lattice& grid,
                                  const Taps<N, Order>& taps) {
#pragma GCC unroll 4
        for (int a = 0; a < N; ++a) {
            Row<N> line[Order + 1];
#pragma GCC unroll 4
            for (int b = 0; b < N; ++b) {
                const Row<N> v = load_taps<T, N>(values + taps.x[a] * grid.stride[0] +
                                                     taps.y[b] * grid.stride[1],
                                                 taps.first_z, grid.shape[2], taps.contiguous);
                for (int j = 0; j <= Order; ++j) {
                    const Row<N> part = taps.weight[1][j][b] * v;
                    line[j] = b == 0 ? part : line[j] + part;
                }
            }
            for (int i = 0; i <= Order; ++i) {
                for (int j = 0; i + j <= Order; ++j) {
                    const Row<N> part = taps.weight[0][i][a] * line[j];
                    sum[i][j] = a == 0 ? part : sum[i][j] + part;
                }
            }
        }
    }

    /// The derivative of orders I, J, K along x, y, z, per metre.
    template <int I, int J, int K>
    [[nodiscard, gnu::always_inline]] double derivative(const Taps<N, Order>& taps) const {
        const double per_voxels = sum_row<N>(sum[I][J] * taps.weight[2][K]);
        return per_voxels * power<I>(taps.per_m[0]) * power<J>(taps.per_m[1]) *
               power<K>(taps.per_m[2]);
    }

private:
    template <int Exponent>
    [[gnu::always_inline]] static double power(double base) {
        return Exponent == 0 ? 1.0 : (Exponent == 1 ? base : base * base);
    }
};

/// work(cells, first, number of points) for each chunk of points.
template <class Work>
[[gnu::always_inline]] inline void for_chunks(const Lattice& grid, const double* points,
                                              index_t begin, index_t end, const Work& work) {
    Cells cells;
    for (index_t first = begin; first < end; first += chunk) {
        const int n = end - first < chunk ? static_cast<int>(end - first) : chunk;
        if (n == chunk) {
            grid.locate(points + 3 * first, cells);
        } else {
            double some[3 * chunk] = {};
            __builtin_memcpy(some, points + 3 * first,
                             3 * sizeof(double) * static_cast<std::size_t>(n));
            grid.locate(some, cells);
        }
        work(cells, first, n);
    }
}

/// Asks for the values around points; of cubic taps, for those of the cell itself.
template <class T>
[[gnu::always_inline]] inline void prefetch(const T* values, const Lattice& grid,
                                            const Cells& cells, int n) {
    for (int i = 0; i < n; ++i) {
        const double* cell = cells.cell + 3 * i;
        const T* first = values + static_cast<index_t>(cell[0]) * grid.stride[0] +
                         static_cast<index_t>(cell[1]) * grid.stride[1] +
                         static_cast<index_t>(cell[2]);
        for (int a = 0; a < 2; ++a) {
            for (int b = 0; b < 2; ++b) {
                __builtin_prefetch(first + a * grid.stride[0] + b * grid.stride[1]);
            }
        }
    }
}

template <class T, int N, int Order>
[[gnu::always_inline]] inline void sample_point(const T* values, const Lattice& grid,
                                                const Taps<N, Order>& taps, index_t point,
                                                const GridPointers<T>& out) {
    const Planes<N, Order> planes(values, grid, taps);
    if (out.value != nullptr) {
        out.value[point] = static_cast<T>(planes.template derivative<0, 0, 0>(taps));
    }
    if constexpr (Order >= 1) {
        if (out.gradient != nullptr) {
            T* to = out.gradient + 3 * point;
            to[0] = static_cast<T>(planes.template derivative<1, 0, 0>(taps));
            to[1] = static_cast<T>(planes.template derivative<0, 1, 0>(taps));
            to[2] = static_cast<T>(planes.template derivative<0, 0, 1>(taps));
        }
    }
    if constexpr (Order == 2) {
        T* to = out.hessian + 6 * point;
        to[0] = static_cast<T>(planes.template derivative<2, 0, 0>(taps));
        to[1] = static_cast<T>(planes.template derivative<1, 1, 0>(taps));
        to[2] = static_cast<T>(planes.template derivative<1, 0, 1>(taps));
        to[3] = static_cast<T>(planes.template derivative<0, 2, 0>(taps));
        to[4] = static_cast<T>(planes.template derivative<0, 1, 1>(taps));
        to[5] = static_cast<T>(planes.template derivative<0, 0, 2>(taps));
    }
}

template <class T, int N, int Order>
void sample_points(const T* values, const GridAxes& axes, const double* points, index_t begin,
                   index_t end, const GridPointers<T>& out) {
    const Lattice grid(axes);
    const GridPointers<T> to = out;
    for_chunks(grid, points, begin, end, [&](const Cells& cells, index_t first, int n) {
        prefetch<T>(values, grid, cells, n);
        for (int i = 0; i < n; ++i) {
            sample_point<T, N, Order>(values, grid, Taps<N, Order>(grid, cells, i), first + i, to);
        }
    });
}

template <class T, int N>
[[gnu::always_inline]] inline void add_taps(const Row<N>& what, index_t first, index_t length,
                                            bool contiguous, T* row) {
    constexpr int width = Row<N>::width;
    for (int i = 0; i < Row<N>::parts; ++i) {
        using Part = typename RowOf<T, width>::type;
        const Part more = __builtin_convertvector(what.part[i], Part);
        T* to = row + first + i * width;
        if (contiguous) {
            Part values;
            __builtin_memcpy(&values, to, sizeof(values));
            values += more;
            __builtin_memcpy(to, &values, sizeof(values));
            continue;
        }
        for (int k = 0; k < width; ++k) {
            row[inside(first + i * width + k, length)] += more[k];
        }
    }
}

/// Adds the contribution of one point to the rows from first_x to last_x.
template <class T, int N>
[[gnu::always_inline]] inline void
spread_point(const GridPointers<const T>& from, const Lattice& grid, const Taps<N, 1>& taps,
             index_t point, index_t first_x, index_t last_x, T* values_grad) {
    const double value = from.value == nullptr ? 0.0 : static_cast<double>(from.value[point]);
    double slope[3] = {};
    for (int axis = 0; axis < 3 && from.gradient != nullptr; ++axis) {
        slope[axis] = taps.per_m[axis] * static_cast<double>(from.gradient[3 * point + axis]);
    }
    const auto& [wx, wy, wz] = taps.weight;
    const Row<N> along_z = value * wz[0] + slope[2] * wz[1];
    const Row<N> of_x = slope[0] * wz[0];
    const Row<N> of_y = slope[1] * wz[0];
    for (int a = 0; a < N; ++a) {
        if (taps.x[a] < first_x || taps.x[a] >= last_x) {
            continue;
        }
        const Row<N> even = wx[0][a] * along_z + wx[1][a] * of_x;
        const Row<N> odd = wx[0][a] * of_y;
        for (int b = 0; b < N; ++b) {
            const Row<N> all = wy[0][b] * even + wy[1][b] * odd;
            add_taps<T, N>(all, taps.first_z, grid.shape[2], taps.contiguous,
                           values_grad + taps.x[a] * grid.stride[0] + taps.y[b] * grid.stride[1]);
        }
    }
}

/// Points that are searched at a time for those of a slab: their coordinates stay in the
/// first-level cache.
inline constexpr index_t window = 512;

#if defined(__AVX2__) && !defined(__AVX512VL__)
/// By which of four lanes, those of points 0, 3, 2, 1, are selected: the bytes that bring their
/// values to the front, in the order of the points.
struct CompressOrder {
    alignas(16) std::uint8_t bytes[16][16]{};
    constexpr CompressOrder() {
        constexpr unsigned lane_of[] = {0, 3, 2, 1};
        for (unsigned in = 0; in < 16; ++in) {
            int n = 0;
            for (const unsigned lane : lane_of) {
                for (unsigned k = 0; k < 4 && (in >> lane & 1U) != 0; ++k) {
                    bytes[in][n++] = static_cast<std::uint8_t>(4 * lane + k);
                }
            }
        }
    }
};
inline constexpr CompressOrder compress_order{};
#endif

/// The part of the grid with first_x <= index along x < last_x, and how far along x points lie
/// that may touch it.
struct Slab {
    index_t first_x, last_x;
    double low, high; // [m]

    /// reach: rows that a point touches beyond those of its cell.
    Slab(const GridAxes& axes, index_t first, index_t last, int reach)
        : first_x(first), last_x(last), low(-__builtin_inf()), high(__builtin_inf()) {
        const double beyond = reach + 1e-6; // the taps decide, after a division
        if (first > 0) {
            low = axes.origin[0] + (static_cast<double>(first - 1) - beyond) * axes.spacing;
        }
        if (last < axes.shape[0]) {
            high = axes.origin[0] + (static_cast<double>(last) + beyond) * axes.spacing;
        }
    }

    /// Which of the points may touch it, in their order; `to` has room for `lanes` more than there
    /// are. NaN may. Appended without a branch: half of random points would be predicted wrongly.
    [[gnu::always_inline]] index_t select(const double* points, index_t n_points,
                                          std::uint32_t* to) const {
        index_t n = 0;
        index_t i = 0;
#if defined(__AVX512VL__)
        const __m512i of_two = _mm512_set_epi64(0, 0, 15, 12, 9, 6, 3, 0);
        const __m512i of_third = _mm512_set_epi64(13, 10, 5, 4, 3, 2, 1, 0);
        __m256i index = _mm256_set_epi32(7, 6, 5, 4, 3, 2, 1, 0);
        for (; i + 8 <= n_points; i += 8) {
            const double* from = points + 3 * i;
            const __m512d two =
                _mm512_permutex2var_pd(_mm512_loadu_pd(from), of_two, _mm512_loadu_pd(from + 8));
            const __m512d x = _mm512_permutex2var_pd(two, of_third, _mm512_loadu_pd(from + 16));
            const __mmask8 in = _mm512_cmp_pd_mask(x, _mm512_set1_pd(low), _CMP_NLT_UQ) &
                                _mm512_cmp_pd_mask(x, _mm512_set1_pd(high), _CMP_NGE_UQ);
            const __m256i found = _mm256_maskz_compress_epi32(in, index);
            __builtin_memcpy(to + n, &found, sizeof(found));
            n += __builtin_popcount(in);
            index = _mm256_add_epi32(index, _mm256_set1_epi32(8));
        }
#elif defined(__AVX2__)
        const __m256d least = _mm256_set1_pd(low);
        const __m256d most = _mm256_set1_pd(high);
        __m128i index = _mm_set_epi32(1, 2, 3, 0);
        for (; i + 4 <= n_points; i += 4) {
            const double* from = points + 3 * i;
            // Of points 0, 3, 2, 1: their x lie in lanes of their own.
            const __m256d x = _mm256_blend_pd(
                _mm256_blend_pd(_mm256_loadu_pd(from), _mm256_loadu_pd(from + 4), 4),
                _mm256_loadu_pd(from + 8), 2);
            const int in = _mm256_movemask_pd(_mm256_and_pd(_mm256_cmp_pd(x, least, _CMP_NLT_UQ),
                                                            _mm256_cmp_pd(x, most, _CMP_NGE_UQ)));
            const __m128i found = _mm_shuffle_epi8(
                index, _mm_load_si128(reinterpret_cast<const __m128i*>(compress_order.bytes[in])));
            __builtin_memcpy(to + n, &found, sizeof(found));
            n += __builtin_popcount(static_cast<unsigned>(in));
            index = _mm_add_epi32(index, _mm_set1_epi32(4));
        }
#endif
        for (; i < n_points; ++i) {
            const double x = points[3 * i];
            to[n] = static_cast<std::uint32_t>(i);
            n += static_cast<unsigned>(!(x < low)) & static_cast<unsigned>(!(x >= high));
        }
        return n;
    }
};

/// Spreads n points of a chunk, those of numbers begin + index[i]. Not inlined: the compiler might
/// contract two copies differently, and a sum must not depend on the number of threads.
template <class T, int N>
[[gnu::noinline]] void spread_chunk(const GridPointers<const T>& from, const Lattice& grid,
                                    const Cells& cells, int n, index_t begin,
                                    const std::uint32_t* index, const Slab& slab, T* values_grad) {
    const GridPointers<const T> own_from = from;
    const index_t first_x = slab.first_x;
    const index_t last_x = slab.last_x;
    for (int i = 0; i < n; ++i) {
        spread_point<T, N>(own_from, grid, Taps<N, 1>(grid, cells, i), begin + index[i], first_x,
                           last_x, values_grad);
    }
}

template <class T, int N>
void spread_points(const GridPointers<const T>& from, const GridAxes& axes, const double* points,
                   index_t n_points, index_t first_x, index_t last_x, T* values_grad) {
    const Lattice grid(axes);
    const Slab slab(axes, first_x, last_x, N == 4 ? 1 : 0);
    std::uint32_t own[window + lanes<double>];
    if (first_x == 0 && last_x == grid.shape[0]) {
        for (int i = 0; i < chunk; ++i) {
            own[i] = static_cast<std::uint32_t>(i);
        }
        for_chunks(grid, points, 0, n_points, [&](const Cells& cells, index_t first, int n) {
            spread_chunk<T, N>(from, grid, cells, n, first, own, slab, values_grad);
        });
        return;
    }
    double own_points[3 * window];
    for (index_t begin = 0; begin < n_points; begin += window) {
        const index_t end = begin + window < n_points ? begin + window : n_points;
        const index_t n_own = slab.select(points + 3 * begin, end - begin, own);
        for (index_t i = 0; i < n_own; ++i) {
            __builtin_memcpy(own_points + 3 * i, points + 3 * (begin + own[i]), 3 * sizeof(double));
        }
        // The next window is loaded while this one is processed.
        const index_t n_next = end + window < n_points ? window : n_points - end;
        const index_t n_chunks = (n_own + chunk - 1) / chunk;
        for_chunks(grid, own_points, 0, n_own, [&](const Cells& cells, index_t first, int n) {
            const index_t nth = first / chunk;
            for (index_t k = nth * n_next / n_chunks; k < (nth + 1) * n_next / n_chunks; k += 2) {
                __builtin_prefetch(points + 3 * (end + k));
            }
            spread_chunk<T, N>(from, grid, cells, n, begin, own + first, slab, values_grad);
        });
    }
}

template <class T>
inline constexpr detail::SdfGridKernels<T> sdf_grid_kernels{
    {{&sample_points<T, 2, 0>, &sample_points<T, 2, 1>, &sample_points<T, 2, 2>},
     {&sample_points<T, 4, 0>, &sample_points<T, 4, 1>, &sample_points<T, 4, 2>}},
    {&spread_points<T, 2>, &spread_points<T, 4>}};

} // namespace geraf2::GERAF2_SIMD_NAMESPACE
