"""Agreement of planes: a slow twin, and rivals of a geometry that is known to be right or wrong."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2.echoes.plane_agreement import (
    Rival,
    as_recorded_at,
    plane_agreement,
    with_axes_reversed,
)
from geraf2.imaging.peaks import join_peaks
from helpers.peak_sets import sphere_peaks
from helpers.specular import pose_of, raster, sphere_paths

N = 12
POSES = [
    pose_of(30.0 * k, raster(3), lambda tx, _: sphere_paths(tx, [[0, 0, 0]], [0.03]))
    for k in range(N)
]
# Two spheres beside the axis, so that no plane sees what another one sees.
SCENE = join_peaks(
    [
        sphere_peaks((0.03, 0.01, 0.0), 0.05, range(N)),
        sphere_peaks((-0.02, 0.02, 0.01), 0.045, range(N)),
    ]
)


def slow_agreement(peaks, n_planes):
    """The same by loops over pairs: share, and each plane's mean log likelihood."""
    points, normals, planes = peaks.points, -peaks.directions, peaks.planes
    pairs = []
    for i in range(len(points)):
        for j in range(i + 1, len(points)):
            step, cosine = points[j] - points[i], normals[i] @ normals[j]
            distance = np.linalg.norm(step)
            if planes[i] == planes[j] or distance > 0.035 or cosine <= 0.76:
                continue
            mean = (normals[i] + normals[j]) / np.linalg.norm(normals[i] + normals[j])
            sigma = np.hypot(1.4e-3 * np.sqrt(2.0), 60.0 * distance**3)
            gauss = np.exp(-0.5 * (step @ mean / sigma) ** 2) / (np.sqrt(2 * np.pi) * sigma)
            pairs.append((planes[i], planes[j], gauss * 2.0 * max(distance, sigma)))
    density, share = np.array([pair[2] for pair in pairs]), 0.3
    for _ in range(12):
        share = np.mean(share * density / (share * density + 1.0 - share))
    of_planes = [
        np.mean([np.log(share * d + 1.0 - share) for a, b, d in pairs if k in (a, b)] or [0.0])
        for k in range(n_planes)
    ]
    return share, np.array(of_planes)


def test_it_is_its_slow_twin():
    jitter = np.random.default_rng(0).normal(0.0, 2e-3, len(SCENE))
    peaks = replace(SCENE, ranges_m=SCENE.ranges_m + jitter)
    found, (share, likelihood) = plane_agreement(peaks, N), slow_agreement(peaks, N)
    assert found.share == pytest.approx(share, rel=1e-9)
    np.testing.assert_allclose(found.log_likelihood, likelihood, rtol=1e-9)


def test_planes_of_a_right_geometry_agree_and_scattered_echoes_do_not():
    ranges = np.random.default_rng(1).uniform(0.33, 0.43, len(SCENE))
    scattered = plane_agreement(replace(SCENE, ranges_m=ranges), N)
    assert plane_agreement(SCENE, N).share > 0.8
    assert scattered.share < 0.15


def test_reversed_axes_are_found_and_reversing_twice_is_the_same():
    reversed_ = with_axes_reversed(SCENE, POSES, horizontal=True)
    again = with_axes_reversed(reversed_, POSES, horizontal=True)
    np.testing.assert_allclose(again.points, SCENE.points, atol=1e-12)
    right, wrong = plane_agreement(SCENE, N), plane_agreement(reversed_, N)
    assert Rival.of(wrong, right).sigmas > 2.5
    assert Rival.of(right, wrong).sigmas < 0.0


def test_a_turntable_in_the_other_sense_is_reversed_axes_in_a_mirror():
    mirror = np.diag([1.0, -1.0, 1.0])
    places = {k: (-k) % N for k in range(N)}  # of a plane at the negative angle
    turned = as_recorded_at(SCENE, POSES, places)
    seen = with_axes_reversed(SCENE, POSES, horizontal=True)
    np.testing.assert_allclose(turned.points @ mirror, seen.points, atol=1e-12)


def test_exchanged_planes_disagree_in_their_own_places_only():
    exchanged = as_recorded_at(SCENE, POSES, {1: 5, 5: 1})
    found = plane_agreement(exchanged, N).of_planes
    assert max(found[1], found[5]) < 0.5 * np.median(found)


def test_few_planes_say_nothing():
    two = SCENE.select(SCENE.planes < 2)
    assert Rival.of(plane_agreement(two, 2), plane_agreement(two, 2)).sigmas == 0.0
