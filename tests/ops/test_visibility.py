import numpy as np
import pytest
from skimage.measure import marching_cubes

from geraf2.geometry.boxes import FACES, box_corners
from geraf2.ops.visibility import MeshScene
from reference import visibility as reference

pytestmark = pytest.mark.embree


@pytest.fixture(scope="module")
def torus():
    """Torus of radii 5 and 2 cm in general position: rays meet up to four faces."""
    axis = np.linspace(-0.08, 0.08, 24)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    level = np.hypot(np.hypot(x, y) - 0.05, z) - 0.02
    vertices, faces, _, _ = marching_cubes(level, 0.0, spacing=(axis[1] - axis[0],) * 3)
    turn, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    vertices = (vertices - 0.08) @ turn.T + np.array([0.4, -0.1, 0.2])
    return vertices.astype(np.float64), faces.astype(np.int64)


@pytest.fixture(scope="module")
def rays(torus):
    rng = np.random.default_rng(5)
    center = torus[0].mean(axis=0)
    origins = center + rng.uniform(-0.15, 0.15, (200, 3))
    targets = center + rng.uniform(-0.05, 0.05, (200, 3))
    return origins, (targets - origins) * rng.uniform(0.1, 30.0, (200, 1))


def test_closest_hit_agrees_with_moller_trumbore(torus, rays):
    distances, faces = MeshScene(*torus).closest_hit(*rays)
    n_hits = 0
    for i, (origin, direction) in enumerate(zip(*rays, strict=True)):
        t, _, face = reference.ray_hits(*torus, origin, direction)
        if len(t) == 0:
            assert np.isinf(distances[i])
            assert faces[i] == -1
        else:
            n_hits += 1
            # float32 rays: 1e-7 of the scene, over the cosine of a grazing face
            assert distances[i] == pytest.approx(t[0], abs=1e-6)
            assert faces[i] in face[np.isclose(t, t[0], atol=1e-6)]
    assert n_hits > 100


@pytest.mark.parametrize("inward", [False, True])
def test_spans_are_the_ends_of_all_stretches(torus, rays, inward):
    """Some rays start inside, some miss, some pass through twice."""
    vertices, faces = torus
    scene = MeshScene(vertices, faces[:, ::-1] if inward else faces)
    near, far = scene.spans(*rays)
    intervals = scene.entry_exit(*rays)
    np.testing.assert_array_equal(near, intervals.t_entry[:, 0])
    ends = np.where(np.isfinite(intervals.t_exit), intervals.t_exit, -np.inf)
    np.testing.assert_array_equal(far, ends.max(axis=1))
    assert (near == 0.0).any()
    assert np.isinf(near).any()
    assert np.isfinite(intervals.t_entry[:, 1]).any()


def test_segments_first_meet_the_mesh_where_the_closest_hit_is(torus, rays):
    scene, (origins, legs) = MeshScene(*torus), rays
    targets = origins + legs
    targets[5] = origins[5]
    distances, _ = scene.closest_hit(origins, np.where(legs == 0.0, 1.0, legs))
    share = np.minimum(distances / np.linalg.norm(legs, axis=1), 1.0)[:, None]
    want = origins + share * legs
    want[5] = origins[5]
    np.testing.assert_allclose(scene.first_meetings(origins, targets), want, atol=1e-12)
    assert 10 < np.count_nonzero(share == 1.0) < 190


def test_entry_exit_agrees_with_all_crossings_by_moller_trumbore(torus, rays):
    intervals = MeshScene(*torus).entry_exit(*rays)
    assert intervals.t_entry.shape[1] == 2
    for i, (origin, direction) in enumerate(zip(*rays, strict=True)):
        t, entering, _ = reference.ray_hits(*torus, origin, direction)
        expected_entry = t[entering]
        if len(t) and not entering[0]:
            expected_entry = np.concatenate([[0.0], expected_entry])
        got_entry = intervals.t_entry[i][np.isfinite(intervals.t_entry[i])]
        got_exit = intervals.t_exit[i][np.isfinite(intervals.t_exit[i])]
        assert got_entry == pytest.approx(expected_entry, abs=2e-6)
        assert got_exit == pytest.approx(t[~entering], abs=2e-6)


def test_occluded_agrees_with_hits_between_the_ends(torus, rays):
    origins, directions = rays
    targets = origins + directions * 0.2
    blocked = MeshScene(*torus).occluded(origins, targets)
    expected = []
    for origin, target in zip(origins, targets, strict=True):
        t, _, _ = reference.ray_hits(*torus, origin, target - origin)
        expected.append(bool((t < np.linalg.norm(target - origin)).any()))
    assert blocked.tolist() == expected
    assert 20 < blocked.sum() < 180


def test_a_face_does_not_hide_its_own_points(torus):
    vertices, faces = torus
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    centers = corners.mean(axis=1)
    blocked = MeshScene(vertices, faces).occluded(centers, centers + 0.002 * normals)
    assert not blocked.any()


def test_winding_number_agrees_with_brute_force(torus):
    vertices, faces = torus
    faces = faces[: len(faces) // 2]  # an open mesh: neither 0 nor 1
    points = vertices.mean(axis=0) + np.random.default_rng(9).uniform(-0.1, 0.1, (50, 3))
    got = MeshScene(vertices, faces).winding_number(points)
    expected = reference.solid_angle_winding(vertices, faces, points)
    assert got == pytest.approx(expected, abs=1e-12)
    assert np.ptp(got) > 0.1


def test_points_on_edges_and_corners_of_a_box_are_handled():
    from geraf2.scene import LosPrior  # noqa: PLC0415 - only this test needs a box

    box = LosPrior.from_box((0.2, 0.2, 0.2))
    scene = MeshScene(box.vertices, box.faces)
    # The diagonal of a face, an edge's direction, and the corner itself.
    signed = scene.signed_distance(
        np.array([[0.2, 0.0, 0.0], [0.0, 0.0, 0.0], [0.2, 0.2, 0.2], [0.1, 0.1, 0.1]])
    )
    assert signed[:2] == pytest.approx([0.1, -0.1])
    assert signed[2] == pytest.approx(0.1 * np.sqrt(3))
    assert signed[3] == pytest.approx(0.0, abs=1e-12)
    intervals = scene.entry_exit([[-1.0, 0.0, 0.0]], [[1.0, 0.0, 0.0]])
    assert intervals.t_entry.tolist() == [[pytest.approx(0.9)]]
    assert intervals.t_exit.tolist() == [[pytest.approx(1.1)]]


def test_an_inward_wound_mesh_has_the_same_inside(torus):
    vertices, faces = torus
    points = vertices.mean(axis=0) + np.random.default_rng(11).uniform(-0.08, 0.08, (200, 3))
    outward, inward = MeshScene(vertices, faces), MeshScene(vertices, faces[:, ::-1])
    inside = outward.contains(points)
    assert inside.any()
    assert np.array_equal(inside, inward.contains(points))
    ray = (points, np.full_like(points, 1.0))
    assert np.allclose(outward.entry_exit(*ray).t_exit, inward.entry_exit(*ray).t_exit, atol=1e-9)


def test_empty_batches_give_empty_results(torus):
    scene = MeshScene(*torus)
    nothing = np.zeros((0, 3))
    assert scene.closest_hit(nothing, nothing)[0].shape == (0,)
    assert scene.entry_exit(nothing, nothing).t_entry.shape == (0, 0)
    assert scene.occluded(nothing, nothing).shape == (0,)
    assert scene.signed_distance(nothing).shape == (0,)


def test_the_distance_is_that_of_the_twin_in_any_order(torus):
    rng = np.random.default_rng(8)
    center = torus[0].mean(axis=0)
    points = center + rng.uniform(-0.1, 0.1, (300, 3))
    points[:20] = torus[0][:20]  # on the surface
    points[20:40] = center + rng.uniform(-5.0, 5.0, (20, 3))
    points[40:60] = points[60:80]  # twice the same
    scene = MeshScene(*torus)
    found = scene.distance(points)
    np.testing.assert_array_equal(found, np.abs(scene.signed_distance(points)))
    alone = [scene.distance(point[None])[0] for point in points]
    np.testing.assert_allclose(found, alone, rtol=0, atol=1e-8)
    order = np.argsort(points[:, 0])
    np.testing.assert_allclose(scene.distance(points[order]), found[order], rtol=0, atol=1e-8)
    expected = reference.unsigned_distance(*torus, points)
    np.testing.assert_allclose(found[:20], expected[:20], atol=1e-7)
    np.testing.assert_allclose(found[20:], expected[20:], atol=1e-9)
    inside = reference.solid_angle_winding(*torus, points[20:]) > 0.5
    np.testing.assert_array_equal(scene.signed_distance(points[20:]) < 0.0, inside)
    assert 10 < inside.sum() < 200


def test_signs_of_a_raster_are_those_of_its_points_one_by_one(torus):
    scene = MeshScene(*torus, num_threads=1)
    low, high = torus[0].min(axis=0) - 0.01, torus[0].max(axis=0) + 0.01
    steps = [np.linspace(a, b, 23) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = scene.signed_distance(points) < 0.0
    assert inside.sum() > 500
    np.testing.assert_array_equal(inside, scene.contains(points))
    # Neighbours in this order are far apart, so that no sign is taken over.
    order = np.random.default_rng(0).permutation(len(points))
    np.testing.assert_array_equal(inside[order], scene.signed_distance(points[order]) < 0.0)


@pytest.mark.parametrize("step", [0.0, 1e-17, 1e-16, 1e-12, 1e-9])
def test_points_on_a_surface_that_lie_close_together_are_near_it(step):
    rng = np.random.default_rng(1)
    low, high = np.array([-0.07, -0.065, -0.06]), np.array([0.09, 0.105, 0.12])
    vertices, faces = box_corners(0.5 * (low + high), high - low), FACES
    corners = vertices[faces[rng.integers(0, 12, 1000)]]
    points = np.einsum("nk,nki->ni", rng.dirichlet([1, 1, 1], 1000), corners).repeat(4, axis=0)
    points += step * rng.normal(size=points.shape)
    scene = MeshScene(vertices, faces, num_threads=1)
    assert np.abs(scene.signed_distance(points)).max() < 1e-8
    assert scene.distance(points).max() < 1e-8
    assert scene.distance(points[:0]).shape == (0,)
