// SPDX-License-Identifier: Apache-2.0
// Sums over cells of elements at the antennas of a block
// (docs/math/echo-models.md#physical-optics-echo).
#pragma once

#include <cstddef>
#include <vector>

#include "geraf2/simd.hpp"
#include "geraf2/types.hpp"
#include "physical_optics/lanes.hpp"

namespace geraf2::detail {

// Neighbouring elements. Relative to the path to the cell's middle, the phase of each varies so
// little over the band that its phasor is a polynomial in frequency, and, where the cell is smooth,
// so little over the block that the sum is a polynomial in the antenna's place.
template <class T>
struct Cell {
    std::size_t begin, end;   // elements
    bool smooth;              // over the block
    T from_tx[3], from_rx[3]; // middle minus the block's centres [m]
    T range_tx, range_rx;     // their lengths [m]
    T turns, turns_step;      // phase of the reference path at sample 0, and per sample
};

// Phase over half the band of the longest path by which elements of a cell differ, walls aside.
inline constexpr double cell_radians = 1.2;
// Terms of exp(j x u), abs(u) <= 1: for x = 1.7, with the delays of walls, 2e-3 and 3e-10 are left.
template <class T>
inline constexpr int n_terms = sizeof(T) == 4 ? 8 : 16;

// Nodes along each side of a block, as many in all as lanes.
inline constexpr int n_nodes = 4;
static_assert(n_nodes * n_nodes == n_lanes);

// Antennas of a block, and places on a raster over it from which a smooth cell is interpolated.
template <class T>
struct Block {
    struct Group {
        Lanes<T> lanes;
        alignas(64) T shares[n_lanes][n_lanes]; // of each node in each lane
    };
    std::vector<Group> groups;
    Lanes<T> nodes;
};

// Sums over a cell of z x^m, from which sum z exp(j x u) = sum_m (j u)^m / m! moment_m.
template <class T>
struct Moments {
    T re[n_terms<T>][n_lanes], im[n_terms<T>][n_lanes];
};

// Registers that are loaded from and stored to plain arrays of T, hence may_alias.
template <class T, int register_bytes>
struct Registers {
    using Type [[gnu::vector_size(register_bytes), gnu::may_alias]] = T;
    static constexpr int width = register_bytes / static_cast<int>(sizeof(T));
    GERAF2_INLINE static Type& at(T& value) { return *reinterpret_cast<Type*>(&value); }
    GERAF2_INLINE static const Type& at(const T& value) {
        return *reinterpret_cast<const Type*>(&value);
    }
};

// Adds an element. `graded`: its gain changes with frequency, z (gain + slope u) exp(j x u).
template <class T, bool graded, int register_bytes>
GERAF2_INLINE void add_moments(const Phasors<T>& p, int face, Moments<T>& sum) {
    using R = Registers<T, register_bytes>;
    const Wave<T>& wave = p.waves[face];
    for (int l = 0; l < n_lanes; l += R::width) {
        typename R::Type re = R::at(wave.re[l]);
        typename R::Type im = R::at(wave.im[l]);
        const typename R::Type radians = R::at(wave.radians[l]);
        typename R::Type gain{};
        typename R::Type slope{};
        typename R::Type rise_re{}; // m slope z x^(m - 1) / j
        typename R::Type rise_im{};
        if constexpr (graded) {
            gain = R::at(p.gain[l]);
            slope = R::at(p.slope[l]);
        }
        for (int m = 0; m < n_terms<T>; ++m) {
            if constexpr (graded) {
                R::at(sum.re[m][l]) += gain * re + rise_re;
                R::at(sum.im[m][l]) += gain * im + rise_im;
                rise_re = static_cast<T>(m + 1) * slope * im;
                rise_im = static_cast<T>(-m - 1) * slope * re;
            } else {
                R::at(sum.re[m][l]) += re;
                R::at(sum.im[m][l]) += im;
            }
            re *= radians;
            im *= radians;
        }
    }
}

// Moments times j^m / m!: coefficients of u^m.
template <class T>
GERAF2_INLINE void to_coefficients(Moments<T>& sum) {
    T scale = T(1);
    for (int m = 1; m < n_terms<T>; ++m) {
        scale /= static_cast<T>(m);
        for (int l = 0; l < n_lanes; ++l) {
            const T re = scale * sum.re[m][l];
            const T im = scale * sum.im[m][l];
            const bool odd = m % 2 == 1;
            sum.re[m][l] = m % 4 == 0 || m % 4 == 3 ? (odd ? im : re) : (odd ? -im : -re);
            sum.im[m][l] = m % 4 < 2 ? (odd ? re : im) : (odd ? -re : -im);
        }
    }
}

// Adds a cell to the accumulators: its polynomial times the phasor of the path to its middle.
template <class T, int register_bytes>
GERAF2_INLINE void add_cell(const Moments<T>& sums, const T (&turns)[2][n_lanes], index_t n_samples,
                            T* sum) {
    using R = Registers<T, register_bytes>;
    using Register = typename R::Type;
    alignas(64) T start[2][n_lanes];
    alignas(64) T step[2][n_lanes];
#pragma omp simd
    for (int l = 0; l < n_lanes; ++l) {
        sincos_turns(turns[0][l], start[1][l], start[0][l]);
        sincos_turns(turns[1][l], step[1][l], step[0][l]);
    }
    const T u_step = n_samples > 1 ? T(2) / static_cast<T>(n_samples - 1) : T(0);
    for (int l = 0; l < n_lanes; l += R::width) {
        Register re[n_terms<T>];
        Register im[n_terms<T>];
        for (int m = 0; m < n_terms<T>; ++m) {
            re[m] = R::at(sums.re[m][l]);
            im[m] = R::at(sums.im[m][l]);
        }
        Register zr = R::at(start[0][l]);
        Register zi = R::at(start[1][l]);
        const Register wr = R::at(step[0][l]);
        const Register wi = R::at(step[1][l]);
        for (index_t t = 0; t < n_samples; ++t) {
            const T u = n_samples > 1 ? static_cast<T>(t) * u_step - T(1) : T(0);
            Register ar = re[n_terms<T> - 1];
            Register ai = im[n_terms<T> - 1];
            for (int m = n_terms<T> - 2; m >= 0; --m) {
                ar = ar * u + re[m];
                ai = ai * u + im[m];
            }
            R::at(sum[2 * t * n_lanes + l]) += ar * zr - ai * zi;
            R::at(sum[(2 * t + 1) * n_lanes + l]) += ar * zi + ai * zr;
            const Register next = zr * wr - zi * wi;
            zi = zr * wi + zi * wr;
            zr = next;
        }
    }
}

// Growth of the path to a cell's middle in all lanes [m].
template <class T>
GERAF2_INLINE void look_at_middle(const Cell<T>& cell, const Lanes<T>& lanes, T* growth) {
    alignas(64) End<T> tx;
    alignas(64) End<T> rx;
    look_from(lanes.tx, cell.from_tx, cell.range_tx, tx);
    look_from(lanes.rx, cell.from_rx, cell.range_rx, rx);
    for (int l = 0; l < n_lanes; ++l) {
        growth[l] = tx.growth[l] + rx.growth[l];
    }
}

// Adds an element to the moments in all lanes, or those of a node to all lanes by their shares.
template <class T, int register_bytes>
GERAF2_INLINE void add_element(const Phasors<T>& phasors, const Constants<T>& c, Moments<T>& sum) {
    for (int face = 0; face < c.n_faces; ++face) {
        if (c.has_edges) {
            add_moments<T, true, register_bytes>(phasors, face, sum);
        } else {
            add_moments<T, false, register_bytes>(phasors, face, sum);
        }
    }
}

template <class T, int register_bytes>
GERAF2_INLINE void interpolate(const Moments<T>& nodes, const T (&shares)[n_lanes][n_lanes],
                               Moments<T>& sum) {
    using R = Registers<T, register_bytes>;
    for (int l = 0; l < n_lanes; l += R::width) {
        for (int m = 0; m < n_terms<T>; ++m) {
            typename R::Type re{};
            typename R::Type im{};
            for (int n = 0; n < n_lanes; ++n) {
                re += R::at(shares[n][l]) * nodes.re[m][n];
                im += R::at(shares[n][l]) * nodes.im[m][n];
            }
            R::at(sum.re[m][l]) = re;
            R::at(sum.im[m][l]) = im;
        }
    }
}

// Adds all cells to the accumulators of a block's groups of n_lanes antennas,
// sum[((g * n_samples + t) * 2 + part) * n_lanes + l]. single: scratch, the elements of a cell that
// are computed antenna by antenna.
template <class T, int register_bytes>
GERAF2_INLINE void accumulate(const std::vector<Cell<T>>& cells,
                              const std::vector<Element<T>>& elements, const Block<T>& block,
                              const std::vector<Wall<T>>& walls, const Constants<T>& c,
                              std::vector<std::size_t>& single, T* sum) {
    alignas(64) T middle[n_lanes];
    alignas(64) T turns[2][n_lanes];
    alignas(64) Phasors<T> phasors;
    alignas(64) Moments<T> moments;
    alignas(64) Moments<T> of_nodes;
    for (const Cell<T>& cell : cells) {
        single.clear();
        if (cell.smooth) {
            of_nodes = Moments<T>{};
            look_at_middle(cell, block.nodes, middle);
        }
        for (std::size_t e = cell.begin; e < cell.end; ++e) {
            const View view =
                cell.smooth ? start_phasors(elements[e], block.nodes, walls, c, middle, phasors)
                            : View::broken;
            if (view == View::smooth) {
                add_element<T, register_bytes>(phasors, c, of_nodes);
            } else if (view == View::broken) {
                single.push_back(e);
            }
        }
        for (std::size_t g = 0; g < block.groups.size(); ++g) {
            const typename Block<T>::Group& group = block.groups[g];
            look_at_middle(cell, group.lanes, middle);
            for (int l = 0; l < n_lanes; ++l) {
                turns[0][l] = cell.turns + middle[l] * c.turns_start_per_m;
                turns[1][l] = cell.turns_step + middle[l] * c.turns_step_per_m;
            }
            if (cell.smooth) {
                interpolate<T, register_bytes>(of_nodes, group.shares, moments);
            } else {
                moments = Moments<T>{};
            }
            for (const std::size_t e : single) {
                if (start_phasors(elements[e], group.lanes, walls, c, middle, phasors) !=
                    View::dark) {
                    add_element<T, register_bytes>(phasors, c, moments);
                }
            }
            to_coefficients(moments);
            add_cell<T, register_bytes>(moments, turns, c.n_samples,
                                        sum + 2 * c.n_samples * n_lanes * static_cast<index_t>(g));
        }
    }
}

#if defined(__x86_64__) && defined(__GNUC__)
#define GERAF2_X86_PATHS 1
template <class T>
[[gnu::target("avx2,fma")]] void
accumulate_avx2(const std::vector<Cell<T>>& cells, const std::vector<Element<T>>& elements,
                const Block<T>& block, const std::vector<Wall<T>>& walls, const Constants<T>& c,
                std::vector<std::size_t>& single, T* sum) {
    accumulate<T, 32>(cells, elements, block, walls, c, single, sum);
}

template <class T>
[[gnu::target("avx512f,avx512dq,avx512vl,fma")]] void
accumulate_avx512(const std::vector<Cell<T>>& cells, const std::vector<Element<T>>& elements,
                  const Block<T>& block, const std::vector<Wall<T>>& walls, const Constants<T>& c,
                  std::vector<std::size_t>& single, T* sum) {
    accumulate<T, 64>(cells, elements, block, walls, c, single, sum);
}
#endif

template <class T>
void accumulate_best(const std::vector<Cell<T>>& cells, const std::vector<Element<T>>& elements,
                     const Block<T>& block, const std::vector<Wall<T>>& walls,
                     const Constants<T>& c, std::vector<std::size_t>& single, T* sum) {
#ifdef GERAF2_X86_PATHS
    switch (simd_level()) {
    case SimdLevel::avx512:
        accumulate_avx512(cells, elements, block, walls, c, single, sum);
        return;
    case SimdLevel::avx2:
        accumulate_avx2(cells, elements, block, walls, c, single, sum);
        return;
    case SimdLevel::baseline:
        break;
    }
#endif
    accumulate<T, 16>(cells, elements, block, walls, c, single, sum);
}

} // namespace geraf2::detail
