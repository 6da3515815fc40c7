"""Scripts of the gallery: each makes a scene that is right, and the quickest runs to its end."""

import runpy

import pytest
from matplotlib import pyplot as plt

import geraf2

QUICKEST = "plot_09_ghosts.py"


class _SimulatedError(Exception):
    """Stops a script where its scene is made."""


@pytest.fixture
def gallery(project_root, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.syspath_prepend(project_root / "docs" / "gallery")
    yield project_root / "docs" / "gallery"
    plt.close("all")


def test_every_script_makes_a_scene(gallery, monkeypatch):
    scenes = []

    def simulate(spec: geraf2.SceneSpec, *, seed: int) -> None:
        scenes.append((spec, seed))
        raise _SimulatedError

    monkeypatch.setattr(geraf2, "simulate", simulate)
    scripts = sorted(gallery.glob("plot_*.py"))
    for script in scripts:
        with pytest.raises(_SimulatedError):
            runpy.run_path(str(script))
    assert len(scenes) == len(scripts) > 0
    assert all(spec.walls and spec.scan.spacing_m <= 0.009 for spec, _ in scenes)


def test_the_quickest_script_draws_its_picture(gallery):
    made = runpy.run_path(str(gallery / QUICKEST))
    assert [len(panel.images) for panel in made["panels"]] == [1, 1]
    assert plt.get_fignums()
