"""Cartons with walls as meshes: the outer skin is the prior."""

import numpy as np
import pytest

from geraf2.apps.photos import los
from geraf2.apps.photos.los import make_los
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.geometry.boxes import FACES, box_corners
from geraf2.geometry.shells import outer_shells
from geraf2.io.mesh import TriangleMesh, write_mesh
from geraf2.scene.los import LosPrior

SIDE, WALL = 0.22, 0.004


@pytest.fixture
def coarse_field(monkeypatch):
    """Fields of 1/8 of the voxels, which take a second in place of five."""
    monkeypatch.setattr(los, "_N_LONGEST", 64)


def box(side, center=(0.0, 0.0, 0.0), *, inward=False):
    faces = FACES[:, ::-1] if inward else FACES
    return TriangleMesh(vertices=box_corners(center, (side,) * 3), faces=faces.copy())


def open_top():
    """Outer and inner skin, joined by a rim at the top."""
    outer, inner = box(SIDE), box(SIDE - 2 * WALL, (0, 0, 0.001), inward=True)
    both = TriangleMesh.joined([outer, inner])
    up = np.isclose(both.vertices[:, 2], both.vertices[8:, 2].max()) | np.isclose(
        both.vertices[:, 2], SIDE / 2
    )
    faces = both.faces[~up[both.faces].all(axis=1)]
    corner = {tuple(np.sign(both.vertices[k, :2])): [] for k in np.flatnonzero(up)}
    for k in np.flatnonzero(up):
        corner[tuple(np.sign(both.vertices[k, :2]))].append(int(k))
    ring = [corner[at] for at in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    rim = []
    for (a, b), (c, d) in zip(ring, [*ring[1:], ring[0]], strict=True):
        rim += [(a, c, d), (a, d, b)]
    return TriangleMesh(vertices=both.vertices, faces=np.concatenate([faces, np.array(rim)]))


@pytest.mark.usefixtures("coarse_field")
def test_the_inner_skin_is_left_out(tmp_path):
    mesh = TriangleMesh.joined([box(SIDE), box(SIDE - 2 * WALL, inward=True)])
    prior = LosPrior.from_mesh(mesh)
    assert len(prior.faces) == 12
    assert prior.size_m == pytest.approx((SIDE,) * 3)
    write_mesh(mesh, tmp_path / "a.ply")
    made = make_los(tmp_path / "a.ply", tmp_path / "out")
    assert len(made.prior.faces) == 12
    values = SdfGrid.load(tmp_path / "out" / "los.npz").values
    middle = tuple(n // 2 for n in values.shape)
    assert values[middle] == pytest.approx(-SIDE / 2, abs=0.004)


def test_the_skins_may_be_nested_deeper_and_stand_beside_others():
    mesh = TriangleMesh.joined(
        [box(0.1), box(0.3), box(0.05, (0.5, 0, 0)), box(0.2, inward=True), box(0.02, (0.5, 0, 0))]
    )
    outer = outer_shells(mesh.vertices, mesh.faces).reshape(-1, 12)
    assert outer.all(axis=1).tolist() == [False, True, True, False, False]
    assert (outer.any(axis=1) == outer.all(axis=1)).all()


@pytest.mark.usefixtures("coarse_field")
def test_walls_with_an_opening_are_refused(tmp_path):
    write_mesh(open_top(), tmp_path / "a.ply")
    with pytest.raises(UserError, match=r"the mesh is hollow: it encloses its walls, 1?\d % of"):
        make_los(tmp_path / "a.ply", tmp_path / "out")
    assert not (tmp_path / "out" / "los.json").exists()


def test_a_scan_of_both_skins_with_a_hole_is_filled(tmp_path):
    outer = box(SIDE)
    mesh = TriangleMesh.joined([outer, box(SIDE - 8 * WALL, inward=True)]).with_faces(
        np.concatenate([outer.faces[1:], box(SIDE).faces[:, ::-1] + 8])
    )
    write_mesh(mesh, tmp_path / "a.ply")
    make_los(tmp_path / "a.ply", tmp_path / "out")
    values = SdfGrid.load(tmp_path / "out" / "los.npz").values
    assert values[tuple(n // 2 for n in values.shape)] < 0
