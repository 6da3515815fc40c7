"""Fixtures for the tests of kernels."""

import pytest

from geraf2.ops import simd_level


@pytest.fixture(params=("baseline", "avx2", "avx512"))
def simd(request, monkeypatch):
    """Each set of instructions; skips where this machine lacks it. None is its own choice."""
    if request.param is not None:
        monkeypatch.setenv("GERAF2_SIMD", request.param)
    try:
        simd_level()
    except ValueError as error:
        pytest.skip(str(error))
    return request.param
