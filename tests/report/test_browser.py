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

from geraf2.calibration.found_box import FoundBox
from geraf2.evaluation import evaluate_mesh, write_metrics
from geraf2.io.mesh import write_mesh
from geraf2.io.planes import ScannedPlanes, save_planes
from geraf2.io.run_folder import RunFolder, mesh_digest
from geraf2.pipeline.reconstruction import load_run
from geraf2.report import write_report
from geraf2.scene import Grid
from helpers.browsing import (
    PHONE,
    SCREENS,
    pixels,
    require_first_screen,
    require_readable,
    serious_findings,
    settle,
)
from helpers.drawing import small_pictures
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


def found_box():
    """Numbers of a box of 120 mm whose bottom was not seen."""
    box = FoundBox(
        axes=np.eye(3),
        turn_sigma_rad=np.zeros(3),
        offsets_m=np.full((3, 2), 0.06),
        sigmas_m=np.array([[2e-4, 2e-4], [4e-3, 2e-4], [np.inf, 3e-4]]),
        bounds_m=np.full((3, 2, 2), 0.06),
        seen=np.array([[2, 2], [2, 2], [0, 1]]),
    )
    return {"by_radar": str(box), **box.numbers()}


def planes_around(n):
    corners = np.array([[0.3, y, z] for y, z in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    turns = trimesh.transformations.rotation_matrix
    angles = 2 * np.pi * np.arange(n) / n
    return np.stack([corners * [1, 0.1, 0.1] @ turns(a, [0, 0, 1])[:3, :3].T for a in angles])


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
    folder.mark_done("box", "key", [], 1.0, numbers=found_box())
    save_planes(ScannedPlanes(corners_m=planes_around(6)), out / "planes.json")
    grid = Grid.cube((0, 0, 0), 0.06, 48)
    heat = np.exp(-np.abs(grid.points()[:, 1] + 0.02) / 0.01).reshape(grid.shape)
    with pytest.MonkeyPatch.context() as patch:
        small_pictures(patch, dpi=80)
        return write_report(out, truth=truth, heatmap=(heat, grid)).resolve().as_uri()


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


@pytest.mark.parametrize(("size", "dark"), SCREENS)
def test_3d_is_drawn_without_trouble_requests_or_overflow(opened, page_url, size, dark):
    page = opened(size, dark)
    assert page.locator(".viewer.works").count() == 1
    assert page.trouble == []
    assert [url for url in page.requests if not url.startswith("data:")] == [page_url]
    require_first_screen(page, size, ".hero .lead")
    require_readable(page, size)
    with_content = pixels(page)
    page.locator(".viewer").get_by_label("content", exact=True).uncheck()
    settle(page)
    changed = np.abs(pixels(page) - with_content).max(axis=2) > 20
    assert 0.05 < changed.mean() < 0.6


@pytest.mark.parametrize("dark", [False, True])
def test_a_wide_table_has_a_shadow_where_it_continues(opened, dark):
    page = opened(PHONE, dark)
    page.evaluate("document.querySelectorAll('details').forEach(e => { e.open = true })")
    part = ".scroll:has(table.files)"
    table = page.locator(part)
    end = table.evaluate("e => e.scrollWidth - e.clientWidth")
    assert end > 40

    def shadows():
        """Whether the left and the right edge of the table differ from the paper."""
        row = pixels(page, part)[4]  # above the letters
        return [bool(np.abs(row[at] - row[len(row) // 2]).max() > 30) for at in (1, -2)]

    assert shadows() == [False, True]
    table.evaluate("e => e.scrollTo(e.scrollWidth, 0)")
    assert shadows() == [True, False]


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


def test_a_pick_names_the_peaks_and_planes_that_hold_it(opened):
    page = opened()
    page.locator(".viewer").evaluate(
        """e => {
          const { glints } = e.viewer.scene;
          const [point, normal] = [glints.positions, glints.normals].map(
            (of) => [...of.slice(0, 3)]);
          const last = { point, home: point, normal, mesh: e.viewer.content, values: [] };
          e.viewer.picks = [last];
          e.viewer.showPicks();
        }"""
    )
    shown = readout(page)
    plane = page.locator(".viewer").evaluate("e => e.viewer.scene.glints.poses[0] + 1")
    assert shown["held by"] == "1 peak"
    assert shown["of plane"] == str(plane)
    settle(page)
    assert page.locator(".viewer .marks g circle").count() == 1
    view_from(page, "+x")
    box = page.locator(".viewer canvas").bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    assert readout(page)["held by"] == "no peak within 5 mm"


def test_a_wiper_shows_the_truth_beside_the_content(opened):
    page = opened()
    view_from(page, "+x")
    page.get_by_role("button", name="compare with truth").click()
    wiper = page.get_by_label("wiper: content on the left, truth on the right")
    settle(page)
    middle = pixels(page)
    is_truth = (middle[..., 1] - middle[..., 0]) > 40  # green
    half = middle.shape[1] // 2
    assert not is_truth[:, : half - 2].any()
    assert is_truth[:, half + 2 :].mean() > 0.02
    wiper.fill("1000")
    settle(page)
    assert ((pixels(page)[..., 1] - pixels(page)[..., 0]) > 40).mean() < 0.004  # an axis is green


def test_a_slice_of_the_heat_map_is_drawn_where_it_is(opened):
    page = opened()
    view_from(page, "+x")
    for label in ("content", "box by radar"):
        page.locator(".viewer").get_by_label(label, exact=True).uncheck()
    page.get_by_label("slice", exact=True).select_option("heat map, across x")
    settle(page)
    assert page.locator(".viewer .slice output").inner_text() == "0.0 mm"
    scale = page.locator('.viewer [data-part="bar"]').evaluate("e => parseFloat(e.style.width)")
    scale /= number(page.locator('.viewer [data-part="length"]').inner_text())
    drawn = pixels(page)[100:-160]
    orange = drawn[..., 0] - drawn[..., 2] > 150  # on both sides of the brightest plane
    column = np.nonzero(orange)[1].mean()
    middle = drawn.shape[1] / 2 + (-20.0 - MIDDLE_MM[1]) * scale  # brightest at y = -20 mm
    assert abs(column - middle) < 3 * scale
    assert "heat map [dB]" in page.locator(".viewer .legend").inner_text()


def test_faces_of_the_box_are_drawn_and_unseen_ones_dashed(opened):
    page = opened()
    shown = page.locator('.viewer [data-part="reduced"]').inner_text()
    assert "-y ± 4.0 mm" in shown
    assert "Dashed, not seen: -z." in shown
    faces = page.locator(".viewer").evaluate(
        "e => e.viewer.painter.faces.map(f => [f.fill !== null, f.lines.n, f.colour])"
    )
    filled, lengths, colours = zip(*faces, strict=True)
    assert filled == (True, True, True, True, False, True)
    assert lengths[4] > 10 * lengths[0]
    assert colours[2][0] - colours[2][2] > 0.3  # 4 mm: warm
    assert colours[0][2] > colours[0][0]  # 0.2 mm: a quiet blue
    page.locator('.viewer [data-view="-z"]').click()
    settle(page)
    before = pixels(page)
    page.locator(".viewer").get_by_label("box by radar", exact=True).uncheck()
    settle(page)
    assert (np.abs(pixels(page) - before).max(axis=2) > 5).mean() > 0.001


def test_a_turn_is_saved_as_a_film(opened, tmp_path):
    page = opened()
    with page.expect_download(timeout=30_000) as download:
        page.get_by_role("button", name="save a turn").click()
    assert download.value.suggested_filename == "block.webm"
    download.value.save_as(tmp_path / "turn.webm")
    film = (tmp_path / "turn.webm").read_bytes()
    assert film[:4] == bytes.fromhex("1a45dfa3")  # Matroska
    assert len(film) > 10_000
    assert page.trouble == []


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
    assert page.locator("#surface img").first.is_visible()


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


@pytest.mark.parametrize(("size", "dark"), SCREENS)
def test_axe_has_no_serious_findings(opened, axe, size, dark):
    page = opened(size, dark)
    assert serious_findings(page, axe) == []
