from dataclasses import replace

import numpy as np
import pytest

from geraf2.errors import UserError
from geraf2.imaging.plane_waves import depth_sharpness, keep_angles, search_depth
from geraf2.scene import Pose, Waveform

WAVEFORM = Waveform(
    start_frequency_hz=24e9, chirp_slope_hz_per_s=4e14, sample_rate_hz=1e6, n_samples=3
)
N_H, N_V, STEP = 40, 36, 0.0025


def pose_of(positions, path, waveform):
    """Antennas whose samples are of these two-way paths [m]."""
    signal = np.exp(2j * np.pi * path[:, None] * waveform.frequencies_hz / 299792458.0)
    return Pose(
        signal=signal.astype(np.complex64),
        tx_positions=positions,
        rx_positions=positions,
        axes=np.eye(3),
    )


def wave(angle_deg, azimuth_deg=20.0):
    """A plane wave over the raster, at all frequencies from one direction."""
    h, v = (a.ravel() for a in np.meshgrid(np.arange(N_H), np.arange(N_V), indexing="ij"))
    positions = STEP * np.stack([0.0 * h, h, v], axis=1)
    sine, azimuth = np.sin(np.deg2rad(angle_deg)), np.deg2rad(azimuth_deg)
    path = 2 * sine * (positions[:, 1] * np.cos(azimuth) + positions[:, 2] * np.sin(azimuth))
    return pose_of(positions, path, WAVEFORM)


def gain(pose, lowest, highest):
    """Amplitude that is left in the middle of the raster, where its edges do not reach."""
    kept = keep_angles(pose, WAVEFORM, lowest, highest).signal.reshape(N_H, N_V, -1)
    middle = (slice(12, -12), slice(12, -12))
    whole = pose.signal.reshape(N_H, N_V, -1)[middle]
    return np.abs((kept[middle] * whole.conj()).mean(axis=(0, 1)))


@pytest.mark.parametrize(
    ("angle", "limits", "expected"),
    [
        (20, (0, 60), 1.0),
        (75, (0, 60), 0.0),
        (0, (15, 60), 0.0),
        (30, (10, 60), 1.0),
        (15, (15, 60), 1 - np.exp(-1)),
        # in the middle of the slope from 0.8 sin(40) to sin(40)
        (np.rad2deg(np.arcsin(0.9 * np.sin(np.deg2rad(40)))), (0, 40), 0.5),
    ],
)
def test_waves_are_kept_by_their_angle(angle, limits, expected):
    assert gain(wave(angle), *limits) == pytest.approx(np.full(3, expected), abs=0.06)


def test_the_order_of_the_antennas_does_not_matter():
    pose = wave(25)
    order = np.random.default_rng(0).permutation(pose.n_antennas)
    straight = keep_angles(pose, WAVEFORM, 5, 50).signal
    assert np.allclose(
        keep_angles(pose.select(order), WAVEFORM, 5, 50).signal, straight[order], atol=1e-5
    )


@pytest.mark.parametrize("kind", ["scattered", "repeated", "line"])
def test_irregular_antennas_are_refused(kind):
    pose = wave(10)
    positions = pose.tx_positions.copy()
    if kind == "scattered":
        positions += np.random.default_rng(0).uniform(-0.001, 0.001, positions.shape)
    elif kind == "repeated":
        positions[7] = positions[8]
    else:
        positions[:, 2] = 0.0
    with pytest.raises(UserError, match="no regular raster"):
        keep_angles(replace(pose, tx_positions=positions, rx_positions=positions), WAVEFORM, 0, 60)


def test_a_raster_with_rounding_errors_is_a_raster():
    pose = wave(20)
    noise = np.random.default_rng(0).uniform(-5e-5, 5e-5, pose.tx_positions.shape)
    assert gain(pose.moved(noise), 0, 60) == pytest.approx(np.ones(3), abs=0.06)


def test_sharpness_counts_the_bright_voxels():
    volume = np.zeros((3, 4, 5), dtype=np.float32)
    volume[0] = 2.0
    volume[1, 2, 3] = 1.0
    assert depth_sharpness(volume, 0) == pytest.approx([1.0, 20.0, 0.0])
    assert depth_sharpness(np.moveaxis(volume, 0, 2), 2) == pytest.approx([1.0, 20.0, 0.0])


def point_at(depth, *, n=24, step=0.004, waveform=WAVEFORM):
    along = (np.arange(n) - (n - 1) / 2) * step
    h, v = (a.ravel() for a in np.meshgrid(along, along[:-3], indexing="ij"))
    positions = np.stack([0.0 * h, h, v], axis=1)
    path = 2 * np.sqrt(depth**2 + (h - 0.005) ** 2 + (v + 0.003) ** 2) + waveform.path_bias_m
    return pose_of(positions, -path, waveform)


@pytest.mark.parametrize("n_samples", [1, 3, 40])
def test_a_point_is_sharpest_at_its_depth(n_samples):
    waveform = replace(WAVEFORM, n_samples=n_samples, chirp_slope_hz_per_s=4e13)
    depths, sharpness = search_depth(point_at(0.08, waveform=waveform), waveform, 0.5)
    best = int(sharpness.argmax())
    assert depths[best] == pytest.approx(0.08, abs=0.25 * waveform.center_wavelength_m + 1e-3)
    assert sharpness[best] > 5 * np.median(sharpness)


def test_a_coarse_raster_gives_no_depth():
    with pytest.raises(UserError, match="too coarse to search the depth"):
        search_depth(point_at(0.3, step=0.013), WAVEFORM, 1.0)
