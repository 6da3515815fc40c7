import numpy as np
import pytest

from geraf2.echoes import glints as glints_module
from geraf2.echoes.glints import (
    GlintConfig,
    agreement_of,
    count_agreeing,
    find_glints,
    major_clusters,
    trusted_depth_db,
)
from geraf2.errors import UserError
from geraf2.imaging.subapertures import SubapertureConfig
from geraf2.scene import Capture, LosPrior, Pose
from specular import (
    BOX_M,
    STANDOFF_M,
    capture_of,
    fibonacci_sphere,
    raster,
    sphere_capture,
    sphere_paths,
)

BOX = LosPrior.from_box((BOX_M, BOX_M, BOX_M))
RADIUS_M = 0.04
# A 4 cm sphere spans 0.1 in direction cosine: less than a third of the default is enough.
NARROW = GlintConfig(subaperture=SubapertureConfig(max_cosine=0.2))


@pytest.fixture(scope="module")
def capture():
    return sphere_capture([[0.0, 0.0, 0.0]], [RADIUS_M])


@pytest.fixture(scope="module")
def glints(capture):
    return find_glints(capture, BOX)


def errors(glints, centers, radii):
    """Signed distance and angle of each glint from the nearest of the spheres."""
    offset = glints.positions[:, None] - np.asarray(centers)
    distance = np.linalg.norm(offset, axis=2) - np.asarray(radii)
    nearest = np.abs(distance).argmin(axis=1)
    rows = np.arange(len(glints))
    normal = offset[rows, nearest] / np.linalg.norm(offset[rows, nearest], axis=1, keepdims=True)
    cosine = np.einsum("ij,ij->i", normal, glints.normals)
    return distance[rows, nearest], np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def test_all_glints_of_a_sphere_lie_on_it_and_face_outward(glints):
    distance, angle = errors(glints, [[0.0, 0.0, 0.0]], [RADIUS_M])
    assert len(glints) == 12 * 16  # one for each sub-aperture
    assert np.abs(distance).max() < 1e-3
    assert abs(distance.mean()) < 3e-4
    assert angle.max() < 3.0
    np.testing.assert_allclose(np.linalg.norm(glints.normals, axis=1), 1.0, atol=1e-12)
    np.testing.assert_array_equal(np.unique(glints.poses), np.arange(12))


def test_the_uncertainty_covers_the_error(glints):
    distance, angle = errors(glints, [[0.0, 0.0, 0.0]], [RADIUS_M])
    assert np.mean(np.abs(distance) < 2.5 * glints.position_sigma_m) > 0.9
    assert np.mean(np.radians(angle) < 2.5 * glints.normal_sigma_rad) > 0.9


def test_irregular_positions_place_the_glints_alike():
    places = raster(41)
    places = places + np.random.default_rng(0).uniform(-1e-3, 1e-3, places.shape)
    capture = sphere_capture([[0.0, 0.0, 0.0]], [RADIUS_M], n_poses=2, places=places)
    config = GlintConfig(subaperture=SubapertureConfig(max_cosine=0.15))
    found = find_glints(capture, BOX, config)
    distance, angle = errors(found, [[0.0, 0.0, 0.0]], [RADIUS_M])
    assert len(found) >= 2 * 9
    assert set(found.poses.tolist()) == {0, 1}
    # Focused range by range, all would lie 0.9 mm inside the sphere.
    assert np.abs(distance).max() < 3e-4
    assert angle.max() < 3.0


def test_two_spheres_are_told_apart():
    centers, radii = [[0.0, 0.0, 0.04], [0.01, 0.0, -0.045]], [0.03, 0.025]
    found = find_glints(sphere_capture(centers, radii), BOX)
    distance, angle = errors(found, centers, radii)
    upper = found.positions[:, 2] > 0.0
    assert upper.sum() >= 60
    assert (~upper).sum() >= 60
    # The other echo's side lobes push each peak a little.
    assert np.abs(distance).max() < 2e-3
    assert np.median(angle) < 2.0


def test_noise_of_the_same_power_makes_no_false_glints():
    found = find_glints(sphere_capture([[0, 0, 0]], [RADIUS_M], noise=1.0), BOX)
    distance, _ = errors(found, [[0.0, 0.0, 0.0]], [RADIUS_M])
    assert len(found) >= 100
    assert np.mean(np.abs(distance) > 2e-3) < 0.02


def among_scatterers(amplitude):
    """A sphere among points that echo by so much in amplitude; noise as strong as the sphere."""
    rng = np.random.default_rng(5)
    points = rng.uniform(-0.08, 0.08, (150, 3))
    points = points[np.linalg.norm(points, axis=1) > RADIUS_M + 0.01]
    sphere = sphere_capture([[0, 0, 0]], [RADIUS_M], noise=1.0)
    clutter = sphere_capture(points, np.zeros(len(points)))
    poses = tuple(
        Pose(**{**vars(pose), "signal": pose.signal + np.complex64(amplitude) * other.signal})
        for pose, other in zip(sphere.poses, clutter.poses, strict=True)
    )
    return Capture(waveform=sphere.waveform, poses=poses)


@pytest.mark.parametrize(("amplitude", "margin_db"), [(0.0, 12.0), (0.1, 15.0)])
def test_the_noise_margin_is_larger_among_scatterers(amplitude, margin_db):
    capture = among_scatterers(amplitude)
    found = find_glints(capture, BOX)
    expected, other = (
        find_glints(capture, BOX, GlintConfig(noise_margin_db=margin))
        for margin in (margin_db, 27.0 - margin_db)
    )
    np.testing.assert_array_equal(found.positions, expected.positions)
    if amplitude > 0.0:
        assert len(other) > len(expected)


def test_what_hangs_on_to_no_strong_glint_goes_among_scatterers(monkeypatch):
    capture, config = among_scatterers(0.07), GlintConfig(noise_margin_db=15.0)
    right, wrong = [], []
    for clutter in (1.0, glints_module.CLUTTER):
        monkeypatch.setattr(glints_module, "CLUTTER", clutter)
        distance, _ = errors(find_glints(capture, BOX, config), [[0.0, 0.0, 0.0]], [RADIUS_M])
        right.append(np.count_nonzero(np.abs(distance) < 2e-3))
        wrong.append(np.count_nonzero(np.abs(distance) > 3e-3))
    assert right[1] == right[0] > 100
    assert 100 < wrong[1] < 0.5 * wrong[0]


def test_the_order_of_the_antennas_does_not_matter(capture, glints):
    rng = np.random.default_rng(3)
    poses = []
    for pose in capture.poses:
        order = rng.permutation(pose.n_antennas)
        rows = {k: vars(pose)[k][order] for k in ("signal", "tx_positions", "rx_positions")}
        poses.append(Pose(**{**vars(pose), **rows}))
    found = find_glints(Capture(waveform=capture.waveform, poses=tuple(poses)), BOX)
    np.testing.assert_allclose(found.positions, glints.positions, atol=1e-6)
    np.testing.assert_allclose(found.normals, glints.normals, atol=1e-5)


def test_the_range_correction_is_taken_off_along_the_line_of_sight(capture, glints):
    config = GlintConfig(range_correction_m=0.001)
    found = find_glints(capture, BOX, config)
    np.testing.assert_allclose(found.positions, glints.positions + 0.001 * glints.normals)


def test_progress_rises_to_one():
    seen = []
    capture = sphere_capture([[0.0, 0.0, 0.0]], [RADIUS_M], n_poses=3)
    find_glints(capture, BOX, NARROW, progress=seen.append)
    np.testing.assert_allclose(seen, [1 / 3, 2 / 3, 1.0])


class TestNothingFound:
    def message(self, paths_of, **options):
        capture = capture_of(paths_of, **{"n_poses": 4, "places": raster(27), **options})
        with pytest.raises(UserError) as caught:
            find_glints(capture, BOX, NARROW)
        return str(caught.value)

    def test_an_empty_box_tells_of_its_walls(self):
        def walls(positions, axes):
            near = -positions @ axes[0] - BOX_M / 2
            return 2.0 * np.stack([near, near + BOX_M], axis=1)

        text = self.message(walls)
        assert "no glint inside the box" in text
        # two walls in each of four poses
        assert "8 echoes of the box's walls and 0 outside it" in text
        assert "at ranges from 0.30 to 0.50 m" in text

    def test_echoes_beside_the_box_are_counted(self):
        def behind(positions, axes):
            return sphere_paths(positions, [0.115 * axes[0]], [0.0])

        assert "0 echoes of the box's walls and 4 outside it" in self.message(behind)

    def test_noise_alone_says_that_nothing_stands_out(self):
        def nothing(positions, axes):
            return np.zeros((len(positions), 0))

        assert "no echo 12 dB above the noise" in self.message(nothing, noise=1.0)

    def test_a_lone_echo_has_no_neighbours(self):
        text = self.message(lambda p, _: sphere_paths(p, [[0.03, 0.0, 0.0]], [0.0]), n_poses=1)
        assert "1 scattered echoes" in text
        assert "1 agreeing neighbours within 8 mm" in text


class TestNeighbours:
    config = GlintConfig()
    up = np.array([0.0, 0.0, 1.0])

    def count(self, positions, normals=None):
        normals = np.tile(self.up, (len(positions), 1)) if normals is None else normals
        return list(count_agreeing(np.asarray(positions, float), normals, self.config))

    def test_neighbours_lie_near_and_on_the_tangent_plane(self):
        here = [0.0, 0.0, 0.0]
        assert self.count([here, [0.007, 0, 0.002]]) == [1, 1]
        assert self.count([here, [0.009, 0, 0]]) == [0, 0]
        assert self.count([here, [0.003, 0, 0.003]]) == [0, 0]
        assert self.count([here, [0.004, 0, 0], [-0.003, 0, 0]]) == [2, 2, 2]

    def test_each_judges_by_its_own_tangent_plane(self):
        tilted = np.array([[0, 0, 1.0], [-np.sin(0.4), 0, np.cos(0.4)]])
        # 2 mm above one plane, 2 cos 0.4 - 7 sin 0.4 = -0.9 mm off the other
        assert self.count([[0, 0, 0], [0.007, 0, 0.002]], tilted) == [1, 1]
        # 0 above one, 7 sin 0.4 = 2.7 mm off the other
        assert self.count([[0, 0, 0], [0.007, 0, 0]], tilted) == [1, 0]

    def test_normals_must_agree(self):
        for angle, expected in ((0.49, 1), (0.51, 0)):
            normals = np.array([[0, 0, 1.0], [0, np.sin(angle), np.cos(angle)]])
            assert self.count([[0, 0, 0], [0.002, 0, 0]], normals) == [expected] * 2

    def test_only_stronger_ones_speak_for_a_glint(self):
        positions = np.array([[0, 0, 0], [0.002, 0, 0], [0.004, 0, 0]])
        normals = np.tile(self.up, (3, 1))
        levels = np.array([0.0, -10.0, -20.0])
        assert list(agreement_of(positions, normals, levels, self.config)) == [0, 1, 2]


class TestTrustedDepth:
    def depth(self, lowest_good):
        """Echoes agree down to a level; 40 in each step of 2 dB."""
        levels = -np.repeat(np.arange(0.5, 34.0, 2.0), 40)
        agreement = np.where(levels > -lowest_good, 2, 0)
        return trusted_depth_db(levels, agreement, 2)

    @pytest.mark.parametrize("level", [18.0, 22.0, 24.0])
    def test_it_stops_where_echoes_stop_to_agree(self, level):
        assert self.depth(level) == level

    def test_it_stays_within_its_limits(self):
        assert self.depth(10.0) == 18.0
        assert self.depth(40.0) == 26.0

    def test_too_few_echoes_do_not_stop_it(self):
        levels = -np.linspace(18.0, 30.0, 60, endpoint=False)  # ten in each step
        assert trusted_depth_db(levels, np.zeros(60, dtype=np.int64), 2) == 26.0


def test_clusters_with_next_to_no_strength_are_dropped():
    body = 0.03 * fibonacci_sphere(400)
    far = np.array([0.08, 0.0, 0.0]) + 1e-3 * fibonacci_sphere(5)
    positions = np.concatenate([body, far])
    weak = np.concatenate([np.ones(400), np.full(5, 0.05)])  # 0.06 %
    keep = major_clusters(positions, weak, GlintConfig())
    assert keep[:400].all()
    assert not keep[400:].any()
    strong = np.concatenate([np.ones(400), np.full(5, 0.5)])  # 0.6 %
    assert major_clusters(positions, strong, GlintConfig()).all()


def test_a_far_cluster_of_a_single_plane_needs_more_strength():
    body, spot = 0.03 * fibonacci_sphere(400), 1e-3 * fibonacci_sphere(5)
    corner = np.array([[0.08, 0.0, 0.0], [0.08, 0.0, 0.02]])  # near each other, far from the body
    positions = np.concatenate([body, spot + corner[0], spot + corner[1]])
    magnitudes = np.concatenate([np.ones(400), np.full(10, 0.5)])  # 0.6 % each
    poses = np.concatenate([np.arange(400) % 12, np.full(10, 7)])

    def kept(magnitudes=magnitudes, positions=positions, poses=poses):
        keep = major_clusters(positions, magnitudes, GlintConfig(), poses=poses)
        assert keep[:400].all()
        return int(keep[400:].sum())

    assert kept() == 0
    assert kept(poses=np.arange(410) % 12) == 10  # several planes see them
    two = np.concatenate([poses[:400], np.arange(10) % 2])
    assert kept(poses=two) == 10
    many = major_clusters(positions, magnitudes, GlintConfig(), poses=two, n_poses=12)
    assert many[:400].all()
    assert not many[400:].any()
    assert kept(magnitudes=np.concatenate([np.ones(400), np.full(10, 1.0)])) == 10  # 1.2 % each
    assert (
        kept(
            positions=np.concatenate(
                [body, 0.8 * (positions[400:] - corner[0]) + corner[0] - [0.02, 0, 0]]
            )
        )
        == 10
    )


def test_a_narrow_dynamic_range_drops_the_weaker_body():
    def paths(positions, axes):
        main = sphere_paths(positions, [[0.0, 0.0, 0.045]], [0.03])
        return np.concatenate([main] * 5 + [sphere_paths(positions, [[0, 0, -0.045]], [0.03])], 1)

    capture = capture_of(paths, n_poses=6)  # 14 dB apart
    sizes = []
    for depth_db in (10.0, 18.0):
        found = find_glints(capture, BOX, GlintConfig(dynamic_range_db=depth_db))
        sizes.append(int((found.positions[:, 2] < 0.0).sum()))
    assert sizes[0] == 0
    assert sizes[1] > 15


def test_the_standoff_of_the_test_capture_is_what_it_says(capture):
    middle = capture.poses[0].phase_centers.mean(axis=0)
    np.testing.assert_allclose(middle, [STANDOFF_M, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("name", "value"),
    [("neighbor_radius_m", 0.0), ("cluster_link_m", -1.0), ("dynamic_range_db", -3.0)],
)
def test_bad_settings_name_the_value(name, value):
    with pytest.raises(ValueError, match=f"{name}.*{value}"):
        GlintConfig(**{name: value})
