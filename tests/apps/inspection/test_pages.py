"""Pages of an inspection and of a comparison, in files and in a real browser."""

import numpy as np
import pytest
import trimesh

from geraf2.cli.main import main
from helpers.browsing import SCREENS, hidden_share, pixels, require_sound, settle

APPEARED, VANISHED = 1, 2
APART = """() => {
  const { viewer } = document.querySelector(".viewer");
  const [mesh] = viewer.scene.meshes;
  const moved = Math.max(...mesh.positions.map((value, i) => Math.abs(value - mesh.home[i])));
  let off = Infinity;
  for (let x = 5; x < viewer.canvas.clientWidth; x += 60) {
    for (let y = 5; y < viewer.canvas.clientHeight; y += 60) {
      const hit = viewer.find(x, y);
      if (!hit || hit.mesh !== mesh) continue;
      for (let i = 0; i < mesh.home.length; i += 3) {
        off = Math.min(off, Math.hypot(...[0, 1, 2].map((k) => mesh.home[i + k] - hit.home[k])));
      }
    }
  }
  return [moved, off];
}"""


@pytest.mark.browser
@pytest.mark.parametrize(("size", "dark"), SCREENS)
def test_an_inspection_is_drawn_and_its_parts_move_apart(open_page, failed, axe, size, dark):
    """A picked point keeps its true position."""
    url = failed.page.resolve().as_uri()
    page = open_page(url, size, dark)
    require_sound(page, url, size, axe)
    assert page.get_by_text("Fail: 2 parts were found, 3 were expected").first.is_visible()
    assert hidden_share(page, "CAD models") > 0.01
    pictures = page.locator(".things img")
    assert pictures.count() == 2
    assert pictures.first.evaluate("one => one.naturalWidth / one.naturalHeight") == 12
    before = pixels(page)
    slider = page.get_by_label("move the parts apart")
    slider.fill("100")
    settle(page)
    assert (np.abs(pixels(page) - before).max(axis=2) > 5).mean() > 0.01
    moved_mm, off_mm = page.evaluate(APART)
    assert moved_mm > 15.0
    assert off_mm < 3.0  # a corner of a triangle of the surface that was measured
    slider.fill("0")
    assert page.evaluate(APART)[0] == 0.0


def compared(folder, here, before):
    """Folder of the files of a comparison of two runs, vertices of its map, and their changes."""
    assert main(["compare", str(here), str(before), "--out", str(folder)]) in (0, 3)
    mesh = trimesh.load(folder / "comparison.glb", force="mesh", process=False)
    return folder, mesh.vertices, np.rint(mesh.vertex_attributes["_CHANGE"]).astype(int).ravel()


@pytest.fixture(scope="module")
def vanished(tmp_path_factory, packed, robbed):
    """One of three cubes is gone."""
    return compared(tmp_path_factory.mktemp("vanished"), robbed, packed)


def test_what_vanished_is_on_the_map_where_it_was(vanished):
    _, vertices, change = vanished
    assert set(change) == {0, VANISHED}
    assert vertices[change == VANISHED].mean(axis=0) == pytest.approx([0.05, 0.0, 0.0], abs=2e-3)
    assert vertices[change == 0][:, 0].max() < 0.02


def test_a_new_part_and_no_other_is_marked(tmp_path, packed, robbed):
    _, vertices, change = compared(tmp_path, packed, robbed)
    assert ((change == APPEARED) == (vertices[:, 0] > 0.03)).all()


@pytest.mark.browser
@pytest.mark.parametrize(("size", "dark"), SCREENS)
def test_a_comparison_is_drawn(open_page, vanished, axe, size, dark):
    url = (vanished[0] / "comparison.html").resolve().as_uri()
    page = open_page(url, size, dark)
    require_sound(page, url, size, axe)
    assert page.get_by_text("A part vanished").first.is_visible()
    assert hidden_share(page, "vanished") > 0.005
