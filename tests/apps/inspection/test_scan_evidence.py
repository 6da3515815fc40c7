"""Cells, counterparts and tails of a comparison, against loops and known shifts."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2.apps.inspection.scan_evidence import (
    Cells,
    Evidence,
    cells_of,
    joined_cells,
    shifts_of,
    without_counterpart,
)
from geraf2.geometry.transforms import rigid
from helpers.glint_sets import glints_at
from helpers.inspected import around, block, glints_of, measured

RNG = np.random.default_rng(0)


def unit(n):
    vectors = RNG.normal(size=(n, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def evidence(body, seed=0):
    apertures = around()
    glints = glints_of(body, apertures, seed=seed, sigma_m=0.0)
    return Evidence(glints, (glints.positions, glints.normals), apertures)


def test_cells_of_both_directions_are_the_shift_along_their_normals():
    shift = np.array([0.001, -0.0005, 0.0007])
    there = measured(block((0.03, 0.02, 0.025), edge_m=0.003), np.eye(4), sigma_m=1e-6)
    here = measured(
        block((0.03, 0.02, 0.025), tuple(-shift), edge_m=0.003), np.eye(4), sigma_m=1e-6
    )
    one, other = evidence(here), evidence(there)
    pose, back = np.eye(4), np.eye(4)
    cells = joined_cells(
        cells_of(one, other, pose, [there]), cells_of(other, one, back, [there]), pose
    )
    flat = np.abs(cells.normals).max(axis=1) > 0.99  # sharp edges have no normal
    assert flat.sum() >= 8
    off = cells.distances_m - cells.normals @ shift
    assert np.abs(off[flat]).max() < 1e-4


def test_a_scan_without_likely_glints_has_no_cells():
    body = measured(block((0.03, 0.02, 0.025), edge_m=0.003), np.eye(4), sigma_m=1e-6)
    one = evidence(body)
    none = one._replace(glints=one.glints.select(np.zeros(0, dtype=int)))
    for pair in ((one, none), (none, one)):
        cells = cells_of(*pair, np.eye(4), [body])
        assert len(cells.parts) == 0
        assert shifts_of(cells, 1, np.zeros(3), (0.01, 0.01), np.zeros(6))[2] == {}


def test_the_distance_of_two_points_of_a_sphere_is_none():
    """Along the mean of their normals, whatever lies between them."""
    normals = unit(400)
    body = measured(block((0.03, 0.02, 0.025), edge_m=0.003), np.eye(4), sigma_m=1e-6)
    halves = []
    for own in (normals[::2], normals[1::2]):
        glints = replace(glints_at(0.02 * own, own), poses=np.zeros(200, dtype=int))
        halves.append(Evidence(glints, (glints.positions, own), around()))
    cells = cells_of(*halves, np.eye(4), [body])
    assert cells.distances_m == pytest.approx(np.zeros(1), abs=1e-12)


def test_cells_measured_in_another_frame_have_the_levers_of_the_second_scan():
    turn = rigid(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([0.1, 0.2, 0.3]))
    at, normals = RNG.normal(size=(5, 3)), unit(5)
    e = RNG.normal(size=5)
    back = Cells(np.zeros(5, int), e, normals, np.cross(at, normals), np.ones(5))
    empty = Cells(*(column[:0] for column in back))
    joined = joined_cells(empty, back, turn)
    moved, turned = at @ turn[:3, :3].T + turn[:3, 3], normals @ turn[:3, :3].T
    assert joined.normals == pytest.approx(turned)
    assert joined.levers_m == pytest.approx(np.cross(moved, turned))
    assert joined.distances_m == pytest.approx(-e)


def test_one_wild_cell_is_no_moved_part_and_many_that_agree_are():
    normals = unit(36)
    parts, at = np.repeat([0, 1, 2], 12), 0.03 * RNG.normal(size=(36, 3))
    e = 0.0008 * RNG.normal(size=36)
    cells = Cells(parts, e, normals, np.cross(at, normals), np.full(36, 0.0008**2))
    play = (0.005, 0.0005)
    wild = e.copy()
    wild[14] += 0.006
    found = shifts_of(cells._replace(distances_m=wild), 3, np.zeros(3), play, np.zeros(6))[2]
    assert found == {}
    moved = e + (normals @ np.array([0.0025, 0.0, 0.0])) * (parts == 1)
    found = shifts_of(cells._replace(distances_m=moved), 3, np.zeros(3), play, np.zeros(6))[2]
    assert list(found) == [1]


def test_only_glints_that_the_planes_face_can_be_missed():
    whole = measured(block((0.03, 0.02, 0.025), edge_m=0.003), np.eye(4), sigma_m=1e-6)
    one = evidence(whole)
    blind = one._replace(peaks=(np.zeros((1, 3)), np.array([[1.0, 0, 0]])))
    upper = [aperture for aperture in around() if abs(aperture.axes[0][2]) < 0.5]
    visible, missed = without_counterpart(one, blind._replace(apertures=upper), np.eye(4))
    up = np.abs(one.glints.normals[:, 2]) > 0.9
    assert not visible[up].any()
    assert (missed == visible).all()
    assert visible[~up].any()
    assert not without_counterpart(one, one, np.eye(4))[1].any()
