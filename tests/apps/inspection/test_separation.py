"""Bodies of a content: cut where a surface bridges their gap, added where it is missing."""

from dataclasses import replace

import numpy as np
import pytest
from skimage.measure import marching_cubes

import geraf2
from geraf2.apps.inspection.bodies import split_bodies
from geraf2.apps.inspection.separation import (
    Echoes,
    bridge_probability,
    joined_by,
    separated,
)
from geraf2.geometry.triangles import enclosed_volume_m3
from geraf2.io.mesh import TriangleMesh
from geraf2.io.points import cloud_bytes
from geraf2.io.run_folder import PEAKS_NAME
from helpers.inspected import around, block, measured, run_of

APERTURES = around()[:12]
HERE = np.eye(4)
BLOCK = block((0.04, 0.04, 0.04))
RADIUS_M, APART_M = 0.015, 0.04
OTHER = (0.07, 0.0, 0.0)


def echoes(*middles_m, probability=0.25, planes=range(12), n=12, depth_m=RADIUS_M):
    """Uncertain echoes of balls from some of the twelve planes, so far before their middles."""
    rng = np.random.default_rng(0)
    angles = np.deg2rad(30.0 * np.repeat(list(planes), n) + rng.uniform(-8, 8, n * len(planes)))
    up = np.deg2rad(rng.uniform(-12, 12, len(angles)))
    normals = np.stack(
        [np.cos(up) * np.cos(angles), np.cos(up) * np.sin(angles), np.sin(up)], axis=1
    )
    positions = np.concatenate([middle + depth_m * normals for middle in np.array(middles_m)])
    n_all = len(positions)
    return Echoes(positions, np.tile(normals, (len(middles_m), 1)), np.full(n_all, probability))


BOTH = echoes((-APART_M / 2, 0, 0), (APART_M / 2, 0, 0), probability=0.8)


def dumbbell():
    """Two balls with a bar between them: as a fit bridges their gap, or one body."""
    at, step = np.linspace(-0.045, 0.045, 46, retstep=True)
    x, y, z = np.meshgrid(at, at, at, indexing="ij")
    balls = [np.sqrt((x - c) ** 2 + y**2 + z**2) - RADIUS_M for c in (-APART_M / 2, APART_M / 2)]
    bar = np.maximum(np.abs(x) - APART_M / 2, np.hypot(y, z) - 0.007)
    values = np.minimum.reduce([*balls, bar])
    found = marching_cubes(values, 0.0, gradient_direction="descent", allow_degenerate=False)
    vertices = step * found[0] + at[0]
    return TriangleMesh(vertices=vertices, faces=found[1].astype(np.int64))


def part(silent_m, probability=1.0):
    """One part, with echoes from all of it but from the middle, |x| below a length."""
    body = measured(dumbbell(), HERE, sigma_m=1e-6)
    seen = np.abs(body.mesh.vertices[:, 0]) > silent_m
    return replace(body, seen=seen, probability=probability)


def test_a_silent_section_that_planes_face_is_cut():
    found = separated([part(0.008)], BOTH, APERTURES)
    assert len(found.bodies) == 2
    assert found.faint == []
    assert found.probability > 0.9
    middles = sorted(float(body.mesh.vertices[:, 0].mean()) for body in found.bodies)
    assert middles == pytest.approx([-APART_M / 2, APART_M / 2], abs=4e-3)
    for body in found.bodies:  # closed at the cut
        assert len(split_bodies(body)) == 1


def test_a_section_that_echoed_is_part_of_one_body():
    found = separated([part(0.0, 0.9)], BOTH, APERTURES)
    assert len(found.bodies[0].mesh.faces) == len(dumbbell().faces)
    assert found.faint == []
    assert found.probability == pytest.approx(0.9 * 0.95, abs=0.02)


def test_a_section_where_only_back_faces_lie_is_cut():
    """They lie behind the middles of plastic balls, some of them where a fit bridges the gap."""
    backs = echoes((-APART_M / 2, 0, 0), (APART_M / 2, 0, 0), probability=0.8, depth_m=-0.018)
    assert len(separated([part(0.0)], backs, APERTURES).bodies) == 2


def test_necks_join_what_hardly_is_a_bridge():
    """Against sets joined one by one; what is joined already costs no probability."""
    rng = np.random.default_rng(1)
    for _ in range(50):
        necks = [
            (float(rng.random()), *map(int, rng.choice(5, 2, replace=False))) for _ in "123456"
        ]
        sets = [{k} for k in range(5)]
        for bridge, i, j in necks:
            if bridge < 0.5:
                both = next(s for s in sets if i in s) | next(s for s in sets if j in s)
                sets = [s for s in sets if not s & both] + [both]
        group, _ = joined_by(necks, 5)
        assert {frozenset(np.flatnonzero(group == k)) for k in group} == set(map(frozenset, sets))
    assert joined_by([(0.1, 0, 1), (0.9, 0, 2), (0.2, 1, 2)], 3)[1] == pytest.approx(0.9 * 0.8)


@pytest.mark.parametrize(
    "found", [echoes((0.0, 0.0, 0.0)), Echoes(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))]
)
def test_a_body_whose_echoes_meet_once_or_never_stays_whole(found):
    body = separated([part(0.008, 0.7)], found, APERTURES)
    assert len(body.bodies) == 1
    assert body.probability == pytest.approx(0.7, abs=0.05)


def test_the_odds_of_a_bridge_are_those_of_its_patches():
    """Eight patches of 10 mm^2, of which a share is seen, against a binomial law written out."""
    for seen in (0.0, 0.25, 1.0):
        k = 8.0 * seen
        bridge = 0.1**k * 0.9 ** (8.0 - k)
        one = 0.9**k * 0.1 ** (8.0 - k)
        assert bridge_probability(80e-6 * seen, 80e-6) == pytest.approx(bridge / (bridge + one))


def test_uncertain_echoes_of_many_planes_around_a_spot_are_a_body():
    found = separated([measured(BLOCK, HERE)], echoes(OTHER), APERTURES)
    (body,) = found.faint
    assert body.probability > 0.9
    assert found.probability == pytest.approx(body.probability * 0.95**2, abs=0.01)
    assert body.mesh.vertices.mean(axis=0) == pytest.approx(OTHER, abs=2e-3)
    assert np.ptp(body.mesh.vertices[:, :2], axis=0) == pytest.approx(2 * RADIUS_M, rel=0.1)
    assert enclosed_volume_m3(body.mesh.vertices, body.mesh.faces) > 0.0  # faces outwards
    assert not body.seen.any()


@pytest.mark.parametrize(
    "found",
    [
        echoes(OTHER, planes=(0, 1)),
        echoes(OTHER, probability=0.01),
        echoes((0.0, 0.0, 0.0)),
    ],
    ids=["few planes", "noise", "of the surface"],
)
def test_others_are_none(found):
    assert separated([measured(BLOCK, HERE)], found, APERTURES).faint == []


@pytest.mark.parametrize("depth_m", [RADIUS_M, -0.018], ids=["front faces", "back faces"])
def test_two_bodies_are_two(depth_m):
    both = echoes((0.07, -0.02, 0.0), (0.07, 0.02, 0.0), depth_m=depth_m)
    found = separated([measured(BLOCK, HERE)], both, APERTURES)
    middles = sorted(body.mesh.vertices[:, 1].mean() for body in found.faint)
    assert middles == pytest.approx([-0.02, 0.02], abs=2e-3)


def test_an_inspection_lists_it_with_a_note(tmp_path):
    run = run_of(tmp_path / "run", BLOCK, pose=HERE, has_glints=True)
    positions, normals, probability = echoes(OTHER)
    columns = {"probability": probability, "label": np.zeros(len(probability), dtype=np.uint8)}
    (run / PEAKS_NAME).write_bytes(cloud_bytes(positions, normals, columns))
    found = geraf2.inspect(run, expect=2, out=tmp_path)
    assert found.verdict == "pass"
    assert found.count_probability > 0.85
    assert found.parts[1].center_m == pytest.approx(OTHER, abs=2e-3)
    assert found.parts[1].seen_fraction == 0.0
    assert found.parts[1].material.kind == "metal"  # no echo passed through it
    assert any("part 2 only uncertain echoes came" in note for note in found.notes)
    assert "count right" in (tmp_path / "inspection.html").read_text()
