from dataclasses import replace

import numpy as np
import pytest

from geraf2.apps.photos.config import AgreementRound
from geraf2.apps.photos.consistency import refine_by_agreement, silhouette_overlap
from geraf2.scene import Grid
from geraf2.scene.photos import PhotoSet
from helpers import photo_sphere

GRID = Grid.cube(tuple(photo_sphere.CENTER), 0.12, 33)
POINTS = GRID.points() - photo_sphere.CENTER
DISTANCE = np.linalg.norm(POINTS, axis=1)
FOOTPRINT_M = 0.45 / 280.0
ROUNDS = (
    AgreementRound(factor=2, node_px=2.0, reach_px=8.0, step_px=1.0),
    AgreementRound(factor=1, node_px=1.5, reach_px=3.0, step_px=0.5),
)


def printed(positions):
    """Grey print of waves shorter than the squares that are compared."""
    waves = np.random.default_rng(3).normal(0.0, 220.0, (24, 3))
    return 0.5 + 0.4 * np.tanh(np.cos(positions @ waves.T + np.arange(24)).sum(axis=1) / 4.0)


def printed_ball(*, distortion=(0.0,) * 5, print_on=True, masks=True, n_photos=10):
    cameras, images, silhouettes = [], [], []
    for small in photo_sphere.cameras(n_photos):
        camera = replace(small.resize(192, 144), distortion=distortion)
        origins, directions = camera.rays(camera.pixel_centers())
        offset = origins - photo_sphere.CENTER
        middle = -(offset * directions).sum(axis=1)
        inside = photo_sphere.RADIUS_M**2 - (offset**2).sum(axis=1) + middle**2
        position = offset + (middle - np.sqrt(np.maximum(inside, 0.0)))[:, None] * directions
        grey = np.where(inside > 0.0, printed(position) if print_on else 0.5, 0.1)
        image = np.repeat(np.round(255.0 * grey).astype(np.uint8)[:, None], 3, axis=1)
        cameras.append(camera)
        images.append(image.reshape(144, 192, 3))
        silhouettes.append((inside > 0.0).reshape(144, 192))
    return PhotoSet(
        names=tuple(f"{i}.png" for i in range(n_photos)),
        cameras=tuple(cameras),
        images=tuple(images),
        masks=tuple(silhouettes) if masks else None,
    )


def dented(towards):
    """The ball with a dent (+) or a bulge (-) of 6 mm on the side of +x."""
    bump = towards * 0.006 * np.exp(-(((POINTS - [0.08, 0.0, 0.0]) / 0.04) ** 2).sum(axis=1))
    return (DISTANCE - photo_sphere.RADIUS_M + bump).reshape(GRID.shape).astype(np.float32)


def errors(values):
    """Distance of the zero level from the ball beside +x, over the grid lines that cross it."""
    crossings = []
    positions = POINTS.reshape(*GRID.shape, 3)
    for j in range(12, 21):
        for k in range(12, 21):
            line, x = values[:, j, k], positions[:, j, k, 0]
            i = np.nonzero((line[:-1] < 0.0) & (line[1:] >= 0.0))[0][-1]
            share = line[i] / (line[i] - line[i + 1])
            y, z = positions[0, j, k, 1:]
            crossings.append(np.hypot(x[i] + share * (x[i + 1] - x[i]), np.hypot(y, z)))
    return np.abs(np.array(crossings) - photo_sphere.RADIUS_M)


@pytest.mark.parametrize(("towards", "masks"), [(1.0, True), (-1.0, False)])
def test_dents_and_bulges_move_to_where_the_photos_agree(towards, masks):
    start = dented(towards)
    found = refine_by_agreement(start, GRID, printed_ball(masks=masks), ROUNDS, FOOTPRINT_M)
    assert np.median(errors(start)) > 3e-3
    assert np.median(errors(found)) < 1e-3
    assert np.percentile(errors(found), 95) < 2e-3


def test_lens_distortion_is_taken_out():
    photos = printed_ball(distortion=(-0.2, 0.05, 0.002, -0.001, 0.0))
    found = refine_by_agreement(dented(-1.0), GRID, photos, ROUNDS, FOOTPRINT_M)
    assert np.median(errors(found)) < 1e-3


def test_without_print_or_with_two_photos_the_surface_stays():
    start = dented(-1.0)
    for photos in (printed_ball(print_on=False), printed_ball(n_photos=2)):
        found = refine_by_agreement(start, GRID, photos, ROUNDS, FOOTPRINT_M)
        assert np.median(errors(found) - errors(start)) == pytest.approx(0.0, abs=3e-4)


def test_without_a_surface_nothing_changes():
    values = np.abs(dented(1.0)) + np.float32(1e-3)
    found = refine_by_agreement(values, GRID, printed_ball(n_photos=3), ROUNDS, FOOTPRINT_M)
    np.testing.assert_array_equal(found, values)


def test_the_overlap_with_silhouettes_is_best_for_the_true_surface():
    photos = printed_ball()
    right, small, large = (
        silhouette_overlap((DISTANCE - radius).reshape(GRID.shape).astype(np.float32), GRID, photos)
        for radius in (photo_sphere.RADIUS_M, 0.06, 0.1)
    )
    assert right > 0.97
    assert small == pytest.approx((0.06 / photo_sphere.RADIUS_M) ** 2, abs=0.03)
    assert large == pytest.approx((photo_sphere.RADIUS_M / 0.1) ** 2, abs=0.03)


def test_a_search_that_uncovers_silhouettes_is_not_believed(monkeypatch):
    start = dented(1.0)
    monkeypatch.setattr(
        "geraf2.apps.photos.consistency._smooth_choice",
        lambda agreement, offsets, laplacian: np.full(agreement.shape[0], -0.01),
    )
    kept = refine_by_agreement(start, GRID, printed_ball(), ROUNDS[:1], FOOTPRINT_M)
    np.testing.assert_array_equal(kept, start)
    unknown = printed_ball(masks=False)
    moved = refine_by_agreement(start, GRID, unknown, ROUNDS[:1], FOOTPRINT_M)
    assert np.median(moved[np.abs(start) < 0.01] - start[np.abs(start) < 0.01]) > 5e-3
