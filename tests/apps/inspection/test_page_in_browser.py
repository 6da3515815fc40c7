"""The page of an inspection in a real browser: drawn, quiet, alone, and it can be reached."""

import numpy as np
import pytest

import geraf2
from geraf2.io.mesh import TriangleMesh, write_mesh
from geraf2.io.run_folder import BOX_NAME, CONTENT_NAME, RunFolder
from helpers.browsing import FEW_SCREENS, hidden_share, pixels, require_sound, settle
from helpers.inspected import SMALL, block, few_starts, measured, wedge
from helpers.solids import joined

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def page_url(tmp_path_factory):
    """Answer that fails: a wedge with a bump and a far side that was filled, a model that lacks."""
    out = tmp_path_factory.mktemp("inspected") / "run"
    out.mkdir()
    body = measured(joined(wedge(), SMALL), sigma_m=3e-4, unseen=(0, 0, -1))
    x, y, _ = wedge().vertices.T
    bump = np.zeros(len(body.mesh.vertices))
    bump[: len(x)] = 0.006 * (np.hypot(x, y) < 0.012)
    middle = body.mesh.vertices[: len(x)].mean(axis=0)
    away = body.mesh.vertices - middle
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    content = TriangleMesh(
        vertices=body.mesh.vertices + bump[:, None] * away,
        faces=body.mesh.faces,
        expected_error_m=body.sigma_m,
    )
    write_mesh(content, out / CONTENT_NAME)
    write_mesh(block((0.16,) * 3, edge_m=0.2), out / BOX_NAME)
    RunFolder(out, "digest", "crate").mark_done("mesh", "key", [CONTENT_NAME, BOX_NAME], 1.0)
    models = [wedge(), SMALL, block((0.01,) * 3)]
    with few_starts():
        answer = geraf2.inspect(out, models, expect=3)
    assert answer.verdict == "fail"
    return (out / "inspection.html").resolve().as_uri()


@pytest.mark.parametrize(("size", "dark"), FEW_SCREENS)
def test_the_answer_is_drawn_without_trouble_requests_or_overflow(
    open_page, page_url, axe, size, dark
):
    page = open_page(page_url, size, dark)
    require_sound(page, page_url, size, axe)
    assert page.get_by_text("Fail: 2 parts").first.is_visible()
    assert hidden_share(page, "CAD models") > 0.01


APART = """() => {
  const { viewer } = document.querySelector(".viewer");
  const [mesh] = viewer.scene.meshes;
  const moved = Math.max(...mesh.positions.map((value, i) => Math.abs(value - mesh.home[i])));
  let off = Infinity;
  for (let x = 5; x < viewer.canvas.clientWidth; x += 30) {
    for (let y = 5; y < viewer.canvas.clientHeight; y += 30) {
      const hit = viewer.find(x, y);
      if (!hit || hit.mesh !== mesh) continue;
      for (let i = 0; i < mesh.home.length; i += 3) {
        off = Math.min(off, Math.hypot(...[0, 1, 2].map((k) => mesh.home[i + k] - hit.home[k])));
      }
    }
  }
  return [moved, off];
}"""


def test_parts_move_apart_and_a_picked_point_keeps_its_true_position(open_page, page_url):
    page = open_page(page_url)
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
