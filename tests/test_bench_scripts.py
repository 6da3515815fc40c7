"""Scripts in bench/ hold together: what one takes from another is there."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

BENCH = Path(__file__).parents[1] / "bench"
SCRIPTS = sorted(p.relative_to(BENCH) for p in BENCH.rglob("*.py"))


@pytest.mark.parametrize("script", SCRIPTS, ids=str)
def test_a_script_finds_what_it_imports(script, monkeypatch):
    monkeypatch.syspath_prepend(str((BENCH / script).parent))
    for name in {path.stem for path in SCRIPTS}:
        monkeypatch.delitem(sys.modules, name, raising=False)
    importlib.import_module(script.stem)


def bent(direction, normal, ratio):
    """Direction behind a surface in the plane, by Snell's law; normal against the wave."""
    cosine = -direction @ normal
    return ratio * direction + (ratio * cosine - np.sqrt(1 - ratio**2 * (1 - cosine**2))) * normal


def through(start, direction, axes, index):
    """Point and direction in which a ray in an ellipse leaves it."""
    along, from_middle = direction / axes, start / axes
    step = -2.0 * (from_middle @ along) / (along @ along)
    end = start + step * direction
    inward = -end / axes**2
    return end, bent(direction, inward / np.linalg.norm(inward), index)


@pytest.mark.parametrize("axes_m", [(0.02, 0.02), (0.02, 0.03), (0.03, 0.02)])
def test_the_gain_of_a_back_face_is_that_of_rays_through_a_body(axes_m, monkeypatch):
    monkeypatch.syspath_prepend(str(BENCH / "python"))
    training = importlib.import_module("train_faces")
    axes, index, off = np.array(axes_m), 1.6, 1e-6

    def outward(point):
        return point / axes**2 / np.linalg.norm(point / axes**2)

    # A plane wave along the x axis: into the body, back from its far face, out again.
    start = np.array([-axes[0] * np.sqrt(1.0 - (off / axes[1]) ** 2), off])
    ray = bent(np.array([1.0, 0.0]), outward(start), 1.0 / index)
    back, _ = through(start, ray, axes, index)
    normal = outward(back)
    ray = ray - 2.0 * (ray @ normal) * normal
    spread = abs(through(back, ray, axes, index)[1][1]) / off
    # Rays that leave the far face at a right angle.
    start = np.array([axes[0] * np.sqrt(1.0 - (off / axes[1]) ** 2), off])
    counted = abs(through(start, -outward(start), axes, index)[1][1]) / off
    shape = np.diag([0.0, 1.0, 1.0]) * axes[0] / axes[1] ** 2
    gain = training.focusing(
        np.array([[1.0, 0.0, 0.0]]), shape[None], shape[None], np.array([2.0 * axes[0]]), index
    )
    np.testing.assert_allclose(gain, (2.0 * counted / spread) ** 2, rtol=1e-3)
