// SPDX-License-Identifier: Apache-2.0
#include "matched_filter/factorised/antenna_clusters.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace geraf2::detail {
namespace {

double coordinate(const AntennaPositions& antennas, index_t antenna, std::size_t axis) {
    const auto row = static_cast<std::size_t>(3 * antenna);
    const double x = axis < 3 ? antennas.tx[row + axis] : antennas.rx[row + axis - 3];
    return std::isfinite(x) ? x : 0.0; // NaN cannot be ordered
}

} // namespace

double ClusterExtent::radius() const noexcept {
    return std::max(std::hypot(half[0], half[1], half[2]), std::hypot(half[3], half[4], half[5]));
}

AntennaClusters::AntennaClusters(const AntennaPositions& antennas, index_t n_parents,
                                 index_t n_children)
    : n_parents_(n_parents), n_children_(n_children), order_(antennas.tx.size() / 3) {
    std::iota(order_.begin(), order_.end(), index_t{0});
    std::vector<index_t> parent_ends;
    split(antennas, 0, static_cast<index_t>(order_.size()), n_parents, parent_ends);
    index_t begin = 0;
    for (const index_t end : parent_ends) {
        parents_.push_back(extent(antennas, begin, end));
        index_t child_begin = begin;
        split(antennas, begin, end, n_children, child_ends_);
        for (index_t j = 0; j < n_children; ++j) {
            const index_t child_end =
                child_ends_[child_ends_.size() - static_cast<std::size_t>(n_children - j)];
            children_.push_back(extent(antennas, child_begin, child_end));
            capacity_ = std::max(capacity_, child_end - child_begin);
            child_begin = child_end;
        }
        begin = end;
    }
}

void AntennaClusters::split(const AntennaPositions& antennas, index_t begin, index_t end,
                            index_t n_parts, std::vector<index_t>& ends) {
    if (n_parts == 1) {
        ends.push_back(end);
        return;
    }
    const ClusterExtent box = extent(antennas, begin, end);
    const auto axis = static_cast<std::size_t>(std::max_element(box.half.begin(), box.half.end()) -
                                               box.half.begin());
    const index_t left = n_parts / 2;
    const index_t middle = begin + (end - begin) * left / n_parts;
    std::nth_element(order_.begin() + begin, order_.begin() + middle, order_.begin() + end,
                     [&](index_t a, index_t b) {
                         const double x = coordinate(antennas, a, axis);
                         const double y = coordinate(antennas, b, axis);
                         return x < y || (x == y && a < b);
                     });
    split(antennas, begin, middle, left, ends);
    split(antennas, middle, end, n_parts - left, ends);
}

ClusterExtent AntennaClusters::extent(const AntennaPositions& antennas, index_t begin,
                                      index_t end) const {
    // An empty cluster lies where an antenna is, so that its zero signal meets no odd distance.
    const index_t last = static_cast<index_t>(order_.size()) - 1;
    const index_t first = std::min(begin, last);
    end = std::max(std::min(end, last + 1), first + 1);
    ClusterExtent out;
    for (std::size_t axis = 0; axis < 6; ++axis) {
        double low = coordinate(antennas, order_[static_cast<std::size_t>(first)], axis);
        double high = low;
        for (index_t i = first + 1; i < end; ++i) {
            const double x = coordinate(antennas, order_[static_cast<std::size_t>(i)], axis);
            low = std::min(low, x);
            high = std::max(high, x);
        }
        out.center[axis] = 0.5 * (low + high);
        out.half[axis] = 0.5 * (high - low);
    }
    return out;
}

std::vector<index_t> AntennaClusters::slots(index_t begin, index_t end, int lanes) const {
    std::vector<index_t> out;
    out.reserve(static_cast<std::size_t>((end - begin) * n_children_ * capacity_));
    const index_t last = static_cast<index_t>(order_.size()) - 1;
    for (index_t group = begin; group < end; group += lanes) {
        for (index_t j = 0; j < n_children_; ++j) {
            for (index_t k = 0; k < capacity_; ++k) {
                for (index_t lane = 0; lane < lanes; ++lane) {
                    const auto child = static_cast<std::size_t>((group + lane) * n_children_ + j);
                    const index_t first = child == 0 ? 0 : child_ends_[child - 1];
                    const index_t n = child_ends_[child] - first;
                    const index_t at = n == 0 ? std::min(first, last) : first + std::min(k, n - 1);
                    const index_t antenna = order_[static_cast<std::size_t>(at)];
                    out.push_back(k < n ? antenna : silent(antenna));
                }
            }
        }
    }
    return out;
}

AlignedBuffer<double> AntennaClusters::parent_centers(index_t begin, index_t end, int lanes) const {
    AlignedBuffer<double> out((end - begin) * 6);
    for (index_t i = begin; i < end; ++i) {
        for (std::size_t axis = 0; axis < 6; ++axis) {
            const index_t group = (i - begin) / lanes;
            const index_t lane = (i - begin) % lanes;
            out.data()[(group * 6 + static_cast<index_t>(axis)) * lanes + lane] =
                parent(i).center[axis];
        }
    }
    return out;
}

AlignedBuffer<double> AntennaClusters::child_centers(index_t begin, index_t end, int lanes) const {
    AlignedBuffer<double> out((end - begin) * n_children_ * 6);
    for (index_t i = begin; i < end; ++i) {
        for (index_t j = 0; j < n_children_; ++j) {
            const index_t group = (i - begin) / lanes * n_children_ + j;
            for (std::size_t axis = 0; axis < 6; ++axis) {
                out.data()[(group * 6 + static_cast<index_t>(axis)) * lanes + (i - begin) % lanes] =
                    child(i, j).center[axis];
            }
        }
    }
    return out;
}

} // namespace geraf2::detail
