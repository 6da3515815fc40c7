// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <doctest/doctest.h>

#include <atomic>
#include <new>

/// Of operator new, which test_failing_allocations.cpp replaces.
struct Faults {
    static constexpr long never = -1;
    std::atomic<long> after{never}; ///< allocations that succeed before the one that fails
    std::atomic<bool> met{false};
};
inline Faults faults;

/// Runs call() with each allocation failing once, and compares what it returns; returns how many.
template <class Call>
long fail_each_allocation(const Call& call) {
    const auto expected = call();
    for (long n = 0; n < 100'000; ++n) {
        faults.met = false;
        faults.after = n;
        bool is_right = true;
        try {
            is_right = call() == expected; // the library does without a buffer for sorting
            faults.after = Faults::never;
        } catch (const std::bad_alloc&) {
            faults.after = Faults::never;
            is_right = call() == expected;
        }
        REQUIRE(is_right);
        if (!faults.met) {
            return n;
        }
    }
    FAIL("faults without end");
    return 0;
}
