"""The mesh does not depend on the instruction set, on threads, or on approximations of kernels."""

from dataclasses import replace

import numpy as np
import pytest

import geraf2
from geraf2 import examples
from geraf2.ops import simd_level
from geraf2.scene import Capture
from geraf2.surfaces import FitConfig

SAME_M = 1e-5
"""A hundredth of the least expected error of a vertex."""


@pytest.fixture(scope="module", autouse=True)
def box_found_once():
    """Boxes are found anew: their search is compared, too."""


@pytest.fixture(scope="module")
def capture():
    """Three planes are enough to compare."""
    whole = examples.small_capture()[0]
    return replace(whole, poses=whole.poses[::2])


def _content(capture: Capture, num_threads: int = 1):
    coarse = geraf2.FastPreset(fit=FitConfig(spacing_m=0.006))
    prior = geraf2.LosPrior.from_box(examples.BOX_M)
    return geraf2.reconstruct(capture, prior, coarse, num_threads=num_threads).content


@pytest.fixture(scope="module")
def content(capture):
    return _content(capture)


def _apart_m(one, other) -> float:
    """Largest distance of vertices, each to the nearest one of the other mesh."""
    step = np.linalg.norm(one.vertices[:, None] - other.vertices[None], axis=-1)
    return float(max(step.min(axis=0).max(), step.min(axis=1).max()))


@pytest.mark.parametrize("level", ["baseline", "avx2"])
def test_each_instruction_set_gives_the_same_mesh(level, capture, content, monkeypatch):
    monkeypatch.setenv("GERAF2_SIMD", level)
    try:
        simd_level()
    except ValueError as error:
        pytest.skip(str(error))
    assert _apart_m(_content(capture), content) < SAME_M


def test_one_thread_and_several_give_the_same_mesh(capture, content):
    assert np.array_equal(_content(capture, num_threads=3).vertices, content.vertices)


def test_exact_and_spread_sub_apertures_give_the_same_mesh(capture, content, monkeypatch):
    """Antennas of this scan lie on a lattice, where images are exact."""
    from geraf2.ops import subaperture  # noqa: PLC0415

    make, spread = subaperture._native_lattice, []

    def without_lattice(subapertures, *arguments):
        spread.append(subapertures.lattice is not None)
        return make(replace(subapertures, lattice=None), *arguments)

    monkeypatch.setattr(subaperture, "_native_lattice", without_lattice)
    assert _apart_m(_content(capture), content) < SAME_M
    assert any(spread)
