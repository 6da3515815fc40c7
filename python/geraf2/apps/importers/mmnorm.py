"""Importer of the layouts of the mmNorm data set: one .npz, or the folder of a robot scan.

    capture.npz          received_signals (n_positions, n_samples, n_rx), complex
                         antenna_locations (n_positions, 3 or more) [m], the transmitter

    exp<N>/{los|nlos}/unprocessed/radars/77_ghz/radar_data/adc_data<unix time>.bin
                         raw samples of a TI board, 4 lanes, 1 chirp a frame
    antenna*.npz         times_77 (T,) [s], tx_77_locs (T, 3 or more) [m], somewhere in exp<N>
    experiment_info.json 'rx offset': axis of the robot frame along which the receivers lie

The radar sweeps 3.0009 GHz from 77.5001 GHz, a frame every 3 ms; receiver k lies
-(5 mm + (3 - k) lambda / 2) from the transmitter along the axis. The phase is
exp(+j 2 pi f d / c), and the instrument adds 0.15 m to the path.
"""

import re
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from geraf2._types import Array, Floats
from geraf2.apps.importers import NO_OPTIONS, ImportOptions, Scan
from geraf2.apps.importers._board import Board, board_of, plane_axes, ti_receivers
from geraf2.apps.importers._recording import open_recording
from geraf2.apps.importers._robot_log import RobotLog
from geraf2.apps.importers._rows import good_rows, note_omission, require_equal, wrong_shape
from geraf2.apps.importers._scene_manifest import scene_manifest
from geraf2.apps.importers._tracks import log_track
from geraf2.apps.importers.dca1000 import read_pose
from geraf2.errors import UserError
from geraf2.io.arrays import read_npz
from geraf2.io.manifest import RadarManifest
from geraf2.io.samples import complex_samples
from geraf2.io.text import read_object
from geraf2.records import RawPose

START_HZ, BANDWIDTH_HZ = 77.5001e9, 3.0009e9
FRAME_PERIOD_S, PATH_BIAS_M = 3e-3, 0.15
N_SAMPLES, N_FRAMES = 512, 4000
# Only slope / sample rate matters: the bandwidth over the number of samples.
_NOMINAL_RATE_HZ = 1e7


class MmnormImporter:
    """Reads the mmNorm layouts."""

    def open(self, source: Path, radar: RadarManifest, options: ImportOptions = NO_OPTIONS) -> Scan:
        """Check arrays, times and positions; see Importer.open."""
        source = Path(source)
        if not source.exists():
            raise UserError(what="no such file or folder", where=source)
        return (_open_npz if source.is_file() else _open_folder)(source, radar, options)


def _open_npz(source: Path, radar: RadarManifest, options: ImportOptions) -> Scan:
    arrays = read_npz(source, ["received_signals", "antenna_locations"])
    stored = arrays["received_signals"]
    if stored.ndim != 3 or stored.dtype.kind != "c" or not stored.size:
        expected = "complex (n_positions, n_samples, n_rx)"
        raise wrong_shape(source, "received_signals", expected, stored)
    positions = _positions(arrays["antenna_locations"], source, "antenna_locations")
    what = "antenna_locations and received_signals differ in length"
    require_equal(what, source, len(stored), len(positions))
    _, n_samples, n_rx = stored.shape
    check = partial(good_rows, keep_good=options.keep_good, where=source)
    good, notes = check([stored], what="positions of received_signals")
    finite, more = check([positions], what="antenna_locations")
    good &= finite
    info = _experiment_info(source.parent, source.parent)
    board = _board(radar, info, positions[good], n_rx, source)
    manifest, still_more = _scene_manifest(source, radar, n_samples)

    def poses() -> Iterator[RawPose]:
        here = positions[good]
        tx, rx = board.antennas(here, np.broadcast_to(np.eye(3), (len(here), 3, 3)))
        signal = stored[good].transpose(0, 2, 1).reshape(-1, n_samples)
        yield RawPose(
            signal=np.ascontiguousarray(signal, dtype=np.complex64),
            tx_positions=tx,
            rx_positions=rx,
            axes=board.axes,
            name=source.stem,
        )

    return Scan(
        manifest=manifest,
        n_antennas=(int(good.sum()) * n_rx,),
        poses=poses,
        notes=(*notes, *more, *still_more, *board.notes),
        facts=(("positions", f"{int(good.sum())} x {n_rx} receivers"),),
        phase_sign=1,
    )


def _open_folder(source: Path, radar: RadarManifest, options: ImportOptions) -> Scan:
    files = _recordings(source)
    n_samples = radar.n_samples or N_SAMPLES
    of_board = {"layout": radar.raw.layout or "4-lane", "n_rx": radar.raw.n_rx or 4}
    raw = radar.raw.model_copy(update=of_board)
    known = radar.model_copy(update={"n_samples": n_samples, "raw": raw})
    folder = files[0][0].parent
    log = _robot_log(folder, source, options)
    notes: list[str] = list(log.notes)
    passes = []
    for path, start_s in files:
        recording = open_recording(path, known, options)
        notes += recording.notes
        if recording.n_frames != N_FRAMES:
            text, hint = f"{path.name} holds {recording.n_frames} frames", "--keep-good takes them"
            note_omission(text, options.keep_good, path, hint, expected=N_FRAMES)
            notes.append(f"{text} instead of {N_FRAMES}")
        track = log_track(
            log,
            recording.n_frames,
            frame_period_s=radar.raw.frame_period_s or FRAME_PERIOD_S,
            start_time_s=start_s if radar.raw.start_time_s is None else radar.raw.start_time_s,
            keep_good=options.keep_good,
        )
        notes += [note for note in track.notes if note not in notes]
        passes.append((recording, track))
    n_rx = passes[0][0].evidence.order.n_rx
    info = _experiment_info(folder, source)
    board = _board(radar, info, log.positions, n_rx, source)
    manifest, more = _scene_manifest(source, radar, n_samples)

    def poses() -> Iterator[RawPose]:
        for recording, track in passes:
            for part in read_pose(recording, track, board):
                yield replace(part, signal=complex_samples(part.signal), name=source.name)

    n_positions = sum(stop - first for _, track in passes for first, stop in track.ranges)
    return Scan(
        manifest=manifest,
        n_antennas=(n_positions * n_rx,),
        poses=poses,
        notes=(*notes, *more, *board.notes),
        facts=(
            ("recordings", f"{len(passes)}, {n_positions} frames x {n_rx} receivers"),
            *passes[0][0].facts,
        ),
        phase_sign=1,
    )


def _scene_manifest(source: Path, radar: RadarManifest, n_samples: int) -> tuple[Any, list[str]]:
    return scene_manifest(
        "mmnorm",
        source,
        radar,
        {
            "start_frequency_hz": START_HZ,
            "chirp_slope_hz_per_s": BANDWIDTH_HZ / n_samples * _NOMINAL_RATE_HZ,
            "sample_rate_hz": _NOMINAL_RATE_HZ,
            "n_samples": n_samples,
            "path_bias_m": PATH_BIAS_M,
        },
    )


def _recordings(source: Path) -> list[tuple[Path, float | None]]:
    """Files of raw samples in the order of the time in their names, and that time [s]."""
    files = sorted(source.rglob("adc_data*.bin"))
    if not files:
        raise UserError(
            what="has no raw samples",
            where=source,
            expected="unprocessed/radars/77_ghz/radar_data/adc_data<unix time>.bin",
        )
    folders = sorted({path.parent for path in files})
    if len(folders) > 1:
        names = ", ".join(str(folder.relative_to(source)) for folder in folders[:2])
        what = f"holds {len(folders)} experiments: {names}"
        raise UserError(what=what, where=source, hint="name one of them")
    matches = ((path, re.fullmatch(r"adc_data_?(\d+(?:\.\d+)?)", path.stem)) for path in files)
    pairs = [(path, float(match[1]) if match else None) for path, match in matches]
    return sorted(pairs, key=lambda pair: pair[1] or 0.0)


def _robot_log(within: Path, source: Path, options: ImportOptions) -> RobotLog:
    """Positions of the transmitter, from the nearest antenna*.npz above a folder."""
    folder, found = source, list[Path]()
    for folder in _folders_above(within, source):
        inside = folder.is_relative_to(source.resolve())
        found = sorted(folder.rglob("antenna*.npz") if inside else folder.glob("antenna*.npz"))
        if found:
            break
    if len(found) != 1:
        raise UserError(what=f"has {len(found)} files antenna*.npz", where=folder, expected="one")
    (path,) = found
    arrays = read_npz(path, ["times_77", "tx_77_locs"])
    times = np.asarray(arrays["times_77"], dtype=np.float64).reshape(-1)
    positions = _positions(arrays["tx_77_locs"], path, "tx_77_locs")
    require_equal("times_77 and tx_77_locs differ in length", path, len(positions), len(times))
    table = np.column_stack([times, positions])
    good, notes = good_rows([table], keep_good=options.keep_good, where=path, what="rows")
    if (np.diff(times[good]) <= 0).any():
        raise UserError(what="times_77 does not increase", where=path)
    return RobotLog(
        path=path,
        positions=positions[good],
        times_s=times[good],
        rows=np.flatnonzero(good) + 1,
        notes=tuple(notes),
    )


def _folders_above(folder: Path, source: Path) -> Iterator[Path]:
    """Folder and those above it, up to two levels above the source."""
    folder, source = folder.resolve(), source.resolve()
    outermost = source.parents[min(1, len(source.parents) - 1)]
    for parent in (folder, *folder.parents):
        yield parent
        if parent == outermost:
            return


def _positions(array: Array, where: Path, name: str) -> Floats:
    if array.ndim != 2 or array.shape[1] < 3 or array.dtype.kind not in "fiu":
        raise wrong_shape(where, name, "(n, 3)", array)
    return np.asarray(array[:, :3], dtype=np.float64)


def _experiment_info(folder: Path, top: Path) -> dict[str, Any]:
    """Contents of the nearest experiment_info.json above; empty without one."""
    paths = (parent / "experiment_info.json" for parent in _folders_above(folder, top))
    path = next((path for path in paths if path.is_file()), None)
    return {} if path is None else read_object(path)


def _board(
    radar: RadarManifest, info: dict[str, Any], positions: Floats, n_rx: int, where: Path
) -> Board:
    notes = []
    axis = _axis(info.get("rx offset"), where)
    if axis is None:
        axis = np.array([1.0, 0.0, 0.0])
        if radar.antennas.rx_offsets_m is None:
            notes.append(
                "no 'rx offset' in an experiment_info.json: the receivers were assumed to lie "
                "along -x; give rx_offsets_m under [antennas]"
            )
    center_hz = START_HZ + 0.5 * BANDWIDTH_HZ
    axes = radar.antennas.axes
    if axes is None:
        axes = plane_axes(positions, towards=np.array([0.0, 0.0, -1.0]), where=where).tolist()
        viewing = ", ".join(f"{value:z.2f}" for value in axes[0])
        notes.append(
            f"the viewing direction was assumed to be ({viewing}), along the normal of the "
            "positions; give axes under [antennas] if it is the other one"
        )
    offsets = radar.antennas.rx_offsets_m or ti_receivers(n_rx, center_hz, axis).tolist()
    known = {"tx_offsets_m": [[0.0] * 3], "rx_offsets_m": offsets, "axes": axes}
    antennas = radar.antennas.model_copy(update=known)
    board = board_of(antennas, n_tx=1, n_rx=n_rx, center_hz=center_hz)
    return replace(board, notes=tuple(notes))


def _axis(value: Any, where: Path) -> Floats | None:
    """Return the unit vector of 'x', '-y', 2, or three numbers; None without a value."""
    if value is None:
        return None
    if match := re.fullmatch(r"([+-]?)([xyz012])", str(value).strip().lower()):
        axis: Floats = np.eye(3)["xyz012".index(match[2]) % 3]
        return -axis if match[1] == "-" else axis
    try:
        vector = np.asarray(value, dtype=np.float64)
        length = float(np.linalg.norm(vector))
        if vector.shape == (3,) and np.isfinite(length) and length > 0:
            return np.asarray(vector / length)
    except (TypeError, ValueError):
        pass
    raise UserError(
        what="'rx offset' is no axis", where=where, expected="x, y or z", got=repr(value)[:40]
    )
