"""`geraf2 render` of runs that have a surface and no fields."""

import json

import numpy as np
import pytest

from geraf2.cli.main import main
from geraf2.io.run_folder import RunFolder
from helpers.small_scene import COARSE_RENDER


def psnr(out):
    return json.loads((out / "views" / "psnr.json").read_text())


def test_reflectivity_is_fitted_once_and_kept(finished_run, capsys):
    angles = ("0", "80")
    options = ["render", str(finished_run), "--angles", *angles, *COARSE_RENDER]
    assert main(options) == 0
    first = capsys.readouterr()
    assert "reflectivity" in first.out
    assert "(seen in training)" in first.out
    assert "echo" in RunFolder.read(finished_run).stages
    error = dark_error = 0.0
    for angle in angles:
        with np.load(finished_run / "views" / f"angle_{float(angle):05.1f}.npz") as view:
            measured = view["measured"].astype(float)
            error += np.sum((view["rendered"] - measured) ** 2)
            dark_error += np.sum(measured**2)
    assert error < 0.7 * dark_error  # walls and a body that are there; a coarse one
    value = psnr(finished_run)["psnr_db"]["0"]
    before = (finished_run / "echo.safetensors").stat().st_mtime_ns
    again = ["render", str(finished_run), "--angles", "0", *COARSE_RENDER]
    assert main(again) == 0
    assert (finished_run / "echo.safetensors").stat().st_mtime_ns == before
    assert psnr(finished_run)["psnr_db"]["0"] == pytest.approx(value, abs=1e-3)
    assert main([*again, "--echo.n-nodes", "2"]) == 0
    assert (finished_run / "echo.safetensors").stat().st_mtime_ns != before
