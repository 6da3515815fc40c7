"""Numbers that break careless kernels, and the instruction sets of this machine."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from hypothesis import strategies as st

from geraf2.ops import simd_level

MAX_COORDINATE_M = 1e6
"""Positions beyond are refused."""

COORDINATES_M = (0.0, -0.0, 5e-324, -2e-308, 1e-160, 1e-20, 1e-9, 0.01, 0.02, -0.36, 1.0, 3e3, -1e6)
REFUSED_M = (np.nan, np.inf, -np.inf, 1.1e6, -1e300)


def levels() -> list[str]:
    """Instruction sets that this machine can run."""
    found = []
    for level in ("baseline", "avx2", "avx512"):
        with forced(level):
            try:
                found.append(simd_level())
            except ValueError:
                continue
    return found


@contextmanager
def forced(level: str) -> Iterator[None]:
    """Run with this instruction set."""
    before = os.environ.get("GERAF2_SIMD")
    os.environ["GERAF2_SIMD"] = level
    try:
        yield
    finally:
        if before is None:
            del os.environ["GERAF2_SIMD"]
        else:
            os.environ["GERAF2_SIMD"] = before


@st.composite
def positions(draw, n_rows, *, near=None, refused=True):
    """(n_rows, 3): hostile coordinates; some rows repeat others, or lie on rows of `near`."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    rows = rng.choice(COORDINATES_M, (n_rows, 3))
    usual = rng.random(n_rows) < draw(st.sampled_from((0.0, 0.5, 1.0)))
    rows[usual] = rng.uniform(-0.4, 0.4, (n_rows, 3))[usual]
    others = rows if near is None or not len(near) else near
    copied = rng.random(n_rows) < draw(st.sampled_from((0.0, 0.3, 1.0)))
    if n_rows:
        rows[copied] = others[rng.integers(len(others), size=n_rows)][copied]
        if refused and draw(st.integers(0, 9)) == 0:
            rows[rng.integers(n_rows), rng.integers(3)] = rng.choice(REFUSED_M)
    return rows


def allowed(*arrays: np.ndarray) -> bool:
    """Whether all positions are finite and near enough."""
    return all((np.abs(a) <= MAX_COORDINATE_M).all() for a in arrays)
