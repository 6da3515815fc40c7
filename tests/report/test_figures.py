import numpy as np
import pytest

from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.io.mesh import TriangleMesh
from geraf2.report import canvas, mesh_views, projections, sdf_slices
from geraf2.report.outlines import shadow_pictures
from geraf2.scene import Grid, LosPrior
from helpers import solids
from helpers.glint_sets import glints_on_sphere
from helpers.shadows import shadows

GRID = Grid(origin_m=(-0.03, -0.04, -0.05), spacing_m=0.01, shape=(7, 9, 11))


@pytest.fixture
def drawn(monkeypatch):
    """Pictures as they are when they are written."""
    seen = []
    save = canvas.Sheet.save

    def keep(sheet, path):
        seen.append(sheet.figure)
        save(sheet, path)

    monkeypatch.setattr(canvas.Sheet, "save", keep)
    return seen


def is_png(path):
    return path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def ball():
    return solids.ball(0.02, 2, expected_error_m=np.linspace(0, 0.005, 162))


def glints(n=30):
    return glints_on_sphere(0.02, n, strengths=np.linspace(0.1, 1, n), poses=np.arange(n) % 5)


def sdf():
    values = (np.linalg.norm(GRID.points(), axis=1) - 0.02).reshape(GRID.shape)
    return SdfGrid(grid=GRID, values=values.astype(np.float32))


def test_projections_show_the_largest_value_where_it_is(tmp_path, drawn):
    volume = np.full(GRID.shape, 0.1, dtype=np.complex64)
    volume[5, 2, 8] = 2j  # x = 20 mm, y = -20 mm, z = 30 mm
    projections(volume, GRID, tmp_path / "p.png")
    assert is_png(tmp_path / "p.png")
    expected = ((20, -20), (20, 30), (-20, 30))  # (x, y), (x, z), (y, z)
    for panel, (across, up) in zip(drawn[0].axes[:3], expected, strict=True):
        (image,) = panel.images
        decibels = np.asarray(image.get_array())
        row, column = np.unravel_index(decibels.argmax(), decibels.shape)
        left, right, bottom, top = image.get_extent()
        n_rows, n_columns = decibels.shape
        assert left + (column + 0.5) * (right - left) / n_columns == pytest.approx(across)
        assert bottom + (row + 0.5) * (top - bottom) / n_rows == pytest.approx(up)
        assert decibels.max() == 0.0
        # 20 log10(0.1 / 2)
        assert decibels.min() == pytest.approx(-26.0206, abs=1e-3)


def test_a_heat_map_without_signal_and_an_empty_mesh_are_user_errors(tmp_path):
    with pytest.raises(UserError, match="no signal to draw"):
        projections(np.zeros(GRID.shape), GRID, tmp_path / "p.png")
    empty = TriangleMesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), dtype=np.int64))
    with pytest.raises(UserError, match="no triangles to draw"):
        mesh_views(empty, tmp_path / "p.png")
    assert not (tmp_path / "p.png").exists()


def test_slices_draw_the_zero_level_at_its_radius(tmp_path, drawn):
    box_mesh = LosPrior.from_box((0.07, 0.09, 0.11)).mesh
    sdf_slices(
        sdf(), tmp_path / "s.png", glints=glints(), truth=ball(), box=box_mesh, center_m=(0, 0, 0)
    )
    assert is_png(tmp_path / "s.png")
    for panel in drawn[0].axes[:3]:
        zero = [c for c in panel.collections if getattr(c, "levels", None) is not None][-1]
        assert list(zero.levels) == [0.0]
        outline = np.concatenate([path.vertices for path in zero.get_paths()])
        # voxels of 10 mm on a radius of 20 mm: linear interpolation errs by up to h^2 / (8 r)
        np.testing.assert_allclose(np.linalg.norm(outline, axis=1), 20.0, atol=0.7)
    assert [panel.get_xlabel() for panel in drawn[0].axes[:3]] == ["x [mm]", "x [mm]", "y [mm]"]


def test_shadows_have_the_outline_of_the_content_before_them(tmp_path, drawn):
    u, v = np.meshgrid(0.002 * np.arange(-20, 21), 0.002 * np.arange(-15, 16), indexing="ij")
    shadow = shadows([np.hypot(u, v) > 0.02], known=u < 0.03)
    shadow_pictures(shadow, ball(), tmp_path / "s.png", truth=ball())
    assert is_png(tmp_path / "s.png")
    panel = drawn[0].axes[0]
    assert panel.get_title() == "along x"
    values = np.ma.filled(np.asarray(panel.images[0].get_array(), dtype=float), np.nan)
    assert values.shape == (31, 41)
    assert np.isnan(values).sum() == 31 * 6  # not covered
    assert values[15, 20] == 0.0
    assert panel.images[0].get_extent() == pytest.approx([-41.0, 41.0, -31.0, 31.0])
    for contour in panel.collections:
        (path,) = contour.get_paths()
        assert np.abs(np.hypot(*path.vertices.T) - 20.0).max() < 2.5
    assert len(panel.collections) == 2
