// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace geraf2 {

/// Major version of the Embree library that the kernels were compiled against.
int embree_major() noexcept;

} // namespace geraf2
