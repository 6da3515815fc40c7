"""Smallest balls that stand out: window, noise, lobes, shadows, and balls that are then found."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from geraf2.echoes.detectability import LEAST_RADIUS_M, Detector, hann_response
from geraf2.echoes.glints import GlintConfig, find_echoes
from geraf2.echoes.labels import Clutter, Label
from geraf2.echoes.ruled_out import (
    Region,
    describe_ruled_out,
    region_numbers,
    rule_out,
    ruled_out_of,
    ruled_out_rows,
)
from geraf2.imaging.peaks import box_spans, collect_peaks
from geraf2.ops.visibility import MeshScene
from geraf2.scene import LosPrior
from helpers.specular import BOX_M, capture_of, signal_of_paths, sphere_paths

STRENGTH_M, BIG_M, NOISE = 1.0, 0.03, 1e-2
CONFIG, PRIOR = GlintConfig(), LosPrior.from_box(BOX_M)


def test_response_of_a_hann_window_against_its_transform():
    n = 256
    window = np.hanning(n + 2)[1:-1]
    for cells in (0.0, 0.4, 1.0, 1.7, 2.5, 3.6):
        turns = np.exp(2j * np.pi * cells * np.arange(n) / (n + 1))
        assert hann_response(np.array(cells)) == pytest.approx(
            abs((window * turns).sum()) / window.sum(), abs=2e-3
        )


def ball():
    made = trimesh.creation.icosphere(radius=BIG_M)
    made.apply_translation([0.0, 0.0, -0.03])
    return MeshScene(made.vertices, made.faces)


def with_ball(capture, center, radius):
    """Add the echo of a metal ball, a / 2 R^2 of a plane's, at the strength of metal."""
    poses = []
    for pose in capture.poses:
        away = np.linalg.norm(pose.tx_positions - center, axis=1)[:, None]
        echo = signal_of_paths(sphere_paths(pose.tx_positions, [center], [radius]))
        signal = pose.signal + STRENGTH_M * radius / (2.0 * away**2) * echo
        poses.append(replace(pose, signal=signal.astype(np.complex64)))
    return replace(capture, poses=tuple(poses))


@pytest.fixture(scope="module")
def capture():
    """A large ball in noise."""
    empty = capture_of(lambda positions, _: sphere_paths(positions, [[0.0, 0.0, 9.0]], [0.0]))
    rng, poses = np.random.default_rng(0), []
    for pose in empty.poses:
        parts = rng.standard_normal((2, *pose.signal.shape))
        poses.append(
            replace(pose, signal=(NOISE * (parts[0] + 1j * parts[1])).astype(np.complex64))
        )
    return with_ball(replace(empty, poses=tuple(poses)), [0.0, 0.0, -0.03], BIG_M)


def peaks_of(capture):
    return collect_peaks(capture, PRIOR, CONFIG.subaperture, CONFIG.noise_margin_db)


@pytest.fixture(scope="module")
def detector(capture):
    clutter = Clutter(support=10.0, strong=0.1)
    return Detector.of(capture, PRIOR, peaks_of(capture), CONFIG, STRENGTH_M, clutter)


def n_standing_out(peaks, center, radius):
    """Sub-apertures with a peak where a ball's echo lies."""
    near = np.linalg.norm(peaks.points - center, axis=1) < radius + 0.01
    return len(np.unique(peaks.subapertures[near]))


def test_balls_stand_out_from_the_radius_that_is_stated(capture, detector):
    for center in ([0.06, 0.02, 0.05], [-0.05, -0.06, 0.0]):
        needed = detector.needed_radii(np.array([center]))
        level = float(np.median(np.concatenate(needed, axis=1)))
        n_all = sum(one.shape[1] for one in needed)
        counts = []
        for share in (0.6, 1.7):
            changed = with_ball(capture, center, share * level)
            peaks = peaks_of(changed).within(box_spans(changed.poses, PRIOR))
            kept = peaks.select(peaks.levels_db >= -CONFIG.dynamic_range_db)
            kept = kept.select(kept.spaced(0.04)[kept.subapertures])
            counts.append(n_standing_out(kept, np.array(center), share * level) / n_all)
        assert counts[0] < 0.25
        assert counts[1] > 0.7


def test_a_ball_behind_another_one_or_in_its_lobe_is_hidden(detector):
    behind = np.array([[0.035, 0.0, -0.03]])
    free = np.concatenate(detector.needed_radii(behind), axis=1)
    hidden = np.concatenate(detector.needed_radii(behind, ball()), axis=1)
    assert np.isinf(hidden).sum() > np.isinf(free).sum() + 20
    # At the place of the large ball's own echo its lobe hides much, far from it the noise does.
    near = np.concatenate(detector.needed_radii(np.array([[0.0, 0.0, -0.03]])), axis=1)
    far = np.concatenate(detector.needed_radii(np.array([[0.0, 0.06, 0.07]])), axis=1)
    assert np.median(near) > 3.0 * np.median(far)


def test_more_clutter_and_stronger_returns_want_a_larger_ball(detector):
    points = np.array([[0.06, 0.02, 0.05], [-0.05, -0.06, 0.0]])
    radii = detector.smallest_radii(points)
    assert (radii >= LEAST_RADIUS_M).all()
    assert np.isfinite(radii).all()
    for clutter in (Clutter(support=0.1, strong=0.1), Clutter(support=10.0, strong=1e3)):
        assert (replace(detector, clutter=clutter).smallest_radii(points) > radii).all()
    nothing = replace(detector, peaks=detector.peaks.select(np.zeros(0, dtype=int)))
    assert np.isinf(nothing.smallest_radii(points)).all()


def test_odds_of_a_return_rise_with_support_and_strength():
    clutter = Clutter(support=8.0, strong=1.0)
    few, many = clutter.log_odds(np.array([0.0, 3.0]), np.array([0.0, 6.0]), np.array([1.0, 0.1]))
    assert few < 0.0 < many
    assert clutter.log_odds(3.0, 6.0, 0.01) == pytest.approx(many - 20.0 * 0.0467, abs=1e-9)


def test_parts_of_the_box_are_named_with_what_was_ruled_out(detector):
    regions = rule_out(detector, PRIOR, ball())
    names = [region.name for region in regions]
    assert names[:3] == ["in the box", "below the content", "above the content"]
    assert names[-1].startswith("z = ")
    assert all(0.0 <= region.unseen_share <= 1.0 for region in regions)
    assert all(r.plastic_mm is None or r.plastic_mm > r.metal_mm for r in regions)
    assert ruled_out_of(region_numbers(regions)) == regions
    assert len(ruled_out_rows(regions)) == len(regions)


def test_the_line_states_metal_and_plastic():
    whole = Region(name="in the box", metal_mm=9.0, plastic_mm=37.0, unseen_share=0.0)
    below = Region(name="below the content", metal_mm=14.0, plastic_mm=None, unseen_share=0.5)
    assert describe_ruled_out([whole, below]) == (
        "no metal ball above 9 mm in 95 % of the box, 14 mm below the content; no plastic ball "
        "above 37 mm in 95 % of the box, none ruled out below the content"
    )
    blind = Region(name="in the box", metal_mm=None, plastic_mm=None, unseen_share=0.3)
    assert "a metal ball of 40 mm cannot be ruled out" in describe_ruled_out([blind])
    assert describe_ruled_out([]) == ""
    assert region_numbers([]) == {}


def test_the_clutter_of_a_scan_is_that_of_its_labels(capture):
    peaks = peaks_of(capture)
    found = find_echoes(capture, PRIOR, CONFIG, peaks=peaks)
    n_direct = int((found.labelled.labels == Label.DIRECT).sum())
    assert n_direct > 100
    assert 0.5 * peaks.magnitudes.max() < found.clutter.strong <= peaks.magnitudes.max()
    # A scan of one ball has little else: its support is far above that of a cluttered one.
    assert found.clutter.support > 10.0
    assert set(found.clutter.numbers()) == {"support_over_clutter", "strong_magnitude"}
