// SPDX-License-Identifier: Apache-2.0
#include "geraf2/version.hpp"

namespace geraf2 {

int embree_major() noexcept { return GERAF2_EMBREE_MAJOR; }

} // namespace geraf2
