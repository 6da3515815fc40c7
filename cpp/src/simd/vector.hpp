// SPDX-License-Identifier: Apache-2.0
// Vectors of GERAF2_VECTOR_BYTES. Included only by translation units that are compiled once per
// instruction set; GERAF2_SIMD_NAMESPACE keeps their symbols apart. No inline function of the
// standard library may be used here: the linker could pick its AVX-512 copy for everybody.
#pragma once

#if !defined(GERAF2_VECTOR_BYTES) || !defined(GERAF2_SIMD_NAMESPACE)
#error "compile this once per instruction set, see cpp/CMakeLists.txt"
#endif

#if defined(__SSE2__)
#include <immintrin.h>
#endif

#include "geraf2/types.hpp"

namespace geraf2::GERAF2_SIMD_NAMESPACE {

inline constexpr int vector_bytes = GERAF2_VECTOR_BYTES;

template <class T>
struct VectorOf;
template <>
struct VectorOf<float> {
    using type [[gnu::vector_size(GERAF2_VECTOR_BYTES)]] = float;
    using bits [[gnu::vector_size(GERAF2_VECTOR_BYTES)]] = std::int32_t;
    static constexpr int sign_shift = 31;
    static constexpr float round_magic = 12582912.0F; // 1.5 * 2^23: adding it rounds to integers
};
template <>
struct VectorOf<double> {
    using type [[gnu::vector_size(GERAF2_VECTOR_BYTES)]] = double;
    using bits [[gnu::vector_size(GERAF2_VECTOR_BYTES)]] = std::int64_t;
    static constexpr int sign_shift = 63;
    static constexpr double round_magic = 6755399441055744.0; // 1.5 * 2^52
};

template <class T>
using Vec = typename VectorOf<T>::type;

/// Antennas side by side in one vector.
template <class T>
inline constexpr int lanes = vector_bytes / static_cast<int>(sizeof(T));

/// A vector of float covers two vectors of double.
template <class T>
inline constexpr int double_parts = lanes<T> / lanes<double>;

template <class T>
[[gnu::always_inline]] inline Vec<T> load(const T* from) {
    Vec<T> v;
    __builtin_memcpy(&v, from, sizeof(v));
    return v;
}

template <class T>
[[gnu::always_inline]] inline void store(T* to, Vec<T> v) {
    __builtin_memcpy(to, &v, sizeof(v));
}

template <class T>
[[gnu::always_inline]] inline Vec<T> splat(T value) {
    return value - Vec<T>{}; // x - 0 keeps -0.0, and NaN
}

[[gnu::always_inline]] inline Vec<float> square_root(Vec<float> v) {
#if GERAF2_VECTOR_BYTES == 64
    return _mm512_maskz_sqrt_ps(0xFFFF, v); // the plain form warns in GCC 12
#elif GERAF2_VECTOR_BYTES == 32
    return _mm256_sqrt_ps(v);
#elif defined(__SSE2__)
    return _mm_sqrt_ps(v);
#else
    for (int lane = 0; lane < lanes<float>; ++lane) {
        v[lane] = __builtin_sqrtf(v[lane]);
    }
    return v;
#endif
}

[[gnu::always_inline]] inline Vec<double> square_root(Vec<double> v) {
#if GERAF2_VECTOR_BYTES == 64
    return _mm512_maskz_sqrt_pd(0xFF, v);
#elif GERAF2_VECTOR_BYTES == 32
    return _mm256_sqrt_pd(v);
#elif defined(__SSE2__)
    return _mm_sqrt_pd(v);
#else
    for (int lane = 0; lane < lanes<double>; ++lane) {
        v[lane] = __builtin_sqrt(v[lane]);
    }
    return v;
#endif
}

/// 1 / sqrt(v) within a few ulp, for normal v > 0.
[[gnu::always_inline]] inline Vec<float> inverse_square_root(Vec<float> v) {
#if GERAF2_VECTOR_BYTES == 64
    const Vec<float> guess = _mm512_maskz_rsqrt14_ps(0xFFFF, v);
#elif GERAF2_VECTOR_BYTES == 32
    const Vec<float> guess = _mm256_rsqrt_ps(v);
#elif defined(__SSE2__)
    const Vec<float> guess = _mm_rsqrt_ps(v);
#else
    return 1.0F / square_root(v);
#endif
#if GERAF2_VECTOR_BYTES >= 32 || defined(__SSE2__)
    // One step of Newton doubles the 12 (AVX-512: 14) bits of the guess.
    return guess * (1.5F - 0.5F * v * guess * guess);
#endif
}

[[gnu::always_inline]] inline Vec<double> inverse_square_root(Vec<double> v) {
    return 1.0 / square_root(v);
}

/// Whether a < b in every lane; NaN is not.
[[gnu::always_inline]] inline bool all_less(Vec<float> a, Vec<float> b) {
#if GERAF2_VECTOR_BYTES == 64
    return _mm512_cmp_ps_mask(a, b, _CMP_LT_OQ) == 0xFFFF;
#elif GERAF2_VECTOR_BYTES == 32
    return _mm256_movemask_ps(_mm256_cmp_ps(a, b, _CMP_LT_OQ)) == 0xFF;
#elif defined(__SSE2__)
    return _mm_movemask_ps(_mm_cmplt_ps(a, b)) == 0xF;
#else
    bool all = true;
    for (int lane = 0; lane < lanes<float>; ++lane) {
        all = all && a[lane] < b[lane];
    }
    return all;
#endif
}

/// As many doubles as T has lanes.
template <class T>
struct Doubles {
    Vec<double> part[double_parts<T>];
};

template <class T>
[[gnu::always_inline]] inline Doubles<T> load_doubles(const double* from) {
    Doubles<T> out;
    for (int i = 0; i < double_parts<T>; ++i) {
        out.part[i] = load<double>(from + i * lanes<double>);
    }
    return out;
}

template <int... Lane>
struct LaneList {};

template <int N, int... Lane>
struct MakeLaneList : MakeLaneList<N - 1, N - 1, Lane...> {};
template <int... Lane>
struct MakeLaneList<0, Lane...> {
    using type = LaneList<Lane...>;
};

template <class Half, int... Lane>
[[gnu::always_inline]] inline Vec<float> join(Half low, Half high, LaneList<Lane...> /*all*/) {
    return __builtin_shufflevector(low, high, Lane...);
}

/// Whether i lies in the first half of its 2 `size`, a power of two.
[[gnu::always_inline]] constexpr bool in_first_half(int i, int size) {
    return (static_cast<unsigned>(i) & static_cast<unsigned>(size)) == 0U;
}

/// Swaps the upper right and lower left quarter of each square of 2 Size x 2 Size.
template <int Size, class V, int... Lane>
[[gnu::always_inline]] inline void swap_quarters(V& upper, V& lower, LaneList<Lane...> /*all*/) {
    constexpr int n = sizeof...(Lane);
    const V a = upper;
    const V b = lower;
    upper = __builtin_shufflevector(a, b, (in_first_half(Lane, Size) ? Lane : n + Lane - Size)...);
    lower = __builtin_shufflevector(a, b, (in_first_half(Lane, Size) ? Lane + Size : n + Lane)...);
}

/// Transposes a square of values in registers, halving the squares log2(lanes) times; all but the
/// first swap of AVX2 stay within 16 bytes.
template <class T, int Size = lanes<T> / 2>
[[gnu::always_inline]] inline void transpose(Vec<T>* rows) {
    constexpr int n = lanes<T>;
    for (int i = 0; i < n; ++i) {
        if (in_first_half(i, Size)) {
            swap_quarters<Size>(rows[i], rows[i + Size], typename MakeLaneList<n>::type{});
        }
    }
    if constexpr (Size > 1) {
        transpose<T, Size / 2>(rows);
    }
}

/// Rounds to T: the step from the double-precision reference to the working precision. Stays in
/// registers; through memory, the load of two stores would stall.
template <class T>
[[gnu::always_inline]] inline Vec<T> narrow(const Doubles<T>& v) {
    if constexpr (sizeof(T) == 8) {
        return v.part[0];
    } else {
        using Half [[gnu::vector_size(GERAF2_VECTOR_BYTES / 2)]] = float;
        return join(__builtin_convertvector(v.part[0], Half),
                    __builtin_convertvector(v.part[1], Half),
                    typename MakeLaneList<lanes<float>>::type{});
    }
}

/// Lanes First, First + 1, ... of v, half of them.
template <int First, int... Lane>
[[gnu::always_inline]] inline auto half_of(Vec<float> v, LaneList<Lane...> /*all*/) {
    return __builtin_shufflevector(v, v, (First + Lane)...);
}

/// The inverse.
[[gnu::always_inline]] inline Doubles<float> widen(Vec<float> v) {
    constexpr int n = lanes<double>;
    const auto low = half_of<0>(v, typename MakeLaneList<n>::type{});
    const auto high = half_of<n>(v, typename MakeLaneList<n>::type{});
#if GERAF2_VECTOR_BYTES == 64 // which the compiler would convert by halves
    return {{_mm512_maskz_cvtps_pd(0xFF, low), _mm512_maskz_cvtps_pd(0xFF, high)}};
#else
    return {
        {__builtin_convertvector(low, Vec<double>), __builtin_convertvector(high, Vec<double>)}};
#endif
}

/// Square roots as reference for T: correctly rounded in double precision, within 1e-13 for float,
/// where a step of Newton from float's root takes a fraction of the time of the machine's. N side
/// by side, in place.
template <int N, class T>
[[gnu::always_inline]] inline void square_roots(Doubles<T>* squares) {
    if constexpr (sizeof(T) == 4) {
        Vec<T> x[N];
        for (int i = 0; i < N; ++i) {
            x[i] = narrow<T>(squares[i]);
        }
        Vec<T> low = x[0];
        Vec<T> high = x[0];
        for (int i = 1; i < N; ++i) {
            low = x[i] < low ? x[i] : low;
            high = x[i] > high ? x[i] : high;
        }
        // Beyond, float's square or its inverse would overflow.
        if (all_less(splat(1e-30F), low) && all_less(high, splat(1e30F))) {
            for (int i = 0; i < N; ++i) {
                x[i] = inverse_square_root(x[i]);
            }
            for (int i = 0; i < N; ++i) {
                const Doubles<T> inverse = widen(x[i]);
                for (int k = 0; k < double_parts<T>; ++k) {
                    const Vec<double> root = squares[i].part[k] * inverse.part[k];
                    squares[i].part[k] =
                        root + (0.5 * inverse.part[k]) * (squares[i].part[k] - root * root);
                }
            }
            return;
        }
    }
    for (int i = 0; i < N; ++i) {
        for (int k = 0; k < double_parts<T>; ++k) {
            squares[i].part[k] = square_root(squares[i].part[k]);
        }
    }
}

/// Nearest even integer, for |v| < 2^22 (float) or 2^51 (double).
template <class T>
[[gnu::always_inline]] inline Vec<T> round_nearest(Vec<T> v) {
    return (v + VectorOf<T>::round_magic) - VectorOf<T>::round_magic;
}

/// v minus the nearest integer; `shifted` is v + round_magic.
template <class T>
[[gnu::always_inline]] inline Vec<T> remainder(Vec<T> v, [[maybe_unused]] Vec<T> shifted) {
#if GERAF2_VECTOR_BYTES == 64
    constexpr int nearest = 8; // to even, to whole numbers, no exceptions
    if constexpr (sizeof(T) == 4) {
        return _mm512_maskz_reduce_ps(0xFFFF, v, nearest);
    } else {
        return _mm512_maskz_reduce_pd(0xFF, v, nearest);
    }
#else
    return v - (shifted - VectorOf<T>::round_magic);
#endif
}

/// v minus the nearest multiple of two: a phase in half turns without its whole turns.
[[gnu::always_inline]] inline Vec<double> without_whole_turns(Vec<double> half_turns) {
    return half_turns - 2.0 * round_nearest<double>(0.5 * half_turns);
}

template <class T>
struct SinCos {
    Vec<T> sin, cos;
};

/// Polynomials of sin(pi r) / r and cos(pi r) in r^2 on |r| <= 1/2, highest power first, nearly
/// minimax. Largest error of either: 6.8e-5, 5.9e-7, 6.7e-9 (below an ulp of float), 7.9e-14.
template <int Level>
struct SinCosTerms;
template <>
struct SinCosTerms<0> {
    static constexpr double sin[] = {2.2995473083999585, -5.1369053263097575, 3.140640037538098};
    static constexpr double cos[] = {-1.22193646439003992, 4.04121233711610198,
                                     -4.93393131072594294, 0.999993202100346555};
};
template <>
struct SinCosTerms<1> {
    static constexpr double sin[] = {-0.5546360558968799, 2.5418989587144494, -5.167142786127798,
                                     3.141582021707839};
    static constexpr double cos[] = {0.219682423575378149, -1.33187297278748505,
                                     4.05841079076259762, -4.93479280248945899,
                                     0.999999953027512369};
};
template <>
struct SinCosTerms<2> {
    static constexpr double sin[] = {0.0776559122760138694, -0.598290411283427535,
                                     2.55007738652891187, -5.16771007666831441,
                                     3.14159264007720325};
    static constexpr double cos[] = {-0.0243959320975504445, 0.23493706859508651,
                                     -1.33521194939055034,   4.05870915476313425,
                                     -4.93480213692894564,   0.999999999779154032};
};
template <>
struct SinCosTerms<3> {
    static constexpr double sin[] = {0.000447492084907710107, -0.00736400547211572253,
                                     0.0821447946706485492,   -0.599264433935728646,
                                     2.55016403590674467,     -5.167712779987959,
                                     3.14159265358963506};
    static constexpr double cos[] = {
        -0.0001004164642205389, 0.00192787005269813329, -0.025806531975921562, 0.23533058831317873,
        -1.33526276618176354,   4.05871212633329482,    -4.9348022005436859,   0.99999999999999806};
};

/// The level whose error is below the rounding of T.
template <class T>
inline constexpr int full_level = sizeof(T) == 4 ? 2 : 3;

/// One polynomial at N values of x, side by side.
template <int N, class T, int Terms>
[[gnu::always_inline]] inline void polynomials(const double (&terms)[Terms], const Vec<T>* x,
                                               Vec<T>* sum) {
    for (int i = 0; i < N; ++i) {
        sum[i] = splat(static_cast<T>(terms[0]));
    }
#pragma GCC unroll 8
    for (int k = 1; k < Terms; ++k) {
        for (int i = 0; i < N; ++i) {
            sum[i] = sum[i] * x[i] + static_cast<T>(terms[k]);
        }
    }
}

template <class T, int Terms>
[[gnu::always_inline]] inline Vec<T> polynomial(const double (&terms)[Terms], Vec<T> x) {
    Vec<T> sum;
    polynomials<1, T>(terms, &x, &sum);
    return sum;
}

/// sin and cos of pi * half_turns for N vectors, step by step side by side: one alone would wait
/// for each of its products.
template <int Level, int N, class T>
[[gnu::always_inline]] inline void sincos_half_turns(const Vec<T>* half_turns, SinCos<T>* out) {
    using Bits = typename VectorOf<T>::bits;
    using Terms = SinCosTerms<Level>;
    Vec<T> r[N];
    Vec<T> square[N];
    Bits flip[N];
    for (int i = 0; i < N; ++i) {
        const Vec<T> shifted = half_turns[i] + VectorOf<T>::round_magic;
        r[i] = remainder<T>(half_turns[i], shifted);
        // Each subtracted half turn flips both signs; the lowest mantissa bit beside the magic
        // number is their parity.
        flip[i] = reinterpret_cast<Bits>(shifted) << VectorOf<T>::sign_shift;
    }
    for (int i = 0; i < N; ++i) {
        square[i] = r[i] * r[i];
    }
    Vec<T> sine[N];
    Vec<T> cosine[N];
    polynomials<N, T>(Terms::sin, square, sine);
    polynomials<N, T>(Terms::cos, square, cosine);
    for (int i = 0; i < N; ++i) {
        out[i] = {reinterpret_cast<Vec<T>>(reinterpret_cast<Bits>(r[i] * sine[i]) ^ flip[i]),
                  reinterpret_cast<Vec<T>>(reinterpret_cast<Bits>(cosine[i]) ^ flip[i])};
    }
}

/// The same for one.
template <int Level, class T>
[[gnu::always_inline]] inline SinCos<T> sincos_half_turns(Vec<T> half_turns) {
    SinCos<T> out;
    sincos_half_turns<Level, 1, T>(&half_turns, &out);
    return out;
}

/// a * b of complex vectors held as separate parts.
template <class T>
struct Complex {
    Vec<T> re, im;
};

template <class T>
[[gnu::always_inline]] inline Complex<T> multiply(Complex<T> a, Complex<T> b) {
    return {a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re};
}

} // namespace geraf2::GERAF2_SIMD_NAMESPACE
