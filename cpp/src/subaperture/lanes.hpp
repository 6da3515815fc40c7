// SPDX-License-Identifier: Apache-2.0
// Kernels of the sub-aperture images for one instruction set:
// docs/math/images.md#sub-aperture-images.
#pragma once

#include <cstdint>
#include <type_traits>

#include "simd/vector.hpp"
#include "subaperture/kernels.hpp"

namespace geraf2::GERAF2_SIMD_NAMESPACE {

using detail::antennas_per_group;
using detail::AxisSum;
using detail::FocusGroup;
using detail::RangeTables;

/// Each cosine keeps four sums in registers, of which there are 32 or 16.
inline constexpr int cosines_per_block = vector_bytes == 64 ? 4 : 2;

/// Sums and differences of the focused sample pairs of one antenna: with z = exp(j m step),
/// s(+m) z + s(-m) / z and s(+m) z - s(-m) / z, times the gain.
template <class T>
[[gnu::always_inline]] inline void
focus_pairs(const RangeTables<T>& tables, const FocusGroup<T>& group, index_t antenna, T* pairs) {
    const index_t n = tables.n_pairs;
    const T* const signal = group.signal[antenna];
    const Vec<T> gain_re = splat(group.gain_re[antenna]);
    const Vec<T> gain_im = splat(group.gain_im[antenna]);
    const Vec<T> step = splat(group.step_half_turns[antenna]);
    Vec<T> m{};
    for (int lane = 0; lane < lanes<T>; ++lane) {
        m[lane] = static_cast<T>(lane) + tables.first_pair;
    }
    for (index_t p = 0; p < n; p += lanes<T>) {
        const SinCos<T> z = sincos_half_turns<full_level<T>, T>(m * step);
        const Vec<T> sum_re = load(signal + p);
        const Vec<T> sum_im = load(signal + n + p);
        const Vec<T> dif_re = load(signal + 2 * n + p);
        const Vec<T> dif_im = load(signal + 3 * n + p);
        const Complex<T> even{sum_re * z.cos - dif_im * z.sin, sum_im * z.cos + dif_re * z.sin};
        const Complex<T> odd{dif_re * z.cos - sum_im * z.sin, dif_im * z.cos + sum_re * z.sin};
        const Complex<T> gain{gain_re, gain_im};
        const Complex<T> e = multiply<T>(even, gain);
        const Complex<T> o = multiply<T>(odd, gain);
        store<T>(pairs + p, e.re);
        store<T>(pairs + n + p, e.im);
        store<T>(pairs + 2 * n + p, o.re);
        store<T>(pairs + 3 * n + p, o.im);
        m += static_cast<T>(lanes<T>);
    }
}

template <class T>
void focus_profiles(const RangeTables<T>& tables, const FocusGroup<T>& group, T* scratch,
                    T* profiles) {
    const index_t n = tables.n_pairs;
    for (index_t a = 0; a < antennas_per_group; ++a) {
        focus_pairs(tables, group, a, scratch + a * 4 * n);
    }
    for (index_t r = 0; r < tables.n_ranges; r += lanes<T>) {
        Vec<T> re[antennas_per_group]{};
        Vec<T> im[antennas_per_group]{};
        for (index_t p = 0; p < n; ++p) {
            const Vec<T> c = load(tables.cosine + p * tables.n_ranges + r);
            const Vec<T> s = load(tables.sine + p * tables.n_ranges + r);
#pragma GCC unroll 4
            for (index_t a = 0; a < antennas_per_group; ++a) {
                const T* const pairs = scratch + a * 4 * n + p;
                re[a] += c * pairs[0] - s * pairs[3 * n];
                im[a] += c * pairs[n] + s * pairs[2 * n];
            }
        }
        for (index_t a = 0; a < antennas_per_group; ++a) {
            T* const out = profiles + a * 2 * tables.n_ranges + r;
            store<T>(out, re[a]);
            store<T>(out + tables.n_ranges, im[a]);
        }
    }
}

template <class T>
void spread(const T* profile, index_t line, const T* h, int n_h, const T* v, int n_v,
            index_t row_stride, T* lattice) {
    for (int i = 0; i < n_h; ++i) {
        for (int j = 0; j < n_v; ++j) {
            const Vec<T> weight = splat(h[i] * v[j]);
            T* const to = lattice + i * row_stride + j * line;
            for (index_t r = 0; r < line; r += lanes<T>) {
                store<T>(to + r, load(to + r) + weight * load(profile + r));
            }
        }
    }
}

template <class T>
void fold(T* rows, index_t n_rows, index_t row_stride, index_t width) {
    for (index_t p = 0; p < n_rows / 2; ++p) {
        T* const low = rows + p * row_stride;
        T* const high = rows + (n_rows - 1 - p) * row_stride;
        for (index_t r = 0; r < width; r += lanes<T>) {
            const Vec<T> a = load(low + r);
            const Vec<T> b = load(high + r);
            store<T>(low + r, b + a);
            store<T>(high + r, b - a);
        }
    }
}

/// Cosine and sine sums of a block of cosines over folded rows, for one vector of ranges.
template <class T>
struct BlockSums {
    Vec<T> cos_re[cosines_per_block]{}, cos_im[cosines_per_block]{};
    Vec<T> sin_re[cosines_per_block]{}, sin_im[cosines_per_block]{};

    [[gnu::always_inline]] inline void add(const AxisSum<T>& axis, index_t block, const T* rows,
                                           index_t row_stride, index_t n_ranges) {
        const index_t n_pairs = axis.n_rows / 2;
        const T* cosine = axis.cosine + block * n_pairs * cosines_per_block;
        const T* sine = axis.sine + block * n_pairs * cosines_per_block;
        const T* even = rows;
        const T* odd = rows + (axis.n_rows - 1) * row_stride;
        for (index_t p = 0; p < n_pairs; ++p) {
            const Vec<T> e_re = load(even);
            const Vec<T> e_im = load(even + n_ranges);
            const Vec<T> o_re = load(odd);
            const Vec<T> o_im = load(odd + n_ranges);
#pragma GCC unroll 4
            for (int u = 0; u < cosines_per_block; ++u) {
                cos_re[u] += e_re * cosine[u];
                cos_im[u] += e_im * cosine[u];
                sin_re[u] += o_re * sine[u];
                sin_im[u] += o_im * sine[u];
            }
            cosine += cosines_per_block;
            sine += cosines_per_block;
            even += row_stride;
            odd -= row_stride;
        }
        if (axis.n_rows % 2 != 0) {
            const T* const middle = axis.middle + block * cosines_per_block;
            const Vec<T> re = load(even);
            const Vec<T> im = load(even + n_ranges);
#pragma GCC unroll 4
            for (int u = 0; u < cosines_per_block; ++u) {
                cos_re[u] += re * middle[u];
                cos_im[u] += im * middle[u];
            }
        }
    }
};

/// Calls write(row, re, im) for both signs of each cosine of a block: C + j S belongs to -|u|,
/// C - j S to +|u|.
template <class T, class Write>
[[gnu::always_inline]] inline void write_block(const AxisSum<T>& axis, index_t block,
                                               const BlockSums<T>& sums, Write write) {
#pragma GCC unroll 4
    for (int u = 0; u < cosines_per_block; ++u) {
        const index_t row = block * cosines_per_block + u;
        if (row < axis.n_cosines) {
            write(row, sums.cos_re[u] - sums.sin_im[u], sums.cos_im[u] + sums.sin_re[u]);
            const index_t mirror = axis.mirror_sum - row;
            if (mirror < axis.count && mirror != row) {
                write(mirror, sums.cos_re[u] + sums.sin_im[u], sums.cos_im[u] - sums.sin_re[u]);
            }
        }
    }
}

template <class T>
void axis_sum(const AxisSum<T>& axis, const T* rows, index_t row_stride, index_t n_lines,
              index_t n_ranges, T* out, index_t out_stride) {
    const index_t n_blocks = (axis.n_cosines + cosines_per_block - 1) / cosines_per_block;
    for (index_t line = 0; line < n_lines; ++line) {
        for (index_t r = 0; r < n_ranges; r += lanes<T>) {
            const index_t column = line * 2 * n_ranges + r;
            for (index_t block = 0; block < n_blocks; ++block) {
                BlockSums<T> sums;
                sums.add(axis, block, rows + column, row_stride, n_ranges);
                write_block(axis, block, sums, [&](index_t row, Vec<T> re, Vec<T> im) {
                    T* const to = out + row * out_stride + column;
                    store<T>(to, re);
                    store<T>(to + n_ranges, im);
                });
            }
        }
    }
}

template <class T>
void axis_magnitude(const AxisSum<T>& axis, const T* rows, index_t row_stride, index_t n_ranges,
                    T* out) {
    const index_t n_blocks = (axis.n_cosines + cosines_per_block - 1) / cosines_per_block;
    for (index_t r = 0; r < n_ranges; r += lanes<T>) {
        for (index_t block = 0; block < n_blocks; ++block) {
            BlockSums<T> sums;
            sums.add(axis, block, rows + r, row_stride, n_ranges);
            write_block(axis, block, sums, [&](index_t row, Vec<T> re, Vec<T> im) {
                store<T>(out + row * n_ranges + r, square_root(re * re + im * im));
            });
        }
    }
}

/// Finds the bits of the value one by one, from the highest: numbers that are not negative are in
/// the order of their bits. With std::nth_element, column by column, this was a fifth of an image.
template <class T>
void middle_values(const T* columns, index_t n_rows, index_t width, T* middle, T* before) {
    using Integer = std::conditional_t<sizeof(T) == 4, std::int32_t, std::int64_t>;
    using Bits = typename VectorOf<T>::bits;
    const auto rank = static_cast<Integer>(n_rows / 2);
    for (index_t r = 0; r < width; r += lanes<T>) {
        Bits value{};
        Bits bit = (Bits{} + 1) << (VectorOf<T>::sign_shift - 1);
        for (; bit[0] > 0; bit >>= 1) {
            const Bits tried = value | bit;
            Bits n_below{};
            for (index_t i = 0; i < n_rows; ++i) {
                n_below -= reinterpret_cast<Bits>(load(columns + i * width + r)) < tried;
            }
            value = n_below <= rank ? tried : value;
        }
        Bits n_below{};
        Bits largest_below{};
        for (index_t i = 0; i < n_rows; ++i) {
            const Bits other = reinterpret_cast<Bits>(load(columns + i * width + r));
            const Bits is_below = other < value;
            n_below -= is_below;
            largest_below = (other & is_below) > largest_below ? other : largest_below;
        }
        store<T>(middle + r, reinterpret_cast<Vec<T>>(value));
        store<T>(before + r, reinterpret_cast<Vec<T>>(n_below == rank ? largest_below : value));
    }
}

template <class T>
inline constexpr detail::SubapertureKernels<T> subaperture_kernels{
    lanes<T>, cosines_per_block, &focus_profiles<T>, &spread<T>,
    &fold<T>, &axis_sum<T>,      &axis_magnitude<T>, &middle_values<T>,
};

} // namespace geraf2::GERAF2_SIMD_NAMESPACE
