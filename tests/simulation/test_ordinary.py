"""Ordinary scenes: one object in one carton in eight ways, inside it, in two halves."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2.errors import UserError
from geraf2.simulation.ordinary import DECIDING_SEED, N_EACH, N_WAYS, draw_ordinary
from geraf2.simulation.scan import scan_planes
from geraf2.simulation.solids import build_solid

SPANNER, HEADPHONES = 4, DECIDING_SEED + 7
WORLD, FAR_WALLS, RAISED = N_EACH, 2 * N_EACH, 4 * N_EACH


def test_ways_differ_in_what_they_name_alone():
    first = draw_ordinary(SPANNER).spec
    assert (first.world.is_off, first.disturbance.far_walls, first.scan.rings) == (True, False, ())
    world = draw_ordinary(SPANNER + WORLD).spec
    assert not world.world.is_off
    assert replace(world, world=first.world) == first
    flash = draw_ordinary(SPANNER + FAR_WALLS).spec
    assert flash.disturbance.far_walls
    assert replace(flash, disturbance=first.disturbance) == first
    raised = draw_ordinary(SPANNER + RAISED).spec
    assert replace(raised, scan=first.scan) == first
    assert raised.scan.n_planes == first.scan.n_planes
    heights = [plane.tx[:, 2].mean() for plane in scan_planes(raised.scan)]
    assert sum(height > 0.1 for height in heights) == 8
    assert (raised.scan.aperture_m, raised.scan.standoff_m) == (
        first.scan.aperture_m,
        first.scan.standoff_m,
    )


@pytest.mark.parametrize("seed", [SPANNER, HEADPHONES])
def test_an_object_lies_in_its_carton_and_the_planes_outside(seed):
    drawn = draw_ordinary(seed)
    (wall,), mesh = drawn.spec.walls, build_solid(drawn.spec.figure)
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx(drawn.record["extents_m"])
    assert 0.08 <= np.ptp(mesh.vertices, axis=0).max() <= 0.13
    free = 0.5 * np.asarray(wall.size_m) - wall.thickness_m - np.abs(mesh.vertices)
    assert free[:, :2].min() > 0.01
    assert free.min() > 0.0
    standing = free[:, 2].min() < 0.001
    assert standing == drawn.record["standing"]
    assert drawn.spec.scan.standoff_m > 0.5 * np.linalg.norm(wall.size_m)
    assert drawn.record["estimated_s"] <= 27.0


def test_halves_share_no_object_and_other_seeds_are_refused():
    names = [[draw_ordinary(s + n).record["object"] for n in (4, 5)] for s in (0, DECIDING_SEED)]
    assert not set(names[0]) & set(names[1])
    for seed in (N_WAYS * N_EACH, DECIDING_SEED - 1, 2 * DECIDING_SEED):
        with pytest.raises(UserError, match=f"expected seeds within 0:64.*got {seed}"):
            draw_ordinary(seed)
