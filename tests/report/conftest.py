import pytest

from helpers.drawing import small_pictures


@pytest.fixture(autouse=True)
def _small_pictures(monkeypatch):
    small_pictures(monkeypatch)
