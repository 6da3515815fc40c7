// SPDX-License-Identifier: Apache-2.0
#include "geraf2/physical_optics.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <compare>
#include <cstddef>
#include <exception>
#include <memory>
#include <numbers>
#include <utility>
#include <vector>

#include "physical_optics/aperture.hpp"
#include "physical_optics/cells.hpp"
#include "physical_optics/lanes.hpp"

namespace geraf2 {
namespace {

using namespace detail;

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

// Sorted by place, so that neighbours are read one after another.
struct Inputs {
    std::vector<double> points, normals, edges;
    std::vector<std::size_t> order; // rows of the weights
    std::vector<std::size_t> cubes; // cube i holds elements cubes[i] to cubes[i + 1] - 1
    std::vector<unsigned> octants;  // 8 * octant of the cube + octant of that octant
    double cube_m;                  // side of a cube
    std::span<const double> tx, rx;
    const EchoParams& params;
};

double half_band_wavenumber(const Waveform& wave) {
    const double band_hz = wave.frequency_hz(wave.n_samples - 1) - wave.frequency_hz(0);
    // Narrow bands: cells of 7 cm, so that float holds the paths to their middle.
    return std::max(std::numbers::pi * std::abs(band_hz) / speed_of_light, 10.0);
}

std::vector<double> take_rows(std::span<const double> values,
                              const std::vector<std::size_t>& rows) {
    const std::size_t width = rows.empty() ? 0 : values.size() / rows.size();
    std::vector<double> found;
    found.reserve(values.size());
    for (const std::size_t row : rows) {
        const auto first = values.begin() + static_cast<std::ptrdiff_t>(row * width);
        found.insert(found.end(), first, first + static_cast<std::ptrdiff_t>(width));
    }
    return found;
}

Inputs sort_elements(std::span<const double> points, std::span<const double> normals,
                     std::span<const double> edges, std::span<const double> tx,
                     std::span<const double> rx, const EchoParams& params) {
    struct Place {
        std::array<double, 3> cube;
        unsigned octants = 0;
        auto operator<=>(const Place&) const = default;
    };
    const double side_m =
        cell_radians / (std::numbers::sqrt3 * half_band_wavenumber(params.waveform));
    std::vector<Place> places(points.size() / 3);
    std::vector<std::size_t> order(places.size());
    for (std::size_t p = 0; p < places.size(); ++p) {
        for (std::size_t axis = 0; axis < 3; ++axis) {
            const double at = points[3 * p + axis] / side_m;
            places[p].cube[axis] = std::floor(at);
            const auto quarter = static_cast<unsigned>(4.0 * (at - std::floor(at)));
            places[p].octants += ((quarter & 2U) << 2U | (quarter & 1U)) << axis;
        }
        order[p] = p;
    }
    // By number among equals: std::stable_sort would do the same, but allocates.
    std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
        return places[a] == places[b] ? a < b : places[a] < places[b];
    });
    std::vector<std::size_t> cubes;
    std::vector<unsigned> octants;
    for (std::size_t i = 0; i < order.size(); ++i) {
        if (i == 0 || places[order[i]].cube != places[order[i - 1]].cube) {
            cubes.push_back(i);
        }
        octants.push_back(places[order[i]].octants);
    }
    cubes.push_back(order.size());
    return {take_rows(points, order),
            take_rows(normals, order),
            take_rows(edges, order),
            order,
            std::move(cubes),
            std::move(octants),
            side_m,
            tx,
            rx,
            params};
}

// Path from a place to the centres of a block.
struct Legs {
    Vec from_tx, from_rx;
    double range_tx, range_rx;

    Legs(const Vec& x, const Vec& tx, const Vec& rx)
        : from_tx{x.x - tx.x, x.y - tx.y, x.z - tx.z}, from_rx{x.x - rx.x, x.y - rx.y, x.z - rx.z},
          range_tx(std::sqrt(dot(from_tx, from_tx))), range_rx(std::sqrt(dot(from_rx, from_rx))) {}
    [[nodiscard]] double path() const { return range_tx + range_rx; }
};

template <class T>
Element<T> make_element(const Inputs& in, std::size_t p, std::complex<T> weight_of,
                        const Legs& legs) {
    const Waveform& wave = in.params.waveform;
    const double wavenumber = middle_wavenumber(wave);
    const auto row = static_cast<index_t>(p);
    std::complex<double> weight{static_cast<double>(weight_of.real()),
                                static_cast<double>(weight_of.imag())};
    Element<T> e{};
    if (in.params.shape == ElementShape::triangle) {
        const Vec slope{legs.from_tx.x / legs.range_tx + legs.from_rx.x / legs.range_rx,
                        legs.from_tx.y / legs.range_tx + legs.from_rx.y / legs.range_rx,
                        legs.from_tx.z / legs.range_tx + legs.from_rx.z / legs.range_rx};
        weight *= triangle_form_factor(wavenumber * dot(slope, load(in.edges, 2 * row)),
                                       wavenumber * dot(slope, load(in.edges, 2 * row + 1)));
    } else if (in.params.shape == ElementShape::rectangle) {
        store(e.edge_1, load(in.edges, 2 * row), wavenumber);
        store(e.edge_2, load(in.edges, 2 * row + 1), wavenumber);
    }
    store(e.from_tx, legs.from_tx);
    store(e.from_rx, legs.from_rx);
    e.range_tx = static_cast<T>(legs.range_tx);
    e.range_rx = static_cast<T>(legs.range_rx);
    store(e.position, load(in.points, row));
    if (!in.normals.empty()) {
        store(e.normal, load(in.normals, row));
    }
    e.weight_re = static_cast<T>(weight.real());
    e.weight_im = static_cast<T>(weight.imag());
    return e;
}

// Elements of a cube that one block sees, in cells.
template <class T>
class Gatherer {
public:
    Gatherer(const Inputs& in, const Aperture<T>& aperture) : in_(in), aperture_(aperture) {
        // In the middle of both faces.
        if (in.params.reflector == Reflector::slab) {
            delay_m_ = in.params.slab_thickness_m * std::sqrt(in.params.slab_permittivity);
        }
    }

    std::vector<Cell<T>> cells;
    std::vector<Element<T>> elements;

    void gather(std::size_t cube, std::span<const std::complex<T>> weights) {
        cells.clear();
        elements.clear();
        rows_.clear();
        paths_.clear();
        for (std::size_t i = in_.cubes[cube]; i < in_.cubes[cube + 1]; ++i) {
            const std::complex<T> weight = weights[in_.order[i]];
            if (weight != std::complex<T>{}) {
                const Legs legs(load(in_.points, static_cast<index_t>(i)), aperture_.tx_center,
                                aperture_.rx_center);
                elements.push_back(make_element(in_, i, weight, legs));
                paths_.push_back(legs.path());
                rows_.push_back(i);
            }
        }
        if (!rows_.empty()) {
            const Vec first = load(in_.points, static_cast<index_t>(rows_.front()));
            const auto middle = [&](double x) {
                return (std::floor(x / in_.cube_m) + 0.5) * in_.cube_m;
            };
            divide(0, rows_.size(), {middle(first.x), middle(first.y), middle(first.z)}, 0);
        }
    }

private:
    // One cell of these elements, or those of its octants where it is not smooth.
    void divide(std::size_t begin, std::size_t end, const Vec& middle, int generation) {
        const double side_m = std::ldexp(in_.cube_m, -generation);
        const Legs legs(middle, aperture_.tx_center, aperture_.rx_center);
        // Phase at the end of the block, relative to the middle, of an element half a side away.
        const double radians = 0.5 * side_m * aperture_.half_side_m *
                               middle_wavenumber(in_.params.waveform) *
                               (1.0 / legs.range_tx + 1.0 / legs.range_rx);
        const bool smooth = aperture_.half_side_m > 0.0 && radians < smooth_radians;
        if (smooth || aperture_.half_side_m == 0.0 || generation == 2 || end - begin < few) {
            add_cell(begin, end, legs, smooth && end - begin > 1);
            return;
        }
        const unsigned shift = generation == 0 ? 3 : 0;
        while (begin < end) {
            const unsigned octant = in_.octants[rows_[begin]] >> shift;
            std::size_t last = begin;
            while (last < end && in_.octants[rows_[last]] >> shift == octant) {
                ++last;
            }
            const auto step = [&](unsigned axis) {
                return ((octant >> axis & 1U) != 0 ? 0.25 : -0.25) * side_m;
            };
            divide(begin, last, {middle.x + step(0), middle.y + step(1), middle.z + step(2)},
                   generation + 1);
            begin = last;
        }
    }

    void add_cell(std::size_t begin, std::size_t end, const Legs& middle, bool smooth) {
        const Waveform& wave = in_.params.waveform;
        const double path_m = middle.path() + delay_m_;
        for (std::size_t e = begin; e < end; ++e) {
            elements[e].lead = static_cast<T>(paths_[e] - path_m);
        }
        // Whole turns are dropped in double: at 77 GHz one float32 ulp of a 2 m path is 2.4e-4 rad.
        const double delay = phase_sign * (path_m + wave.path_bias_m) / speed_of_light;
        const double turns = wave.frequency_hz(0) * delay;
        const double turns_step = wave.chirp_slope_hz_per_s / wave.sample_rate_hz * delay;
        Cell<T> cell{};
        cell.begin = begin;
        cell.end = end;
        cell.smooth = smooth;
        store(cell.from_tx, middle.from_tx);
        store(cell.from_rx, middle.from_rx);
        cell.range_tx = static_cast<T>(middle.range_tx);
        cell.range_rx = static_cast<T>(middle.range_rx);
        cell.turns = static_cast<T>(turns - std::round(turns));
        cell.turns_step = static_cast<T>(turns_step - std::round(turns_step));
        cells.push_back(cell);
    }

    // Four nodes leave 3e-3 of the farthest element at the end of a block, and 5e-4 rms.
    static constexpr double smooth_radians = 0.8;
    // Fewer elements are not worth another cell.
    static constexpr std::size_t few = 32;

    const Inputs& in_;
    const Aperture<T>& aperture_;
    double delay_m_ = 0.0;
    std::vector<std::size_t> rows_; // of the elements
    std::vector<double> paths_;     // to the block's centres
};

template <class T>
T inverse_or_zero(T value) {
    return value == T(0) ? T(0) : T(1) / value;
}

template <class T>
Constants<T> make_constants(const Inputs& in) {
    const Waveform& wave = in.params.waveform;
    const double per_m = phase_sign / speed_of_light;
    const double half_band_hz =
        0.5 * (wave.frequency_hz(wave.n_samples - 1) - wave.frequency_hz(0));
    Constants<T> c{};
    c.turns_per_m = static_cast<T>(per_m * (wave.frequency_hz(0) + half_band_hz));
    c.turns_start_per_m = static_cast<T>(per_m * wave.frequency_hz(0));
    c.radians_per_m = static_cast<T>(2.0 * std::numbers::pi * per_m * half_band_hz);
    c.turns_step_per_m = static_cast<T>(per_m * wave.chirp_slope_hz_per_s / wave.sample_rate_hz);
    c.slab_contrast = static_cast<T>(in.params.slab_permittivity - 1.0);
    c.inverse_slab_contrast = inverse_or_zero(c.slab_contrast);
    c.slab_thickness = static_cast<T>(in.params.slab_thickness_m);
    store(c.boresight, in.params.boresight);
    const double wavenumber = middle_wavenumber(wave);
    c.detune = static_cast<T>(half_band_hz / (wave.frequency_hz(0) + half_band_hz));
    c.curvature = static_cast<T>(1.0 / (6.0 * wavenumber * wavenumber));
    c.has_normals = !in.normals.empty();
    c.has_edges = in.params.shape == ElementShape::rectangle;
    c.n_faces = in.params.reflector == Reflector::slab ? 2 : 1;
    c.slab_crossings = static_cast<T>(in.params.slab_crossing * in.params.slab_crossing);
    c.pattern_exponent = in.params.pattern_exponent;
    c.n_samples = wave.n_samples;
    return c;
}

template <class T>
void echo_of_block(const Inputs& in, std::span<const std::complex<T>> weights, index_t begin,
                   index_t end, const std::vector<Wall<T>>& walls,
                   std::span<std::complex<T>> signal) {
    const Aperture<T> aperture = make_aperture<T>(in.tx, in.rx, in.params, begin, end);
    Gatherer<T> seen(in, aperture);
    std::vector<std::size_t> single;
    const Constants<T> c = make_constants<T>(in);
    const auto n_groups = static_cast<index_t>(aperture.block.groups.size());
    const auto n_values = static_cast<std::size_t>(2 * c.n_samples * n_lanes * n_groups);
    // Over-allocated by one 64-byte line and aligned by hand: registers are stored to it.
    std::vector<T> buffer(n_values + 64 / sizeof(T));
    void* aligned = buffer.data();
    std::size_t space = buffer.size() * sizeof(T);
    auto* sum = static_cast<T*>(std::align(64, n_values * sizeof(T), aligned, space));
    for (std::size_t cube = 0; cube + 1 < in.cubes.size(); ++cube) {
        seen.gather(cube, weights);
        accumulate_best<T>(seen.cells, seen.elements, aperture.block, walls, c, single, sum);
    }
    const T scale = static_cast<T>(1.0 / (4.0 * std::numbers::pi));
    for (index_t a = begin; a < end; ++a) {
        const index_t g = (a - begin) / n_lanes;
        for (index_t t = 0; t < c.n_samples; ++t) {
            const T* value = sum + (g * c.n_samples + t) * 2 * n_lanes + (a - begin) % n_lanes;
            signal[static_cast<std::size_t>(a * c.n_samples + t)] = {-scale * value[n_lanes],
                                                                     scale * value[0]};
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
    const Inputs in = sort_elements(points, normals, edges, tx, rx, params);
    const std::size_t n_points = points.size() / 3;
    std::vector<Wall<T>> wall_list;
    for (const DielectricBox& box : walls) {
        Wall<T> wall{};
        store(wall.center, box.center);
        store(wall.half, box.half_size);
        wall.thickness = static_cast<T>(box.thickness_m);
        wall.contrast = static_cast<T>(box.permittivity - 1.0);
        wall.inverse_contrast = inverse_or_zero(wall.contrast);
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
