import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from geraf2.io.mesh import read_mesh
from geraf2.scene import save_capture
from geraf2.simulation import load_spec, simulate
from small_scene import SPEC


def _run(script: Path, *arguments: str, folder: Path) -> str:
    # two threads: the examples run beside other tests
    environment = {**os.environ, "OMP_NUM_THREADS": "2"}
    done = subprocess.run(
        [sys.executable, "-W", "error", str(script), *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_matched_filter_example_finds_its_target(project_root, tmp_path):
    out = _run(project_root / "examples" / "matched_filter.py", folder=tmp_path)
    brightest = out.split("brightest voxel [")[1].split("]")[0]
    found = [float(value) for value in brightest.split(",")]
    # A voxel is 2 mm; along the range, which is x, a cell of 42 mm makes the peak flat.
    assert found == pytest.approx([0.01, -0.02, 0.015], abs=0.003)


@pytest.mark.slow
def test_a_scan_becomes_a_mesh_in_ten_lines(project_root, tmp_path):
    # A small figure has a small domain: the example uses the default, fine grid.
    (tmp_path / "spec.toml").write_text(SPEC.replace("height_m = 0.11", "height_m = 0.06"))
    save_capture(simulate(load_spec(tmp_path / "spec.toml"), seed=0)[0], tmp_path / "scene")
    script = project_root / "examples" / "reconstruct.py"
    out = _run(script, "scene", "0.2", "0.2", "0.2", folder=tmp_path)
    assert "content.ply" in out
    assert len(read_mesh(tmp_path / "content.ply").faces) > 500
    # The same lines stand in the README.
    readme = (project_root / "README.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", readme, flags=re.DOTALL)
    (tmp_path / "readme.py").write_text(code.replace("0.22", "0.2"))
    (tmp_path / "content.ply").unlink()
    _run(tmp_path / "readme.py", folder=tmp_path)
    assert len(read_mesh(tmp_path / "content.ply").faces) > 500
