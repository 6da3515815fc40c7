"""Pictures that are drawn coarsely or not at all, for tests that ask for other things.

A report of five pictures takes 3 s, a coarse one 1.5 s, one with blank pictures 0.3 s. The fixtures
last for a module: folders of tests are no packages, where the scope "package" lasts for all tests.
"""

import pytest
from PIL import Image

from geraf2.io.atomic import atomic_path
from geraf2.report import canvas, figures

_SAVE = canvas.Sheet.save


def small_pictures(patch, dpi=40):
    patch.setattr(canvas, "_DPI", dpi)
    patch.setattr(figures, "_MESH_PIXELS", 40)


def blank(sheet, path):
    with atomic_path(path) as temporary:
        Image.new("RGB", (8, 8)).save(temporary, format="png")


@pytest.fixture(scope="module", autouse=True)
def drawn_coarsely():
    """For the conftest.py of a folder of tests."""
    with pytest.MonkeyPatch.context() as patch:
        small_pictures(patch)
        yield


@pytest.fixture(scope="module", autouse=True)
def not_drawn():
    """For the conftest.py of a folder of tests: pictures are made, their files are blank."""
    with pytest.MonkeyPatch.context() as patch:
        small_pictures(patch)
        patch.setattr(canvas.Sheet, "save", blank)
        yield


@pytest.fixture
def drawn(monkeypatch):
    """For a test whose pictures are drawn nevertheless."""
    monkeypatch.setattr(canvas.Sheet, "save", _SAVE)
