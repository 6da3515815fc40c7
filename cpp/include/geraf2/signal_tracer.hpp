// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <complex>
#include <span>

#include "geraf2/antennas.hpp"
#include "geraf2/types.hpp"
#include "geraf2/wave.hpp"

namespace geraf2 {

/// Points that reflect, and how strongly.
template <class T>
struct Reflectors {
    std::span<const double> points; ///< (n_points, 3) [m]
    std::span<const T> normals;     ///< (n_points, 3), or empty: no specular factor
    std::span<const T> amplitude;   ///< (rows, n_points, parts)
    index_t rows = 1;               ///< 1: the same for all antennas, or n_antennas
    index_t parts = 1;              ///< 1: real, 2: real and imaginary part
};

struct SignalTracerOptions {
    double rtol = 1e-3; ///< largest error of a phasor exp(j phase) in blocks of points
    int num_threads = 1;
};

/// Received signal: s_i(t) = sum_x A_i(x) q_i(x) exp(-j 2 pi f(t) d_i(x) / c), with
/// d_i(x) = |x - tx_i| + |x - rx_i| + path_bias and, where normals are given, the specular factor
/// q = (w_o . w_r)+ = (2 (n . a) (n . b) - a . b)+, a and b the unit vectors from tx_i and rx_i to
/// x; else q = 1 (docs/math/signal-tracer.md#signal-tracer). A point on an antenna has q = 0.
///
/// The result does not depend on num_threads, not even in its last bit. T: float or double.
template <class T>
void signal_tracer_fwd(const Reflectors<T>& reflectors, const AntennaPositions& antennas,
                       const Waveform& waveform, const SignalTracerOptions& options,
                       std::span<std::complex<T>> signal); // (n_antennas, n_samples)

/// Gradients of L; spans of outputs that are not wanted are empty.
template <class T>
struct SignalTracerGradients {
    std::span<T> amplitude;    ///< (rows, n_points, parts), as Reflectors::amplitude
    std::span<double> normals; ///< (n_points, 3)
    std::span<double> points;  ///< (n_points, 3)
    std::span<double> tx;      ///< (n_antennas, 3)
    std::span<double> rx;      ///< (n_antennas, 3)
};

/// Backward of signal_tracer_fwd, signal_grad = dL/dRe s + j dL/dIm s. The gradient to the
/// amplitude is the adjoint of the same approximation; the others are derivatives to rtol.
/// Bit-identical from call to call at one num_threads.
template <class T>
void signal_tracer_bwd(std::span<const std::complex<T>> signal_grad, // (n_antennas, n_samples)
                       const Reflectors<T>& reflectors, const AntennaPositions& antennas,
                       const Waveform& waveform, const SignalTracerOptions& options,
                       const SignalTracerGradients<T>& gradients);

/// Antennas of each reflector: part = group n_looks + look holds the reflectors from
/// reflectors[part] to reflectors[part + 1], which echo to the antennas of that group.
struct TracerParts {
    std::span<const index_t> reflectors; ///< (n_groups n_looks + 1)
    std::span<const index_t> antennas;   ///< each once, group after group, (n_antennas)
    std::span<const index_t> groups;     ///< where each group's antennas begin, (n_groups + 1)
    index_t n_looks = 1;
};

/// signal_tracer_fwd of each part, in one call. Amplitudes are real and shared by the antennas of a
/// group: rows = parts = 1.
template <class T>
void trace_parts_fwd(const Reflectors<T>& reflectors, const AntennaPositions& antennas,
                     const TracerParts& parts, const Waveform& waveform,
                     const SignalTracerOptions& options,
                     std::span<std::complex<T>> signal); // (n_looks, n_antennas, n_samples)

/// Backward of trace_parts_fwd; an output that is not wanted is empty.
template <class T>
void trace_parts_bwd(std::span<const std::complex<T>> signal_grad, const Reflectors<T>& reflectors,
                     const AntennaPositions& antennas, const TracerParts& parts,
                     const Waveform& waveform, const SignalTracerOptions& options,
                     std::span<T> amplitude_grad,     // (n_points)
                     std::span<double> normals_grad); // (n_points, 3)

} // namespace geraf2
