"""Labels of peaks: a slow twin of the rule, and what it makes of peaks whose origin is known."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2.echoes.hypotheses import find_candidates
from geraf2.echoes.labels import Label, label_peaks, posterior
from geraf2.imaging.peaks import join_peaks
from geraf2.ops.visibility import MeshScene
from geraf2.scene import LosPrior
from helpers.peak_sets import peaks_of_plane, positions_of, sphere_peaks
from helpers.specular import BOX_M, frame, pose_of, raster, sphere_paths

BOX = LosPrior.from_box((BOX_M,) * 3)
VOLUME_M3 = BOX_M**3
MARGIN_M = 0.012
RADIUS_M = 0.03
PERIOD = 3.8e-3 / (2 * 8e-3)
POSES = [
    pose_of(30.0 * number, raster(2), lambda tx, _: sphere_paths(tx, [[0, 0, 0]], [RADIUS_M]))
    for number in range(12)
]


def found_in(peaks):
    scene = MeshScene(BOX.vertices, BOX.faces)
    return find_candidates(peaks, POSES, scene, (), wall_margin_m=MARGIN_M, range_correction_m=0.0)


def labelled(peaks):
    return label_peaks(peaks, found_in(peaks), VOLUME_M3, MARGIN_M)


def scattered(n, seed=0, period=np.inf, low=-0.08, high=0.08):
    """Peaks of points anywhere in the box, each seen once, by all planes in turn."""
    rng = np.random.default_rng(seed)
    parts = []
    for number in range(12):
        axes = frame(30.0 * number)
        positions = rng.uniform(-0.03, 0.03, (n // 12, 2))
        leg = rng.uniform(low, high, (n // 12, 3)) - (-0.4 * axes[0] + positions @ axes[1:])
        far = np.linalg.norm(leg, axis=1)
        cosines = (leg / far[:, None]) @ axes[1:].T
        parts.append(peaks_of_plane(number, positions, cosines, far, period))
    return join_peaks(parts)


def test_a_surface_is_direct_and_scatterers_are_clutter():
    surface, clutter = sphere_peaks((0, 0, 0), RADIUS_M, range(12)), scattered(96)
    found = labelled(join_peaks([surface, clutter]))
    is_surface = found.candidates.peaks < len(surface)
    assert (found.labels[is_surface] == Label.DIRECT).mean() > 0.97
    assert (found.labels[~is_surface] == Label.CLUTTER).mean() > 0.9
    assert found.probability[is_surface].mean() > 0.8
    assert sum(found.counts().values()) == len(surface) + len(clutter)


@pytest.mark.parametrize("center", [(0.0, 0.0, 0.065), (0.0, 0.055, 0.055)])
def test_grating_lobes_are_moved_to_their_true_direction(center):
    """At 8 mm cosines beyond 0.12 wrap around; the sphere lies at 0.17."""
    planes = [0, 1, 11]
    found = labelled(sphere_peaks(center, RADIUS_M, planes, PERIOD))
    offset = np.linalg.norm(found.candidates.positions - center, axis=1) - RADIUS_M
    believed = found.probability > 0.5
    assert believed.mean() > 0.9
    assert np.abs(offset[believed]).max() < 1e-3
    assert (found.labels == Label.ALIAS).sum() > 10


def test_a_grating_lobe_of_a_wall_is_the_wall():
    """A flash of the near wall, whose image shows a period beside, is no return of the content."""
    positions = positions_of()
    flash = np.tile([PERIOD, 0.0], (len(positions), 1))
    walls = join_peaks(
        [
            peaks_of_plane(number, positions, flash, np.full(len(positions), 0.3), PERIOD)
            for number in (0, 3, 6, 9)
        ]
    )
    surface = sphere_peaks((0, 0, 0), RADIUS_M, range(12), PERIOD)
    found = labelled(join_peaks([walls, surface]))
    of_wall = found.candidates.peaks < len(walls)
    assert (found.labels[of_wall] == Label.WALL).all()
    assert (found.labels[~of_wall] == Label.DIRECT).mean() > 0.97


def test_without_peaks_there_are_no_labels():
    peaks = sphere_peaks((0, 0, 0), RADIUS_M, [0])
    nothing = peaks.select(np.zeros(len(peaks), dtype=bool))
    found = labelled(nothing)
    assert len(found.labels) == len(found.probability) == 0
    assert found.counts() == {}


def test_the_cloud_holds_every_peak_with_probability_and_label():
    found = labelled(join_peaks([sphere_peaks((0, 0, 0), RADIUS_M, range(12)), scattered(24)]))
    front, back = np.eye(3, dtype=bool)[:2]
    placed = found.on_faces(np.arange(3), front, back)
    data = placed.cloud_bytes()
    head, body = data.split(b"end_header\n", 1)
    assert b"element vertex %d\n" % len(found.labels) in head
    names = [*("x", "y", "z", "nx", "ny", "nz", "probability")]
    rows = np.frombuffer(body, dtype=[*((name, "<f4") for name in names), ("label", "u1")])
    np.testing.assert_allclose(rows["y"], found.candidates.positions[:, 1], atol=1e-7)
    np.testing.assert_allclose(rows["probability"][3:], found.probability[3:], atol=1e-7)
    assert rows["label"][:3].tolist() == [Label.DIRECT, Label.SEEN_THROUGH, Label.CLUTTER]
    assert rows["probability"][0] == pytest.approx(found.probability[0])
    assert rows["probability"][1:3].tolist() == [0.0, 0.0]


def test_beyond_an_assumed_face_a_lone_peak_needs_more_evidence_than_a_surface():
    surface = sphere_peaks((0, 0, 0), RADIUS_M, range(12))
    peaks = join_peaks([surface, scattered(24)])
    found = found_in(peaks)
    inside = found.depth_m > MARGIN_M
    unlikely = replace(found, presence=np.full(len(found), 0.1))
    known, assumed = (posterior(peaks, each, VOLUME_M3, inside) for each in (found, unlikely))
    of_sphere = found.peaks < len(surface)
    assert (assumed[of_sphere & inside] > 0.5).mean() > 0.9
    lone = ~of_sphere & inside
    assert (assumed[lone] < 0.3 * known[lone]).all()
