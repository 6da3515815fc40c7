"""The page of a plan: sliders, the arm's path in time, what is seen, poses for robots."""

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geraf2.apps.planning import scan_time
from geraf2.apps.planning.plan_page import write_plan_page
from geraf2.apps.planning.planning import PlanOptions, make_timed_plan
from helpers.browsing import FEW_SCREENS, require_sound

pytestmark = pytest.mark.browser

OPTIONS = PlanOptions(box=(0.2, 0.2, 0.2), minutes=5.0, channels=8, spacing=0.004)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Page of a few settings, and the plan that it shows first."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scan_time, "_RINGS", (3, 9, 18))
        patch.setattr(scan_time, "_RAISED", (0, 6))
        patch.setattr(scan_time, "_RAISED_DEG", (40.0,))
        path = tmp_path_factory.mktemp("plan") / "plan.html"
        files = write_plan_page(path, OPTIONS, minutes=(0.2, 2.0), channels=(1,))
        return files, make_timed_plan(OPTIONS)


@pytest.mark.parametrize(("size", "dark"), FEW_SCREENS)
def test_it_fits_and_can_be_reached(open_page, written, axe, size, dark):
    url = written[0][0].as_uri()
    require_sound(open_page(url, size, dark), url, size, axe)


def test_sliders_choose_the_plan_and_the_time(open_page, written):
    page, plan = open_page(written[0][0].as_uri()), written[1]
    lead = page.locator(".hero .lead")
    assert lead.inner_text() == f"{plan.design.n_planes} planes: {plan.design}"
    seen = f"{100 * plan.seen_share:.0f} % of all directions"
    assert page.locator('[data-plan="seen"]').inner_text() == seen
    counts = "e => e.viewer.scene.planes.corners.length / 12"
    assert page.locator(".viewer").evaluate(counts) == plan.design.n_planes
    page.get_by_label("Antennas at once").fill("0")
    page.get_by_label("Scan time").fill("1")
    assert page.locator('[data-plan="minutes-text"]').inner_text() == "2 minutes"
    assert page.locator('[data-plan="channels-text"]').inner_text() == "1 channels"
    assert lead.inner_text() == "No plan fits into this time."
    assert page.locator(".viewer").evaluate(counts) == 0
    page.get_by_label("Antennas at once").fill("1")
    assert page.locator(".viewer").evaluate(counts) < plan.design.n_planes
    page.get_by_label("Scan time").fill("2")
    done = "e => [e.viewer.painter.pathDone, e.viewer.painter.path.n, e.viewer.named]"
    n_lines = sum(len(plane.lines) for plane in plan.scan.planes)
    assert page.locator(".viewer").evaluate(done) == [2 * n_lines, 2 * n_lines, None]
    page.get_by_label("The arm").fill("0")
    assert page.locator(".viewer").evaluate(done) == [2, 2 * n_lines, 0]
    page.get_by_label("The arm").fill("500")
    half = 0.5 * plan.scan.planes[-1].lines[-1].end_s
    begun = [n for n, plane in enumerate(plan.scan.planes) if plane.lines[0].start_s <= half]
    assert page.locator(".viewer").evaluate(done)[2] == begun[-1]
    assert page.trouble == []


def test_poses_are_those_of_the_plan(written):
    (_, ur, ros), plan = written
    with ur.open() as handle:
        rows = list(csv.DictReader(handle))
    lines = [(plane, line) for plane in plan.scan.planes for line in plane.lines]
    assert len(rows) == 2 * len(lines)
    for row, (plane, line) in zip(rows[1::2], lines, strict=True):
        at = [float(row[axis]) for axis in "xyz"]
        turn = Rotation.from_rotvec([float(row[f"r{axis}"]) for axis in "xyz"]).as_matrix()
        np.testing.assert_allclose(at, line.end_m, atol=1e-6)
        np.testing.assert_allclose(turn.T, plane.axes, atol=1e-5)
    with ros.open() as handle:
        poses = list(csv.DictReader(handle))
    assert len(poses) == sum(line.n_positions for _, line in lines)
    last = Rotation.from_quat([float(poses[-1][f"orientation.{axis}"]) for axis in "xyzw"])
    np.testing.assert_allclose(last.as_matrix().T, lines[-1][0].axes, atol=1e-5)
    assert float(poses[-1]["stamp"]) == pytest.approx(lines[-1][1].end_s, abs=1e-5)


@pytest.mark.parametrize(
    "given",
    [{}, {"minutes": 5.0}, {"minutes": 5.0, "preset": "awr1843"}, {"minutes": 5.0, "channels": 2}],
)
def test_the_page_shows_the_plan_of_the_terminal(given, tmp_path, monkeypatch):
    monkeypatch.setattr(scan_time, "_RINGS", (3, 9))
    monkeypatch.setattr(scan_time, "_RAISED", (0,))
    options = PlanOptions(box=(0.2, 0.2, 0.2), spacing=0.004, **given)
    path = write_plan_page(tmp_path / "p.html", options, minutes=(5.0, 20.0, 40.0))[0]
    data = json.loads(re.search(r'id="plan-data">(.*?)</script>', path.read_text(), re.DOTALL)[1])
    row, column = data["first"]
    shown = data["minutes"][row]
    plan = make_timed_plan(replace(options, minutes=shown))
    assert shown == given.get("minutes", 20.0)
    assert data["channels"][column] in (0, plan.scan.array.n_channels)
    cell = data["cells"][row][column]
    assert cell["planes"] == f"{plan.design.n_planes} planes: {plan.design}"
    assert cell["seen"] == f"{100 * plan.seen_share:.0f} % of all directions"
