// SPDX-License-Identifier: Apache-2.0
#include "matched_filter/plan.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>
#include <utility>

#include "matched_filter/tiers.hpp"

namespace geraf2::detail {
namespace {

/// Largest error of exp(j x s), |s| <= 1, as a Chebyshev series cut off after `degree`.
double chebyshev_error(int degree, double x) {
    double sum = 0.0;
    for (int k = degree + 1; k <= degree + 12; ++k) {
        sum += 2.0 * std::abs(bessel_j(k, x));
    }
    return sum;
}

/// Coefficients c_p of exp(j x s) ~ sum_p j^p c_p s^p from the Chebyshev series; c is real.
void exponential_polynomial(int degree, double x, double* c) {
    double previous[24] = {1.0}; // monomial coefficients of T_(k-1)
    double current[24] = {0.0, 1.0};
    std::fill_n(c, degree + 1, 0.0);
    c[0] = bessel_j(0, x);
    for (int k = 1; k <= degree; ++k) {
        const double weight = 2.0 * bessel_j(k, x);
        for (int p = k; p >= 0; p -= 2) { // j^k = j^p (-1)^((k - p) / 2)
            c[p] += ((k - p) / 2 % 2 == 0 ? weight : -weight) * current[p];
        }
        double next[24] = {};
        for (int p = 0; p <= k + 1; ++p) {
            next[p] = (p > 0 ? 2.0 * current[p - 1] : 0.0) - previous[p];
        }
        std::copy_n(current, 24, previous);
        std::copy_n(next, 24, current);
    }
}

/// Largest argument whose chebyshev_error stays below `limit`.
double largest_argument(int degree, double limit, double at_most) {
    if (chebyshev_error(degree, at_most) <= limit) {
        return at_most;
    }
    double low = 0.0;
    double high = at_most;
    for (int i = 0; i < 60; ++i) {
        const double middle = 0.5 * (low + high);
        (chebyshev_error(degree, middle) <= limit ? low : high) = middle;
    }
    return low;
}

/// b that makes max |x^k - b x^(k-2)| on [-1, 1] smallest; the value there is 1 - b.
double economy(int k) {
    double low = 0.0;
    double high = 1.0;
    for (int i = 0; i < 60; ++i) {
        const double b = 0.5 * (low + high);
        const double inside = b * 2.0 / k * std::pow(b * (k - 2) / k, 0.5 * (k - 2));
        (inside < 1.0 - b ? low : high) = b;
    }
    return low;
}

/// Points from which on a block is cheaper than the exact method.
index_t break_even(int tier, index_t n_pairs) {
    const double gain = exact_point_cost(n_pairs) - block_point_cost(tier);
    return gain > 0.0 ? static_cast<index_t>(std::ceil(block_set_up_cost(tier, n_pairs) / gain))
                      : std::numeric_limits<index_t>::max();
}

std::vector<index_t> in_order(index_t n_antennas, int lanes) {
    std::vector<index_t> slots(static_cast<std::size_t>((n_antennas + lanes - 1) / lanes * lanes),
                               silent(n_antennas - 1));
    std::iota(slots.begin(), slots.begin() + n_antennas, index_t{0});
    return slots;
}

BlockErrors block_errors(double rtol) {
    // Half of rtol for the profile, a quarter for the range, the rest for sine and cosine.
    return {0.5 * rtol, 0.25 * rtol};
}

} // namespace

double bessel_j(int order, double x) noexcept {
    double term = 1.0;
    for (int k = 1; k <= order; ++k) {
        term *= 0.5 * x / k;
    }
    double sum = 0.0;
    for (int k = 1; std::abs(term) > 1e-20 && k < 100; ++k) {
        sum += term;
        term *= -0.25 * x * x / (k * (k + order));
    }
    return sum;
}

WavePhases::WavePhases(const Waveform& waveform) {
    const auto n = static_cast<double>(waveform.n_samples);
    const double middle = waveform.start_frequency_hz +
                          waveform.chirp_slope_hz_per_s * 0.5 * (n - 1) / waveform.sample_rate_hz;
    // The filter turns every sample back: the opposite of the received phase.
    half_turns_per_m = -phase_sign * 2.0 * middle / speed_of_light;
    step_half_turns_per_m = -phase_sign * 2.0 * waveform.chirp_slope_hz_per_s /
                            (waveform.sample_rate_hz * speed_of_light);
    last_pair = 0.5 * (n - 1);
}

template <class T>
double attainable_rtol(double rtol) noexcept {
    return std::max(rtol, sizeof(T) == 4 ? 2e-6 : 1e-12);
}

template <class T>
int block_tier(double rtol) noexcept {
    if (rtol >= 5e-4) {
        return narrow_coarse;
    }
    return sizeof(T) == 4 || rtol >= 1e-5 ? narrow_fine : narrow_double;
}

double exact_point_cost(index_t n_pairs) noexcept {
    return 170.0 + 7.0 * static_cast<double>(n_pairs);
}

double block_point_cost(int tier) noexcept {
    const MatchedFilterTier& t = tiers[tier];
    return 1.4 * (2 * (3 + t.range_order) + 11 + 2 * t.profile_degree);
}

double block_set_up_cost(int tier, index_t n_pairs) noexcept {
    return 800.0 + static_cast<double>(n_pairs) * (20 + 4 * (tiers[tier].profile_degree + 1));
}

template <class T>
WaveformPlan<T>::WaveformPlan(const Waveform& waveform, const MatchedFilterOptions& options)
    : WaveformPlan(waveform, options, block_tier<T>(options.rtol)) {}

template <class T>
WaveformPlan<T>::WaveformPlan(const Waveform& waveform, const MatchedFilterOptions& options,
                              int tier_index)
    : WaveformPlan(waveform, tier_index, block_errors(attainable_rtol<T>(options.rtol))) {
    if (options.method != MatchedFilterMethod::exact) {
        rule_.max_radius = max_radius_;
    }
    if (options.method == MatchedFilterMethod::automatic) {
        rule_.min_points = break_even(tables_.tier, tables_.n_pairs);
    }
}

template <class T>
WaveformPlan<T>::WaveformPlan(const Waveform& waveform, int tier, const BlockErrors& errors)
    : profile_((waveform.n_samples + 1) / 2 * (tiers[tier].profile_degree + 1)) {
    const WavePhases phases(waveform);
    const int degree = tiers[tier].profile_degree;
    tables_.tier = tier;
    tables_.n_pairs = (waveform.n_samples + 1) / 2;
    tables_.first_pair = waveform.n_samples % 2 == 0 ? 0.5 : 0.0;
    tables_.half_turns_per_m = phases.half_turns_per_m;
    tables_.step_half_turns_per_m = phases.step_half_turns_per_m;
    tables_.path_bias_m = waveform.path_bias_m;
    tables_.range_limit = errors.range;
    tables_.range_economy = economy(tiers[tier].range_order + 1);
    tables_.range_residual = 1.0 - tables_.range_economy;
    const double per_half_turn = std::numbers::pi * tables_.step_half_turns_per_m /
                                 tables_.half_turns_per_m; // phase of one sample step
    const double steepest = std::abs(per_half_turn) * phases.last_pair;
    double reach = tiers[tier].max_half_turns;
    if (steepest > 0.0) {
        reach = std::min(reach, largest_argument(degree, errors.profile, 8.0) / steepest);
    }
    double c[24];
    for (index_t pair = 0; pair < tables_.n_pairs; ++pair) {
        const double slope = per_half_turn * (tables_.first_pair + static_cast<double>(pair));
        exponential_polynomial(degree, slope * reach, c);
        double power = 1.0;
        for (int p = 0; p <= degree; ++p) {
            profile_.data()[pair * (degree + 1) + p] = static_cast<T>(c[p] / power);
            power *= reach;
        }
    }
    tables_.profile = profile_.data();
    max_radius_ = reach / (2.0 * std::abs(tables_.half_turns_per_m));
}

template <class T>
MatchedFilterTables<T> carrier_tables(const Waveform& waveform, int tier, double range_error) {
    MatchedFilterTables<T> tables;
    tables.tier = tier;
    tables.half_turns_per_m = WavePhases(waveform).half_turns_per_m;
    tables.range_limit = range_error;
    tables.range_economy = economy(carrier_tiers[tier].range_order + 1);
    tables.range_residual = 1.0 - tables.range_economy;
    return tables;
}

template <class T>
AntennaPack<T>::AntennaPack(const AntennaPositions& antennas, int lanes, index_t n_samples,
                            int num_threads, index_t n_signals)
    : AntennaPack(antennas, in_order(static_cast<index_t>(antennas.tx.size() / 3), lanes), lanes,
                  n_samples, num_threads, n_signals) {}

template <class T>
AntennaPack<T>::AntennaPack(const AntennaPositions& antennas, std::vector<index_t> slots, int lanes,
                            index_t n_samples, int num_threads, index_t n_signals)
    : n_antennas_(static_cast<index_t>(antennas.tx.size() / 3)), slots_(std::move(slots)),
      n_samples_(n_samples), n_signals_(n_signals), n_pairs_((n_samples + 1) / 2), lanes_(lanes),
      n_groups_(static_cast<index_t>(slots_.size()) / lanes),
      num_threads_(static_cast<int>(std::clamp<index_t>(n_groups_, 1, num_threads))),
      positions_(n_groups_ * 6 * lanes),
      signal_(AlignedBuffer<T>::uninitialised(n_signals * n_groups_ * n_pairs_ * 4 * lanes)) {
    const index_t group_size = n_pairs_ * 4 * lanes;
#pragma omp parallel for num_threads(num_threads_) schedule(static) if (num_threads_ > 1)
    for (index_t group = 0; group < n_signals_ * n_groups_; ++group) {
        std::fill_n(signal_.data() + group * group_size, group_size, T{});
    }
    for (index_t slot = 0; slot < n_groups_ * lanes; ++slot) {
        const index_t entry = slots_[static_cast<std::size_t>(slot)];
        const index_t antenna = entry < 0 ? silent(entry) : entry;
        double* to = positions_.data() + slot / lanes * 6 * lanes + slot % lanes;
        for (index_t axis = 0; axis < 3; ++axis) {
            const auto at = static_cast<std::size_t>(3 * antenna + axis);
            to[axis * lanes] = antennas.tx[at];
            to[(3 + axis) * lanes] = antennas.rx[at];
        }
    }
}

template <class T>
void AntennaPack<T>::pack_signal(std::span<const std::complex<T>> signal) {
    const index_t n_slots = n_groups_ * lanes_;
    const index_t high = n_samples_ / 2; // sample at +first_pair from mid-band
    const index_t low = (n_samples_ - 1) / 2;
#pragma omp parallel for num_threads(num_threads_) schedule(static)
    for (index_t slot = 0; slot < n_signals_ * n_slots; ++slot) {
        const index_t antenna = slots_[static_cast<std::size_t>(slot % n_slots)];
        if (antenna < 0) {
            continue;
        }
        const std::complex<T>* from =
            signal.data() + (slot / n_slots * n_antennas_ + antenna) * n_samples_;
        T* to = signal_.data() + slot / lanes_ * n_pairs_ * 4 * lanes_ + slot % lanes_;
        for (index_t pair = 0; pair < n_pairs_; ++pair, to += 4 * lanes_) {
            // The middle sample of an odd count is its own partner and counts once.
            const bool alone = high + pair == low - pair;
            const std::complex<T> plus = from[high + pair];
            const std::complex<T> minus = alone ? std::complex<T>{} : from[low - pair];
            const std::complex<T> difference = alone ? std::complex<T>{} : plus - minus;
            to[0] = plus.real() + minus.real();
            to[lanes_] = plus.imag() + minus.imag();
            to[2 * lanes_] = difference.real();
            to[3 * lanes_] = difference.imag();
        }
    }
}

template <class T>
void AntennaPack<T>::unpack_signal(std::span<std::complex<T>> signal) const {
    const index_t n_slots = n_groups_ * lanes_;
    const index_t high = n_samples_ / 2;
    const index_t low = (n_samples_ - 1) / 2;
#pragma omp parallel for num_threads(num_threads_) schedule(static)
    for (index_t slot = 0; slot < n_signals_ * n_slots; ++slot) {
        const index_t antenna = slots_[static_cast<std::size_t>(slot % n_slots)];
        if (antenna < 0) {
            continue;
        }
        std::complex<T>* to = signal.data() + (slot / n_slots * n_antennas_ + antenna) * n_samples_;
        const T* from = signal_.data() + slot / lanes_ * n_pairs_ * 4 * lanes_ + slot % lanes_;
        for (index_t pair = 0; pair < n_pairs_; ++pair, from += 4 * lanes_) {
            const std::complex<T> sum{from[0], from[lanes_]};
            const std::complex<T> difference{from[2 * lanes_], from[3 * lanes_]};
            const bool alone = high + pair == low - pair;
            to[low - pair] = sum - difference;
            to[high + pair] = alone ? sum : sum + difference;
        }
    }
}

template <class T>
PackedAntennas<T> AntennaPack<T>::view() const noexcept {
    return {n_groups_, positions_.data(), signal_.data(), n_signals_};
}

template double attainable_rtol<float>(double) noexcept;
template double attainable_rtol<double>(double) noexcept;
template int block_tier<float>(double) noexcept;
template int block_tier<double>(double) noexcept;
template MatchedFilterTables<float> carrier_tables<float>(const Waveform&, int, double);
template MatchedFilterTables<double> carrier_tables<double>(const Waveform&, int, double);
template class WaveformPlan<float>;
template class WaveformPlan<double>;
template class AntennaPack<float>;
template class AntennaPack<double>;

} // namespace geraf2::detail
