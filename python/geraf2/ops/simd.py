"""What the native module was built with and runs on."""

from geraf2 import _core  # noqa: TID251 - ops is the room that wraps the native module


def simd_level() -> str:
    """Name the instruction set: "baseline", "avx2" or "avx512".

    It is the best of this CPU, or what the environment variable GERAF2_SIMD names. Raises
    ValueError if the variable names no level, or one that this CPU lacks.
    """
    return _core.simd_level()


def max_threads() -> int:
    """Threads that OpenMP would use by itself."""
    return _core.max_threads()


def embree_major() -> int:
    """Major version of the Embree ray tracer that was built in: 3 or 4."""
    return _core.embree_major()
