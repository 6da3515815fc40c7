// SPDX-License-Identifier: Apache-2.0
// The factorised method, docs/math/block-and-factorised.md#factorised-method: portions of the work,
// and their threads.
#include "matched_filter/factorised/factorised.hpp"

#include <omp.h>

#include <algorithm>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "matched_filter/factorised/box_geometry.hpp"
#include "matched_filter/factorised/chunk.hpp"
#include "matched_filter/factorised/plan.hpp"
#include "simd/dispatch.hpp"

namespace geraf2::detail {
namespace {

/// How the work is cut to fit the memory: parents of one chunk, and boxes worked on together.
struct Portions {
    index_t parents_per_chunk = 0;
    double table_bytes = 0.0; ///< room for tables at nodes

    template <class T>
    static Portions of(const FactorisedPlan<T>& plan, const Sizes& sizes, index_t n_samples,
                       const MatchedFilterOptions& options) {
        const AntennaClusters& clusters = plan.clusters();
        const int lanes = kernels_for_cpu<MatchedFilterKernels<T>>().lanes;
        const auto per_thread = static_cast<double>(options.num_threads);
        const auto children = static_cast<double>(clusters.n_children());
        // Of one parent: antennas, centres, tables of one box, and a share of each thread's.
        const double tables = children * 2.0 * static_cast<double>(sizes.nodes) * sizeof(T);
        const double parent = children * static_cast<double>(clusters.capacity()) *
                                  AntennaPack<T>::slot_bytes(n_samples) +
                              (children + 1.0) * 48.0 + tables +
                              per_thread * 2.0 * static_cast<double>(sizes.subnodes) * sizeof(T);
        const double fixed = per_thread * ThreadSpace<T>::bytes(sizes, 0.0, lanes);
        const double quantum = parent * parent_quantum;
        if (fixed + quantum > options.max_memory_bytes) {
            throw std::invalid_argument(
                "max_memory must be at least " +
                std::to_string(static_cast<long long>((fixed + quantum) / 1e6) + 1) +
                " MB for this grid and waveform, got " +
                std::to_string(static_cast<long long>(options.max_memory_bytes / 1e6)) + " MB");
        }
        const double fit = (options.max_memory_bytes - fixed) / quantum;
        const index_t all = clusters.n_parents();
        Portions out;
        out.parents_per_chunk =
            std::min(all, parent_quantum * static_cast<index_t>(std::min(fit, 1e9)));
        const auto n = static_cast<double>(out.parents_per_chunk);
        out.table_bytes = options.max_memory_bytes - fixed - n * (parent - tables);
        return out;
    }
};

/// Boxes [begin, end) of one batch with the offsets of their tables.
template <class T>
struct Batch {
    std::vector<BoxGeometry<T>> boxes;
    std::vector<index_t> tables; ///< first number of each box's tables
    index_t size = 0;            ///< numbers in all tables

    /// Pairs (box, i) for i below count(box): a flat list to share among threads.
    template <class Count>
    [[nodiscard]] std::vector<std::array<index_t, 2>> tasks(Count count) const {
        std::vector<std::array<index_t, 2>> out;
        for (index_t b = 0; b < static_cast<index_t>(boxes.size()); ++b) {
            for (index_t i = 0; i < count(boxes[static_cast<std::size_t>(b)]); ++i) {
                out.push_back({b, i});
            }
        }
        return out;
    }
    [[nodiscard]] const BoxGeometry<T>& box(index_t b) const noexcept {
        return boxes[static_cast<std::size_t>(b)];
    }
};

/// Boxes handed to the threads together at most: enough for all, and a step of progress.
constexpr index_t boxes_per_batch = 16;

template <class T>
Batch<T> next_batch(const FactorisedPlan<T>& plan, const VoxelGrid& grid, index_t& next,
                    index_t numbers_per_node, double table_bytes) {
    Batch<T> out;
    const auto& boxes = plan.boxes();
    while (next < static_cast<index_t>(boxes.size()) &&
           static_cast<index_t>(out.boxes.size()) < boxes_per_batch) {
        const BoxPlan& box = boxes[static_cast<std::size_t>(next)];
        const index_t nodes =
            box.tier < 0 ? 0 : (box.n_nodes() + point_quantum - 1) / point_quantum * point_quantum;
        const index_t size = nodes * numbers_per_node;
        if (!out.boxes.empty() && static_cast<double>(out.size + size) * sizeof(T) > table_bytes) {
            break;
        }
        out.boxes.emplace_back(grid, box);
        out.tables.push_back(out.size);
        out.size += size;
        ++next;
    }
    return out;
}

/// One call: plan, memory, progress.
template <class T>
class Job {
public:
    Job(const FactorisedPlan<T>& plan, const AntennaPositions& antennas, const VoxelGrid& grid,
        const Waveform& waveform, const MatchedFilterOptions& options)
        : antennas_(antennas), grid_(grid), n_samples_(waveform.n_samples), options_(options),
          plan_(plan), scale_(static_cast<T>(1.0 / static_cast<double>(antennas.count()))) {
        for (const BoxPlan& box : plan_.boxes()) {
            sizes_.include(box);
        }
        portions_ = Portions::of(plan_, sizes_, n_samples_, options);
    }

    void forward(std::span<const std::complex<T>> signal, std::span<std::complex<T>> image) {
        std::fill(image.begin(), image.end(), std::complex<T>{});
        for_batches(
            [&](Chunk<T>& chunk) { chunk.pack().pack_signal(signal); },
            [&](Chunk<T>& chunk, const Batch<T>& batch, std::vector<ThreadSpace<T>>& spaces) {
                forward_batch(chunk, batch, spaces, image.data());
            },
            [](Chunk<T>& /*chunk*/) {});
    }

    void adjoint(std::span<const std::complex<T>> image, std::span<std::complex<T>> signal) {
        for_batches(
            [](Chunk<T>& /*chunk*/) {},
            [&](Chunk<T>& chunk, const Batch<T>& batch, std::vector<ThreadSpace<T>>& spaces) {
                adjoint_batch(chunk, batch, spaces, image.data());
            },
            [&](Chunk<T>& chunk) { chunk.pack().unpack_signal(signal); });
    }

private:
    template <class Begin, class Work, class End>
    void for_batches(Begin begin_chunk, Work work, End end_chunk) {
        const index_t n_parents = plan_.clusters().n_parents();
        double done = 0.0;
        const double all = plan_.cost() * static_cast<double>(n_parents);
        for (index_t begin = 0; begin < n_parents; begin += portions_.parents_per_chunk) {
            const index_t end = std::min(begin + portions_.parents_per_chunk, n_parents);
            Chunk<T> chunk(plan_, antennas_, begin, end, n_samples_, options_.num_threads);
            begin_chunk(chunk);
            std::vector<ThreadSpace<T>> spaces;
            spaces.reserve(static_cast<std::size_t>(options_.num_threads));
            for (int i = 0; i < options_.num_threads; ++i) {
                spaces.emplace_back(sizes_, chunk.n_groups(), chunk.lanes());
            }
            for (index_t next = 0; next < static_cast<index_t>(plan_.boxes().size());) {
                const Batch<T> batch =
                    next_batch(plan_, grid_, next, 2 * chunk.n_tables() * chunk.lanes(),
                               portions_.table_bytes);
                work(chunk, batch, spaces);
                for (const BoxGeometry<T>& box : batch.boxes) {
                    done += box.plan.cost * static_cast<double>(end - begin);
                }
                if (options_.progress) {
                    options_.progress(std::min(done / all, 1.0));
                }
            }
            end_chunk(chunk);
        }
    }

    [[nodiscard]] T* tables(const Batch<T>& batch, index_t b) noexcept {
        return tables_->data() + batch.tables[static_cast<std::size_t>(b)];
    }

    void reserve_tables(index_t size) {
        if (!tables_ || tables_->size() < size) {
            tables_.reset(); // before, so that never both are held
            tables_ = std::make_unique<AlignedBuffer<T>>(AlignedBuffer<T>::uninitialised(size));
        }
    }

    void forward_batch(Chunk<T>& chunk, const Batch<T>& batch, std::vector<ThreadSpace<T>>& spaces,
                       std::complex<T>* image) {
        reserve_tables(batch.size);
        const auto fill = batch.tasks([&](const BoxGeometry<T>& box) {
            return box.plan.tier < 0 ? index_t{0} : chunk.n_tables();
        });
        const auto slabs = batch.tasks([](const BoxGeometry<T>& box) {
            return box.plan.tier < 0 ? index_t{1} : box.plan.parts[0];
        });
        const auto n_fill = static_cast<index_t>(fill.size());
        const auto n_slabs = static_cast<index_t>(slabs.size());
#pragma omp parallel num_threads(options_.num_threads)
        {
            auto& space = spaces[static_cast<std::size_t>(omp_get_thread_num())];
#pragma omp for schedule(dynamic)
            for (index_t i = 0; i < n_fill; ++i) {
                const auto [b, table] = fill[static_cast<std::size_t>(i)];
                const BoxGeometry<T>& box = batch.box(b);
                chunk.fill_table(box, table, space,
                                 tables(batch, b) + table * chunk.table_size(box));
            }
#pragma omp for schedule(dynamic)
            for (index_t i = 0; i < n_slabs; ++i) {
                const auto [b, slab] = slabs[static_cast<std::size_t>(i)];
                const BoxGeometry<T>& box = batch.box(b);
                if (box.plan.tier < 0) {
                    chunk.image_block(box, scale_, space, grid_, image);
                } else {
                    chunk.image_slab(box, slab, tables(batch, b), scale_, space, grid_, image);
                }
            }
        }
    }

    void adjoint_batch(Chunk<T>& chunk, const Batch<T>& batch, std::vector<ThreadSpace<T>>& spaces,
                       const std::complex<T>* image) {
        reserve_tables(batch.size);
        const auto groups = batch.tasks([&](const BoxGeometry<T>& box) {
            return box.plan.tier < 0 ? index_t{0} : chunk.n_groups();
        });
        const auto n_tasks = static_cast<index_t>(groups.size());
        const index_t children = chunk.n_tables() / chunk.n_groups();
        const auto n_boxes = static_cast<index_t>(batch.boxes.size());
#pragma omp parallel num_threads(options_.num_threads)
        {
            auto& space = spaces[static_cast<std::size_t>(omp_get_thread_num())];
#pragma omp for schedule(dynamic)
            for (index_t i = 0; i < n_tasks; ++i) {
                const auto [b, group] = groups[static_cast<std::size_t>(i)];
                const BoxGeometry<T>& box = batch.box(b);
                const index_t size = children * chunk.table_size(box);
                T* to = tables(batch, b) + group * size;
                std::fill_n(to, size, T{});
                for (index_t slab = 0; slab < box.plan.parts[0]; ++slab) {
                    chunk.gather_slab(box, slab, group, image, scale_, space, grid_, to);
                }
            }
            // Each table's antennas belong to one thread, which sees all boxes in their order.
#pragma omp for schedule(dynamic)
            for (index_t table = 0; table < chunk.n_tables(); ++table) {
                for (index_t b = 0; b < n_boxes; ++b) {
                    const BoxGeometry<T>& box = batch.box(b);
                    if (box.plan.tier < 0) {
                        chunk.spread_block(box, table, image, scale_, space, grid_);
                    } else {
                        chunk.spread_table(box, table, space,
                                           tables(batch, b) + table * chunk.table_size(box));
                    }
                }
            }
        }
    }

    AntennaPositions antennas_;
    VoxelGrid grid_;
    index_t n_samples_;
    MatchedFilterOptions options_;
    const FactorisedPlan<T>& plan_;
    T scale_;
    Sizes sizes_;
    Portions portions_;
    std::unique_ptr<AlignedBuffer<T>> tables_; ///< each zeroed by the thread that fills it
};

} // namespace

template <class T>
void factorised_fwd(std::span<const std::complex<T>> signal, const FactorisedPlan<T>& plan,
                    const AntennaPositions& antennas, const VoxelGrid& grid,
                    const Waveform& waveform, const MatchedFilterOptions& options,
                    std::span<std::complex<T>> image) {
    Job<T>(plan, antennas, grid, waveform, options).forward(signal, image);
}

template <class T>
void factorised_bwd(std::span<const std::complex<T>> image, const FactorisedPlan<T>& plan,
                    const AntennaPositions& antennas, const VoxelGrid& grid,
                    const Waveform& waveform, const MatchedFilterOptions& options,
                    std::span<std::complex<T>> signal) {
    Job<T>(plan, antennas, grid, waveform, options).adjoint(image, signal);
}

template void factorised_fwd<float>(std::span<const std::complex<float>>,
                                    const FactorisedPlan<float>&, const AntennaPositions&,
                                    const VoxelGrid&, const Waveform&, const MatchedFilterOptions&,
                                    std::span<std::complex<float>>);
template void factorised_fwd<double>(std::span<const std::complex<double>>,
                                     const FactorisedPlan<double>&, const AntennaPositions&,
                                     const VoxelGrid&, const Waveform&, const MatchedFilterOptions&,
                                     std::span<std::complex<double>>);
template void factorised_bwd<float>(std::span<const std::complex<float>>,
                                    const FactorisedPlan<float>&, const AntennaPositions&,
                                    const VoxelGrid&, const Waveform&, const MatchedFilterOptions&,
                                    std::span<std::complex<float>>);
template void factorised_bwd<double>(std::span<const std::complex<double>>,
                                     const FactorisedPlan<double>&, const AntennaPositions&,
                                     const VoxelGrid&, const Waveform&, const MatchedFilterOptions&,
                                     std::span<std::complex<double>>);

} // namespace geraf2::detail
