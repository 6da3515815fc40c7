// SPDX-License-Identifier: Apache-2.0
// Row loops of the grid energy, plain so that the compiler vectorises them; included only by
// translation units that are compiled once per instruction set. No inline function of the standard
// library may be used here: the linker could pick its AVX-512 copy for everybody.
#pragma once

#if !defined(GERAF2_VECTOR_BYTES) || !defined(GERAF2_SIMD_NAMESPACE)
#error "compile this once per instruction set, see cpp/CMakeLists.txt"
#endif

#include "grid_energy/kernels.hpp"

namespace geraf2::GERAF2_SIMD_NAMESPACE {

using detail::BendingRow;
using detail::row_margin;
using detail::SmoothRow;

template <class T>
void bend_row(const BendingRow<T>& row, T* scratch, T* product) {
    const index_t n = row.n;
    T* const middle = scratch + row_margin;
    T* const mixed = middle + n + 2 * row_margin;
    T* const out = product;
    const T* const r0 = row.rows[0];
    const T* const r1 = row.rows[1];
    const T* const r2 = row.rows[2];
    const T* const r3 = row.rows[3];
    const T* const r4 = row.rows[4];
    const T* const r5 = row.rows[5];
    const T* const r6 = row.rows[6];
    const T* const r7 = row.rows[7];
    const T* const r8 = row.rows[8];
    const T* const r9 = row.rows[9];
    const T* const r10 = row.rows[10];
    const T* const r11 = row.rows[11];
    const T* const r12 = row.rows[12];
    const T* const w = row.weights;
    const T* const m = row.weights + detail::n_stencil_rows;
    const T w0 = w[0], w1 = w[1], w2 = w[2], w3 = w[3], w4 = w[4], w5 = w[5], w6 = w[6];
    const T w7 = w[7], w8 = w[8], w9 = w[9], w10 = w[10], w11 = w[11], w12 = w[12];
    const T m0 = m[0], m1 = m[1], m2 = m[2], m3 = m[3], m4 = m[4];
#pragma omp simd // outputs overlap no input
    for (index_t k = 0; k < n; ++k) {
        middle[k] = r0[k];
        mixed[k] = (m0 * r0[k] + m1 * r1[k]) + (m2 * r2[k] + m3 * r3[k]) + m4 * r4[k];
        out[k] = ((w0 * r0[k] + w1 * r1[k]) + (w2 * r2[k] + w3 * r3[k])) +
                 ((w4 * r4[k] + w5 * r5[k]) + (w6 * r6[k] + w7 * r7[k])) +
                 ((w8 * r8[k] + w9 * r9[k]) + (w10 * r10[k] + w11 * r11[k])) + w12 * r12[k];
    }
    const T* const f = row.first;
    const T* const s = row.second;
#pragma omp simd // outputs overlap no input
    for (index_t k = 0; k < n; ++k) {
        out[k] += (f[k] * mixed[k - 1] + f[n + k] * mixed[k] + f[2 * n + k] * mixed[k + 1]) +
                  (s[k] * middle[k - 2] + s[n + k] * middle[k - 1]) +
                  (s[2 * n + k] * middle[k] + s[3 * n + k] * middle[k + 1]) +
                  s[4 * n + k] * middle[k + 2];
    }
}

template <class T>
void smooth_row(const SmoothRow<T>& row, index_t n, T* change, T* moved) {
    const T* const product = row.product;
    const T* const right = row.right;
    const T* const inverse = row.inverse;
    const T* const field = row.field;
    T* const c = change;
    T* const out = moved;
    const T momentum = row.momentum;
    const T step = row.step;
#pragma omp simd // outputs overlap no input
    for (index_t k = 0; k < n; ++k) {
        const T d = momentum * c[k] + step * inverse[k] * (right[k] - product[k]);
        c[k] = d;
        out[k] = field[k] + d;
    }
}

template <class T>
inline constexpr detail::GridEnergyKernels<T> grid_energy_kernels{&bend_row<T>, &smooth_row<T>};

} // namespace geraf2::GERAF2_SIMD_NAMESPACE
