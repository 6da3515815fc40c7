// SPDX-License-Identifier: Apache-2.0
// Exponentials of vectors. Like simd/vector.hpp for translation units compiled once per instruction
// set only.
#pragma once

#include <numbers>

#include "simd/vector.hpp"

namespace geraf2::GERAF2_SIMD_NAMESPACE {

/// (e^r - 1 - r) / r^2 on |r| <= ln(2) / 2, highest power first, nearly minimax: e^r within 8e-9
/// and 1.3e-17. ln 2 in two parts, the first short enough that its multiples are exact.
template <class T>
struct ExpTerms;
template <>
struct ExpTerms<float> {
    static constexpr double terms[] = {0.0013926250831497611, 0.008363232883682618,
                                       0.04166655421298415, 0.16666576666119928, 0.5};
    static constexpr float ln2_high = 0.693359375F;
    static constexpr float ln2_low = -2.12194440e-4F;
    static constexpr float lowest = -87.0F; // 2^-126 is e^-87.3
    static constexpr int exponent_shift = 23;
    static constexpr std::int32_t one_bits = 0x3F800000;
};
template <>
struct ExpTerms<double> {
    static constexpr double terms[] = {2.5100472505694996e-08, 2.7620201591031547e-07,
                                       2.7557268275906696e-06, 2.4801521057868204e-05,
                                       0.00019841269863171557, 0.0013888888917367081,
                                       0.008333333333330039,   0.041666666666623824,
                                       0.16666666666666669,    0.5};
    static constexpr double ln2_high = 6.93147180369123816490e-01;
    static constexpr double ln2_low = 1.90821492927058770002e-10;
    static constexpr double lowest = -708.0; // 2^-1022 is e^-708.4
    static constexpr int exponent_shift = 52;
    static constexpr std::int64_t one_bits = 0x3FF0000000000000;
};

/// v where it is at least `limit`, or NaN, else `below`.
template <class T>
[[gnu::always_inline]] inline Vec<T> or_below(Vec<T> v, T limit, T below) {
    return v < splat(limit) ? splat(below) : v;
}

/// e^x = scale (1 + part), scale a power of two and |part| < 0.42.
template <class T>
struct Exponential {
    Vec<T> scale, part;

    /// For x <= 0; below ExpTerms::lowest as there. NaN stays.
    [[gnu::always_inline]] explicit Exponential(Vec<T> x) {
        using Terms = ExpTerms<T>;
        using Bits = typename VectorOf<T>::bits;
        x = or_below<T>(x, Terms::lowest, Terms::lowest);
        const Vec<T> shifted = x * static_cast<T>(std::numbers::log2e) + VectorOf<T>::round_magic;
        const Vec<T> n = shifted - VectorOf<T>::round_magic;
        const Vec<T> r = (x - n * Terms::ln2_high) - n * Terms::ln2_low;
        part = r + r * r * polynomial<T>(Terms::terms, r);
        // The lowest bits beside the magic number are n; higher ones are shifted out.
        const Bits exponent =
            (reinterpret_cast<Bits>(shifted) << Terms::exponent_shift) + Terms::one_bits;
        scale = reinterpret_cast<Vec<T>>(exponent);
    }
};

/// e^x for x <= 0, within 2 ulp; zero below ExpTerms::lowest.
template <class T>
[[gnu::always_inline]] inline Vec<T> exp_negative(Vec<T> x) {
    const Exponential<T> e(x);
    const Vec<T> value = e.scale + e.scale * e.part;
    return x < splat(ExpTerms<T>::lowest) ? Vec<T>{} : value;
}

/// e^x - 1 for x <= 0, within 2 ulp, also near zero.
template <class T>
[[gnu::always_inline]] inline Vec<T> expm1_negative(Vec<T> x) {
    const Exponential<T> e(x);
    return e.scale * e.part + (e.scale - T(1));
}

/// 1 / (1 + e^x), for any x, without overflow.
template <class T>
[[gnu::always_inline]] inline Vec<T> logistic_negative(Vec<T> x) {
    const Vec<T> e = exp_negative<T>(x < Vec<T>{} ? x : -x);
    return (x <= Vec<T>{} ? splat(T(1)) : e) / (T(1) + e);
}

} // namespace geraf2::GERAF2_SIMD_NAMESPACE
