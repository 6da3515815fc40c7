"""Runs and answers that several tests share: each is made once."""

from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

import geraf2
from geraf2.io.mesh import TriangleMesh, write_mesh
from geraf2.io.run_folder import BOX_NAME, CONTENT_NAME
from geraf2.pipeline.events import Listener
from helpers.inspected import CUBES, SMALL, block, few_starts, measured_body, run_of, wedge
from helpers.run_folders import record_run
from helpers.solids import joined


@pytest.fixture
def quick_search():
    """Few initial poses of models."""
    with few_starts():
        yield


@pytest.fixture(scope="session")
def listed(tmp_path_factory):
    """Folder with `run`, of a wedge and a block, and their CAD models in millimetres."""
    folder = tmp_path_factory.mktemp("listed")
    run_of(folder / "run", wedge(), SMALL)
    turn = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    solid = trimesh.Trimesh(1e3 * wedge().vertices @ turn.T + 7.0, wedge().faces)
    solid.export(folder / "wedge.stl")
    trimesh.Trimesh(1e3 * SMALL.vertices, SMALL.faces).export(folder / "block.stl")
    return folder


class Steps(Listener):
    """Fractions that each step reports."""

    def __init__(self):
        self.fractions = {}

    def step(self, label):
        return nullcontext(self.fractions.setdefault(label, []).append)


@pytest.fixture(scope="session")
def failed(tmp_path_factory):
    """Answer to a wedge with a bump and a far side that was filled, and a block in a box.

    The models are the wedge, another part than the block, and one that is missing.
    """
    out, steps = tmp_path_factory.mktemp("failed") / "run", Steps()
    out.mkdir()
    body = measured_body(joined(wedge(), SMALL), sigma_m=3e-4, unseen=(0, 0, -1))
    x, y, _ = wedge().vertices.T
    bump = np.zeros(len(body.mesh.vertices))
    bump[: len(x)] = 0.006 * (np.hypot(x, y) < 0.012)
    away = body.mesh.vertices - body.mesh.vertices[: len(x)].mean(axis=0)
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    content = TriangleMesh(
        vertices=body.mesh.vertices + bump[:, None] * away,
        faces=body.mesh.faces,
        expected_error_m=body.sigma_m,
    )
    write_mesh(content, out / CONTENT_NAME)
    write_mesh(block((0.16,) * 3, edge_m=0.2), out / BOX_NAME)
    record_run(out, "crate")
    models = [wedge(), block((0.04, 0.04, 0.003)), block((0.1, 0.08, 0.06), edge_m=0.008)]
    with few_starts():
        answer = geraf2.inspect(out, models, expect=3, listener=steps)
    return SimpleNamespace(answer=answer, steps=steps.fractions, page=out / "inspection.html")


@pytest.fixture(scope="session")
def packed(tmp_path_factory):
    """Run of three cubes."""
    out = tmp_path_factory.mktemp("packed") / "run"
    return run_of(out, *CUBES, pose=np.eye(4), has_glints=True)


@pytest.fixture(scope="session")
def robbed(tmp_path_factory):
    """Run of the first two of them."""
    out = tmp_path_factory.mktemp("robbed") / "run"
    return run_of(out, *CUBES[:2], pose=np.eye(4), has_glints=True)
