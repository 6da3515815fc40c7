"""The report in a real browser: what is drawn, picked, asked for and can be reached."""

import re
from functools import partial
from pathlib import Path
from urllib.parse import urlparse
from urllib.request import url2pathname

import numpy as np
import pytest
import trimesh
from PIL import Image

from geraf2.evaluation import evaluate_mesh, write_metrics
from geraf2.io.mesh import write_mesh
from geraf2.io.run_folder import RunFolder, mesh_digest
from geraf2.pipeline.reconstruction import load_run
from geraf2.report import canvas, figures, write_report
from helpers.browsing import DESKTOP, PHONE, pixels, serious_findings, settle
from helpers.glint_sets import glints_on_sphere
from helpers.solids import triangles

pytestmark = pytest.mark.browser

SIDES_MM = np.array([40.0, 30.0, 50.0])
MIDDLE_MM = np.array([5.0, -3.0, 10.0])


def block(sides_mm, middle_mm):
    """Return a block, finely cut so that it has many vertices."""
    made = trimesh.creation.box(extents=sides_mm / 1e3).subdivide().subdivide()
    error = np.linspace(0.0, 0.008, len(made.vertices))
    return triangles(made, middle_mm / 1e3, expected_error_m=error)


@pytest.fixture(scope="module")
def page_url(tmp_path_factory):
    """Report of a block whose truth is 1 mm larger on each side, in a box, with glints."""
    out = tmp_path_factory.mktemp("run")
    content, truth = block(SIDES_MM, MIDDLE_MM), block(SIDES_MM + 2.0, MIDDLE_MM)
    write_mesh(content, out / "mesh_content.ply")
    write_mesh(block(np.full(3, 120.0), np.zeros(3)), out / "mesh_box.ply")
    glints_on_sphere(0.03, 60, poses=np.arange(60) % 6).save(out / "glints.npz")
    write_metrics(
        evaluate_mesh(content, truth, n_samples=200), out / "metrics.json", extra=mesh_digest(out)
    )
    (out / "config.toml").write_text('preset = "fast"\n[fit]\nspacing_m = 0.003\n')
    folder = RunFolder(out, "digest", "block")
    numbers = {"applied": ["delay: 1.5 mm of path +- 0.2"], "left": ["axis: 0.1 mm +- 5.0"]}
    folder.mark_done("calibration", "key", [], 1.0, numbers=numbers)
    folder.mark_done("glints", "key", ["glints.npz"], 1.0)
    folder.mark_done("mesh", "key", ["mesh_content.ply", "mesh_box.ply"], 1.0)
    folder.warn("antennas are far apart")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(canvas, "_DPI", 40)
        patch.setattr(figures, "_MESH_PIXELS", 40)
        return write_report(out, truth=truth).resolve().as_uri()


@pytest.fixture
def opened(open_page, page_url):
    """Open the report: (size, dark) -> page, see `open_page`."""
    return partial(open_page, page_url)


def readout(page):
    names = page.locator(".readout dt").all_inner_texts()
    return dict(zip(names, page.locator(".readout dd").all_inner_texts(), strict=True))


def number(text):
    return float(re.match(r"-?[\d.]+", text).group())


def view_from(page, name):
    """View along an axis without perspective; returns pixels a millimetre."""
    page.locator(".viewer").evaluate("viewer => viewer.scrollIntoView()")
    page.locator('.viewer [data-part="orthographic"]').click()
    page.locator(f'.viewer [data-view="{name}"]').click()
    settle(page)
    width = page.locator('.viewer [data-part="bar"]').evaluate("bar => parseFloat(bar.style.width)")
    return width / number(page.locator('.viewer [data-part="length"]').inner_text())


@pytest.mark.parametrize(("size", "dark"), [(DESKTOP, False), (PHONE, True)])
def test_3d_is_drawn_without_trouble_requests_or_overflow(opened, page_url, size, dark):
    page = opened(size, dark)
    assert page.locator(".viewer.works").count() == 1
    assert page.trouble == []
    assert [url for url in page.requests if not url.startswith("data:")] == [page_url]
    assert page.evaluate("document.documentElement.scrollWidth") <= size[0]
    with_content = pixels(page)
    page.locator(".viewer").get_by_label("content", exact=True).uncheck()
    settle(page)
    changed = np.abs(pixels(page) - with_content).max(axis=2) > 20
    assert 0.05 < changed.mean() < 0.6


def test_a_pick_shows_position_and_distance_to_the_truth(opened):
    page = opened()
    scale = view_from(page, "+x")
    box = page.locator(".viewer canvas").bounding_box()
    for across_mm, up_mm in ((8.0, 12.0), (-11.0, -20.0)):
        x = box["x"] + box["width"] / 2 + across_mm * scale
        y = box["y"] + box["height"] / 2 - up_mm * scale
        page.mouse.click(x, y)
        shown = readout(page)
        found = [number(shown[name]) for name in "xyz"]
        expected = MIDDLE_MM + np.array([SIDES_MM[0] / 2, across_mm, up_mm])
        np.testing.assert_allclose(found, expected, atol=0.5)
        assert shown["distance to the truth"] == "1.00 mm inside it"
        assert shown["on"] == "content"
        assert 0 <= number(shown["expected error"]) <= 8


def test_two_picks_are_measured_and_a_cut_shows_what_is_behind(opened):
    page = opened()
    scale = view_from(page, "+x")
    box = page.locator(".viewer canvas").bounding_box()
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.locator('.viewer [data-part="measure"]').click()
    page.mouse.click(middle[0], middle[1])
    page.mouse.click(middle[0] + 9 * scale, middle[1] - 12 * scale)
    assert number(readout(page)["distance"]) == pytest.approx(15.0, abs=0.5)
    page.locator('.viewer [data-part="measure"]').click()
    page.get_by_label("cut along x", exact=True).fill("500")  # half of the block is left
    page.mouse.click(middle[0], middle[1])
    # through the open front: the far side from within
    assert number(readout(page)["x"]) == pytest.approx(MIDDLE_MM[0] - SIDES_MM[0] / 2, abs=0.5)


def test_keys_turn_pick_and_forget(opened):
    page = opened()
    before = pixels(page)
    page.locator(".viewer canvas").focus()
    for key in ("ArrowLeft", "ArrowLeft", "+"):
        page.keyboard.press(key)
    settle(page)
    assert (pixels(page) != before).any()
    page.keyboard.press("3")  # from +y
    page.keyboard.press("Enter")
    assert number(readout(page)["y"]) == pytest.approx(MIDDLE_MM[1] + SIDES_MM[1] / 2, abs=0.5)
    page.keyboard.press("Escape")
    assert readout(page) == {}


def test_a_picture_can_be_saved(opened, tmp_path):
    page = opened()
    with page.expect_download() as download:
        page.locator('.viewer [data-part="save"]').click()
    assert download.value.suggested_filename == "block.png"
    download.value.save_as(tmp_path / "block.png")
    picture = np.asarray(Image.open(tmp_path / "block.png").convert("RGB")).astype(int)  # noqa: TID251 - our own
    assert picture.std(axis=(0, 1)).max() > 10
    assert page.trouble == []


def test_without_webgl_the_pictures_stay(opened):
    page = opened(without_webgl=True)
    assert page.locator(".viewer .fallback").is_visible()
    assert not page.locator(".viewer canvas").is_visible()
    assert page.locator("#surface img").is_visible()


def test_a_notebook_frame_shows_the_view(opened, page_url, tmp_path):
    run = load_run(Path(url2pathname(urlparse(page_url).path)).parent)
    (tmp_path / "cell.html").write_text(f"<!doctype html><body>{run._repr_html_()}</body>")
    page = opened(PHONE)
    page.goto((tmp_path / "cell.html").as_uri())
    frame = page.frame_locator("iframe")
    frame.locator(".viewer.works canvas").wait_for(timeout=20_000)
    frame.locator('[data-view="+x"]').click()
    frame.locator(".viewer").evaluate("e => e.viewer.draw()")
    look_through = "v => v.pickAt(0.47 * v.canvas.clientWidth, 0.48 * v.canvas.clientHeight)"
    frame.locator(".viewer").evaluate(f"e => ({look_through})(e.viewer)")
    assert "on\ncontent" in frame.locator(".readout").inner_text()
    assert page.trouble == []


@pytest.mark.parametrize(("size", "dark"), [(DESKTOP, False), (PHONE, True)])
def test_axe_has_no_serious_findings(opened, axe, size, dark):
    page = opened(size, dark)
    assert serious_findings(page, axe) == []
