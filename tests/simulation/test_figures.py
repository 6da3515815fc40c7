import numpy as np
import pytest
import trimesh

from geraf2.errors import UserError
from geraf2.io.mesh import TriangleMesh, write_mesh
from geraf2.simulation import FigureSpec, build_solid, figures
from geraf2.simulation.figures import FIGURES

# Holes through each object of thin parts.
GENUS = {"slatted_chair": 2, "spectacles": 2, "key": 1, "mug": 1, "scissors": 2}
GENUS |= {"stool": 3, "spanner": 1, "padlock": 1, "watering_can": 1, "goblet": 0, "headphones": 0}


def signed_volume(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return np.einsum("fi,fi->", a, np.cross(b, c)) / 6


@pytest.mark.parametrize("name", sorted(FIGURES))
def test_figure_is_closed_outward_as_high_as_asked_and_has_its_holes(name, monkeypatch):
    if name not in GENUS:  # what has no thin parts is as good from coarser cells
        monkeypatch.setattr(figures, "_N_VERTICAL", 40)
    mesh = build_solid(FigureSpec(name=name, height_m=0.12, center_m=(0.01, 0.02, 0.03)))
    edges = np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    assert set(counts) == {2}
    assert signed_volume(mesh) > 5e-6
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    assert high[2] - low[2] == pytest.approx(0.12)
    assert 0.5 * (low + high) == pytest.approx([0.01, 0.02, 0.03])
    if name in GENUS:
        whole = trimesh.Trimesh(mesh.vertices, mesh.faces)
        assert (whole.body_count, whole.euler_number) == (1, 2 - 2 * GENUS[name])


def tetrahedron():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    return TriangleMesh(vertices=vertices, faces=faces)


@pytest.mark.parametrize("up", [sign + axis for sign in "+-" for axis in "xyz"])
def test_up_axis_turns_without_mirroring(tmp_path, up):
    extents = {"x": [3, 2, 1], "y": [1, 3, 2], "z": [1, 2, 3]}[up[1]]
    file = tmp_path / "t.ply"
    write_mesh(tetrahedron(), file)
    mesh = build_solid(FigureSpec(mesh=str(file), up=up, height_m=0.1))
    got = mesh.vertices.max(axis=0) - mesh.vertices.min(axis=0)
    assert got == pytest.approx(np.array(extents) * 0.1 / extents[2])
    assert signed_volume(mesh) > 0
    # The right angle at the file's origin lies at the foot if its axis points up.
    corner = mesh.vertices[np.argmin(np.linalg.norm(mesh.vertices - mesh.vertices[0], axis=1))]
    assert corner[2] == pytest.approx(-0.05 if up[0] == "+" else 0.05, abs=1e-6)


def test_an_inward_wound_file_is_turned_outward(tmp_path):
    file = tmp_path / "t.ply"
    tetra = tetrahedron()
    write_mesh(TriangleMesh(vertices=tetra.vertices, faces=tetra.faces[:, ::-1]), file)
    assert signed_volume(build_solid(FigureSpec(mesh=str(file)))) > 0


def test_smoothing_keeps_the_mesh_closed_and_finer(tmp_path):
    file = tmp_path / "t.ply"
    write_mesh(tetrahedron(), file)
    mesh = build_solid(FigureSpec(mesh=str(file), smooth_subdivisions=2))
    assert mesh.faces.shape[0] == 4 * 16
    assert signed_volume(mesh) > 0


def test_open_meshes_are_refused(tmp_path):
    file = tmp_path / "open.ply"
    tetra = tetrahedron()
    write_mesh(TriangleMesh(vertices=tetra.vertices, faces=tetra.faces[:3]), file)
    with pytest.raises(UserError, match=r"open\.ply: the mesh is not watertight.*3 open edges"):
        build_solid(FigureSpec(mesh=str(file)))
