"""The zero level is moved to the depth of the glints: on spheres of geometrical optics."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from carton import PRIOR, SPHERES
from geraf2.paper.config import CorrectedPaperConfig, PaperConfig, StageConfig
from geraf2.paper.glint_level import DEPTHS_M, depth_difference, line_of_sight, shift_of
from geraf2.paper.trainer import PaperTrainer

CONFIG = replace(
    CorrectedPaperConfig(),
    n_antennas=100,
    grid_n=(33,),
    mesh_n=33,
    stage1=StageConfig(n_steps=1),
    stage2=StageConfig(n_steps=0),
)


def spot(at_m, width_m=0.012):
    return np.exp(-(((DEPTHS_M - at_m) / width_m) ** 2))


@pytest.mark.parametrize("behind_m", [-0.0043, 0.0, 0.0017])
def test_depths_of_two_spots_are_told_apart_to_a_part_of_a_millimetre(behind_m):
    found = depth_difference(spot(0.002 + behind_m, 0.015), 3.0 * spot(0.002))
    assert found == pytest.approx(behind_m, abs=1e-4)


def test_the_peaks_beside_the_middle_count():
    measured = spot(0.001, 0.004) + 5.0 * spot(-0.024, 0.004)
    assert depth_difference(spot(0.003, 0.004), measured) == pytest.approx(0.002, abs=1e-4)
    assert depth_difference(np.ones_like(DEPTHS_M), measured) is None
    assert depth_difference(measured, np.arange(len(DEPTHS_M), dtype=float)) is None


def test_a_line_of_sight_goes_through_the_glint_away_from_the_window():
    line = line_of_sight(np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.0, 0.5]))
    np.testing.assert_allclose(line[:, 2], 0.1 - DEPTHS_M, atol=1e-12)
    np.testing.assert_allclose(line[:, :2], 0.0)


def test_what_is_rendered_too_deep_lies_inside():
    shift = shift_of([0.001, 0.003, 0.002, 0.05])
    assert shift.outside_m == pytest.approx(-0.0025)
    assert shift.quartiles_m[0] < shift.outside_m < shift.quartiles_m[1]
    assert shift.n_planes == 4
    assert shift.inward_m == shift.outside_m
    assert shift_of([0.001, 0.003]).inward_m == 0.0


def test_a_surface_is_moved_inward_as_far_as_three_quarters_of_the_planes_ask():
    shift = shift_of([-0.001, -0.003, -0.002, -0.004, -0.005])
    assert shift.outside_m == pytest.approx(0.003)
    assert shift.inward_m == shift.quartiles_m[0] == pytest.approx(0.002)
    assert shift_of([-0.003, -0.001, 0.001, 0.002, -0.002]).inward_m == 0.0


@pytest.fixture(scope="module")
def maps(capture):
    return PaperTrainer(capture, PRIOR, CONFIG).maps


def put_spheres(trainer, outside_m):
    """Give a trainer the distance to the spheres, moved outward, as its field."""
    grid = trainer.model.sdf.grid
    distances = [
        np.linalg.norm(grid.points() - center, axis=1) - radius - outside_m
        for center, radius in zip(*SPHERES, strict=True)
    ]
    values = torch.from_numpy(np.min(distances, axis=0).reshape(grid.shape)).float()
    trainer.model.sdf.values = torch.nn.Parameter(values)


@pytest.mark.parametrize("outside_m", [-0.003, 0.0, 0.003])
def test_a_moved_surface_is_found_by_the_depth_of_its_glints(capture, maps, outside_m):
    trainer = PaperTrainer(capture, PRIOR, CONFIG, maps=maps)
    put_spheres(trainer, outside_m)
    before = trainer.generator.get_state()
    shift = trainer.find_glint_shift()
    assert shift.n_planes == len(capture.poses)
    # A lobe of power 8 puts the glint of a sphere of 30 mm 0.5 mm too deep.
    assert shift.outside_m == pytest.approx(outside_m, abs=0.001)
    assert torch.equal(trainer.generator.get_state(), before)  # the training goes on as it would


def test_the_distance_is_moved_where_the_setting_says_so(capture, maps):
    moved = PaperTrainer(capture, PRIOR, CONFIG, maps=maps)
    kept = PaperTrainer(capture, PRIOR, replace(CONFIG, glint_level=False), maps=maps)
    for trainer in (moved, kept):
        put_spheres(trainer, 0.003)
    values = [trainer.distance().values for trainer in (moved, kept)]
    assert kept.glint_shift is None
    inside = values[1] < -0.005  # no piece at the crop
    change = (values[0] - values[1])[inside]
    np.testing.assert_allclose(change, moved.glint_shift.inward_m, atol=1e-6)
    assert 0.001 < moved.glint_shift.inward_m < 0.004


def test_the_letter_of_the_paper_moves_nothing():
    assert not PaperConfig().glint_level
    assert CorrectedPaperConfig().glint_level
