"""Robot logs: reading, interpolation at the frames, faults."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geraf2.apps.importers._board import board_of
from geraf2.apps.importers._robot_log import read_log
from geraf2.apps.importers._tracks import log_track
from geraf2.errors import UserError
from geraf2.io.manifest import AntennaManifest

TIMES = np.arange(0.0, 1.0, 0.1)
POSITIONS = np.stack([0.3 + 0.2 * TIMES, -0.1 * TIMES, 0.05 + 0 * TIMES], axis=1)


def write_csv(path, table, names="time_s,x_m,y_m,z_m"):
    lines = [",".join(f"{value:.9g}" for value in row) for row in table]
    path.write_text("\n".join([*([names] if names else []), *lines]) + "\n")
    return path


@pytest.fixture
def log(tmp_path):
    return write_csv(tmp_path / "log.csv", np.column_stack([TIMES, POSITIONS]))


def track(path, n_frames=19, *, keep_good=False, period=0.05, start=0.0, **more):
    return log_track(
        read_log(path, keep_good=keep_good),
        n_frames,
        frame_period_s=period,
        start_time_s=start,
        keep_good=keep_good,
        **more,
    )


def test_positions_are_interpolated_at_the_frames(log):
    found = track(log)
    assert found.ranges == ((0, 19),)
    positions, rotations = found.at(3, 19)
    times = 0.05 * np.arange(3, 19)
    expected = np.stack([0.3 + 0.2 * times, -0.1 * times, np.full(16, 0.05)], axis=1)
    assert np.allclose(positions, expected, atol=1e-9)
    assert np.array_equal(rotations, np.broadcast_to(np.eye(3), (16, 3, 3)))


def test_npy_tables_and_records_are_read(tmp_path):
    table = np.column_stack([TIMES, POSITIONS])
    np.save(tmp_path / "a.npy", table)
    records = np.zeros(10, dtype=[("x_mm", "f4"), ("time", "f8"), ("y_m", "f8"), ("z", "f8")])
    records["x_mm"], records["time"] = 1e3 * POSITIONS[:, 0], TIMES
    records["y_m"], records["z"] = POSITIONS[:, 1], POSITIONS[:, 2]
    np.save(tmp_path / "b.npy", records)
    for name in ("a.npy", "b.npy"):
        found = read_log(tmp_path / name, keep_good=False)
        assert np.allclose(found.positions, POSITIONS, atol=1e-7)
        assert np.allclose(found.times_s, TIMES)


def test_one_row_a_frame_needs_no_times(tmp_path):
    path = write_csv(tmp_path / "l.csv", POSITIONS, "x,y,z")
    found = track(path, n_frames=20, period=None)
    assert found.frames_per_position == 2
    assert np.allclose(found.at(2, 5)[0], POSITIONS[2:5])
    with pytest.raises(UserError, match="10 positions without time stamps do not match 21 frames"):
        track(path, n_frames=21, period=None)
    assert track(path, n_frames=21, period=None, keep_good=True).ranges == ((0, 10),)


@pytest.mark.parametrize("names", ["time_s,x_m,y_m,z_m", "time_s,x_m,y_m,z_m,qw,qx,qy,qz"])
def test_a_log_of_one_row_is_one_position(tmp_path, names):
    row = [0.2, 0.3, 0.1, 0.0, *Rotation.from_euler("z", 0.5).as_quat()[[3, 0, 1, 2]]]
    path = write_csv(tmp_path / "l.csv", [row[: names.count(",") + 1]], names)
    with pytest.raises(UserError, match="18 of 19 frames lie outside the time stamps"):
        track(path)
    found = track(path, keep_good=True)
    assert found.ranges == ((4, 5),)
    positions, rotations = found.at(4, 5)
    assert np.allclose(positions, row[1:4])
    assert np.isclose(rotations[0, 1, 0], np.sin(0.5) if "qw" in names else 0.0)


def test_offsets_turn_with_the_end_effector(tmp_path):
    turns = Rotation.from_euler("z", np.linspace(0, 90, 10)[:, None], degrees=True)
    quaternions = turns.as_quat()[:, [3, 0, 1, 2]]
    path = write_csv(
        tmp_path / "l.csv",
        np.column_stack([TIMES, POSITIONS, quaternions]),
        "time_s,x_m,y_m,z_m,qw,qx,qy,qz",
    )
    found = track(path)
    offsets = AntennaManifest(
        tx_offsets_m=[[0.01, 0, 0], [0, 0.02, 0]], rx_offsets_m=[[0.0, 0.0, 0.03]]
    )
    board = board_of(offsets, n_tx=2, n_rx=1, center_hz=78e9)
    tx, rx = board.antennas(*found.at(9, 10))  # half a step of the log: 45 degrees
    position, half = 0.3 + 0.2 * 0.45, np.sqrt(0.5)
    base = np.array([position, -0.045, 0.05])
    turned = np.array([[0.01 * half, 0.01 * half, 0], [-0.02 * half, 0.02 * half, 0]])
    assert np.allclose(tx - base, turned)
    assert np.allclose(rx - base, [[0, 0, 0.03]])
    # viewing along x at the beginning, along y at the end, between them on the mean
    assert np.allclose(board.mean_axes(found)[0], [half, half, 0], atol=0.01)


def test_receivers_of_a_ti_board_are_the_default():
    board = board_of(AntennaManifest(), n_tx=1, n_rx=4, center_hz=78e9)
    half_wave = 299792458.0 / 78e9 / 2
    assert np.allclose(board.rx_offsets[:, 1], [-(0.005 + (3 - k) * half_wave) for k in range(4)])
    assert "rx_offsets_m" in board.notes[0]
    with pytest.raises(UserError, match="the positions of the 2 transmitters are not known"):
        board_of(AntennaManifest(), n_tx=2, n_rx=4, center_hz=78e9)
    with pytest.raises(UserError, match="rx_offsets_m has the wrong length, expected 4, got 1"):
        board_of(AntennaManifest(rx_offsets_m=[[0.0] * 3]), n_tx=1, n_rx=4, center_hz=78e9)


def test_the_first_row_is_the_first_frame_when_nothing_else_is_known(log):
    found = track(log, start=None)
    assert np.allclose(found.positions[0], POSITIONS[0])
    assert "start_time_s" in found.notes[0]
    with pytest.raises(UserError, match="time between frames is not known"):
        track(log, period=None)


def test_positions_that_jump_are_refused_or_left_out(tmp_path):
    positions = POSITIONS.copy()
    positions[5:] += [0.5, 0, 0]
    path = write_csv(tmp_path / "l.csv", np.column_stack([TIMES, positions]))
    with pytest.raises(UserError, match=r"positions jump by 0.52 m in 0.1 s after row 5, expected"):
        track(path)
    found = track(path, keep_good=True)
    assert found.ranges == ((0, 9), (10, 19))  # the frame between the rows is left out
    assert "1 frames at 1 jumps" in found.notes[-1]
    beside = write_csv(tmp_path / "m.csv", np.column_stack([TIMES, 1e3 * positions]))
    with pytest.raises(UserError, match="expected metres"):
        track(beside)
    with pytest.raises(UserError, match=r"positions jump after 9 of 10 rows, .*check their unit"):
        track(beside, keep_good=True)


def test_without_times_a_metre_is_a_jump(tmp_path):
    positions = POSITIONS.copy()
    positions[7] += 2
    path = write_csv(tmp_path / "l.csv", positions, "x,y,z")
    with pytest.raises(UserError, match=r"positions jump by .* after row 7"):
        track(path, n_frames=10, period=None)


def test_a_hole_in_which_the_radar_moved_is_refused_or_left_out(tmp_path):
    times = np.concatenate([0.01 * np.arange(100), 5 + 0.01 * np.arange(100)])
    positions = np.stack([0.02 * times, 0 * times, 0 * times], axis=1)
    path = write_csv(tmp_path / "l.csv", np.column_stack([times, positions]))
    with pytest.raises(UserError, match=r"positions have a hole, they move by 0.0802 m in 4.01 s"):
        track(path, n_frames=100)
    found = track(path, n_frames=120, keep_good=True)
    assert found.ranges == ((0, 20), (100, 120))


@pytest.mark.parametrize(
    ("row", "value", "text"),
    [
        (3, np.nan, "1 of 10 rows hold NaN, first row 4"),
        (4, 0.05, "time stamps do not increase at 1 rows, first 5"),
    ],
)
def test_bad_rows_are_refused_or_left_out(tmp_path, row, value, text):
    table = np.column_stack([TIMES, POSITIONS])
    table[row, 0] = value
    path = write_csv(tmp_path / "l.csv", table)
    with pytest.raises(UserError, match=text):
        read_log(path, keep_good=False)
    found = read_log(path, keep_good=True)
    assert len(found.positions) == 9
    assert row + 1 not in found.rows
    assert "left out" in found.notes[0]
