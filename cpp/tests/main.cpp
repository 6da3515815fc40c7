// SPDX-License-Identifier: Apache-2.0
#define DOCTEST_CONFIG_IMPLEMENT
#include <doctest/doctest.h>

#include <cstdio>
#include <stdexcept>

#include "geraf2/simd.hpp"

namespace {

constexpr int skipped = 77; // ctest's SKIP_RETURN_CODE

} // namespace

int main(int argc, char** argv) {
    // A log without the instruction set would hide that the slow paths did not run.
    try {
        std::printf("kernels use %s\n", geraf2::simd_level_name(geraf2::simd_level()));
    } catch (const std::invalid_argument& error) {
        std::printf("skipped: %s\n", error.what());
        return skipped;
    }
    return doctest::Context(argc, argv).run();
}
