"""Scripts of the gallery: each makes a scene that is right, and the quickest runs to its end."""

import re
import runpy

import pytest
from matplotlib import pyplot as plt
from PIL import Image

import geraf2

QUICKEST = "plot_09_ghosts.py"
MAX_THUMBNAIL_BYTES = 60_000


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


def test_every_script_has_a_drawn_thumbnail(gallery):
    named = []
    for script in sorted(gallery.glob("plot_*.py")):
        text = script.read_text(encoding="utf-8")
        (name,) = re.findall(r'^# sphinx_gallery_thumbnail_path = "(.*)"$', text, re.MULTILINE)
        path = gallery.parent / name
        assert path.stem == script.stem
        assert path.stat().st_size <= MAX_THUMBNAIL_BYTES
        with Image.open(path) as picture:  # noqa: TID251 - our own
            assert picture.size == (400, 280)
            colours = picture.convert("RGB").getcolors(maxcolors=400 * 280)
        assert len(colours) > 100  # shaded meshes or a heat map, not a placeholder
        assert max(n for n, _ in colours) < 0.9 * 400 * 280
        named.append(path)
    assert sorted((gallery.parent / "_static" / "gallery").iterdir()) == named
