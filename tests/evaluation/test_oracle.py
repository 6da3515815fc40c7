import numpy as np
import pytest

from geraf2.evaluation import evaluate_mesh, oracle_matched_filter
from geraf2.fields import NestedSets, SdfGrid, SphereSolid
from geraf2.scene import Grid, LosPrior, Wall
from geraf2.surfaces.extraction import cropped_content
from geraf2.surfaces.isosurface import extract_surface

SIDE_M = 0.2
WALL = Wall(size_m=(SIDE_M,) * 3, thickness_m=0.012, permittivity=1.6)
PRIOR = LosPrior.from_box((SIDE_M,) * 3, walls=(WALL,))
GRID = Grid.cube((0.0, 0.0, 0.0), 0.11, 56)
BALL = SphereSolid(radius_m=0.05)


def ball_mesh():
    values = BALL.signed_distance(GRID.points()).reshape(GRID.shape)
    return extract_surface(SdfGrid(grid=GRID, values=values.astype(np.float32)))


def test_cropping_takes_the_wall_and_leaves_the_content():
    values = NestedSets.from_walls([WALL], BALL).signed_distance(GRID.points())
    sdf = SdfGrid(grid=GRID, values=values.reshape(GRID.shape).astype(np.float32))
    for crop_m in (0.005, 0.02):  # within the wall, and behind it
        content = cropped_content(sdf, PRIOR, crop_m)
        radius = np.linalg.norm(content.vertices, axis=1)
        assert abs(radius - 0.05).max() < 0.001


def test_an_empty_field_has_no_content():
    sdf = SdfGrid(grid=GRID, values=np.ones(GRID.shape, dtype=np.float32))
    assert cropped_content(sdf, PRIOR, 0.01).faces.shape == (0, 3)


def test_the_oracle_finds_the_threshold_that_the_truth_would_choose():
    """A volume that falls with the distance from a ball: level 0.6 is its surface."""
    distance = BALL.signed_distance(GRID.points()).reshape(GRID.shape)
    volume = np.clip(0.6 - 10.0 * distance, 0.0, 1.0)
    levels = [0.2, 0.4, 0.6, 0.8]
    score = oracle_matched_filter(
        volume, GRID, PRIOR, ball_mesh(), crop_m=0.012, levels=levels, n_samples=2000
    )
    assert score.level in (0.6, 0.8)  # both within 15 mm; only one within 5
    assert score.f1_15mm > 0.999
    at_surface = cropped_content(
        SdfGrid(grid=GRID, values=(0.6 - volume).astype(np.float32)), PRIOR, 0.012
    )
    direct = evaluate_mesh(at_surface, ball_mesh(), n_samples=2000)
    assert score.f1_5mm == pytest.approx(direct.f1(0.005))
    assert score.f1_2mm == pytest.approx(direct.f1(0.002))
    assert score.chamfer_1e3_m2 == pytest.approx(direct.chamfer_1e3_m2)


def test_a_volume_without_signal_is_refused():
    with pytest.raises(ValueError, match="positive somewhere inside the prior"):
        oracle_matched_filter(np.zeros(GRID.shape), GRID, PRIOR, ball_mesh(), crop_m=0.01)
