// SPDX-License-Identifier: Apache-2.0
// Steps of the factorised method, docs/math/block-and-factorised.md#factorised-method, box by box:
//   antennas -> nodes of the box, per cluster -> (two levels: nodes of its parts, per parent)
//   -> voxels.
// The adjoint takes the same steps backwards with the transposed weights.
#pragma once

#include <algorithm>
#include <array>
#include <complex>

#include "common/aligned_buffer.hpp"
#include "matched_filter/factorised/antenna_clusters.hpp"
#include "matched_filter/factorised/box_geometry.hpp"
#include "matched_filter/factorised/plan.hpp"
#include "matched_filter/kernels.hpp"
#include "matched_filter/plan.hpp"
#include "simd/dispatch.hpp"

namespace geraf2::detail {

/// Numbers that the steps of one box need per lane, and what one thread writes while it works.
struct Sizes {
    index_t nodes = 0;    ///< table of one cluster at the nodes, in complex values
    index_t subnodes = 0; ///< tables of one parent in all parts of a slab
    index_t pass = 0;     ///< the larger of the buffers between axes
    index_t voxels = 0;   ///< of one part, or of a box for the block method

    void include(const BoxPlan& box) noexcept {
        const auto most = [](index_t& to, index_t n) { to = std::max(to, n); };
        if (box.tier < 0) {
            most(voxels, box.n_voxels() + point_quantum);
            return;
        }
        const std::array<index_t, 3> part = box.part_count();
        most(nodes, box.n_nodes() + point_quantum);
        most(subnodes, box.parts[1] * box.parts[2] * box.n_subnodes());
        most(voxels, part[0] * part[1] * part[2]);
        const auto passes = [&](const auto& from, const auto& to) {
            most(pass, to[0] * from[1] * from[2]);
            most(pass, to[0] * to[1] * from[2]);
        };
        if (box.n_subnodes() > 0) {
            passes(box.nodes, box.subnodes);
            passes(box.subnodes, part);
        } else {
            passes(box.nodes, part);
        }
    }
};

template <class T>
struct ThreadSpace {
    AlignedBuffer<T> coefficients;
    AlignedBuffer<T> pass0, pass1;
    AlignedBuffer<T> parents; ///< (lane groups, parts of a slab, subnodes, 2, lanes)
    AlignedBuffer<T> sums;    ///< (voxels, 2, lanes)
    AlignedBuffer<T> values;  ///< (voxels, 2)

    ThreadSpace(const Sizes& sizes, index_t n_groups, int lanes)
        : coefficients(groups_per_tile * max_coefficients * lanes), pass0(2 * sizes.pass * lanes),
          pass1(2 * sizes.pass * lanes), parents(2 * n_groups * sizes.subnodes * lanes),
          sums(2 * sizes.voxels * lanes), values(2 * sizes.voxels) {}

    static double bytes(const Sizes& sizes, double n_groups, int lanes) noexcept {
        return 2.0 * lanes * sizeof(T) *
               (static_cast<double>(2 * sizes.pass + sizes.voxels) +
                n_groups * static_cast<double>(sizes.subnodes));
    }
};

/// A run of parents whose antennas, tables and buffers fit into the memory.
template <class T>
class Chunk {
public:
    Chunk(const FactorisedPlan<T>& plan, const AntennaPositions& antennas, index_t begin,
          index_t end, index_t n_samples, int num_threads)
        : kernels_(kernels_for_cpu<MatchedFilterKernels<T>>()), plan_(plan),
          pack_(antennas, plan.clusters().slots(begin, end, kernels_.lanes), kernels_.lanes,
                n_samples, num_threads),
          parents_(plan.clusters().parent_centers(begin, end, kernels_.lanes)),
          children_(plan.clusters().child_centers(begin, end, kernels_.lanes)),
          n_groups_((end - begin) / kernels_.lanes), n_children_(plan.clusters().n_children()),
          capacity_(plan.clusters().capacity()) {}

    [[nodiscard]] AntennaPack<T>& pack() noexcept { return pack_; }
    [[nodiscard]] index_t n_groups() const noexcept { return n_groups_; }
    [[nodiscard]] index_t n_tables() const noexcept { return n_groups_ * n_children_; }
    [[nodiscard]] int lanes() const noexcept { return kernels_.lanes; }
    [[nodiscard]] index_t table_size(const BoxGeometry<T>& box) const noexcept {
        return 2 * box.n_padded() * lanes();
    }

    /// Partial images of one group of children at the nodes of a box.
    void fill_table(const BoxGeometry<T>& box, index_t table, ThreadSpace<T>& space,
                    T* to) const noexcept {
        std::fill_n(to, table_size(box), T{});
        kernels_.block_fwd(plan_.tables(box.plan.tier), pack_.view(), table * capacity_,
                           (table + 1) * capacity_, box.block(), space.coefficients.data(), to);
        kernels_.modulate(plan_.carrier(), child(table), box.nodes(), -1, to);
    }

    /// Adjoint of fill_table.
    void spread_table(const BoxGeometry<T>& box, index_t table, ThreadSpace<T>& space,
                      T* values) noexcept {
        kernels_.modulate(plan_.carrier(), child(table), box.nodes(), 1, values);
        kernels_.block_bwd(plan_.tables(box.plan.tier), pack_.view(), table * capacity_,
                           (table + 1) * capacity_, box.block(), values, space.coefficients.data(),
                           pack_.signal());
    }

    /// Image of the slab parts[0] = slab from the tables of all groups; adds scale times it.
    void image_slab(const BoxGeometry<T>& box, index_t slab, const T* tables, T scale,
                    ThreadSpace<T>& space, const VoxelGrid& grid,
                    std::complex<T>* image) const noexcept {
        const bool two = box.plan.n_subnodes() > 0;
        if (two) {
            for (index_t group = 0; group < n_groups_; ++group) {
                parents_fwd(box, slab, group, tables, space);
            }
        }
        for_parts(box, [&](index_t j, index_t k) {
            const std::array<index_t, 3> at = {slab, j, k};
            const PointTensor<T> voxels = box.part(at, true);
            const index_t n = voxels.count[0] * voxels.count[1] * voxels.count[2];
            std::fill_n(space.sums.data(), 2 * n * lanes(), T{});
            for (index_t group = 0; group < n_groups_; ++group) {
                const T* from =
                    two ? parent_table(box, space, group, j, k) : tables + group * table_size(box);
                outer_axes_fwd(box, at, from, space);
                const auto& last = axis(box, 2, k).to_voxels;
                kernels_.expand_fwd(plan_.carrier(), two ? parent(group) : child(group), voxels,
                                    last.n_from, last.forward.data(), space.pass1.data(),
                                    space.sums.data());
            }
            kernels_.sum_lanes(2 * n, space.sums.data(), space.values.data());
            const T* value = space.values.data();
            for_voxels(box, at, grid, [&](index_t voxel) {
                image[voxel] += std::complex<T>(scale * value[0], scale * value[1]);
                value += 2;
            });
        });
    }

    /// Adjoint of image_slab for one group: adds to its tables.
    void gather_slab(const BoxGeometry<T>& box, index_t slab, index_t group,
                     const std::complex<T>* image, T scale, ThreadSpace<T>& space,
                     const VoxelGrid& grid, T* tables) const noexcept {
        const bool two = box.plan.n_subnodes() > 0;
        if (two) {
            std::fill_n(space.parents.data(),
                        2 * box.plan.parts[1] * box.plan.parts[2] * box.plan.n_subnodes() * lanes(),
                        T{});
        }
        for_parts(box, [&](index_t j, index_t k) {
            const std::array<index_t, 3> at = {slab, j, k};
            T* value = space.values.data();
            for_voxels(box, at, grid, [&](index_t voxel) {
                value[0] = scale * image[voxel].real();
                value[1] = scale * image[voxel].imag();
                value += 2;
            });
            const PointTensor<T> voxels = box.part(at, true);
            const auto& last = axis(box, 2, k).to_voxels;
            std::fill_n(space.pass1.data(),
                        2 * voxels.count[0] * voxels.count[1] * last.n_from * lanes(), T{});
            kernels_.expand_bwd(plan_.carrier(), two ? parent(group) : child(group), voxels,
                                last.n_from, last.forward.data(), false, space.values.data(),
                                space.pass1.data());
            outer_axes_bwd(box, at, space, two ? parent_table(box, space, 0, j, k) : tables);
        });
        if (two) {
            parents_bwd(box, slab, group, space, tables);
        }
    }

    /// A box by the block method; adds scale times the image.
    void image_block(const BoxGeometry<T>& box, T scale, ThreadSpace<T>& space,
                     const VoxelGrid& grid, std::complex<T>* image) const noexcept {
        std::fill_n(space.sums.data(), table_size(box), T{});
        kernels_.block_fwd(plan_.tables(-1), pack_.view(), 0, pack_.n_groups(), box.block(),
                           space.coefficients.data(), space.sums.data());
        kernels_.sum_lanes(2 * box.n_padded(), space.sums.data(), space.values.data());
        const T* value = space.values.data();
        for_box(box, grid, [&](index_t voxel) {
            image[voxel] += std::complex<T>(scale * value[0], scale * value[1]);
            value += 2;
        });
    }

    /// Adjoint of image_block for the antennas of one table.
    void spread_block(const BoxGeometry<T>& box, index_t table, const std::complex<T>* image,
                      T scale, ThreadSpace<T>& space, const VoxelGrid& grid) noexcept {
        std::fill_n(space.values.data(), 2 * box.n_padded(), T{});
        T* value = space.values.data();
        for_box(box, grid, [&](index_t voxel) {
            value[0] = scale * image[voxel].real();
            value[1] = scale * image[voxel].imag();
            value += 2;
        });
        kernels_.block_bwd(plan_.tables(-1), pack_.view(), table * capacity_,
                           (table + 1) * capacity_, box.block(), space.values.data(),
                           space.coefficients.data(), pack_.signal());
    }

private:
    static const PartAxis<T>& axis(const BoxGeometry<T>& box, std::size_t a, index_t i) noexcept {
        return box.parts[a][static_cast<std::size_t>(i)];
    }
    [[nodiscard]] const double* parent(index_t group) const noexcept {
        return parents_.data() + group * 6 * lanes();
    }
    [[nodiscard]] const double* child(index_t table) const noexcept {
        return children_.data() + table * 6 * lanes();
    }
    [[nodiscard]] T* parent_table(const BoxGeometry<T>& box, ThreadSpace<T>& space, index_t group,
                                  index_t j, index_t k) const noexcept {
        const index_t part = (group * box.plan.parts[1] + j) * box.plan.parts[2] + k;
        return space.parents.data() + 2 * part * box.plan.n_subnodes() * lanes();
    }

    template <class Visit>
    static void for_parts(const BoxGeometry<T>& box, Visit visit) noexcept {
        for (index_t j = 0; j < box.plan.parts[1]; ++j) {
            for (index_t k = 0; k < box.plan.parts[2]; ++k) {
                visit(j, k);
            }
        }
    }

    template <class Visit>
    static void visit_range(const std::array<index_t, 3>& first,
                            const std::array<index_t, 3>& count, const VoxelGrid& grid,
                            Visit visit) noexcept {
        for (index_t x = first[0]; x < first[0] + count[0]; ++x) {
            for (index_t y = first[1]; y < first[1] + count[1]; ++y) {
                const index_t row = (x * grid.shape[1] + y) * grid.shape[2];
                for (index_t z = first[2]; z < first[2] + count[2]; ++z) {
                    visit(row + z);
                }
            }
        }
    }
    template <class Visit>
    static void for_voxels(const BoxGeometry<T>& box, const std::array<index_t, 3>& at,
                           const VoxelGrid& grid, Visit visit) noexcept {
        const auto& x = axis(box, 0, at[0]);
        const auto& y = axis(box, 1, at[1]);
        const auto& z = axis(box, 2, at[2]);
        visit_range({x.first, y.first, z.first}, {x.count, y.count, z.count}, grid, visit);
    }
    template <class Visit>
    static void for_box(const BoxGeometry<T>& box, const VoxelGrid& grid, Visit visit) noexcept {
        visit_range(box.plan.first, box.plan.count, grid, visit);
    }

    /// First axis: rows of from (n0, rest) to pass0 (p0, rest).
    void first_axis_fwd(const AxisWeights<T>& weights, index_t rest, const T* from,
                        T* to) const noexcept {
        std::fill_n(to, weights.n_to * rest, T{});
        kernels_.contract(weights.n_from, weights.n_to, rest, weights.forward.data(), from, to);
    }
    /// Second axis: (p0, n1, rest) to (p0, p1, rest).
    void second_axis_fwd(const AxisWeights<T>& weights, index_t n, index_t rest, const T* from,
                         T* to) const noexcept {
        std::fill_n(to, n * weights.n_to * rest, T{});
        for (index_t i = 0; i < n; ++i) {
            kernels_.contract(weights.n_from, weights.n_to, rest, weights.forward.data(),
                              from + i * weights.n_from * rest, to + i * weights.n_to * rest);
        }
    }
    /// Adjoints: add to `to`.
    void first_axis_bwd(const AxisWeights<T>& weights, index_t rest, const T* from,
                        T* to) const noexcept {
        kernels_.contract(weights.n_to, weights.n_from, rest, weights.transpose.data(), from, to);
    }
    void second_axis_bwd(const AxisWeights<T>& weights, index_t n, index_t rest, const T* from,
                         T* to) const noexcept {
        for (index_t i = 0; i < n; ++i) {
            kernels_.contract(weights.n_to, weights.n_from, rest, weights.transpose.data(),
                              from + i * weights.n_to * rest, to + i * weights.n_from * rest);
        }
    }

    /// From a table to rows of voxels in pass1.
    void outer_axes_fwd(const BoxGeometry<T>& box, const std::array<index_t, 3>& at, const T* from,
                        ThreadSpace<T>& space) const noexcept {
        const auto& x = axis(box, 0, at[0]).to_voxels;
        const auto& y = axis(box, 1, at[1]).to_voxels;
        const index_t rest = 2 * axis(box, 2, at[2]).to_voxels.n_from * lanes();
        first_axis_fwd(x, y.n_from * rest, from, space.pass0.data());
        second_axis_fwd(y, x.n_to, rest, space.pass0.data(), space.pass1.data());
    }
    void outer_axes_bwd(const BoxGeometry<T>& box, const std::array<index_t, 3>& at,
                        ThreadSpace<T>& space, T* to) const noexcept {
        const auto& x = axis(box, 0, at[0]).to_voxels;
        const auto& y = axis(box, 1, at[1]).to_voxels;
        const index_t rest = 2 * axis(box, 2, at[2]).to_voxels.n_from * lanes();
        std::fill_n(space.pass0.data(), x.n_to * y.n_from * rest, T{});
        second_axis_bwd(y, x.n_to, rest, space.pass1.data(), space.pass0.data());
        first_axis_bwd(x, y.n_from * rest, space.pass0.data(), to);
    }

    /// Tables of one group of parents in all parts of a slab, from those of their children. The
    /// outer axes are shared by the parts of a slab and of a column.
    void parents_fwd(const BoxGeometry<T>& box, index_t slab, index_t group, const T* tables,
                     ThreadSpace<T>& space) const noexcept {
        const auto& x = axis(box, 0, slab).to_subnodes;
        const index_t rest = 2 * box.plan.nodes[2] * lanes();
        const index_t n_parts = box.plan.parts[1] * box.plan.parts[2];
        std::fill_n(parent_table(box, space, group, 0, 0),
                    2 * n_parts * box.plan.n_subnodes() * lanes(), T{});
        for (index_t c = 0; c < n_children_; ++c) {
            const index_t table = group * n_children_ + c;
            first_axis_fwd(x, box.plan.nodes[1] * rest, tables + table * table_size(box),
                           space.pass0.data());
            for (index_t j = 0; j < box.plan.parts[1]; ++j) {
                second_axis_fwd(axis(box, 1, j).to_subnodes, x.n_to, rest, space.pass0.data(),
                                space.pass1.data());
                for (index_t k = 0; k < box.plan.parts[2]; ++k) {
                    const auto& z = axis(box, 2, k).to_subnodes;
                    kernels_.expand_fwd(plan_.carrier(), child(table),
                                        box.part({slab, j, k}, false), z.n_from, z.forward.data(),
                                        space.pass1.data(), parent_table(box, space, group, j, k));
                }
            }
        }
        for_parts(box, [&](index_t j, index_t k) {
            kernels_.modulate(plan_.carrier(), parent(group), box.part({slab, j, k}, false), -1,
                              parent_table(box, space, group, j, k));
        });
    }

    /// Adjoint of parents_fwd, from the first tables of space.parents.
    void parents_bwd(const BoxGeometry<T>& box, index_t slab, index_t group, ThreadSpace<T>& space,
                     T* tables) const noexcept {
        const auto& x = axis(box, 0, slab).to_subnodes;
        const index_t rest = 2 * box.plan.nodes[2] * lanes();
        for_parts(box, [&](index_t j, index_t k) {
            kernels_.modulate(plan_.carrier(), parent(group), box.part({slab, j, k}, false), 1,
                              parent_table(box, space, 0, j, k));
        });
        for (index_t c = 0; c < n_children_; ++c) {
            const index_t table = group * n_children_ + c;
            std::fill_n(space.pass0.data(), x.n_to * box.plan.nodes[1] * rest, T{});
            for (index_t j = 0; j < box.plan.parts[1]; ++j) {
                const auto& y = axis(box, 1, j).to_subnodes;
                std::fill_n(space.pass1.data(), x.n_to * y.n_to * rest, T{});
                for (index_t k = 0; k < box.plan.parts[2]; ++k) {
                    const auto& z = axis(box, 2, k).to_subnodes;
                    kernels_.expand_bwd(plan_.carrier(), child(table),
                                        box.part({slab, j, k}, false), z.n_from, z.forward.data(),
                                        true, parent_table(box, space, 0, j, k),
                                        space.pass1.data());
                }
                second_axis_bwd(y, x.n_to, rest, space.pass1.data(), space.pass0.data());
            }
            first_axis_bwd(x, box.plan.nodes[1] * rest, space.pass0.data(),
                           tables + c * table_size(box));
        }
    }

    const MatchedFilterKernels<T>& kernels_;
    const FactorisedPlan<T>& plan_;
    AntennaPack<T> pack_;
    AlignedBuffer<double> parents_;
    AlignedBuffer<double> children_;
    index_t n_groups_;
    index_t n_children_;
    index_t capacity_;
};

} // namespace geraf2::detail
