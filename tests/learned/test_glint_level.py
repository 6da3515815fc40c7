"""The zero level is moved to the depth of the glints: on spheres of geometrical optics."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from geraf2.fields import SdfGrid
from geraf2.learned import glint_level
from geraf2.learned.config import CorrectedPaperConfig, StageConfig
from geraf2.learned.glint_level import (
    GlintDepths,
    moved,
    part_depths,
)
from geraf2.learned.trainer import PaperTrainer
from geraf2.scene import Grid
from helpers.carton import PRIOR, SPHERES

CONFIG = replace(
    CorrectedPaperConfig(),
    n_antennas=100,
    grid_n=(33,),
    mesh_n=33,
    stage1=StageConfig(n_steps=1),
    stage2=StageConfig(n_steps=0),
)
MAX_M = 0.002


def ball(radius_m, n_per_side=41):
    grid = Grid.cube((0.0, 0.0, 0.0), 0.05, n_per_side)
    distance = np.linalg.norm(grid.points(), axis=1).reshape(grid.shape) - radius_m
    return SdfGrid(grid=grid, values=distance.astype(np.float32))


def radius_of(sdf):
    """From the value in the middle of a side of the grid: the slope is 1 there."""
    middle = sdf.grid.shape[0] // 2
    line = sdf.values[middle, middle, middle:]
    positions = np.arange(len(line)) * sdf.grid.spacing_m
    return float(np.interp(0.0, line, positions))


def shifted(sdf, inward_m):
    return moved(sdf, inward_m, part_depths(sdf))


def test_a_thick_part_is_moved_wholly_and_a_thin_one_by_half_of_its_depth():
    assert radius_of(shifted(ball(0.03), 0.002)) == pytest.approx(0.028, abs=1e-4)
    assert radius_of(shifted(ball(0.03), -0.002)) == pytest.approx(0.032, abs=1e-4)
    assert radius_of(shifted(ball(0.006), 0.005)) == pytest.approx(0.003, abs=3e-4)
    assert radius_of(shifted(ball(0.006), -0.005)) == pytest.approx(0.011, abs=1e-4)


@pytest.fixture(scope="module")
def maps(capture):
    return PaperTrainer(capture, PRIOR, CONFIG).loss.maps


def put_spheres(trainer, outside_m):
    """Give a trainer the distance to the spheres, moved outward, as its field."""
    grid = trainer.model.sdf.grid
    distances = [
        np.linalg.norm(grid.points() - center, axis=1) - radius - outside_m
        for center, radius in zip(*SPHERES, strict=True)
    ]
    values = torch.from_numpy(np.min(distances, axis=0).reshape(grid.shape)).float()
    trainer.model.sdf.values = torch.nn.Parameter(values)


def test_a_moved_surface_is_found_by_the_depth_of_its_glints(capture, maps):
    outside_m = -0.003  # the test below has one outside
    trainer = PaperTrainer(capture, PRIOR, CONFIG, maps=maps)
    put_spheres(trainer, outside_m)
    before = trainer.draws.generator.get_state()
    distance = trainer.model.sdf.sample_grid(trainer.domain.grid(CONFIG.mesh_n))
    shift = GlintDepths(trainer.draws, trainer.loss, trainer.threads).find_shift(
        distance, part_depths(distance), MAX_M
    )
    assert shift.n_glints == glint_level.N_WINDOWS * len(capture.poses)
    assert len(shift.outside_m) == glint_level.N_ROUNDS
    # A lobe of power 8 puts the glint of a sphere of 30 mm 0.5 mm too deep.
    assert shift.inward_m == pytest.approx(outside_m, abs=0.001)
    assert torch.equal(
        trainer.draws.generator.get_state(), before
    )  # the training continues as it would


def test_the_distance_is_moved_if_the_setting_asks_for_it(capture, maps):
    moved_one = PaperTrainer(capture, PRIOR, CONFIG, maps=maps)
    kept = PaperTrainer(capture, PRIOR, replace(CONFIG, glint_level=False), maps=maps)
    for trainer in (moved_one, kept):
        put_spheres(trainer, 0.0015)
    values = [trainer.distance().values for trainer in (moved_one, kept)]
    assert kept.glint_shift is None
    inward_m = moved_one.glint_shift.inward_m
    assert 0.0005 < inward_m < MAX_M
    deep = values[1] < -inward_m / glint_level.INWARD_SHARE  # of no part that counts as thin
    assert deep.sum() > 100
    np.testing.assert_allclose((values[0] - values[1])[deep], inward_m, atol=1e-6)
