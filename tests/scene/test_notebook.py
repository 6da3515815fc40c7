"""What captures and priors show of themselves."""

import re
from dataclasses import replace

import numpy as np

import geraf2


def _polygons(html):
    found = re.findall(r'<polygon points="([^"]*)"', html)
    return [np.array([pair.split(",") for pair in one.split()], dtype=float) for one in found]


def test_a_capture_shows_its_planes_around_its_box():
    capture, _ = geraf2.examples.small_capture()
    html = capture._repr_html_()
    assert len(html) < 10_000
    assert "<th>planes</th><td>6</td>" in html
    assert "160 x 160 x 160 mm" in html
    *planes, box = _polygons(html)
    assert len(planes) == 6
    assert len(box) == 4
    middles = np.array([plane.mean(axis=0) for plane in planes])
    assert np.allclose(middles.mean(axis=0), box.mean(axis=0), atol=1.0)
    assert all((abs(m - box.mean(axis=0)) > np.ptp(box, axis=0) / 2).any() for m in middles)


def test_names_from_files_are_text():
    capture, _ = geraf2.examples.small_capture()
    html = replace(capture, provenance={"source": "<script>"})._repr_html_()
    assert "&lt;script&gt;" in html
    assert "<script>" not in html
