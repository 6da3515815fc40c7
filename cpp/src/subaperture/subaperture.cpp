// SPDX-License-Identifier: Apache-2.0
#include "geraf2/subaperture.hpp"

#include <omp.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <exception>
#include <numbers>

#include "common/aligned_buffer.hpp"
#include "simd/dispatch.hpp"
#include "subaperture/kernels.hpp"
#include "subaperture/plan.hpp"

namespace geraf2 {
namespace {

using detail::AlignedBuffer;
using detail::antennas_per_group;
using detail::FocusGroup;
using detail::SubapertureKernels;
using detail::SubaperturePlan;

/// Widest spreading kernel: 12 lattice points resolve 1e-10.
constexpr int max_spread_width = 16;

std::size_t at(index_t i) noexcept { return static_cast<std::size_t>(i); }

/// Everything that one thread writes while it images; allocated before the parallel region, first
/// written in it: the images write each buffer whole, the lattice is zeroed for each.
template <class T>
struct Workspace {
    AlignedBuffer<T> pairs, profiles, lattice, lines, magnitudes;
    std::vector<T> columns;

    Workspace(const SubaperturePlan<T>& plan)
        : pairs(buffer(antennas_per_group * 4 * plan.ranges().n_pairs)),
          profiles(buffer(antennas_per_group * 2 * plan.ranges().n_ranges)),
          lattice(buffer(plan.horizontal().n_rows * plan.vertical().n_rows * 2 *
                         plan.ranges().n_ranges)),
          lines(buffer(plan.horizontal().count * plan.vertical().n_rows * 2 *
                       plan.ranges().n_ranges)),
          magnitudes(
              buffer(plan.horizontal().count * plan.vertical().count * plan.ranges().n_ranges)) {}

private:
    static AlignedBuffer<T> buffer(index_t size) { return AlignedBuffer<T>::uninitialised(size); }
};

/// One pose ready to be imaged, sub-aperture by sub-aperture.
template <class T>
class PoseImager {
public:
    PoseImager(std::span<const std::complex<T>> signal, std::span<const double> tx,
               std::span<const double> rx, const Waveform& waveform,
               const SubapertureMembers& members, const SubapertureLattice& lattice,
               const SubapertureBins& bins)
        : kernels_(detail::kernels_for_cpu<detail::SubapertureKernels<T>>()),
          plan_(waveform, lattice, bins, kernels_), packed_(plan_.pack(signal)), tx_(tx), rx_(rx),
          members_(members), lattice_(lattice), path_bias_m_(waveform.path_bias_m) {}

    [[nodiscard]] const SubaperturePlan<T>& plan() const noexcept { return plan_; }

    /// Magnitudes into space.magnitudes, (horizontal, vertical, padded ranges).
    void image(index_t subaperture, Workspace<T>& space) const {
        const auto& h = plan_.horizontal();
        const auto& v = plan_.vertical();
        const index_t n_ranges = plan_.ranges().n_ranges;
        const index_t row = v.n_rows * 2 * n_ranges;
        std::fill_n(space.lattice.data(), space.lattice.size(), T{});
        fill_lattice(subaperture, space);
        kernels_.fold(space.lattice.data(), h.n_rows, row, row);
        kernels_.axis_sum(h, space.lattice.data(), row, v.n_rows, n_ranges, space.lines.data(),
                          row);
        for (index_t i = 0; i < h.count; ++i) {
            T* const lines = space.lines.data() + i * row;
            kernels_.fold(lines, v.n_rows, 2 * n_ranges, 2 * n_ranges);
            kernels_.axis_magnitude(v, lines, 2 * n_ranges, n_ranges,
                                    space.magnitudes.data() + i * v.count * n_ranges);
        }
    }

private:
    /// Two-way path of an antenna to the focus, less that of the centre [m]: exact for any
    /// baseline, and for antennas off the plane.
    [[nodiscard]] double focus_path(index_t subaperture, index_t antenna) const {
        double tx_square = 0.0;
        double rx_square = 0.0;
        for (index_t axis = 0; axis < 3; ++axis) {
            const double focus = members_.focus[at(3 * subaperture + axis)];
            const double tx = tx_[at(3 * antenna + axis)] - focus;
            const double rx = rx_[at(3 * antenna + axis)] - focus;
            tx_square += tx * tx;
            rx_square += rx * rx;
        }
        return std::sqrt(tx_square) + std::sqrt(rx_square) -
               2.0 * members_.focus_range_m[at(subaperture)];
    }

    void fill_lattice(index_t subaperture, Workspace<T>& space) const {
        const index_t begin = members_.offsets[at(subaperture)];
        const index_t end = members_.offsets[at(subaperture + 1)];
        const index_t line = 2 * plan_.ranges().n_ranges;
        for (index_t first = begin; first < end; first += antennas_per_group) {
            FocusGroup<T> group;
            for (index_t g = 0; g < antennas_per_group; ++g) {
                const index_t member = std::min(first + g, end - 1); // the last one again
                const index_t antenna = members_.antennas[at(member)];
                const double path = focus_path(subaperture, antenna) + path_bias_m_;
                const double half_turns = plan_.half_turns_per_m() * path;
                const double phase =
                    std::numbers::pi * (half_turns - 2.0 * std::round(0.5 * half_turns));
                const double weight = members_.weights[at(member)];
                const auto slot = at(g);
                group.signal[slot] = packed_.data() + antenna * 4 * plan_.ranges().n_pairs;
                group.gain_re[slot] = static_cast<T>(weight * std::cos(phase));
                group.gain_im[slot] = static_cast<T>(weight * std::sin(phase));
                group.step_half_turns[slot] = static_cast<T>(plan_.step_half_turns_per_m() * path);
            }
            kernels_.focus_profiles(plan_.ranges(), group, space.pairs.data(),
                                    space.profiles.data());
            for (index_t g = 0; g < std::min(antennas_per_group, end - first); ++g) {
                place(first + g, space.profiles.data() + g * line, space.lattice.data());
            }
        }
    }

    /// Adds a profile to the lattice.
    void place(index_t member, const T* profile, T* lattice) const {
        std::array<T, max_spread_width> h{};
        std::array<T, max_spread_width> v{};
        const index_t i = spread_weights(members_.places[at(2 * member)],
                                         lattice_.horizontal_spacing_m, lattice_.n_horizontal, h);
        const index_t j = spread_weights(members_.places[at(2 * member + 1)],
                                         lattice_.vertical_spacing_m, lattice_.n_vertical, v);
        const index_t line = 2 * plan_.ranges().n_ranges;
        kernels_.spread(profile, line, h.data(), lattice_.spread_width, v.data(),
                        lattice_.spread_width, lattice_.n_vertical * line,
                        lattice + (i * lattice_.n_vertical + j) * line);
    }

    /// First lattice point that an antenna reaches, and its weights from there on.
    [[nodiscard]] index_t spread_weights(double place_m, double spacing_m, index_t n,
                                         std::array<T, max_spread_width>& weights) const {
        const int width = lattice_.spread_width;
        const double place = place_m / spacing_m + 0.5 * static_cast<double>(n - 1);
        // Clamped before it is converted: no integer holds a position of 1e30.
        const auto within = [](double at, index_t last) {
            return static_cast<index_t>(std::clamp(at, 0.0, static_cast<double>(last)));
        };
        if (width == 1) {
            weights[0] = T{1};
            return within(std::round(place), n - 1);
        }
        const index_t first = within(std::ceil(place - 0.5 * width), n - width);
        for (int k = 0; k < width; ++k) {
            const double x = (static_cast<double>(first + k) - place) / (0.5 * width);
            weights[at(k)] = static_cast<T>(detail::spread_kernel(x, lattice_.spread_exponent));
        }
        return first;
    }

    const SubapertureKernels<T>& kernels_;
    SubaperturePlan<T> plan_;
    AlignedBuffer<T> packed_;
    std::span<const double> tx_, rx_;
    const SubapertureMembers& members_;
    const SubapertureLattice& lattice_;
    double path_bias_m_;
};

/// Images every sub-aperture and calls use(subaperture, workspace); an exception in one of them is
/// rethrown after the loop.
template <class T, class Use>
void for_each_image(const PoseImager<T>& imager, index_t n_subapertures, int num_threads, Use use) {
    const int threads = static_cast<int>(std::clamp<index_t>(n_subapertures, 1, num_threads));
    std::vector<Workspace<T>> spaces;
    spaces.reserve(at(threads));
    for (int i = 0; i < threads; ++i) {
        spaces.emplace_back(imager.plan());
    }
    std::exception_ptr error;
#pragma omp parallel for num_threads(threads) schedule(dynamic)
    for (index_t s = 0; s < n_subapertures; ++s) {
        try {
            auto& space = spaces[at(omp_get_thread_num())];
            imager.image(s, space);
            use(s, space); // lists of peaks grow
        } catch (...) {
#pragma omp critical(geraf2_subaperture_error)
            if (!error) {
                error = std::current_exception();
            }
        }
    }
    if (error) {
        std::rethrow_exception(error);
    }
}

void append(std::vector<double>& to, const std::vector<double>& from) {
    to.insert(to.end(), from.begin(), from.end());
}

} // namespace

template <class T>
void subaperture_images(std::span<const std::complex<T>> signal, std::span<const double> tx,
                        std::span<const double> rx, const Waveform& waveform,
                        const SubapertureMembers& members, const SubapertureLattice& lattice,
                        const SubapertureBins& bins, int num_threads, std::span<T> magnitudes) {
    const PoseImager<T> imager(signal, tx, rx, waveform, members, lattice, bins);
    const index_t n_directions = bins.horizontal.count * bins.vertical.count;
    for_each_image(imager, members.n_subapertures(), num_threads,
                   [&](index_t subaperture, Workspace<T>& space) {
                       const T* from = space.magnitudes.data();
                       T* to = magnitudes.data() + subaperture * bins.size();
                       for (index_t d = 0; d < n_directions; ++d) {
                           std::copy_n(from + d * imager.plan().ranges().n_ranges,
                                       bins.ranges.count, to + d * bins.ranges.count);
                       }
                   });
}

template <class T>
SubaperturePeaks subaperture_peaks(std::span<const std::complex<T>> signal,
                                   std::span<const double> tx, std::span<const double> rx,
                                   const Waveform& waveform, const SubapertureMembers& members,
                                   const SubapertureLattice& lattice, const SubapertureBins& bins,
                                   const PeakThresholds& thresholds, int num_threads) {
    const PoseImager<T> imager(signal, tx, rx, waveform, members, lattice, bins);
    std::vector<SubaperturePeaks> found(at(members.n_subapertures()));
    for_each_image(imager, members.n_subapertures(), num_threads,
                   [&](index_t subaperture, Workspace<T>& space) {
                       detail::append_peaks(space.magnitudes.data(),
                                            imager.plan().ranges().n_ranges, bins, thresholds,
                                            subaperture, space.columns, found[at(subaperture)]);
                   });
    SubaperturePeaks all;
    for (const SubaperturePeaks& one : found) {
        all.subapertures.insert(all.subapertures.end(), one.subapertures.begin(),
                                one.subapertures.end());
        append(all.cosines, one.cosines);
        append(all.ranges_m, one.ranges_m);
        append(all.magnitudes, one.magnitudes);
        append(all.noise, one.noise);
        append(all.tops, one.tops);
    }
    return all;
}

template void subaperture_images(std::span<const std::complex<float>>, std::span<const double>,
                                 std::span<const double>, const Waveform&,
                                 const SubapertureMembers&, const SubapertureLattice&,
                                 const SubapertureBins&, int, std::span<float>);
template void subaperture_images(std::span<const std::complex<double>>, std::span<const double>,
                                 std::span<const double>, const Waveform&,
                                 const SubapertureMembers&, const SubapertureLattice&,
                                 const SubapertureBins&, int, std::span<double>);
template SubaperturePeaks subaperture_peaks(std::span<const std::complex<float>>,
                                            std::span<const double>, std::span<const double>,
                                            const Waveform&, const SubapertureMembers&,
                                            const SubapertureLattice&, const SubapertureBins&,
                                            const PeakThresholds&, int);
template SubaperturePeaks subaperture_peaks(std::span<const std::complex<double>>,
                                            std::span<const double>, std::span<const double>,
                                            const Waveform&, const SubapertureMembers&,
                                            const SubapertureLattice&, const SubapertureBins&,
                                            const PeakThresholds&, int);

} // namespace geraf2
