"""A monostatic planar scan with stepped frequencies, as arrays one after the other in one file.

    scan.npy            six arrays, written by numpy.save one after the other:
                        data (2, n_frequencies, n_x, n_y) unsigned, Q before I;
                        first and last frequency [Hz]; their number; step along x and y [m];
                        nominal depth [m]
    antenna_phase.txt   two rows: frequency [Hz], phase of the antenna [rad] (optional)

The signal is I - jQ, without its mean over the plane at each frequency (what stands still in the
radar), times exp(-j phase(f)), and follows exp(-j 2 pi f d / c). The plane is x horizontal, y
vertical. In the capture frame these are y and z; the plane is centred on the origin, and the radar
looks along +x.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from geraf2._types import Array, Floats
from geraf2.errors import UserError
from geraf2.io.arrays import BROKEN_ARRAY
from geraf2.io.importers import NO_OPTIONS, ImportOptions, Scan
from geraf2.io.importers._rows import left_out, wrong_shape
from geraf2.io.importers._scene_manifest import scene_manifest
from geraf2.io.manifest import RadarManifest
from geraf2.records import RawPose

SCAN_NAME, PHASE_NAME = "scan.npy", "antenna_phase.txt"
# Frequencies of a stepped scan are samples of a very slow chirp; any rate says the same.
_NOMINAL_RATE_HZ = 1e6


@dataclass(frozen=True, kw_only=True, eq=False)
class _PlanarScan:
    path: Path
    parts: Array
    """(2, n_frequencies, n_x, n_y), Q before I."""
    frequencies_hz: Floats
    step_m: tuple[float, float]
    depth_m: float


class PlanarImporter:
    """Reads a planar scan with stepped frequencies."""

    def open(self, source: Path, radar: RadarManifest, options: ImportOptions = NO_OPTIONS) -> Scan:
        """Check the arrays; see Importer.open."""
        source = Path(source)
        scan = _read_scan(source / SCAN_NAME if source.is_dir() else source)
        phases, notes = _antenna_phases(scan, options)
        n_frequencies = len(scan.frequencies_hz)
        spacing_hz = float(scan.frequencies_hz[1] - scan.frequencies_hz[0])
        # The phase of the antenna was measured with its delay.
        known_bias = 0.0 if phases is not None else None
        manifest, more_notes = scene_manifest(
            "planar",
            source,
            radar,
            {
                "start_frequency_hz": float(scan.frequencies_hz[0]),
                "chirp_slope_hz_per_s": spacing_hz * _NOMINAL_RATE_HZ,
                "sample_rate_hz": _NOMINAL_RATE_HZ,
                "n_samples": n_frequencies,
                "path_bias_m": known_bias,
            },
        )
        _, _, n_x, n_y = scan.parts.shape

        def poses() -> Iterator[RawPose]:
            yield _read_pose(scan, phases)

        return Scan(
            manifest=manifest,
            n_antennas=(n_x * n_y,),
            poses=poses,
            notes=(*notes, *more_notes),
            facts=(
                (
                    "plane",
                    f"{n_x} x {n_y} places, {1e3 * scan.step_m[0]:g} x {1e3 * scan.step_m[1]:g} mm",
                ),
                ("nominal depth", f"{scan.depth_m:g} m"),
            ),
            phase_sign=-1,
        )


def _read_scan(path: Path) -> _PlanarScan:
    if not path.is_file():
        raise UserError(what="no such file", where=path)
    with path.open("rb") as handle:
        data, first, last, count, step, depth = (
            _next_array(handle, path, number) for number in range(1, 7)
        )
    if data.ndim != 4 or data.shape[0] != 2 or data.dtype.kind not in "uif" or not data.size:
        raise wrong_shape(path, "array 1", "(2, n_frequencies, n_x, n_y)", data.shape)
    values = {}
    for name, array, size in (
        ("first frequency", first, 1),
        ("last frequency", last, 1),
        ("number of frequencies", count, 1),
        ("step", step, 2),
        ("depth", depth, 1),
    ):
        if array.size != size or array.dtype.kind not in "uif" or not np.isfinite(array).all():
            raise UserError(
                what=f"{name} must be {size} finite numbers", where=path, got=str(array)[:60]
            )
        values[name] = array.astype(np.float64).reshape(-1)
    n_frequencies = int(values["number of frequencies"][0])
    if n_frequencies != data.shape[1] or n_frequencies < 2:
        raise UserError(
            what="number of frequencies contradicts the samples",
            where=path,
            expected=f"{data.shape[1]}, and at least 2",
            got=n_frequencies,
        )
    low, high = values["first frequency"][0], values["last frequency"][0]
    if not high > low:
        raise UserError(what="last frequency must lie above the first", where=path, got=high)
    return _PlanarScan(
        path=path,
        parts=data,
        frequencies_hz=np.linspace(low, high, n_frequencies),
        step_m=(float(values["step"][0]), float(values["step"][1])),
        depth_m=float(values["depth"][0]),
    )


def _next_array(handle: BinaryIO, path: Path, number: int) -> Array:
    try:
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
    if not path.is_file():
        return None, [f"no {PHASE_NAME} beside {scan.path.name}: the phase is not calibrated"]
    try:
        table = np.loadtxt(path, ndmin=2, dtype=np.float64)
    except ValueError as error:
        raise UserError(what=f"cannot be read as numbers: {error}", where=path) from None
    if table.shape[0] != 2 or table.shape[1] < 2:
        raise UserError(what="must hold two rows, frequency and phase", where=path, got=table.shape)
    notes = []
    good = np.asarray(np.isfinite(table).all(axis=0))
    if not good.all():
        text = f"{int((~good).sum())} of {good.size} columns hold NaN"
        left_out(text, options.keep_good, path, hint="--keep-good leaves them out")
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
    quadrature, in_phase = scan.parts.astype(np.float64)
    signal = in_phase - 1j * quadrature
    if not np.isfinite(signal).all():
        raise UserError(
            what=f"{int((~np.isfinite(signal)).sum())} samples are NaN or infinite", where=scan.path
        )
    signal -= signal.mean(axis=(1, 2), keepdims=True)
    if phases is not None:
        signal *= np.exp(-1j * phases)[:, None, None]
    n_frequencies, n_x, n_y = signal.shape
    along, up = (
        (np.arange(n) - (n - 1) / 2) * step for n, step in zip((n_x, n_y), scan.step_m, strict=True)
    )
    places = np.zeros((n_x, n_y, 3))
    places[..., 1], places[..., 2] = along[:, None], up
    positions = places.reshape(-1, 3)
    return RawPose(
        signal=np.ascontiguousarray(signal.reshape(n_frequencies, -1).T, dtype=np.complex64),
        tx_positions=positions,
        rx_positions=positions.copy(),
        axes=np.eye(3),
        name=scan.path.parent.name,
    )
