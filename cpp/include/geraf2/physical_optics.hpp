// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <complex>
#include <span>

#include "geraf2/types.hpp"
#include "geraf2/wave.hpp"

namespace geraf2 {

/// Closed shell of a dielectric with parallel faces, axes along the frame's.
struct DielectricBox {
    Vec3<double> center;       ///< [m]
    Vec3<double> half_size;    ///< outer half sides [m]
    double thickness_m = 0.0;  ///< of the wall
    double permittivity = 1.0; ///< relative, real
};

/// Extent of one element of the surface; its phase varies linearly over it.
enum class ElementShape {
    point,     ///< no extent
    triangle,  ///< edges hold two corners, seen from the centroid
    rectangle, ///< edges hold the two half sides
};

/// What the elements are made of.
enum class Reflector {
    conductor, ///< reflection coefficient -1
    slab,      ///< r of the nearer face, -r (1 - r^2) of the farther, delayed by twice the slab
};

struct EchoParams {
    Waveform waveform;
    ElementShape shape = ElementShape::point;
    Reflector reflector = Reflector::conductor;
    double slab_permittivity = 1.0;
    double slab_thickness_m = 0.0;
    double slab_crossing = 1.0; ///< what one crossing leaves, beside the faces' reflection
    Vec3<double> boresight;     ///< unit vector of the antennas' main lobe
    int pattern_exponent = 0;   ///< n of the amplitude pattern cos^n of each tx and rx
};

/// Physical-optics echo of surface elements p seen by antennas a of block b:
/// s_a(t) = j / (4 pi) sum_p w_bp r T O g F / (R_t R_r) exp(phase_sign j 2 pi f_t (d_ap + e_ap) /
/// c) d = R_t + R_r + bias, O = (n . w_t + n . w_r) / 2 where the element faces both, else 0, T and
/// e the transmission and excess path of every wall crossed, F the element's form factor. |s|^2 is
/// received over transmitted power for antennas of unit gain.
template <class T>
void physical_optics(std::span<const double> points,           // (n_points, 3) [m]
                     std::span<const double> normals,          // (n_points, 3), or empty: O = 1
                     std::span<const double> edges,            // (n_points, 2, 3) [m], or empty
                     std::span<const std::complex<T>> weights, // (n_blocks, n_points) [m^2]
                     std::span<const double> tx,               // (n_antennas, 3) [m]
                     std::span<const double> rx,               // (n_antennas, 3) [m]
                     std::span<const index_t> block_offsets,   // (n_blocks + 1)
                     std::span<const DielectricBox> walls,     // crossed walls
                     const EchoParams& params,
                     std::span<std::complex<T>> signal, // (n_antennas, n_samples), overwritten
                     int num_threads);

} // namespace geraf2
