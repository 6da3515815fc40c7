"""Order of `best`: links, then the rim, then a fit that knows how many planes there are."""

import numpy as np
import pytest

from geraf2.echoes.glints import GlintConfig, find_glints
from geraf2.fields import SdfGrid
from geraf2.imaging.subapertures import SubapertureConfig
from geraf2.scene import Grid, LosPrior
from geraf2.surfaces import refinement
from geraf2.surfaces.fit import FitConfig
from geraf2.surfaces.refinement import (
    RefineConfig,
    SelectedGlints,
    fit_refined,
    mean_field,
    select_glints,
)
from helpers.glint_sets import glints_on_sphere
from helpers.specular import BOX_M, sphere_capture
from helpers.synthetic import point_capture

BOX = LosPrior.from_box((BOX_M, BOX_M, BOX_M))
NARROW = GlintConfig(subaperture=SubapertureConfig(max_cosine=0.2))


def test_glints_are_kept_and_continued_at_the_rim():
    capture = sphere_capture([[0.0, 0.0, 0.0]], [0.04], n_poses=3)
    glints = find_glints(capture, BOX, NARROW)
    found = select_glints(capture, BOX, glints, first=NARROW)
    np.testing.assert_array_equal(found.seen.positions[: len(glints)], glints.positions)
    assert len(found.rim) > 3 * 20
    assert np.abs(np.linalg.norm(found.rim.positions, axis=1) - 0.04).max() < 1e-3


def test_with_few_planes_fits_on_several_voxels_are_made():
    config = RefineConfig()
    scales = config.few_planes_voxel_scales
    assert config.fits_of(12) == config.fits_of(36) == [config.fit]
    few = config.fits_of(6)
    voxels = [scale * config.fit.spacing_m for scale in scales]
    assert [fit.spacing_m for fit in few] == pytest.approx(voxels)


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("few_planes_voxel_scales", ()),
        ("few_planes_voxel_scales", (1.0, 0.0)),
        ("max_contradicted", 1.5),
    ],
)
def test_settings_out_of_range_are_refused(setting, value):
    with pytest.raises(ValueError, match=setting):
        RefineConfig(**{setting: value})


COARSE = FitConfig(spacing_m=0.008, distance_rounds=1)


def ball_glints(n=400, seed=0):
    return glints_on_sphere(0.04, n, seed=seed)


def test_a_mean_of_fields_is_on_the_grid_of_the_first():
    grid = Grid.cube((0.0, 0.0, 0.0), 0.05, 5)
    finer = Grid.cube((0.0, 0.0, 0.0), 0.05, 9)
    one = SdfGrid(grid=grid, values=grid.points()[:, 0].reshape(grid.shape).astype(np.float32))
    other = SdfGrid(grid=finer, values=np.full(finer.shape, 0.02, dtype=np.float32))
    mean = mean_field([one, other])
    assert mean.grid == grid
    np.testing.assert_allclose(mean.values, 0.5 * (one.values + 0.02), atol=1e-7)
    assert mean_field([one]) is one


@pytest.mark.parametrize(("n_poses", "n_fits"), [(12, 1), (3, 3)])
def test_with_few_planes_the_mean_of_fits_on_several_voxels_is_taken(monkeypatch, n_poses, n_fits):
    selected = SelectedGlints(ball_glints(), ball_glints(50, seed=2))
    calls = []

    def field(evidence, capture, prior, config, *, num_threads):
        calls.append((len(evidence.glints), len(evidence.rim), evidence.rim_weight))
        grid = Grid.cube((0.0, 0.0, 0.0), 0.08, 17)
        value = 0.01 * len(calls)
        return SdfGrid(grid=grid, values=np.full(grid.shape, value, dtype=np.float32))

    monkeypatch.setattr(refinement, "fit_sdf", field)
    config = RefineConfig(fit=COARSE)
    sdf = fit_refined(selected, point_capture(n_poses), BOX, config, num_threads=1)
    assert calls == n_fits * [(400, 50, 0.2 if n_poses >= 12 else 1.0)]
    assert sdf.values.max() == sdf.values.min() == pytest.approx(0.005 * (n_fits + 1))


def test_the_mean_of_real_fits_is_the_surface():
    selected = SelectedGlints(ball_glints(), ball_glints(50, seed=2))
    sdf = fit_refined(selected, point_capture(12), BOX, RefineConfig(fit=COARSE))
    error = np.abs(sdf.sample(selected.linked.positions))
    assert np.median(error) < 1e-3
