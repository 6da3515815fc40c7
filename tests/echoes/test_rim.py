"""Glints of the rim of each plane, where known glints support them."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2.echoes.glints import GlintConfig, find_glints
from geraf2.echoes.rim import RimConfig, find_rim_glints
from geraf2.imaging.subapertures import SubapertureConfig
from geraf2.scene import LosPrior
from helpers.specular import BOX_M, STANDOFF_M, sphere_capture

BOX = LosPrior.from_box((BOX_M, BOX_M, BOX_M))
RADIUS_M = 0.04
NARROW = GlintConfig(subaperture=SubapertureConfig(max_cosine=0.2))


@pytest.fixture(scope="module")
def capture():
    return sphere_capture([[0.0, 0.0, 0.0]], [RADIUS_M])


@pytest.fixture(scope="module")
def glints(capture):
    return find_glints(capture, BOX, NARROW)


@pytest.fixture(scope="module")
def rim(capture, glints):
    return find_rim_glints(capture, BOX, glints, first=NARROW)


def test_the_rim_of_a_sphere_lies_on_it_and_faces_outward(rim):
    assert len(rim) > 12 * 20
    distance = np.linalg.norm(rim.positions, axis=1)
    assert np.abs(distance - RADIUS_M).max() < 1e-3
    outward = rim.positions / distance[:, None]
    angle = np.degrees(np.arccos(np.einsum("ij,ij->i", outward, rim.normals)))
    assert angle.max() < 4.0
    assert np.median(angle) < 1.0


def test_rim_glints_have_steeper_angles_than_whole_subapertures(glints, rim):
    # Middles of whole sub-apertures reach 21 mm up on a plane 0.4 m away, those of 4 cm 41 mm.
    whole, cut = (float(g.normals[:, 2].max()) for g in (glints, rim))
    assert whole == pytest.approx(0.021 / STANDOFF_M, abs=0.006)
    assert cut == pytest.approx(0.041 / STANDOFF_M, abs=0.006)


def test_peaks_without_a_known_glint_nearby_are_dropped(capture, glints):
    elsewhere = replace(glints, positions=glints.positions + np.array([0.0, 0.0, 0.03]))
    assert len(find_rim_glints(capture, BOX, elsewhere, first=NARROW)) == 0


def test_without_sizes_or_glints_there_are_no_rim_glints(capture, glints):
    assert len(find_rim_glints(capture, BOX, glints, RimConfig(sizes_m=()), NARROW)) == 0
    nothing = glints.select(np.zeros(len(glints), dtype=bool))
    assert len(find_rim_glints(capture, BOX, nothing, first=NARROW)) == 0
