import os
import subprocess
import sys
from pathlib import Path

import pytest


def _run(script: Path, *arguments: str, folder: Path) -> str:
    # two threads: the examples run beside other tests
    environment = {**os.environ, "OMP_NUM_THREADS": "2"}
    done = subprocess.run(
        [sys.executable, "-W", "error", str(script), *arguments],
        cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_matched_filter_example_finds_its_target(project_root, tmp_path):
    out = _run(project_root / "examples" / "matched_filter.py", folder=tmp_path)
    brightest = out.split("brightest voxel [")[1].split("]")[0]
    found = [float(value) for value in brightest.split(",")]
    # A voxel is 2 mm; along the range, which is x, a cell of 42 mm makes the peak flat.
    assert found == pytest.approx([0.01, -0.02, 0.015], abs=0.003)
