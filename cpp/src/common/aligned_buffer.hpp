// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <new>
#include <utility>

#include "geraf2/types.hpp"

namespace geraf2::detail {

/// Zeroed memory on cache-line boundaries: a vector load never straddles two lines. A page is left
/// free behind it, so that no page holds two buffers: the prefetcher would take lines within a page
/// away from the thread that writes to the next buffer, as with false sharing.
template <class T>
class AlignedBuffer {
public:
    explicit AlignedBuffer(index_t size) : AlignedBuffer(size, Raw{}) {
        std::fill_n(data_, size_, T{});
    }
    /// Not zeroed: the thread that will work on the memory does it.
    static AlignedBuffer uninitialised(index_t size) { return AlignedBuffer(size, Raw{}); }
    AlignedBuffer(AlignedBuffer&& other) noexcept : data_(other.data_), size_(other.size_) {
        other.data_ = nullptr;
        other.size_ = 0;
    }
    AlignedBuffer(const AlignedBuffer&) = delete;
    AlignedBuffer& operator=(const AlignedBuffer&) = delete;
    AlignedBuffer& operator=(AlignedBuffer&& other) noexcept {
        std::swap(data_, other.data_);
        std::swap(size_, other.size_);
        return *this;
    }
    ~AlignedBuffer() { ::operator delete(data_, alignment); }

    [[nodiscard]] T* data() noexcept { return data_; }
    [[nodiscard]] const T* data() const noexcept { return data_; }
    [[nodiscard]] index_t size() const noexcept { return size_; }

private:
    struct Raw {};
    AlignedBuffer(index_t size, Raw /*tag*/)
        : data_(static_cast<T*>(
              ::operator new(static_cast<std::size_t>(size) * sizeof(T) + page, alignment))),
          size_(size) {}

    static constexpr std::align_val_t alignment{64};
    static constexpr std::size_t page = 4096;
    T* data_;
    index_t size_;
};

} // namespace geraf2::detail
