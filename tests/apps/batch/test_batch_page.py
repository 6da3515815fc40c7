"""The page of a batch in a real browser: rows, filter, order, links, sizes."""

from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote, urlparse
from urllib.request import url2pathname

import pytest

from geraf2.apps.batch.folder import JobPaths, JobResult
from geraf2.apps.batch.page import Pages
from geraf2.io.verdict import Trust
from helpers.browsing import SCREENS, require_readable, serious_findings
from helpers.run_folders import CAUSE, VERDICTS

pytestmark = pytest.mark.browser

LONG = "a_rather_long_name_of_a_scene_that_came_from_a_robot_with_a_date_2026_11_26"


def result(scene, **more):
    values = {"state": "done", "preset": "best", "seconds": 31.4, "cpu_seconds": 50.0}
    values |= {"verdict": str(Trust.RELIABLE), "probability_of_failure": 0.01}
    scores = {"f1_5mm": 0.98, "f1_3mm": 0.9, "f1_2mm": 0.8, "chamfer_1e3_m2": 0.0044}
    scores |= {"volume_ratio": 1.02, "extent_x_mm": 0.1, "extent_y_mm": 1.0, "extent_z_mm": -1.0}
    scores |= {"offset_mm": 0.2}
    numbers = {"typical_error_mm": 0.5, "not_seen_percent": 20.2}
    plain = {"scores": scores, "numbers": numbers, "peak_memory_mib": 900.0}
    return JobResult(key=scene, scene=scene, **(values | plain | more))


@pytest.fixture(scope="module")
def page_url(tmp_path_factory):
    out = tmp_path_factory.mktemp("night")
    names = [f"box {n}" for n in range(1, 12)] + [LONG, "broken"]
    jobs = [JobPaths(out, f"{n:040x}", name) for n, name in enumerate(names)]
    for n, paths in enumerate(jobs):
        done = result(paths.scene, numbers={"typical_error_mm": 0.1 * (n + 1)})
        if paths.scene == "broken":
            error = "the first plane holds numbers that are not finite: " + 20 * "really "
            done = replace(done, state="bad input", error=error, scores={}, numbers={}, verdict="")
        else:
            paths.run.mkdir(parents=True)
            (paths.run / "report.html").write_text("<!doctype html>")
        if paths.scene == LONG:
            worst, cause = VERDICTS[Trust.NOT_TO_BE_TRUSTED], CAUSE
            more = {"verdict": str(worst.trust), "because": cause.text, "do": cause.action}
            done = replace(done, **more, probability_of_failure=worst.probability_of_failure)
        paths.write(done)
    Pages(out, "a night").draw(jobs, {})
    return (out / "batch.html").as_uri()


def shown(page):
    return page.locator("#jobs tbody tr:visible td.name").all_inner_texts()


@pytest.mark.parametrize(("size", "dark"), SCREENS)
def test_nothing_is_cut_off_and_every_link_leads_somewhere(open_page, page_url, axe, size, dark):
    page = open_page(page_url, size, dark)
    assert page.trouble == []
    require_readable(page, size)
    assert serious_findings(page, axe) == []
    cut = """[...document.querySelectorAll("#jobs td, #jobs th")].filter(e =>
      e.getClientRects().length && e.getBoundingClientRect().left > -9000 &&
      (e.getBoundingClientRect().right > innerWidth + 0.5 || e.scrollWidth > e.clientWidth + 1)
    ).map(e => e.textContent)"""
    assert page.evaluate(cut) == []
    links = page.locator("#jobs a[href]").evaluate_all("all => all.map(a => a.href)")
    assert len(links) == 12
    for link in links:
        assert Path(url2pathname(unquote(urlparse(link).path))).exists()


def test_rows_are_filtered_and_ordered(open_page, page_url):
    page = open_page(page_url)
    row = page.locator("#jobs tr", has_text=LONG)
    assert row.locator("td.trust").inner_text() == "not to be trusted"
    assert row.locator("td.error").inner_text() == f"Because {CAUSE.text}: {CAUSE.action}."
    facts = " ".join(page.locator(".facts").inner_text().split())
    assert "reliable 11 doubtful 0 not to be trusted 1" in facts
    assert shown(page)[0] == "broken"  # failed ones first
    assert len(shown(page)) == 13
    page.locator("#state").select_option("bad input")
    assert shown(page) == ["broken"]
    page.locator("#state").select_option("")
    page.get_by_role("searchbox").fill("box 1")
    assert shown(page) == ["box 1", "box 10", "box 11"]
    assert page.locator("#shown").inner_text() == "3 of 13 scenes"
    page.get_by_role("searchbox").fill("")
    head = page.get_by_role("button", name="typical error [mm]")
    head.click()
    head.click()
    assert shown(page)[0] == LONG
    assert shown(page)[-1] == "broken"  # rows without the number stay last
    column = page.locator("#jobs th", has=head)
    assert column.get_attribute("aria-sort") == "descending"
