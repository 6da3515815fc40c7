"""Bodies of uncertain echoes that agree, beside a surface."""

import numpy as np
import pytest

import geraf2
from geraf2.apps.inspection.faint import faint_bodies
from geraf2.geometry.triangles import enclosed_volume_m3
from geraf2.io.points import cloud_bytes
from geraf2.io.run_folder import PEAKS_NAME
from helpers.inspected import around, block, run_of

CORNERS = np.array([aperture.corners_m for aperture in around()[:12]])
BLOCK = block((0.04, 0.04, 0.04))
RADIUS_M = 0.015


def echoes(middle_m, probability=0.25, planes=range(12), n=12):
    """Uncertain echoes of a ball from some of the twelve planes, as peaks."""
    rng = np.random.default_rng(0)
    angles = np.deg2rad(30.0 * np.repeat(list(planes), n) + rng.uniform(-8, 8, n * len(planes)))
    up = np.deg2rad(rng.uniform(-12, 12, len(angles)))
    normals = np.stack(
        [np.cos(up) * np.cos(angles), np.cos(up) * np.sin(angles), np.sin(up)], axis=1
    )
    return np.asarray(middle_m) + RADIUS_M * normals, normals, np.full(len(normals), probability)


def both(*peaks):
    return tuple(np.concatenate(columns) for columns in zip(*peaks, strict=True))


def test_uncertain_echoes_of_many_planes_around_a_spot_are_a_body():
    (body,), probability = faint_bodies(BLOCK, echoes((0.07, 0.0, 0.0)), CORNERS)
    assert min(body.probability, probability) > 0.9
    assert body.mesh.vertices.mean(axis=0) == pytest.approx([0.07, 0.0, 0.0], abs=2e-3)
    assert np.ptp(body.mesh.vertices[:, :2], axis=0) == pytest.approx(2 * RADIUS_M, rel=0.1)
    assert enclosed_volume_m3(body.mesh.vertices, body.mesh.faces) > 0.0  # faces outwards
    assert not body.seen.any()


@pytest.mark.parametrize(
    "peaks",
    [
        echoes((0.07, 0.0, 0.0), planes=(0, 1)),
        echoes((0.07, 0.0, 0.0), probability=0.05),
        echoes((0.018, 0.0, 0.0)),
    ],
    ids=["few planes", "noise", "of the surface"],
)
def test_others_are_none(peaks):
    assert faint_bodies(BLOCK, peaks, CORNERS)[0] == []


def test_two_bodies_are_two():
    peaks = both(echoes((0.07, -0.02, 0.0)), echoes((0.07, 0.02, 0.0)))
    bodies, _ = faint_bodies(BLOCK, peaks, CORNERS)
    assert sorted(b.mesh.vertices[:, 1].mean() for b in bodies) == pytest.approx(
        [-0.02, 0.02], abs=2e-3
    )


def test_an_inspection_lists_it_with_a_note(tmp_path):
    run = run_of(tmp_path / "run", BLOCK, pose=np.eye(4), has_glints=True)
    positions, normals, probability = echoes((0.07, 0.0, 0.0))
    labels = np.zeros(len(probability), dtype=np.uint8)
    columns = {"probability": probability, "label": labels}
    (run / PEAKS_NAME).write_bytes(cloud_bytes(positions, normals, columns))
    found = geraf2.inspect(run, expect=2, out=tmp_path)
    assert found.verdict == "pass"
    assert found.count_probability > 0.9
    assert found.parts[1].center_m == pytest.approx((0.07, 0.0, 0.0), abs=2e-3)
    assert found.parts[1].seen_fraction == 0.0
    assert found.parts[1].material.kind == "not determined"
    assert any("part 2 only uncertain echoes came" in note for note in found.notes)
    assert "count right" in (tmp_path / "inspection.html").read_text()
