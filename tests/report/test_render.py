import numpy as np
import pytest

from geraf2.report import MeshPainter, View
from geraf2.scene import LosPrior
from helpers import solids

RADIUS = 0.05


@pytest.fixture(scope="module")
def ball():
    return solids.ball(RADIUS, 4)


def view(azimuth=0.0, elevation=0.0, n_pixels=80):
    return View(
        azimuth_deg=azimuth,
        elevation_deg=elevation,
        center_m=(0.0, 0.0, 0.0),
        half_width_m=0.08,
        n_pixels=n_pixels,
    )


def grey(mesh):
    return np.full((len(mesh.vertices), 3), 0.7)


def test_a_ball_covers_the_area_of_its_disc(ball):
    picture = MeshPainter(ball).render(view(30.0, 20.0), grey(ball))
    assert picture.shape == (80, 80, 4)
    pixel_area = (0.16 / 80) ** 2
    # four rays a pixel: the disc's edge of 157 mm is uncertain by a quarter pixel, averaged
    assert picture[..., 3].sum() * pixel_area == pytest.approx(np.pi * RADIUS**2, rel=0.01)
    assert picture.min() >= 0.0
    assert picture.max() <= 1.0


def test_each_side_shows_what_lies_there_and_up_is_up(ball):
    colours = np.clip(ball.vertices / RADIUS, 0, 1)  # red towards +x, green +y, blue +z
    painter = MeshPainter(ball)
    from_x = painter.render(view(0.0), colours)
    from_y = painter.render(view(90.0), colours)
    middle = (slice(38, 42), slice(38, 42))
    assert from_x[middle][..., 0].min() > 0.5 > from_x[middle][..., 1].max()
    assert from_y[middle][..., 1].min() > 0.5 > from_y[middle][..., 0].max()
    # row 0 is the top of the picture; seen from +x the +y side is on the right
    assert from_x[18:25, 40, 2].mean() > 0.4 > from_x[56:62, 40, 2].mean()
    assert from_x[40, 56:62, 1].mean() > 0.4 > from_x[40, 18:24, 1].mean()


def test_light_falls_from_above_and_creases_are_darker(ball):
    picture = MeshPainter(ball).render(view(), grey(ball))
    assert picture[22, 40, :3].mean() > 1.15 * picture[58, 40, :3].mean()
    pair = solids.joined(*(solids.ball(RADIUS, 4, (0, y, 0)) for y in (-0.045, 0.045)))
    ambient = MeshPainter(pair).ambient
    crease = np.abs(pair.vertices[:, 1]) < 0.012
    outside = np.abs(pair.vertices[:, 1]) > 0.08
    assert ambient[crease].mean() < 0.75 * ambient[outside].mean()


def test_flat_faces_stay_flat_across_a_sharp_edge():
    cube = LosPrior.from_box((0.08, 0.08, 0.08)).mesh
    picture = MeshPainter(cube).render(view(0.0), grey(cube))
    face = picture[25:55, 25:55, :3]
    assert np.ptp(face) < 0.02
