// SPDX-License-Identifier: Apache-2.0
#include "geraf2/physical_optics.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <exception>
#include <memory>
#include <numbers>
#include <vector>

#include "physical_optics/lanes.hpp"

namespace geraf2 {
namespace {

using namespace detail;

using Vec = Vec3<double>;
double dot(const Vec& a, const Vec& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
Vec load(std::span<const double> rows, index_t row) {
    const auto i = static_cast<std::size_t>(3 * row);
    return {rows[i], rows[i + 1], rows[i + 2]};
}
template <class T>
void store(T (&out)[3], const Vec& v, double scale = 1.0) {
    out[0] = static_cast<T>(scale * v.x);
    out[1] = static_cast<T>(scale * v.y);
    out[2] = static_cast<T>(scale * v.z);
}
Vec mean_row(std::span<const double> rows, index_t begin, index_t end) {
    Vec sum{};
    for (index_t i = begin; i < end; ++i) {
        const Vec v = load(rows, i);
        sum = {sum.x + v.x, sum.y + v.y, sum.z + v.z};
    }
    const auto n = static_cast<double>(end - begin);
    return {sum.x / n, sum.y / n, sum.z / n};
}

// First divided difference of -exp(-j x), without cancellation where both arguments are equal.
std::complex<double> divided_difference(double x, double y) {
    const double half = 0.5 * (x - y);
    const double sinc = half == 0.0 ? 1.0 : std::sin(half) / half;
    return std::complex<double>(0.0, 1.0) * std::polar(sinc, -0.5 * (x + y));
}

// Mean of exp(-j phase) over a triangle whose phase is linear, given at its corners relative to
// the centroid: 2 sum_n (-j)^n h_n / (n + 2)!, h_n the complete symmetric polynomials. 16 terms
// are exact to 1e-9 for phases up to 3 rad (edges of lambda / 3 seen at grazing incidence: 2.8);
// beyond, the same as twice the second divided difference, over the widest of the three gaps.
std::complex<double> triangle_form_factor(double a, double b) {
    const double c = -a - b;
    if (std::max({std::abs(a), std::abs(b), std::abs(c)}) > 3.0) {
        std::array<double, 3> x{a, b, c};
        std::sort(x.begin(), x.end());
        return 2.0 * (divided_difference(x[0], x[1]) - divided_difference(x[1], x[2])) /
               (x[0] - x[2]);
    }
    const double e2 = a * b + b * c + c * a;
    const double e3 = a * b * c;
    std::array<double, 17> h{};
    h[0] = 1.0;
    h[1] = 0.0;
    h[2] = -e2;
    double re = 1.0;
    double im = 0.0;
    double factorial = 2.0; // (n + 2)!
    for (std::size_t n = 1; n < h.size(); ++n) {
        if (n > 2) {
            h[n] = -e2 * h[n - 2] + e3 * h[n - 3];
        }
        factorial *= static_cast<double>(n + 2);
        const double term = 2.0 * h[n] / factorial;
        switch (n % 4) {
        case 0:
            re += term;
            break;
        case 1:
            im -= term;
            break;
        case 2:
            re -= term;
            break;
        default:
            im += term;
            break;
        }
    }
    return {re, im};
}

double middle_wavenumber(const Waveform& wave) {
    const double middle_hz = 0.5 * (wave.frequency_hz(0) + wave.frequency_hz(wave.n_samples - 1));
    return 2.0 * std::numbers::pi * middle_hz / speed_of_light;
}

struct Inputs {
    std::span<const double> points, normals, edges, tx, rx;
    const EchoParams& params;
};

// Elements of one block, with the double-precision phase of the path to the block's centres.
template <class T>
std::vector<Element<T>> gather_elements(const Inputs& in, std::span<const std::complex<T>> weights,
                                        const Vec& tx_center, const Vec& rx_center) {
    const Waveform& wave = in.params.waveform;
    const double wavenumber = middle_wavenumber(wave);
    const double step_hz = wave.chirp_slope_hz_per_s / wave.sample_rate_hz;
    std::vector<Element<T>> elements;
    elements.reserve(weights.size());
    for (std::size_t p = 0; p < weights.size(); ++p) {
        if (weights[p] == std::complex<T>{}) {
            continue;
        }
        const auto row = static_cast<index_t>(p);
        const Vec x = load(in.points, row);
        const Vec from_tx{x.x - tx_center.x, x.y - tx_center.y, x.z - tx_center.z};
        const Vec from_rx{x.x - rx_center.x, x.y - rx_center.y, x.z - rx_center.z};
        const double range_tx = std::sqrt(dot(from_tx, from_tx));
        const double range_rx = std::sqrt(dot(from_rx, from_rx));
        std::complex<double> weight{static_cast<double>(weights[p].real()),
                                    static_cast<double>(weights[p].imag())};
        Element<T> e{};
        if (in.params.shape == ElementShape::triangle) {
            const Vec slope{from_tx.x / range_tx + from_rx.x / range_rx,
                            from_tx.y / range_tx + from_rx.y / range_rx,
                            from_tx.z / range_tx + from_rx.z / range_rx};
            weight *= triangle_form_factor(wavenumber * dot(slope, load(in.edges, 2 * row)),
                                           wavenumber * dot(slope, load(in.edges, 2 * row + 1)));
        } else if (in.params.shape == ElementShape::rectangle) {
            store(e.edge_1, load(in.edges, 2 * row), wavenumber);
            store(e.edge_2, load(in.edges, 2 * row + 1), wavenumber);
        }
        store(e.from_tx, from_tx);
        store(e.from_rx, from_rx);
        e.range_tx = static_cast<T>(range_tx);
        e.range_rx = static_cast<T>(range_rx);
        store(e.position, x);
        if (!in.normals.empty()) {
            store(e.normal, load(in.normals, row));
        }
        e.weight_re = static_cast<T>(weight.real());
        e.weight_im = static_cast<T>(weight.imag());
        // Whole turns are dropped in double: at 77 GHz one float32 ulp of a 2 m path is 2.4e-4 rad.
        const double delay = (range_tx + range_rx + wave.path_bias_m) / speed_of_light;
        const double turns = phase_sign * wave.start_frequency_hz * delay;
        const double turns_step = phase_sign * step_hz * delay;
        e.turns = static_cast<T>(turns - std::round(turns));
        e.turns_step = static_cast<T>(turns_step - std::round(turns_step));
        elements.push_back(e);
    }
    return elements;
}

template <class T>
Constants<T> make_constants(const Inputs& in) {
    const Waveform& wave = in.params.waveform;
    const double per_m = phase_sign / speed_of_light;
    Constants<T> c{};
    c.turns_per_m = static_cast<T>(per_m * wave.start_frequency_hz);
    c.turns_step_per_m = static_cast<T>(per_m * wave.chirp_slope_hz_per_s / wave.sample_rate_hz);
    c.slab_permittivity = static_cast<T>(in.params.slab_permittivity);
    c.slab_thickness = static_cast<T>(in.params.slab_thickness_m);
    store(c.boresight, in.params.boresight);
    const double wavenumber = middle_wavenumber(wave);
    const double middle_hz = wavenumber * speed_of_light / (2.0 * std::numbers::pi);
    c.detune = static_cast<T>(wave.frequency_hz(0) / middle_hz - 1.0);
    c.detune_step = static_cast<T>(wave.chirp_slope_hz_per_s / wave.sample_rate_hz / middle_hz);
    c.curvature = static_cast<T>(1.0 / (6.0 * wavenumber * wavenumber));
    c.has_normals = !in.normals.empty();
    c.has_edges = in.params.shape == ElementShape::rectangle;
    c.reflector = in.params.reflector;
    c.pattern_exponent = in.params.pattern_exponent;
    c.n_samples = wave.n_samples;
    return c;
}

template <class T>
void echo_of_block(const Inputs& in, std::span<const std::complex<T>> weights, index_t begin,
                   index_t end, const std::vector<Wall<T>>& walls,
                   std::span<std::complex<T>> signal) {
    const Vec tx_center = mean_row(in.tx, begin, end);
    const Vec rx_center = mean_row(in.rx, begin, end);
    const std::vector<Element<T>> elements = gather_elements(in, weights, tx_center, rx_center);
    const Constants<T> c = make_constants<T>(in);
    const auto n_values = static_cast<std::size_t>(2 * c.n_samples * n_lanes);
    // Over-allocated by one 64-byte line and aligned by hand: registers are stored to it.
    std::vector<T> buffer(n_values + 64 / sizeof(T));
    void* aligned = buffer.data();
    std::size_t space = buffer.size() * sizeof(T);
    auto* sum = static_cast<T*>(std::align(64, n_values * sizeof(T), aligned, space));
    const T scale = static_cast<T>(1.0 / (4.0 * std::numbers::pi));
    for (index_t first = begin; first < end; first += n_lanes) {
        Lanes<T> lanes;
        for (index_t l = 0; l < n_lanes; ++l) {
            const index_t a = std::min(first + l, end - 1); // spare lanes repeat the last antenna
            const Vec tx = load(in.tx, a);
            const Vec rx = load(in.rx, a);
            const double tx_offset[3] = {tx.x - tx_center.x, tx.y - tx_center.y,
                                         tx.z - tx_center.z};
            const double rx_offset[3] = {rx.x - rx_center.x, rx.y - rx_center.y,
                                         rx.z - rx_center.z};
            for (int axis = 0; axis < 3; ++axis) {
                lanes.tx[axis][l] = static_cast<T>(tx_offset[axis]);
                lanes.rx[axis][l] = static_cast<T>(rx_offset[axis]);
            }
        }
        std::fill(sum, sum + n_values, T(0));
        accumulate_best<T>(elements, lanes, walls, c, sum);
        for (index_t l = 0; l < std::min<index_t>(n_lanes, end - first); ++l) {
            for (index_t t = 0; t < c.n_samples; ++t) {
                const T re = sum[2 * t * n_lanes + l];
                const T im = sum[(2 * t + 1) * n_lanes + l];
                signal[static_cast<std::size_t>((first + l) * c.n_samples + t)] = {-scale * im,
                                                                                   scale * re};
            }
        }
    }
}

} // namespace

template <class T>
void physical_optics(std::span<const double> points, std::span<const double> normals,
                     std::span<const double> edges, std::span<const std::complex<T>> weights,
                     std::span<const double> tx, std::span<const double> rx,
                     std::span<const index_t> block_offsets, std::span<const DielectricBox> walls,
                     const EchoParams& params, std::span<std::complex<T>> signal, int num_threads) {
    const Inputs in{points, normals, edges, tx, rx, params};
    const std::size_t n_points = points.size() / 3;
    std::vector<Wall<T>> wall_list;
    for (const DielectricBox& box : walls) {
        Wall<T> wall{};
        store(wall.center, box.center);
        store(wall.half, box.half_size);
        wall.thickness = static_cast<T>(box.thickness_m);
        wall.permittivity = static_cast<T>(box.permittivity);
        wall_list.push_back(wall);
    }
    const auto n_blocks = static_cast<index_t>(block_offsets.size()) - 1;
    std::exception_ptr error;
#pragma omp parallel for schedule(dynamic, 1) num_threads(num_threads)
    for (index_t b = 0; b < n_blocks; ++b) {
        try {
            const auto block = static_cast<std::size_t>(b);
            if (block_offsets[block] < block_offsets[block + 1]) {
                echo_of_block<T>(in, weights.subspan(block * n_points, n_points),
                                 block_offsets[block], block_offsets[block + 1], wall_list, signal);
            }
        } catch (...) {
#pragma omp critical(geraf2_physical_optics_error)
            if (!error) {
                error = std::current_exception();
            }
        }
    }
    if (error) {
        std::rethrow_exception(error);
    }
}

template void physical_optics<float>(std::span<const double>, std::span<const double>,
                                     std::span<const double>, std::span<const std::complex<float>>,
                                     std::span<const double>, std::span<const double>,
                                     std::span<const index_t>, std::span<const DielectricBox>,
                                     const EchoParams&, std::span<std::complex<float>>, int);
template void physical_optics<double>(std::span<const double>, std::span<const double>,
                                      std::span<const double>,
                                      std::span<const std::complex<double>>,
                                      std::span<const double>, std::span<const double>,
                                      std::span<const index_t>, std::span<const DielectricBox>,
                                      const EchoParams&, std::span<std::complex<double>>, int);

} // namespace geraf2
