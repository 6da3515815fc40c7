"""The next plane: on a sphere with a cap of large error, seen or hidden."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2.errors import UserError
from geraf2.io.mesh import TriangleMesh
from geraf2.pipeline.next_plane import expected_errors
from geraf2.pipeline.scan_time import plane_at
from geraf2.scene import Pose
from geraf2.scene.plan import plane_of

HALF = np.array([0.07, 0.125])
ABOVE, BESIDE, BELOW = (plane_at(0.0, np.deg2rad(e), 0.4, HALF) for e in (90.0, 0.0, -90.0))


@pytest.fixture(scope="module")
def ball():
    """Sphere of 4 cm whose cap above 60 degrees has an error of 5.4 mm, the rest 0.4 mm."""
    trimesh = pytest.importorskip("trimesh")
    made = trimesh.creation.icosphere(subdivisions=4, radius=0.04)
    top = made.vertices[:, 2] > 0.04 * np.sin(np.deg2rad(60.0))
    return TriangleMesh(
        vertices=np.asarray(made.vertices),
        faces=np.asarray(made.faces),
        expected_error_m=np.where(top, 5.4e-3, 0.4e-3),
    )


def test_the_plane_above_takes_the_error_of_the_cap_that_it_sees(ball):
    before, after = expected_errors(ball, [ABOVE, BESIDE, BELOW])
    cap = 0.5 * (1.0 - np.sin(np.deg2rad(60.0)))  # share of the sphere
    assert before == pytest.approx(0.4e-3 + 5e-3 * cap, rel=0.03)
    # Of normals from the middle those meet the plane that point into its solid angle; tilts of 10
    # degrees move some out and others, of the cap, in.
    x, y = HALF / 0.4
    seen = 4.0 * np.arctan(x * y / np.sqrt(1 + x**2 + y**2)) / (4 * np.pi)
    gained = before - after
    assert gained[0] == pytest.approx(5e-3 * seen, rel=0.25)
    assert gained[1] == gained[2] == 0.0


def test_what_stands_in_the_way_takes_the_gain_away(ball):
    lid = np.array([[x, y, 0.08] for x in (-0.2, 0.2) for y in (-0.2, 0.2)])
    lid = np.concatenate([lid, lid + np.array([0.0, 0.0, 0.001])])
    faces = np.array([[0, 1, 2], [2, 1, 3], [4, 6, 5], [5, 6, 7]]) + len(ball.vertices)
    covered = TriangleMesh(
        vertices=np.concatenate([ball.vertices, lid]),
        faces=np.concatenate([ball.faces, faces]),
        expected_error_m=np.concatenate([ball.expected_error_m, np.full(8, 0.4e-3)]),
    )
    before, after = expected_errors(covered, [ABOVE])
    assert after[0] == pytest.approx(before)
    with pytest.raises(UserError, match="does not say its expected error"):
        expected_errors(replace(ball, expected_error_m=None), [ABOVE])


def test_the_plane_of_a_pose_covers_its_phase_centres():
    rng = np.random.default_rng(0)
    local = rng.uniform(-1, 1, (50, 2)) * HALF + [0.01, 0.02]
    centers = BESIDE.middle + local @ BESIDE.axes[1:]
    apart = np.array([0.0, 0.001, 0.0])
    pose = Pose(
        signal=np.zeros((50, 1), np.complex64),
        tx_positions=centers + apart,
        rx_positions=centers - apart,
        axes=BESIDE.axes,
    )
    plane = plane_of(pose)
    assert plane.half_m == pytest.approx(0.5 * np.ptp(local, axis=0))
    assert plane.axes == pytest.approx(BESIDE.axes)
    inside = np.abs((centers - plane.middle) @ plane.axes[1:].T) <= plane.half_m + 1e-12
    assert inside.all()
