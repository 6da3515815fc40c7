import pytest

from geraf2.report import canvas, figures


@pytest.fixture(autouse=True)
def _small_pictures(monkeypatch):
    """Draw coarsely: the tests ask what is drawn, not how finely."""
    monkeypatch.setattr(canvas, "_DPI", 40)
    monkeypatch.setattr(figures, "_MESH_PIXELS", 40)
