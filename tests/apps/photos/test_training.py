import os
import signal
from dataclasses import replace

import numpy as np
import pytest
import torch

from geraf2.apps.photos.config import GridStage, PhotoConfig
from geraf2.apps.photos.neus.coloured_grid import ColouredGridConfig
from geraf2.apps.photos.neus.rendering import PhotoSamplingConfig
from geraf2.apps.photos.training import start_surface, train_neural_surface
from geraf2.apps.photos.visual_hull import Region
from geraf2.errors import UserError
from helpers import photo_sphere

GRID = PhotoConfig(
    stages=(GridStage(n_longest=16, n_steps=40), GridStage(n_longest=24, n_steps=40)),
    rays_per_step=256,
    model=ColouredGridConfig(width=16),
    sampling=PhotoSamplingConfig(n_coarse=24, n_fine=8, n_rounds=2),
)
REGION = Region(low_m=tuple(photo_sphere.CENTER - 0.12), high_m=tuple(photo_sphere.CENTER + 0.12))


def radius_errors(surface):
    vertices = surface.mesh().vertices
    return np.abs(np.linalg.norm(vertices - photo_sphere.CENTER, axis=1) - photo_sphere.RADIUS_M)


def psnr(surface, photos, index):
    view = surface.render(photos.cameras[index])
    wanted = photos.images[index] / 255.0
    inside = photos.masks[index]
    return -10.0 * np.log10(np.mean((view.colour - wanted)[inside] ** 2))


def test_photos_with_silhouettes_give_the_ball_and_its_colours():
    photos = photo_sphere.photo_set(9)
    start = start_surface(photos.subset(range(8)), GRID)
    surface = train_neural_surface(photos.subset(range(8)), GRID)
    assert np.median(radius_errors(surface)) < 3e-3
    view = surface.render(photos.cameras[8])
    solid = view.opacity > 0.5
    assert (solid & photos.masks[8]).sum() > 0.9 * (solid | photos.masks[8]).sum()
    assert psnr(surface, photos, 8) > psnr(start, photos, 8) + 2.0
    depth = np.nanmin(view.depth)
    distance = np.linalg.norm(photos.cameras[8].position - photo_sphere.CENTER)
    assert depth == pytest.approx(distance - photo_sphere.RADIUS_M, abs=0.005)
    towards = view.normal[solid].mean(axis=0)
    assert towards @ photos.cameras[8].view_direction < -0.5


SHORT_GRID = replace(GRID, stages=tuple(replace(stage, n_steps=6) for stage in GRID.stages))


def test_a_resumed_training_ends_at_the_same_bits(tmp_path):
    photos = photo_sphere.photo_set(6)
    config, whole = SHORT_GRID, train_neural_surface(photos, SHORT_GRID, region=REGION)
    path = tmp_path / "checkpoint.safetensors"

    def interrupt(trainer, _):
        if trainer.step_number == 9:  # in the middle of the second grid
            os.kill(os.getpid(), signal.SIGINT)

    # A shell gives what it runs in the background an ignored Ctrl-C.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            train_neural_surface(photos, config, region=REGION, checkpoint=path, progress=interrupt)
    finally:
        signal.signal(signal.SIGINT, before)
    steps = []
    resumed = train_neural_surface(
        photos,
        config,
        checkpoint=path,
        resume=True,
        progress=lambda trainer, _: steps.append(trainer.step_number),
    )
    assert steps[0] == 10
    expected, _ = whole.state()
    found, _ = resumed.state()
    assert expected.keys() == found.keys()
    for name, array in expected.items():
        np.testing.assert_array_equal(found[name], array, err_msg=name)


def test_a_checkpoint_of_other_settings_is_refused(tmp_path):
    photos = photo_sphere.photo_set(4)
    path = tmp_path / "checkpoint.safetensors"
    short = replace(GRID, stages=(GridStage(n_longest=12, n_steps=1),))
    train_neural_surface(photos, short, checkpoint=path)
    with pytest.raises(UserError, match="another config"):
        train_neural_surface(photos, GRID, checkpoint=path, resume=True)
    with pytest.raises(UserError, match="another photos"):
        train_neural_surface(photos.subset([0, 1, 2]), short, checkpoint=path, resume=True)


def test_a_loss_that_is_not_finite_is_named():
    def poison(trainer, _):
        if trainer.step_number == 2:
            with torch.no_grad():
                trainer.surface.field.features.table.fill_(torch.nan)

    with pytest.raises(UserError, match=r"step 3 of 80: .* 'colour' of the loss is nan"):
        train_neural_surface(photo_sphere.photo_set(4), GRID, progress=poison)


def test_silhouettes_without_a_common_body_are_one_line():
    photos = photo_sphere.photo_set(4)
    masks = [np.zeros_like(mask) for mask in photos.masks]
    for index, mask in enumerate(masks):  # to the left in all of them: a hollow ring
        mask[16:20, index : 4 + index] = True
    with pytest.raises(UserError, match="no common body"):
        train_neural_surface(replace(photos, masks=tuple(masks)), GRID)
