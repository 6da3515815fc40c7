// SPDX-License-Identifier: Apache-2.0
#include "geraf2/lensless.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numeric>

namespace geraf2 {
namespace {

using Triple = std::array<double, 3>;

/// Gradients shorter than this have no direction.
constexpr double min_length = 1e-6;

template <class T>
Triple triple(std::span<const T> rows, index_t row) noexcept {
    const auto at = static_cast<std::size_t>(3 * row);
    return {static_cast<double>(rows[at]), static_cast<double>(rows[at + 1]),
            static_cast<double>(rows[at + 2])};
}

double dot(const Triple& a, const Triple& b) noexcept {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

Triple minus(const Triple& a, const Triple& b) noexcept {
    return {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
}

/// base^exponent; std::pow would take a third of an amplitude's time.
double power_of(double base, double exponent) noexcept {
    constexpr double largest = 64.0;
    if (exponent < 0.0 || exponent > largest || exponent != std::floor(exponent)) {
        return std::pow(base, exponent);
    }
    double out = 1.0;
    for (auto left = static_cast<unsigned>(exponent); left != 0; left >>= 1U) {
        out *= (left & 1U) != 0 ? base : 1.0;
        base *= base;
    }
    return out;
}

/// Normal and lobe of one pair.
struct Facing {
    Triple normal;         ///< gradient / |gradient|
    Triple direction;      ///< from the group's middle to the point
    double inverse_length; ///< of the gradient
    double distance;       ///< from the group's middle [m]
    double cosine;
    double lobe; ///< (2 cosine^2 - 1)+
    bool short_gradient;

    Facing(const Triple& gradient, const Triple& point, const Triple& center) noexcept {
        const double length = std::sqrt(dot(gradient, gradient));
        short_gradient = length < min_length;
        inverse_length = 1.0 / std::max(length, min_length);
        const Triple way = minus(point, center);
        distance = std::sqrt(dot(way, way));
        for (std::size_t axis = 0; axis < 3; ++axis) {
            normal[axis] = gradient[axis] * inverse_length;
            direction[axis] = way[axis] / distance;
        }
        cosine = dot(normal, direction);
        lobe = std::max(2.0 * cosine * cosine - 1.0, 0.0);
    }
};

} // namespace

template <class T>
void ray_intervals(std::span<const double> origins, const Vec3<double>& direction,
                   std::span<const double> near, std::span<const double> far,
                   std::span<const double> jitter, int num_threads, const RayIntervals<T>& out) {
    const auto n_rays = static_cast<index_t>(near.size());
    const std::size_t n_ends = near.empty() ? 1 : jitter.size() / near.size();
    const std::size_t n = n_ends - 1;
    const double along[] = {direction.x, direction.y, direction.z};
#pragma omp parallel for num_threads(num_threads) schedule(static)
    for (index_t row = 0; row < n_rays; ++row) {
        const auto ray = static_cast<std::size_t>(row);
        const double share = (far[ray] - near[ray]) / static_cast<double>(n_ends);
        const Triple origin = triple(origins, row);
        double start[3];
        for (std::size_t axis = 0; axis < 3; ++axis) {
            start[axis] = origin[axis] + near[ray] * along[axis];
            out.starts[3 * ray + axis] = static_cast<T>(start[axis]);
        }
        double begin = share * jitter[ray * n_ends];
        out.offset[ray] = static_cast<T>(begin);
        for (std::size_t i = 0; i < n; ++i) {
            const double end = share * (static_cast<double>(i + 1) + jitter[ray * n_ends + i + 1]);
            const double middle = 0.5 * (begin + end);
            out.step[ray * n + i] = static_cast<T>(end - begin);
            for (std::size_t axis = 0; axis < 3; ++axis) {
                out.points[3 * (ray * n + i) + axis] =
                    static_cast<T>(start[axis] + middle * along[axis]);
            }
            begin = end;
        }
    }
}

template <class T>
SamplePairs facing_samples(const VolumeSamples<T>& samples, const EchoForm& form,
                           index_t samples_per_ray, index_t n_looks, int num_threads) {
    const auto n_samples = static_cast<index_t>(samples.alpha.size());
    const auto n_groups = static_cast<index_t>(form.centers.size() / 3);
    const bool has_lobe = form.lobe_power != 1.0;
    std::vector<std::uint8_t> lit(static_cast<std::size_t>(n_groups * n_samples), 0);
#pragma omp parallel for num_threads(num_threads) schedule(static)
    for (index_t i = 0; i < n_samples; ++i) {
        if (samples.alpha[static_cast<std::size_t>(i)] == T{}) {
            continue;
        }
        const Triple gradient = triple(samples.gradient, i);
        const Triple point = triple(samples.points, i);
        const double square = std::max(dot(gradient, gradient), min_length * min_length);
        for (index_t group = 0; group < n_groups; ++group) {
            const Triple way = minus(point, triple(form.centers, group));
            const double along = dot(gradient, way);
            // 2 cos^2 > 1; not below, so that a NaN is seen in the signal
            const bool dark = has_lobe && 2.0 * along * along <= square * dot(way, way);
            lit[static_cast<std::size_t>(group * n_samples + i)] = dark ? 0 : 1;
        }
    }
    const auto look_of = [=](index_t i) {
        return (i % samples_per_ray + 5 * (i / samples_per_ray)) % n_looks;
    };
    SamplePairs out;
    out.offsets.assign(static_cast<std::size_t>(n_groups * n_looks) + 1, 0);
    for (index_t group = 0; group < n_groups; ++group) {
        const std::uint8_t* row = lit.data() + group * n_samples;
        index_t* count = out.offsets.data() + group * n_looks + 1;
        for (index_t i = 0; i < n_samples; ++i) {
            if (row[i] != 0) {
                ++count[look_of(i)];
            }
        }
    }
    std::partial_sum(out.offsets.begin(), out.offsets.end(), out.offsets.begin());
    out.sample.resize(static_cast<std::size_t>(out.offsets.back()));
    std::vector<index_t> next(out.offsets.begin(), out.offsets.end() - 1);
    for (index_t group = 0; group < n_groups; ++group) {
        const std::uint8_t* row = lit.data() + group * n_samples;
        index_t* place = next.data() + group * n_looks;
        for (index_t i = 0; i < n_samples; ++i) {
            if (row[i] != 0) {
                out.sample[static_cast<std::size_t>(place[look_of(i)]++)] = i;
            }
        }
    }
    return out;
}

template <class T>
void echo_amplitudes_fwd(const VolumeSamples<T>& samples, const PairsView& pairs,
                         std::span<const T> shift, const EchoForm& form, int num_threads,
                         std::span<T> amplitude, std::span<T> factor, std::span<T> normals) {
    const auto n_parts = static_cast<index_t>(pairs.offsets.size()) - 1;
#pragma omp parallel for num_threads(num_threads) schedule(dynamic)
    for (index_t part = 0; part < n_parts; ++part) {
        const index_t group = part / pairs.n_looks;
        const Triple center = triple(form.centers, group);
        const double reference =
            form.references.empty() ? 0.0 : form.references[static_cast<std::size_t>(group)];
        const auto begin = static_cast<std::size_t>(pairs.offsets[static_cast<std::size_t>(part)]);
        const auto end =
            static_cast<std::size_t>(pairs.offsets[static_cast<std::size_t>(part) + 1]);
        for (std::size_t k = begin; k < end; ++k) {
            const index_t i = pairs.sample[k];
            const auto at = static_cast<std::size_t>(i);
            const Facing facing(triple(samples.gradient, i), triple(samples.points, i), center);
            const double through =
                std::max(static_cast<double>(samples.transmittance[at] + shift[k]), 0.0);
            double f = form.two_way_power == 2 ? through * through : through;
            if (form.lobe_power != 1.0) {
                f *= power_of(facing.lobe, form.lobe_power - 1.0);
            }
            if (!form.references.empty()) {
                f *= (reference / facing.distance) * (reference / facing.distance);
            }
            factor[k] = static_cast<T>(f);
            amplitude[k] = static_cast<T>(f * static_cast<double>(samples.alpha[at]));
            for (std::size_t axis = 0; axis < 3; ++axis) {
                normals[3 * k + axis] = static_cast<T>(facing.normal[axis]);
            }
        }
    }
}

template <class T>
void echo_amplitudes_bwd(const VolumeSamples<T>& samples, const PairsView& pairs,
                         std::span<const T> shift, const EchoForm& form, std::span<const T> factor,
                         std::span<const T> amplitude_grad, std::span<const T> normals_grad,
                         const SampleGradients<T>& out) {
    const auto n_parts = static_cast<index_t>(pairs.offsets.size()) - 1;
    // In one thread: a sample may be in several groups' pairs, and 10^4 of them take 0.2 ms.
    for (index_t part = 0; part < n_parts; ++part) {
        const Triple center = triple(form.centers, part / pairs.n_looks);
        const auto begin = static_cast<std::size_t>(pairs.offsets[static_cast<std::size_t>(part)]);
        const auto end =
            static_cast<std::size_t>(pairs.offsets[static_cast<std::size_t>(part) + 1]);
        for (std::size_t k = begin; k < end; ++k) {
            const index_t i = pairs.sample[k];
            const auto at = static_cast<std::size_t>(i);
            const auto grad = static_cast<double>(amplitude_grad[k]);
            const auto f = static_cast<double>(factor[k]);
            const double by_factor = grad * static_cast<double>(samples.alpha[at]) * f;
            const auto through = static_cast<double>(samples.transmittance[at] + shift[k]);
            out.alpha[at] += static_cast<T>(grad * f);
            if (through > 0.0) { // else the amplitude is zero, and does not change
                out.transmittance[at] += static_cast<T>(by_factor * form.two_way_power / through);
            }
            if (out.gradient.empty()) {
                continue;
            }
            const Facing facing(triple(samples.gradient, i), triple(samples.points, i), center);
            Triple slope = triple(normals_grad, static_cast<index_t>(k));
            if (form.lobe_power != 1.0 && facing.lobe > 0.0) {
                const double by_cosine =
                    by_factor * (form.lobe_power - 1.0) * 4.0 * facing.cosine / facing.lobe;
                for (std::size_t axis = 0; axis < 3; ++axis) {
                    slope[axis] += by_cosine * facing.direction[axis];
                }
            }
            const double along = facing.short_gradient ? 0.0 : dot(slope, facing.normal);
            for (std::size_t axis = 0; axis < 3; ++axis) {
                out.gradient[3 * at + axis] += static_cast<T>(
                    (slope[axis] - along * facing.normal[axis]) * facing.inverse_length);
            }
        }
    }
}

template <class T>
double length_defect(std::span<const T> gradients, int num_threads, std::span<T> slope) {
    constexpr std::size_t block = 1024;
    const std::size_t n = gradients.size() / 3;
    std::vector<double> sums((n + block - 1) / block, 0.0);
    const double per_one = n == 0 ? 0.0 : 1.0 / static_cast<double>(n);
#pragma omp parallel for num_threads(num_threads) schedule(static)
    for (std::size_t b = 0; b < sums.size(); ++b) {
        double sum = 0.0;
        for (std::size_t i = b * block; i < std::min(n, (b + 1) * block); ++i) {
            const Triple g = triple(gradients, static_cast<index_t>(i));
            const double length = std::sqrt(dot(g, g) + 1e-12);
            sum += (length - 1.0) * (length - 1.0);
            const double factor = 2.0 * per_one * (length - 1.0) / length;
            for (std::size_t axis = 0; axis < 3; ++axis) {
                slope[3 * i + axis] = static_cast<T>(factor * g[axis]);
            }
        }
        sums[b] = sum;
    }
    return per_one * std::accumulate(sums.begin(), sums.end(), 0.0);
}

template double length_defect<float>(std::span<const float>, int, std::span<float>);
template double length_defect<double>(std::span<const double>, int, std::span<double>);
template void ray_intervals<float>(std::span<const double>, const Vec3<double>&,
                                   std::span<const double>, std::span<const double>,
                                   std::span<const double>, int, const RayIntervals<float>&);
template void ray_intervals<double>(std::span<const double>, const Vec3<double>&,
                                    std::span<const double>, std::span<const double>,
                                    std::span<const double>, int, const RayIntervals<double>&);
template SamplePairs facing_samples<float>(const VolumeSamples<float>&, const EchoForm&, index_t,
                                           index_t, int);
template SamplePairs facing_samples<double>(const VolumeSamples<double>&, const EchoForm&, index_t,
                                            index_t, int);
template void echo_amplitudes_fwd<float>(const VolumeSamples<float>&, const PairsView&,
                                         std::span<const float>, const EchoForm&, int,
                                         std::span<float>, std::span<float>, std::span<float>);
template void echo_amplitudes_fwd<double>(const VolumeSamples<double>&, const PairsView&,
                                          std::span<const double>, const EchoForm&, int,
                                          std::span<double>, std::span<double>, std::span<double>);
template void echo_amplitudes_bwd<float>(const VolumeSamples<float>&, const PairsView&,
                                         std::span<const float>, const EchoForm&,
                                         std::span<const float>, std::span<const float>,
                                         std::span<const float>, const SampleGradients<float>&);
template void echo_amplitudes_bwd<double>(const VolumeSamples<double>&, const PairsView&,
                                          std::span<const double>, const EchoForm&,
                                          std::span<const double>, std::span<const double>,
                                          std::span<const double>, const SampleGradients<double>&);

} // namespace geraf2
