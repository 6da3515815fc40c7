"""Which instruction set the kernels use."""

from geraf2 import _core  # noqa: TID251 - ops is the room that wraps the native module


def simd_level() -> str:
    """Name the instruction set: "baseline", "avx2" or "avx512".

    It is the best of this CPU, or what the environment variable GERAF2_SIMD names. Raises
    ValueError if the variable names no level, or one that this CPU lacks.
    """
    return _core.simd_level()
