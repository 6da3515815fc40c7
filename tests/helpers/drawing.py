"""Pictures that are drawn coarsely: tests ask what is drawn, not how finely."""

import pytest

from geraf2.report import canvas, figures


def small_pictures(patch, dpi=40):
    patch.setattr(canvas, "_DPI", dpi)
    patch.setattr(figures, "_MESH_PIXELS", 40)


@pytest.fixture(scope="package", autouse=True)
def drawn_coarsely():
    """For conftest.py of a folder of tests; a report takes half the time."""
    with pytest.MonkeyPatch.context() as patch:
        small_pictures(patch)
        yield
