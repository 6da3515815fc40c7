"""Suites of benchmarks for tests."""

import pytest

from geraf2.apps.benchmark import load_suite

BASE = """[base]
figure = { name = "llama", height_m = 0.11 }
walls = [{ size_m = [0.20, 0.20, 0.20] }]
"""


@pytest.fixture
def suite_of(tmp_path):
    """Suite of a text, with the llama in a box as the base of its scenes."""

    def read(text):
        (tmp_path / "suite.toml").write_text(BASE + text)
        return load_suite(tmp_path / "suite.toml")

    return read
