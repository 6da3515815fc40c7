"""Which surface of a photo row is held against which truth; the commands are stood in for."""

import sys

import numpy as np
import pytest

from geraf2.benchmark import Runner, load_suite, rows_of
from geraf2.io.mesh import TriangleMesh, write_mesh
from geraf2.scene import LosPrior

SUITE = """
[base]
figure = { name = "llama", height_m = 0.11 }
walls = [{ size_m = [0.20, 0.20, 0.20] }]
[scenes.llama]
[methods.photos]
title = "photos"
kind = "photos"
arguments = ["--preset", "quick"]
[experiments.photos]
title = "Photos"
scenes = ["llama"]
methods = ["photos"]
cases = [
  { label = "box", scene = { photos = { subject = "box" } } },
  { label = "content", scene = { photos = { subject = "content" } } },
  { label = "none" },
]
"""

# Instead of `geraf2`: a scene whose object is the small cube, a surface that is the small cube.
STAND_IN = """
import pathlib, shutil, sys
cubes = pathlib.Path(sys.argv[1])
command, source, out = sys.argv[2], sys.argv[3], pathlib.Path(sys.argv[4])
out.mkdir(parents=True)
if command == "simulate":
    shutil.copy(cubes / "small.ply", out / "truth.ply")
    shutil.copy(cubes / "large.ply", out / "los.ply")
else:
    assert command == "los" and source.endswith("photos"), sys.argv
    assert sys.argv[5:7] == ["--preset", "quick"], sys.argv
    shutil.copy(cubes / "small.ply", out / "los.ply")
"""


@pytest.fixture
def results(tmp_path):
    for name, side in (("small", 0.1), ("large", 0.2)):
        prior = LosPrior.from_box((side, side, side))
        mesh = TriangleMesh(vertices=prior.vertices, faces=prior.faces)
        write_mesh(mesh, tmp_path / f"{name}.ply", frame="capture")
    (tmp_path / "stand_in.py").write_text(STAND_IN)
    (tmp_path / "suite.toml").write_text(SUITE)
    runner = Runner(
        out=tmp_path / "out",
        command=[sys.executable, str(tmp_path / "stand_in.py"), str(tmp_path)],
        versions=lambda _: {},
    )
    rows = rows_of(load_suite(tmp_path / "suite.toml"))
    return tmp_path / "out", {row.case.label: runner.run(row) for row in rows}


def test_photos_are_scored_by_what_they_show(results):
    out, by_case = results
    assert by_case["content"].f1_5mm == pytest.approx(1.0)
    # Of a cube of 10 cm nothing lies near the sides of one of 20.
    assert by_case["box"].f1_15mm == 0.0
    assert by_case["box"].chamfer_1e3_m2 > 1.0
    assert "no photos" in by_case["none"].error
    has_content = [
        (out / str(by_case[label].folder) / "mesh_content.ply").is_file()
        for label in ("content", "box")
    ]
    assert has_content == [True, False]
    assert np.isfinite(by_case["content"].median_m)
