// SPDX-License-Identifier: Apache-2.0
// Interface between ray_march.cpp (portable code) and the kernels (one copy per instruction set).
#pragma once

#include "geraf2/types.hpp"

namespace geraf2::detail {

/// All (n_rays, n_samples) but depth, (n_rays). Forward, the outputs; backward, the gradients to
/// them, null where zero.
template <class T>
struct RayOutputs {
    T* alpha = nullptr;
    T* transmittance = nullptr;
    T* weight = nullptr;
    T* depth = nullptr;
};

template <class T>
struct RayInputs {
    const T* sdf = nullptr;
    const T* cos = nullptr;
    const T* step = nullptr;
    T inv_s{};
    index_t n_samples = 0;
    int power = 1;
};

template <class T>
struct RayGradients {
    T* sdf = nullptr;
    T* cos = nullptr;
    double* inv_s = nullptr; ///< (n_rays)
};

/// Each call does one tile: n_rows <= lanes rays from `first` on.
template <class T>
struct RayMarchKernels {
    int lanes;
    void (*fwd)(const RayInputs<T>& in, index_t first, int n_rows, const RayOutputs<T>& out);
    /// alpha and transmittance of `found` as computed by fwd.
    void (*bwd)(const RayInputs<T>& in, const RayOutputs<const T>& found,
                const RayOutputs<const T>& grad, index_t first, int n_rows,
                const RayGradients<T>& out);
};

} // namespace geraf2::detail
