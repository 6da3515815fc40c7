"""Instruction sets and libraries of the native module."""

from typing import Final

from geraf2 import _core  # noqa: TID251 - ops is the package that wraps the native module

VECTOR_KERNELS: Final = (
    "matched_filter",
    "signal_tracer",
    "subaperture",
    "physical_optics",
    "grid_energy",
    "ray_march",
    "sdf_grid",
)
"""Compiled once per instruction set; one choice, `simd_level`, serves them all."""


def simd_level() -> str:
    """Name the instruction set: "baseline", "avx2" or "avx512".

    It is the best of this CPU, or what the environment variable GERAF2_SIMD names. Raises
    ValueError if the variable names no level, or one that this CPU lacks.
    """
    return _core.simd_level()


def kernel_paths() -> dict[str, str]:
    """Name the path that each kernel takes here; raises as `simd_level` does."""
    level = simd_level()
    others = {"mesh_scene": "chosen by Embree"}
    others |= dict.fromkeys(("lensless", "pair_density"), "one for all processors")
    return {**dict.fromkeys(VECTOR_KERNELS, level), **others}


def max_threads() -> int:
    """Threads that OpenMP would use by itself."""
    return _core.max_threads()


def embree_major() -> int:
    """Major version of the Embree ray tracer that was built in: 3 or 4."""
    return _core.embree_major()
