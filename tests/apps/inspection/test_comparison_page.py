"""`geraf2 compare --out`: page and map of what changed, in files and in a real browser."""

import json

import numpy as np
import pytest
import trimesh

from geraf2.cli.main import main
from helpers.browsing import FEW_SCREENS, hidden_share, require_sound
from helpers.inspected import block, run_of

CUBES = [block((0.02,) * 3, (x, 0.0, 0.0), 0.003) for x in (-0.05, 0.0, 0.05)]
APPEARED, VANISHED = 1, 2


def compared(folder, here, before):
    """Files of a comparison of two runs of parts."""
    runs = [
        run_of(folder / name, *parts, pose=np.eye(4), has_glints=True)
        for name, parts in (("here", here), ("before", before))
    ]
    assert main(["compare", *map(str, runs), "--out", str(folder / "out")]) in (0, 1)
    return folder / "out"


@pytest.fixture(scope="module")
def robbed(tmp_path_factory):
    """One of three cubes is gone."""
    return compared(tmp_path_factory.mktemp("robbed"), CUBES[:2], CUBES)


def changes_in(out):
    """Vertices of the map, and the number of the change of each."""
    mesh = trimesh.load(out / "comparison.glb", force="mesh", process=False)
    return mesh.vertices, np.rint(mesh.vertex_attributes["_CHANGE"]).astype(int).reshape(-1)


def test_what_vanished_is_on_the_map_where_it_was(robbed):
    vertices, change = changes_in(robbed)
    assert set(change) == {0, VANISHED}
    assert vertices[change == VANISHED].mean(axis=0) == pytest.approx([0.05, 0.0, 0.0], abs=2e-3)
    assert vertices[change == 0][:, 0].max() < 0.02
    found = json.loads((robbed / "comparison.json").read_text())
    assert [one["what"] for one in found["changes"]] == ["vanished"]


def test_a_new_part_and_no_other_is_marked(tmp_path):
    vertices, change = changes_in(compared(tmp_path, CUBES, CUBES[:2]))
    assert ((change == APPEARED) == (vertices[:, 0] > 0.03)).all()


def test_an_unchanged_box_has_an_empty_map(tmp_path):
    out = compared(tmp_path, CUBES, CUBES)
    assert not changes_in(out)[1].any()
    assert "Unchanged since the reference" in (out / "comparison.html").read_text()


@pytest.mark.browser
@pytest.mark.parametrize(("size", "dark"), FEW_SCREENS)
def test_the_page_is_drawn_without_trouble_requests_or_overflow(open_page, robbed, axe, size, dark):
    url = (robbed / "comparison.html").resolve().as_uri()
    page = open_page(url, size, dark)
    require_sound(page, url, size, axe)
    assert page.get_by_text("A part vanished").first.is_visible()
    assert hidden_share(page, "vanished") > 0.005
