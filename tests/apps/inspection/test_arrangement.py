"""Models whose parts have grown together: who explains what, cuts, and what is missing."""

import numpy as np
import pytest
from skimage.measure import marching_cubes

from geraf2.apps.inspection.arrangement import arrange_models, cut_apart
from geraf2.apps.inspection.bodies import Content, split_bodies
from geraf2.apps.inspection.matching import match_models
from geraf2.apps.inspection.models import model_of
from geraf2.geometry.transforms import apply_rigid
from geraf2.geometry.triangles import count_open_edges, enclosed_volume_m3
from geraf2.io.mesh import TriangleMesh
from helpers.inspected import POSE, block, few_starts, measured_body

BLOCKS = {"long": ((0.06, 0.02, 0.03), -0.018), "cube": ((0.03, 0.03, 0.03), 0.020)}
"""Sides and where the middle lies along y [m]; a bridge of 10 mm joins them."""


def grown_together():
    """Surface of both blocks and of what the fit put between them, connected."""
    step = 0.002
    at = [np.arange(-half, half, step) for half in (0.04, 0.045, 0.025)]
    positions = np.stack(np.meshgrid(*at, indexing="ij"), -1)
    boxes = [(sides, (0.0, y, 0.0)) for sides, y in BLOCKS.values()]
    boxes.append(((0.012, 0.03, 0.012), (0.0, 0.0, 0.0)))
    field = np.min(
        [(np.abs(positions - c) - np.divide(s, 2)).max(axis=-1) for s, c in boxes], axis=0
    )
    vertices, faces, _, _ = marching_cubes(field, 1e-6, gradient_direction="descent")
    low = np.array([a[0] for a in at])
    return TriangleMesh(vertices=vertices * step + low, faces=faces.astype(np.int64))


@pytest.fixture(scope="module")
def whole():
    return measured_body(grown_together())


@pytest.fixture(scope="module")
def models():
    """Both blocks, and a cube that is not there: it would lie on faces of the larger one."""
    return [*(block(sides) for sides, _ in BLOCKS.values()), block((0.026,) * 3)]


@pytest.fixture(scope="module")
def placed(whole, models):
    with few_starts():
        return arrange_models(models, whole, None)


def test_each_model_lies_where_it_is_and_what_explains_nothing_more_is_missing(placed):
    for placement, (_, y) in zip(placed, BLOCKS.values(), strict=False):
        true = apply_rigid(POSE, np.array([0.0, y, 0.0]))
        assert placement.middle_m == pytest.approx(true, abs=1e-3)
    assert placed[2] is None


def test_the_cut_runs_between_models_and_each_finds_its_part(whole, models, placed):
    (piece,) = split_bodies(whole)
    bodies, home = cut_apart([piece], models, placed)
    assert home == {0: 0, 1: 1}
    assert all(count_open_edges(body.mesh.faces) == 0 for body in bodies)
    volumes = [enclosed_volume_m3(body.mesh.vertices, body.mesh.faces) for body in bodies]
    exact = [np.prod(sides) for sides, _ in BLOCKS.values()]
    assert volumes == pytest.approx(exact, rel=0.06)  # with half of the bridge
    given = {m: (b, placed[m].pose) for m, b in home.items()}
    cad = [model_of(mesh, str(m)) for m, mesh in enumerate(models)]
    found = match_models(cad, Content(bodies, whole), given=given)
    assert [match.status for match in found] == ["present", "present", "missing"]
    assert [match.body for match in found] == [0, 1, None]
    assert cut_apart([piece], models[:1], placed[:1]) == ([piece], {0: 0})
