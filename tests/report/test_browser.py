"""The report in a real browser: drawn, readable, accessible and quiet; what a click measures."""

import re

import numpy as np
import pytest
import trimesh

from geraf2.calibration.found_box import FoundBox
from geraf2.evaluation import evaluate_mesh, write_metrics
from geraf2.io.mesh import write_mesh
from geraf2.io.planes import ScannedPlanes, save_planes
from geraf2.io.run_folder import mesh_digest
from geraf2.io.verdict import VERDICT_STAGE, Trust
from geraf2.report import write_report
from geraf2.scene import Grid
from helpers.browsing import (
    DESKTOP,
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
from helpers.run_folders import VERDICTS, record_run
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
    calibration = {"applied": ["delay: 1.5 mm of path +- 0.2"], "left": ["axis: 0.1 mm +- 5.0"]}
    numbers = {"box": found_box(), "calibration": calibration, "glints": {}, "mesh": {}}
    numbers[VERDICT_STAGE] = VERDICTS[Trust.DOUBTFUL].numbers()
    record_run(out, "block", numbers=numbers, warnings=["antennas are far apart"])
    save_planes(ScannedPlanes(corners_m=planes_around(6)), out / "planes.json")
    grid = Grid.cube((0, 0, 0), 0.06, 48)
    heat = np.exp(-np.abs(grid.points()[:, 1] + 0.02) / 0.01).reshape(grid.shape)
    with pytest.MonkeyPatch.context() as patch:
        small_pictures(patch, dpi=80)
        return write_report(out, truth=truth, heatmap=(heat, grid)).resolve().as_uri()


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


@pytest.mark.parametrize(
    ("size", "dark", "without_webgl"),
    [*((*screen, False) for screen in SCREENS), (DESKTOP, True, True), (PHONE, False, True)],
)
def test_the_report_in_a_browser(open_page, page_url, axe, size, dark, without_webgl):
    page = open_page(page_url, size, dark, without_webgl)
    assert [url for url in page.requests if not url.startswith("data:")] == [page_url]
    require_readable(page, size)
    verdict = page.locator(".verdict")
    assert "Doubtful 40 % likely wrong" in " ".join(verdict.inner_text().split())
    below = verdict.bounding_box()["y"] + verdict.bounding_box()["height"]
    assert below < page.locator("section").first.bounding_box()["y"]  # before any number
    assert serious_findings(page, axe) == []
    if without_webgl:
        require_pictures(page)
        return
    assert page.locator(".viewer.works").count() == 1
    require_first_screen(page, size, ".hero .lead")
    with_content = pixels(page)
    page.locator(".viewer").get_by_label("content", exact=True).uncheck()
    settle(page)
    changed = np.abs(pixels(page) - with_content).max(axis=2) > 20
    assert 0.05 < changed.mean() < 0.6
    if size == DESKTOP:
        page.locator(".viewer").get_by_label("content", exact=True).check()
        require_what_a_click_measures(page)
        require_slice_and_faces(page)
    assert page.trouble == []


def require_pictures(page):
    """Assert that the pictures stand where the view would, and nothing is empty beside them."""
    viewer = page.locator(".hero .viewer")
    assert viewer.locator(".fallback").is_visible()
    assert not viewer.locator("canvas").is_visible()
    assert viewer.locator("figure img").first.is_visible()
    assert page.locator("#surface").is_hidden()
    assert page.locator('.side a[href="#surface"]').count() == 0
    frame, inside = (part.bounding_box() for part in (viewer, viewer.locator("figure")))
    assert frame["y"] + frame["height"] - inside["y"] - inside["height"] < 10
    below = page.locator(".hero .beside").bounding_box()
    assert 0 < below["y"] - frame["y"] - frame["height"] < 30


def require_what_a_click_measures(page):
    """Picks of the truth's distance and of peaks, the distance of two picks, a cut, keys."""
    scale = view_from(page, "+x")
    box = page.locator(".viewer canvas").bounding_box()
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    for across_mm, up_mm in ((8.0, 12.0), (-11.0, -20.0)):
        page.mouse.click(middle[0] + across_mm * scale, middle[1] - up_mm * scale)
        shown = readout(page)
        expected = MIDDLE_MM + np.array([SIDES_MM[0] / 2, across_mm, up_mm])
        np.testing.assert_allclose([number(shown[name]) for name in "xyz"], expected, atol=0.5)
        assert shown["distance to the truth"] == "1.00 mm inside it"
        assert shown["on"] == "content"
        assert 0 <= number(shown["expected error"]) <= 8
        assert shown["held by"] == "no peak within 5 mm"
    page.locator('.viewer [data-part="measure"]').click()
    page.mouse.click(*middle)
    page.mouse.click(middle[0] + 9 * scale, middle[1] - 12 * scale)
    assert number(readout(page)["distance"]) == pytest.approx(15.0, abs=0.5)
    page.locator('.viewer [data-part="measure"]').click()
    page.get_by_label("cut along x", exact=True).fill("500")  # half of the block is left
    page.mouse.click(*middle)
    # through the open front: the far side from within
    assert number(readout(page)["x"]) == pytest.approx(MIDDLE_MM[0] - SIDES_MM[0] / 2, abs=0.5)
    page.locator(".viewer canvas").focus()
    page.keyboard.press("Escape")
    assert readout(page) == {}
    page.get_by_label("cut along x", exact=True).fill("1000")


def require_slice_and_faces(page):
    """The brightest plane of the heat map where it is; uncertain faces warm, unseen ones dashed."""
    for label in ("content", "box by radar"):
        page.locator(".viewer").get_by_label(label, exact=True).uncheck()
    page.get_by_label("slice", exact=True).select_option("heat map, across x")
    settle(page)
    scale = page.locator('.viewer [data-part="bar"]').evaluate("e => parseFloat(e.style.width)")
    scale /= number(page.locator('.viewer [data-part="length"]').inner_text())
    drawn = pixels(page)[100:-160]
    orange = drawn[..., 0] - drawn[..., 2] > 150  # on both sides of the brightest plane
    middle = drawn.shape[1] / 2 + (-20.0 - MIDDLE_MM[1]) * scale  # brightest at y = -20 mm
    assert abs(np.nonzero(orange)[1].mean() - middle) < 3 * scale
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
