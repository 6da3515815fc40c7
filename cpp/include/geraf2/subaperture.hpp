// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <complex>
#include <span>
#include <vector>

#include "geraf2/types.hpp"
#include "geraf2/wave.hpp"

namespace geraf2 {

/// Direction cosines first + i * pitch. Images are taken on axes that are symmetric about zero:
/// first is -pitch * mirror_sum() / 2.
struct CosineAxis {
    index_t count = 0;
    double first = 0.0;
    double pitch = 0.0;
    bool wraps = false; ///< the axis is periodic

    [[nodiscard]] double at(index_t i) const noexcept {
        return first + pitch * static_cast<double>(i);
    }
    /// An index and that of the opposite cosine add up to this.
    [[nodiscard]] index_t mirror_sum() const noexcept { return wraps ? count : count - 1; }
};

/// One-way ranges first_m + i * pitch_m.
struct RangeAxis {
    index_t count = 0;
    double first_m = 0.0;
    double pitch_m = 0.0;
};

/// Bins of a sub-aperture image; the last axis runs fastest.
struct SubapertureBins {
    CosineAxis horizontal, vertical;
    RangeAxis ranges;

    [[nodiscard]] index_t size() const noexcept {
        return horizontal.count * vertical.count * ranges.count;
    }
};

/// Lattice about the middle of each sub-aperture on which the sums are taken.
struct SubapertureLattice {
    index_t n_horizontal = 0, n_vertical = 0;
    double horizontal_spacing_m = 0.0, vertical_spacing_m = 0.0;
    /// 1: antennas lie on the lattice. More: each is spread over so many lattice places a side with
    /// the kernel exp(spread_exponent (sqrt(1 - x^2) - 1)), divided by the kernel's transform.
    int spread_width = 1;
    double spread_exponent = 0.0;
};

/// Antennas of the sub-apertures of one pose, packed one after the other.
struct SubapertureMembers {
    std::span<const index_t> offsets;      ///< (n_subapertures + 1), into the next three
    std::span<const index_t> antennas;     ///< (n_members)
    std::span<const double> weights;       ///< (n_members), of each sub-aperture with sum 1
    std::span<const double> places;        ///< (n_members, 2) along the axes, from the middle [m]
    std::span<const double> focus;         ///< (n_subapertures, 3) [m]
    std::span<const double> focus_range_m; ///< (n_subapertures) from the centre to the focus

    [[nodiscard]] index_t n_subapertures() const noexcept {
        return static_cast<index_t>(focus_range_m.size());
    }
};

/// Which maxima of an image count.
struct PeakThresholds {
    double dynamic_range = 0.0; ///< amplitude against the image's largest
    double noise_margin = 0.0;  ///< amplitude against the noise floor of the range bin
};

/// Local maxima, sub-aperture after sub-aperture, in the order of their bins.
struct SubaperturePeaks {
    std::vector<index_t> subapertures;
    std::vector<double> cosines; ///< (n_peaks, 2) horizontal, vertical
    std::vector<double> ranges_m;
    std::vector<double> magnitudes;
    std::vector<double> noise; ///< root mean square in the peak's range bin
    std::vector<double> tops;  ///< (n_subapertures) largest magnitude of each image
};

/// Images of all sub-apertures of a pose (docs/math/images.md#sub-aperture-images):
///
///     I(u, r) = | sum_a sum_t w_a w_t s_a(t) exp(j k_t (2 r + q_a + b)) exp(-2 j k_c u.delta_a) |
///
/// with the path q_a to the focus less that of the centre, the instrument delay b, and Hann weights
/// w_t over the chirp. The result does not depend on num_threads. T: float or double.
template <class T>
void subaperture_images(std::span<const std::complex<T>> signal, // (n_antennas, n_samples)
                        std::span<const double> tx,              // (n_antennas, 3) [m]
                        std::span<const double> rx,              // (n_antennas, 3) [m]
                        const Waveform& waveform, const SubapertureMembers& members,
                        const SubapertureLattice& lattice, const SubapertureBins& bins,
                        int num_threads,
                        std::span<T> magnitudes); // (n_subapertures, bins)

/// The peaks of these images, without keeping them.
template <class T>
SubaperturePeaks subaperture_peaks(std::span<const std::complex<T>> signal,
                                   std::span<const double> tx, std::span<const double> rx,
                                   const Waveform& waveform, const SubapertureMembers& members,
                                   const SubapertureLattice& lattice, const SubapertureBins& bins,
                                   const PeakThresholds& thresholds, int num_threads);

/// The peaks of one given image: maxima among 26 neighbours, never in the first or last range bin
/// nor on the border of an axis that does not wrap, refined by a parabola through three log
/// magnitudes per axis. None where a magnitude is not a number.
template <class T>
SubaperturePeaks image_peaks(std::span<const T> magnitudes, // (bins)
                             const SubapertureBins& bins, const PeakThresholds& thresholds);

/// Root mean square of the noise in each range bin from the median of every fourth direction.
template <class T>
void noise_floor(std::span<const T> magnitudes, // (bins)
                 const SubapertureBins& bins,
                 std::span<double> floor); // (n_ranges)

} // namespace geraf2
