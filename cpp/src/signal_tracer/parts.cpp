// SPDX-License-Identifier: Apache-2.0
// Many small tracings in one call, distributed over the threads.
#include <algorithm>
#include <cstddef>
#include <exception>
#include <vector>

#include "geraf2/signal_tracer.hpp"

namespace geraf2 {
namespace {

/// One part, cut out of the whole.
template <class T>
struct Part {
    Reflectors<T> reflectors;
    AntennaPositions antennas;
    std::span<const index_t> order; ///< the antennas' indices among all
    std::size_t first = 0;          ///< of its reflectors
    std::size_t look = 0;
    SignalTracerOptions options;
};

/// Positions in the order of the groups, (n_antennas, 3).
std::vector<double> in_order(std::span<const double> positions, std::span<const index_t> order) {
    std::vector<double> out(3 * order.size());
    for (std::size_t i = 0; i < order.size(); ++i) {
        std::copy_n(positions.data() + 3 * order[i], 3, out.data() + 3 * i);
    }
    return out;
}

/// body(part) for all parts with reflectors; an exception is rethrown afterwards. As many
/// parts at once as there are threads, or if they are fewer one after another with all threads.
template <class T, class Body>
void for_parts(const Reflectors<T>& all, const AntennaPositions& antennas, const TracerParts& parts,
               const SignalTracerOptions& options, const Body& body) {
    const std::vector<double> tx = in_order(antennas.tx, parts.antennas);
    const std::vector<double> rx = in_order(antennas.rx, parts.antennas);
    const auto n_parts = static_cast<index_t>(parts.reflectors.size()) - 1;
    const bool across = n_parts >= options.num_threads;
    const int threads = across ? options.num_threads : 1;
    std::exception_ptr error;
#pragma omp parallel for num_threads(threads) schedule(dynamic)
    for (index_t p = 0; p < n_parts; ++p) {
        const auto at = static_cast<std::size_t>(p);
        const auto n_looks = static_cast<std::size_t>(parts.n_looks);
        const auto first = static_cast<std::size_t>(parts.reflectors[at]);
        const std::size_t n = static_cast<std::size_t>(parts.reflectors[at + 1]) - first;
        const auto begin = static_cast<std::size_t>(parts.groups[at / n_looks]);
        const std::size_t heard = static_cast<std::size_t>(parts.groups[at / n_looks + 1]) - begin;
        if (n == 0 || heard == 0) {
            continue;
        }
        try {
            Part<T> part;
            part.reflectors = {all.points.subspan(3 * first, 3 * n),
                               all.normals.subspan(3 * first, 3 * n),
                               all.amplitude.subspan(first, n), 1, 1};
            part.antennas = {std::span(tx).subspan(3 * begin, 3 * heard),
                             std::span(rx).subspan(3 * begin, 3 * heard)};
            part.order = parts.antennas.subspan(begin, heard);
            part.first = first;
            part.look = at % n_looks;
            part.options = {options.rtol, across ? 1 : options.num_threads};
            body(part);
        } catch (...) {
#pragma omp critical(geraf2_signal_tracer_parts_error)
            if (!error) {
                error = std::current_exception();
            }
        }
    }
    if (error) {
        std::rethrow_exception(error);
    }
}

} // namespace

template <class T>
void trace_parts_fwd(const Reflectors<T>& reflectors, const AntennaPositions& antennas,
                     const TracerParts& parts, const Waveform& waveform,
                     const SignalTracerOptions& options, std::span<std::complex<T>> signal) {
    std::fill(signal.begin(), signal.end(), std::complex<T>{});
    const auto row = static_cast<std::size_t>(waveform.n_samples);
    const std::size_t n_antennas = parts.antennas.size();
    for_parts<T>(reflectors, antennas, parts, options, [&](const Part<T>& part) {
        std::vector<std::complex<T>> own(part.order.size() * row);
        signal_tracer_fwd<T>(part.reflectors, part.antennas, waveform, part.options, own);
        for (std::size_t i = 0; i < part.order.size(); ++i) {
            const auto antenna = static_cast<std::size_t>(part.order[i]);
            std::copy_n(own.data() + i * row, row,
                        signal.data() + (part.look * n_antennas + antenna) * row);
        }
    });
}

template <class T>
void trace_parts_bwd(std::span<const std::complex<T>> signal_grad, const Reflectors<T>& reflectors,
                     const AntennaPositions& antennas, const TracerParts& parts,
                     const Waveform& waveform, const SignalTracerOptions& options,
                     std::span<T> amplitude_grad, std::span<double> normals_grad) {
    std::fill(amplitude_grad.begin(), amplitude_grad.end(), T{});
    std::fill(normals_grad.begin(), normals_grad.end(), 0.0);
    const auto row = static_cast<std::size_t>(waveform.n_samples);
    const std::size_t n_antennas = parts.antennas.size();
    for_parts<T>(reflectors, antennas, parts, options, [&](const Part<T>& part) {
        std::vector<std::complex<T>> own(part.order.size() * row);
        for (std::size_t i = 0; i < part.order.size(); ++i) {
            const auto antenna = static_cast<std::size_t>(part.order[i]);
            std::copy_n(signal_grad.data() + (part.look * n_antennas + antenna) * row, row,
                        own.data() + i * row);
        }
        const std::size_t n = part.reflectors.amplitude.size();
        SignalTracerGradients<T> to;
        if (!amplitude_grad.empty()) {
            to.amplitude = amplitude_grad.subspan(part.first, n);
        }
        if (!normals_grad.empty()) {
            to.normals = normals_grad.subspan(3 * part.first, 3 * n);
        }
        signal_tracer_bwd<T>(own, part.reflectors, part.antennas, waveform, part.options, to);
    });
}

template void trace_parts_fwd<float>(const Reflectors<float>&, const AntennaPositions&,
                                     const TracerParts&, const Waveform&,
                                     const SignalTracerOptions&, std::span<std::complex<float>>);
template void trace_parts_fwd<double>(const Reflectors<double>&, const AntennaPositions&,
                                      const TracerParts&, const Waveform&,
                                      const SignalTracerOptions&, std::span<std::complex<double>>);
template void trace_parts_bwd<float>(std::span<const std::complex<float>>, const Reflectors<float>&,
                                     const AntennaPositions&, const TracerParts&, const Waveform&,
                                     const SignalTracerOptions&, std::span<float>,
                                     std::span<double>);
template void trace_parts_bwd<double>(std::span<const std::complex<double>>,
                                      const Reflectors<double>&, const AntennaPositions&,
                                      const TracerParts&, const Waveform&,
                                      const SignalTracerOptions&, std::span<double>,
                                      std::span<double>);

} // namespace geraf2
