"""Densities of echoes by the faces of bodies on their lines of sight, against a slow twin."""

import numpy as np
import trimesh

from geraf2.echoes import faces
from helpers.glint_sets import glints_at
from reference.faces import densities

CELL_M, WIDTH = 0.042, 1.5


def two_plates(glints):
    """Plates of 6 mm and 30 mm across the x axis, 20 mm apart."""
    thin = trimesh.creation.box((0.006, 0.2, 0.2))
    thick = trimesh.creation.box((0.03, 0.2, 0.2)).apply_translation([-0.038, 0.0, 0.0])
    both = trimesh.util.concatenate([thin.subdivide(), thick.subdivide()])
    return both.vertices, both.faces


def test_densities_are_those_of_one_number_at_a_time():
    rng = np.random.default_rng(4)
    positions = np.column_stack([rng.uniform(-0.1, 0.03, 40), np.zeros(40), np.zeros(40)])
    glints = glints_at(positions, np.tile([1.0, 0.0, 0.0], (40, 1)))
    scan = faces.Scan(
        glints=glints, surface_through=two_plates, cell_m=CELL_M, volume_m3=0.1, num_threads=1
    )
    shares = np.array([0.4, 0.3, 0.2, 0.1])
    lines = faces._cross(scan, glints, WIDTH)
    assert lines.exists.all()
    found = faces._densities(lines, shares, WIDTH, CELL_M)
    model = {"index": faces.INDEX, "cell_m": CELL_M, "width": WIDTH, "shares": shares[:3]}
    model["area_m2"] = 2.0 * (0.2 * 0.2 * 2.0 + 4.0 * 0.2 * 0.018)
    # Where the line crosses a plate, both point out of it along the line.
    paths, agreements = [(-0.003, 0.003), (0.023, 0.053)], [(1.0, 1.0)] * 2
    for x, own in zip(positions[:, 0], found, strict=True):
        np.testing.assert_allclose(own, densities(-x, paths, agreements, model), rtol=1e-6)
