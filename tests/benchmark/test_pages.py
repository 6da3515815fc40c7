"""The page of a benchmark: which pictures it shows."""

import numpy as np
import pytest
from PIL import Image

from geraf2.benchmark import RowResult, load_suite, rows_of, write_pages

SUITE = """
[base]
figure = { name = "llama", height_m = 0.11 }
walls = [{ size_m = [0.20, 0.20, 0.20] }]
[scenes.llama]
[methods.one]
title = "first way"
kind = "render"
[methods.two]
title = "second way"
kind = "render"
[experiments.views]
title = "Planes left out"
scenes = ["llama"]
methods = ["one", "two"]
"""


@pytest.fixture
def page(tmp_path):
    (tmp_path / "suite.toml").write_text(SUITE)
    suite = load_suite(tmp_path / "suite.toml")
    results = []
    for row in rows_of(suite):
        views = tmp_path / "runs" / row.method / "views"
        views.mkdir(parents=True)
        for name in ("angle_000.0_measured.png", "angle_000.0_rendered.png"):
            Image.fromarray(np.zeros((4, 6, 3), dtype=np.uint8)).save(views / name)
        results.append((row, RowResult(folder=f"runs/{row.method}", psnr_db=30.0)))
    return write_pages(tmp_path, suite, results).read_text(encoding="utf-8")


def test_what_was_measured_is_shown_once_and_each_way_beside_it(page):
    for what in ("measured", "first way, rendered", "second way, rendered"):
        assert page.count(f"llama, 000.0 degrees, {what}.</figcaption>") == 1
