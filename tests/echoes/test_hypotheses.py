"""Candidates of peaks against a search over all periods, one by one."""

import numpy as np
import pytest

from geraf2.echoes.hypotheses import find_candidates
from geraf2.ops.visibility import MeshScene
from geraf2.scene import LosPrior, Pose
from helpers.peak_sets import sphere_peaks
from helpers.specular import BOX_M, antennas, raster

BOX = LosPrior.from_box((BOX_M,) * 3)
MARGIN_M, PERIOD = 0.012, 0.2375


@pytest.fixture(scope="module")
def poses():
    made = []
    for number in range(3):
        tx, rx, axes = antennas(30.0 * number, raster(2))
        signal = np.zeros((len(tx), 8), dtype=np.complex64)
        made.append(Pose(signal=signal, tx_positions=tx, rx_positions=rx, axes=axes))
    return made


def candidates(peaks, poses, walls=(), **options):
    scene = MeshScene(BOX.vertices, BOX.faces)
    return find_candidates(peaks, poses, scene, walls, wall_margin_m=MARGIN_M, **options)


def test_all_periods_in_the_box_are_candidates(poses):
    peaks = sphere_peaks((0.0, 0.03, 0.065), 0.02, [0, 2], PERIOD)
    found = candidates(peaks, poses, range_correction_m=0.0)
    expected = set()
    for k in range(len(peaks)):
        axes = poses[peaks.planes[k]].axes
        _, h, v = axes @ peaks.directions[k]
        for a in range(-2, 3):
            for b in range(-2, 3):
                u, w = h + a * PERIOD, v + b * PERIOD
                if u**2 + w**2 >= 0.9**2 and (a or b):
                    continue
                ahead = np.array([np.sqrt(1.0 - u**2 - w**2), u, w]) @ axes
                point = peaks.centers[k] + peaks.ranges_m[k] * ahead
                beyond = np.abs(point).max() - 0.5 * BOX_M
                if beyond < MARGIN_M or not (a or b):
                    expected.add((k, *np.round(point, 9), bool(a or b)))
    seen = {
        (int(k), *np.round(p, 9), bool(a))
        for k, p, a in zip(found.peaks, found.positions, found.is_alias, strict=True)
    }
    # Beside an edge of the box the distance to its surface is longer than beyond one face.
    assert seen <= expected
    assert len(seen) > 0.9 * len(expected)
    assert found.is_alias.any()


def test_a_fine_raster_has_no_aliases(poses):
    peaks = sphere_peaks((0.0, 0.0, 0.0), 0.03, [0, 1])
    found = candidates(peaks, poses, range_correction_m=0.0)
    np.testing.assert_array_equal(found.peaks, np.arange(len(peaks)))
    np.testing.assert_allclose(found.positions, peaks.points)
    np.testing.assert_allclose(found.normals, -peaks.directions)


def test_no_peaks_no_candidates(poses):
    peaks = sphere_peaks((0.0, 0.0, 0.0), 0.03, [0])
    assert len(candidates(peaks.select(np.zeros(len(peaks), dtype=bool)), poses)) == 0
