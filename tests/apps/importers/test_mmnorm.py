import json

import numpy as np
import pytest

from geraf2.apps.importers import ImportOptions, load_importer, mmnorm
from geraf2.errors import UserError
from geraf2.io.manifest import AntennaManifest, RadarManifest
from geraf2.scene import Waveform
from helpers.raw_capture import echo, whole_pose, words_of

N_SAMPLES, N_FRAMES = 64, 30
WAVEFORM = Waveform(
    start_frequency_hz=77.5001e9,
    chirp_slope_hz_per_s=3.0009e9 / N_SAMPLES * 1e7,
    sample_rate_hz=1e7,
    n_samples=N_SAMPLES,
    path_bias_m=0.15,
)
TARGET = np.array([0.03, 0.02, -0.3])
START = 1700000000.25


def receivers(axis):
    half_wave = 299792458.0 / (77.5001e9 + 0.5 * 3.0009e9) / 2
    return -(0.005 + (3 - np.arange(4)) * half_wave)[:, None] * axis


def samples(positions, axis):
    tx = np.repeat(positions, 4, axis=0)
    rx = (positions[:, None] + receivers(axis)).reshape(-1, 3)
    return echo(tx, rx, TARGET[None], WAVEFORM).reshape(len(positions), 4, N_SAMPLES)


def opened(source, options=None, **radar):
    return load_importer("mmnorm").open(source, RadarManifest(**radar), options or ImportOptions())


class TestFolder:
    """A robot that moves along y, then along x, in two recordings."""

    @pytest.fixture(autouse=True)
    def short_recordings(self, monkeypatch):
        monkeypatch.setattr(mmnorm, "N_FRAMES", N_FRAMES)
        monkeypatch.setattr(mmnorm, "N_SAMPLES", N_SAMPLES)

    @staticmethod
    def positions(times):
        return np.stack([0.02 * (times > 0.2), 0.05 * times, 0 * times], axis=1)

    @pytest.fixture
    def source(self, tmp_path):
        source = tmp_path / "robot_collected" / "1_2_3" / "exp0" / "nlos"
        folder = source / "unprocessed" / "radars" / "77_ghz" / "radar_data"
        folder.mkdir(parents=True)
        for begin in (0.0, 0.3):
            times = begin + 3e-3 * np.arange(N_FRAMES)
            words = words_of(samples(self.positions(times), np.array([0.0, 1.0, 0.0])))
            name = f"adc_data{START + begin:.2f}.bin"
            (folder / name).write_bytes(words.tobytes())
        times = np.arange(-0.01, 0.5, 0.01)
        np.savez(
            source / "antenna_locs.npz",
            times_77=START + times,
            tx_77_locs=np.column_stack([self.positions(times), np.ones(len(times))]),
        )
        (source.parent / "experiment_info.json").write_text(json.dumps({"rx offset": "y"}))
        return source

    def test_recordings_and_robot_become_one_plane(self, source):
        scan = opened(source)
        signal, tx, rx = whole_pose(scan)
        assert scan.n_antennas == (2 * N_FRAMES * 4,)
        times = np.concatenate([3e-3 * np.arange(N_FRAMES), 0.3 + 3e-3 * np.arange(N_FRAMES)])
        positions = self.positions(times)
        # A float64 of seconds since 1970 holds 0.2 microseconds.
        assert np.allclose(tx, np.repeat(positions, 4, axis=0), atol=1e-6)
        assert np.allclose(rx - tx, np.tile(receivers(np.array([0.0, 1.0, 0.0])), (60, 1)))
        assert np.array_equal(signal, samples(positions, np.array([0.0, 1.0, 0.0])).reshape(-1, 64))
        assert scan.phase_sign == 1
        waveform = scan.manifest.waveform
        assert waveform.start_frequency_hz == 77.5001e9
        assert waveform.chirp_slope_hz_per_s * 64 / waveform.sample_rate_hz == pytest.approx(
            3.0009e9
        )
        assert waveform.path_bias_m == 0.15
        (pose, *_) = scan.poses()
        assert np.allclose(pose.axes[0], [0, 0, -1], atol=1e-9)

    def test_several_experiments_are_named(self, source):
        other = source.parent / "los" / "unprocessed" / "radars" / "77_ghz" / "radar_data"
        other.mkdir(parents=True)
        (other / "adc_data1.bin").touch()
        with pytest.raises(UserError, match="holds 2 experiments: los/unprocessed"):
            opened(source.parent)

    def test_a_recording_cut_short_is_refused_or_kept(self, source):
        path = min(source.rglob("*.bin"))
        path.write_bytes(path.read_bytes()[:-700])
        with pytest.raises(UserError, match="last frame is cut short"):
            opened(source)
        scan = opened(source, ImportOptions(keep_good=True))
        assert scan.n_antennas == ((2 * N_FRAMES - 1) * 4,)
        assert any("holds 29 frames instead of 30" in note for note in scan.notes)

        path.write_bytes(path.read_bytes()[: -3 * 1024 - 324])
        with pytest.raises(UserError, match="holds 26 frames, expected 30; keep_good"):
            opened(source)

    def test_missing_files_are_named(self, source, tmp_path):
        (source / "antenna_locs.npz").unlink()
        with pytest.raises(UserError, match=r"has 0 files antenna\*\.npz"):
            opened(source)
        (tmp_path / "empty").mkdir()
        with pytest.raises(UserError, match="has no raw samples"):
            opened(tmp_path / "empty")

    @pytest.mark.parametrize(("value", "good"), [("-z", 1), (2, 1), ([0, 0, 2], 1), ("w", 0)])
    def test_the_axis_of_the_receivers(self, source, value, good):
        (source.parent / "experiment_info.json").write_text(json.dumps({"rx offset": value}))
        if not good:
            with pytest.raises(UserError, match="'rx offset' is no axis"):
                opened(source)
            return
        _, tx, rx = whole_pose(opened(source))
        sign = -1.0 if value == "-z" else 1.0
        assert np.allclose((rx - tx)[:4], receivers(np.array([0.0, 0.0, sign])))


class TestNpz:
    @pytest.fixture
    def arrays(self):
        y, z = np.meshgrid(0.004 * np.arange(6), 0.004 * np.arange(5))
        positions = np.column_stack([y.ravel(), z.ravel(), np.zeros(30)])
        signals = samples(positions, np.array([1.0, 0.0, 0.0])).transpose(0, 2, 1)
        return {"received_signals": signals, "antenna_locations": positions}

    def save(self, path, arrays, compressed=False):
        (np.savez_compressed if compressed else np.savez)(path, **arrays)
        return path

    @pytest.mark.parametrize("compressed", [False, True])
    def test_signals_and_positions_are_kept(self, tmp_path, arrays, compressed):
        scan = opened(self.save(tmp_path / "a.npz", arrays, compressed))
        for _ in range(2):  # more than once, as the command line does
            signal, tx, rx = whole_pose(scan)
            expected = arrays["received_signals"].transpose(0, 2, 1).reshape(-1, 64)
            assert np.array_equal(signal, expected)
            assert np.array_equal(tx, np.repeat(arrays["antenna_locations"], 4, axis=0))
            assert np.allclose(rx - tx, np.tile(receivers(np.array([1.0, 0, 0])), (30, 1)))
        assert any("rx offset" in note for note in scan.notes)

    def test_offsets_and_axes_of_the_user_go_first(self, tmp_path, arrays):
        axes = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
        antennas = AntennaManifest(rx_offsets_m=[[0.0, k, 0.0] for k in range(4)], axes=axes)
        scan = opened(self.save(tmp_path / "a.npz", arrays), antennas=antennas)
        _, tx, rx = whole_pose(scan)
        assert np.array_equal((rx - tx)[:4, 1], [0, 1, 2, 3])
        assert np.array_equal(next(iter(scan.poses())).axes, axes)

    @pytest.mark.parametrize(
        ("positions", "text"),
        [
            (np.zeros((30, 2)), "antenna_locations has the wrong shape"),
            (np.zeros((30, 3)), "the viewing direction is not known"),
        ],
    )
    def test_positions_that_do_not_fit_are_named(self, tmp_path, arrays, positions, text):
        with pytest.raises(UserError, match=text):
            opened(self.save(tmp_path / "a.npz", {**arrays, "antenna_locations": positions}))
