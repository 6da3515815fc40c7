"""Echo of a surface against its equation and closed forms."""

import numpy as np
import pytest

from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.geometry.triangles import split_triangles
from geraf2.io.mesh import TriangleMesh
from geraf2.ops.visibility import MeshScene
from geraf2.scene import LosPrior
from geraf2.surfaces.facets import Facets, SurfaceRenderer
from helpers.solids import ball
from helpers.synthetic import WAVEFORM, point_pose

PRIOR = LosPrior.from_box((0.16, 0.16, 0.16))
POSE = point_pose(0.0, n_side=5, spacing_m=0.01)
FAR_AWAY = MeshScene(np.eye(3) + 9.0, [[0, 1, 2]])


def facets(mesh, edge_m=0.002):
    return Facets.of_triangles(split_triangles(np.asarray(mesh.vertices)[mesh.faces], edge_m))


def nothing():
    return Facets(points=np.zeros((0, 3)), normals=np.zeros((0, 3)), areas=np.zeros(0))


def renderer(content, outside=None, blocker=FAR_AWAY, **options):
    outside = nothing() if outside is None else outside
    return SurfaceRenderer(content, outside, blocker, WAVEFORM, (0.0, 0.0, 0.0), **options)


def reference(points, normals, areas, pose):
    """The sum of the docstring with spreading from each antenna, all points seen."""
    centers = 0.5 * (pose.tx_positions + pose.rx_positions)
    signal = np.zeros(pose.signal.shape, dtype=complex)
    for point, normal, area in zip(points, normals, areas, strict=True):
        for a, (tx, rx) in enumerate(zip(pose.tx_positions, pose.rx_positions, strict=True)):
            to_tx, to_rx = tx - point, rx - point
            out, back = np.linalg.norm(to_tx), np.linalg.norm(to_rx)
            incoming = -to_tx / out
            mirrored = incoming - 2 * (normal @ incoming) * normal
            lobe = max(mirrored @ to_rx / back, 0.0)
            r_0 = np.linalg.norm(centers[a])
            spread = (r_0 / np.linalg.norm(centers[a] - point)) ** 2
            path = out + back + WAVEFORM.path_bias_m
            phase = 2 * np.pi * WAVEFORM.frequencies_hz * path / SPEED_OF_LIGHT_M_PER_S
            signal[a] += area * spread * lobe * np.exp(-1j * phase)
    return signal


def test_parts_add_up_to_the_equation():
    rng = np.random.default_rng(0)
    points = 0.03 * rng.normal(size=(20, 3))
    normals = np.array([1.0, 0.0, 0.0]) + 0.2 * rng.normal(size=(20, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    areas = rng.uniform(1e-6, 2e-6, 20)
    content = Facets(points=points, normals=normals, areas=areas)
    shares = rng.uniform(size=(1, 20)) * [[1.0], [-1.0]] + [[0.0], [1.0]]
    parts = renderer(content, n_clusters=25).render(POSE, shares)
    expected = reference(points, normals, areas, POSE)
    scale = np.abs(expected).max()
    assert parts.shape == (4, *POSE.signal.shape)
    assert np.abs(parts[:2].sum(axis=0) - expected).max() < 3e-3 * scale
    assert not parts[2:].any()
    few = renderer(content).render(POSE, np.ones((1, 20)))[0]
    assert np.abs(few - expected).max() < 0.05 * scale


def test_a_sphere_echoes_as_its_highlight():
    # Stationary phase: the integral over the surface is pi / (k (1/a + 1/D)) at the point nearest
    # to the antenna, D away; here relative to the middle, D + a away.
    radius, standoff = 0.04, 0.4
    pose = point_pose(0.0, n_side=1, standoff_m=standoff)
    mesh = ball(radius, 5)
    blocker = MeshScene(mesh.vertices, mesh.faces)
    content = facets(mesh, 0.0015)
    signal = renderer(content, blocker=blocker).render(pose, np.ones((1, len(content.areas))))[0]
    k = 2 * np.pi * WAVEFORM.frequencies_hz.mean() / SPEED_OF_LIGHT_M_PER_S
    distance = standoff - radius
    expected = np.pi / (k * (1 / radius + 1 / distance)) * (standoff / distance) ** 2
    assert np.abs(signal).mean() == pytest.approx(expected, rel=0.03)


def test_a_blocker_hides_content_and_far_wall_but_not_the_near_wall():
    wide = TriangleMesh(
        vertices=np.array([[0.05, -1.0, -1.0], [0.05, 1.0, -1.0], [0.05, 0.0, 2.0]]),
        faces=np.array([[0, 1, 2]]),
    )
    content = facets(ball(0.02), 0.004)
    outside = facets(TriangleMesh(vertices=PRIOR.vertices, faces=PRIOR.faces), 0.01)
    share = np.ones((1, len(content.areas)))
    free = renderer(content, outside).render(POSE, share)
    hidden = renderer(content, outside, MeshScene(wide.vertices, wide.faces)).render(POSE, share)
    assert (np.abs(free).max(axis=(1, 2)) > 0).all()
    assert not hidden[0].any()
    assert not hidden[2].any()
    np.testing.assert_array_equal(hidden[1], free[1])


def test_walls_move_the_content_farther_away():
    content = Facets(points=np.zeros((1, 3)), normals=np.array([[1.0, 0.0, 0.0]]), areas=np.ones(1))
    pose = point_pose(0.0, n_side=1)
    plain = renderer(content).render(pose, np.ones((1, 1)))[0]
    late = renderer(content, excess_path=lambda a, d, r: np.full(len(r), 0.001)).render(
        pose, np.ones((1, 1))
    )[0]
    turn = 2 * np.pi * WAVEFORM.frequencies_hz * 0.002 / SPEED_OF_LIGHT_M_PER_S
    np.testing.assert_allclose(late, plain * np.exp(-1j * turn), atol=5e-3)


def test_no_facets_make_no_echo():
    assert not renderer(nothing()).render(POSE, np.zeros((1, 0))).any()
