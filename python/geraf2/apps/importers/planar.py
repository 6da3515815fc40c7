"""Importer of a monostatic planar scan with stepped frequencies, arrays in one file.

    scan.npy            six arrays, written by numpy.save one after the other:
                        data, complex (n_frequencies, n_x, n_y), I + jQ; or real or integer
                        (2, n_frequencies, n_x, n_y), Q before I;
                        first and last frequency [Hz]; their number; step along x and y [m];
                        nominal depth [m]
    antenna_phase.txt   two rows: frequency [Hz], phase of the antenna [rad] (optional)

The mean of the signal over the plane (direct leakage) is subtracted at each frequency. Separate I
and Q are read as I - jQ, which follows exp(-j 2 pi f d / c), times exp(-j phase(f)). Complex
numbers are kept as I + jQ, with the other sign; the caller conjugates. One frequency suffices. The
plane is x horizontal, y vertical. In the capture frame these are y and z; the plane is centred on
the origin, and the viewing direction is +x.
"""

from os import SEEK_CUR
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from geraf2._types import Array, Floats
from geraf2.apps.importers import NO_OPTIONS, ImportOptions, Scan
from geraf2.apps.importers._rows import note_omission, require_equal, wrong_shape
from geraf2.apps.importers._scene_manifest import scene_manifest
from geraf2.errors import UserError
from geraf2.io.arrays import BROKEN_ARRAY, NPY_MAGIC
from geraf2.io.file_kinds import refuse_other_kind
from geraf2.io.manifest import RadarManifest
from geraf2.io.regular import open_regular
from geraf2.io.text import read_lines
from geraf2.records import RawPose

SCAN_NAME, PHASE_NAME = "scan.npy", "antenna_phase.txt"
# Arrays behind the samples, and how many numbers each holds.
_NUMBERS = {
    "first frequency": 1,
    "last frequency": 1,
    "number of frequencies": 1,
    "step": 2,
    "depth": 1,
}
# Frequencies of a stepped scan are samples of a very slow chirp; its sample rate is arbitrary.
_NOMINAL_RATE_HZ = 1e6


class _PlanarScan(NamedTuple):
    path: Path
    data: Array
    """Complex (n_frequencies, n_x, n_y), or (2, n_frequencies, n_x, n_y), Q before I."""
    frequencies_hz: Floats
    step_m: tuple[float, float]
    depth_m: float


class PlanarImporter:
    """Reads a planar scan with stepped frequencies."""

    def open(self, source: Path, radar: RadarManifest, options: ImportOptions = NO_OPTIONS) -> Scan:
        """Check the arrays; see Importer.open."""
        path = source = Path(source)
        if source.is_dir():  # scan.npy, or the only .npy file
            files = sorted(source.glob("*.npy"))
            path = files[0] if len(files) == 1 else source / SCAN_NAME
        scan = _read_scan(path)
        own_sign = 1 if scan.data.dtype.kind == "c" else -1
        sign = options.phase_sign or own_sign
        phases, notes = _antenna_phases(scan, options)
        waveform: dict[str, float | int | None] = {
            "n_samples": len(scan.frequencies_hz),
            "start_frequency_hz": float(scan.frequencies_hz[0]),
            # The phase of the antenna was measured with its delay.
            "path_bias_m": None if phases is None else 0.0,
        }
        if len(scan.frequencies_hz) > 1:
            spacing_hz = float(scan.frequencies_hz[1] - scan.frequencies_hz[0])
            waveform["chirp_slope_hz_per_s"] = spacing_hz * _NOMINAL_RATE_HZ
            waveform["sample_rate_hz"] = _NOMINAL_RATE_HZ
        manifest, more_notes = scene_manifest("planar", source, radar, waveform)
        (n_x, n_y), (step_x, step_y) = scan.data.shape[-2:], scan.step_m
        return Scan(
            manifest=manifest,
            n_antennas=(n_x * n_y,),
            poses=lambda: iter([_read_pose(scan, None if phases is None else sign * phases)]),
            notes=(*notes, *more_notes),
            facts=(
                ("plane", f"{n_x} x {n_y} positions, {1e3 * step_x:g} x {1e3 * step_y:g} mm"),
                ("nominal depth", f"{scan.depth_m:g} m"),
            ),
            phase_sign=own_sign,
        )


def _read_scan(path: Path) -> _PlanarScan:
    if not path.is_file():
        raise UserError(what="no such file", where=path)
    refuse_other_kind(path, ("npy",))
    with open_regular(path) as handle:
        data, *others = (_next_array(handle, path, number) for number in range(1, 7))
    values = []
    for (name, size), array in zip(_NUMBERS.items(), others, strict=True):
        if array.size != size or array.dtype.kind not in "uif" or not np.isfinite(array).all():
            what = f"{name} must be {size} finite numbers"
            raise UserError(what=what, where=path, got=str(array)[:60])
        values.append(array.astype(np.float64).reshape(-1))
    (low,), (high,), (n_frequencies,), step, (depth,) = values
    if not (step > 0).all():
        raise UserError(what="steps must be positive", where=path, got=step)
    data = _check_samples(data, int(n_frequencies), path)
    what = "number of frequencies contradicts the samples"
    require_equal(what, path, f"{data.shape[-3]:g}", f"{n_frequencies:g}")
    if n_frequencies > 1 and not high > low:
        raise UserError(what="last frequency must lie above the first", where=path, got=high)
    if n_frequencies == 1:
        what = "the scan has one frequency, but the last is not the first"
        require_equal(what, path, low, high)
    frequencies_hz = np.linspace(low, high, data.shape[-3])
    return _PlanarScan(path, data, frequencies_hz, (float(step[0]), float(step[1])), float(depth))


def _check_samples(data: Array, n_frequencies: int, path: Path) -> Array:
    """Check that the samples have one of the two layouts; a complex plane is one frequency."""
    if data.dtype.kind == "c" and data.ndim == 2 and n_frequencies == 1:
        data = data[None]
    good = data.ndim == 3 if data.dtype.kind == "c" else data.ndim == 4 and data.shape[0] == 2
    if not good or data.dtype.kind not in "uifc" or not data.size:
        layouts = "complex (n_frequencies, n_x, n_y), or (2, n_frequencies, n_x, n_y)"
        raise wrong_shape(path, "array 1", layouts, data)
    return data


def _next_array(handle: BinaryIO, path: Path, number: int) -> Array:
    try:
        magic = handle.read(len(NPY_MAGIC))
        if magic not in (NPY_MAGIC, b""):  # numpy.load would open an archive, or mention pickles
            msg = "it does not begin as one of numpy.save"
            raise ValueError(msg)
        handle.seek(-len(magic), SEEK_CUR)
        array: Array = np.load(handle, allow_pickle=False)
    except (*BROKEN_ARRAY, MemoryError) as error:
        reason = " ".join(str(error).split()) or "the file is cut short"
        raise UserError(
            what=f"array {number} of 6 cannot be read: {reason}",
            where=path,
            expected="samples, first and last frequency, their number, step, depth",
        ) from None
    return array


def _antenna_phases(scan: _PlanarScan, options: ImportOptions) -> tuple[Floats | None, list[str]]:
    """Phase of the antenna at each frequency [rad]; None where it was not measured."""
    path = scan.path.parent / PHASE_NAME
    if not path.exists():
        return None, [f"no {PHASE_NAME} beside {scan.path.name}: the phase is not calibrated"]
    refuse_other_kind(path)
    try:
        table = np.loadtxt(read_lines(path), ndmin=2, dtype=np.float64)
    except ValueError as error:
        raise UserError(what=f"cannot be read as numbers: {error}", where=path) from None
    if table.shape[0] != 2 or table.shape[1] < 2:
        raise UserError(what="must hold two rows, frequency and phase", where=path, got=table.shape)
    notes = []
    good = np.asarray(np.isfinite(table).all(axis=0))
    if not good.all():
        text = f"{int((~good).sum())} of {good.size} columns hold NaN"
        note_omission(text, options.keep_good, path)
        notes.append(f"{path.name}: {text}; left out")
        table = table[:, good]
    frequencies, phases = table
    slack = 1e-6 * scan.frequencies_hz[-1]
    if (
        not (np.diff(frequencies) > 0).all()
        or frequencies[0] > scan.frequencies_hz[0] + slack
        or frequencies[-1] < scan.frequencies_hz[-1] - slack
    ):
        raise UserError(
            what="does not cover the frequencies of the scan in rising order",
            where=path,
            expected=f"{scan.frequencies_hz[0]:.6g} to {scan.frequencies_hz[-1]:.6g} Hz",
            got=f"{frequencies[0]:.6g} to {frequencies[-1]:.6g} Hz",
        )
    return np.interp(scan.frequencies_hz, frequencies, phases), notes


def _read_pose(scan: _PlanarScan, phases: Floats | None) -> RawPose:
    """Return the pose; `phases` are added to those of the samples [rad]."""
    if scan.data.dtype.kind == "c":
        signal = scan.data.astype(np.complex128)
    else:
        quadrature, in_phase = scan.data.astype(np.float64)
        signal = in_phase - 1j * quadrature
    if not np.isfinite(signal).all():
        n_bad = int((~np.isfinite(signal)).sum())
        raise UserError(what=f"{n_bad} samples are NaN or infinite", where=scan.path)
    signal -= signal.mean(axis=(1, 2), keepdims=True)
    if phases is not None:
        signal *= np.exp(1j * phases)[:, None, None]
    n_frequencies, n_x, n_y = signal.shape
    grid = np.zeros((n_x, n_y, 3))
    grid[..., 1] = (np.arange(n_x) - (n_x - 1) / 2)[:, None] * scan.step_m[0]
    grid[..., 2] = (np.arange(n_y) - (n_y - 1) / 2) * scan.step_m[1]
    positions = grid.reshape(-1, 3)
    return RawPose(
        signal=np.ascontiguousarray(signal.reshape(n_frequencies, -1).T, dtype=np.complex64),
        tx_positions=positions,
        rx_positions=positions.copy(),
        axes=np.eye(3),
        name=scan.path.parent.name,
    )
