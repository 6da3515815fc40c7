"""Importer of named arrays in a MATLAB file, of version 4 to 7.2 (SciPy) or 7.3 (h5py).

    signal              (n_antennas, n_samples) or (n_poses, n_antennas, n_samples), complex;
                        or signal_real and signal_imag
    tx_positions        (n_antennas, 3) or (n_poses, n_antennas, 3) [m]; rx_positions likewise;
                        or positions, for a monostatic radar
    axes                (3, 3) or (n_poses, 3, 3), rows viewing, horizontal, vertical; without it
                        the normal of the antennas, towards the origin
    start_frequency_hz, chirp_slope_hz_per_s, sample_rate_hz, path_bias_m      numbers, optional

They may be fields of structs. Other names are given by --arrays signal=adc, or by the table
[arrays] of radar.toml: signal = "scan.adc".
"""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from geraf2._types import Array, Floats
from geraf2.apps.importers import NO_OPTIONS, ImportOptions, Scan
from geraf2.apps.importers._board import plane_axes
from geraf2.apps.importers._mat_arrays import MatArray, open_arrays
from geraf2.apps.importers._rows import blocks, good_rows, wrong_shape
from geraf2.apps.importers._scene_manifest import scene_manifest
from geraf2.errors import UserError
from geraf2.io.manifest import RadarManifest
from geraf2.records import RawPose

ARRAYS = (
    "signal",
    "signal_real",
    "signal_imag",
    "tx_positions",
    "rx_positions",
    "positions",
    "axes",
)
NUMBERS = ("start_frequency_hz", "chirp_slope_hz_per_s", "sample_rate_hz", "path_bias_m")


class MatImporter:
    """Reads named arrays of a MATLAB file."""

    def open(self, source: Path, radar: RadarManifest, options: ImportOptions = NO_OPTIONS) -> Scan:
        """Check names and shapes; see Importer.open."""
        source = Path(source)
        given = _given_names(radar, options)
        arrays, there = open_arrays(source, {n: given.get(n, n) for n in (*ARRAYS, *NUMBERS)})
        missing = [f"{n} = {given[n]}" for n in given if n not in arrays]
        if missing:
            raise UserError(
                what=f"the file lacks what is named: {', '.join(missing)}", where=source, got=there
            )
        _require_arrays(arrays, source, there)
        signal = _signal(arrays, source)
        n_poses, n_antennas, n_samples = (1, *signal.shape)[-3:]
        tx, rx = _positions(arrays, source, n_poses, n_antennas)
        axes = _axes(arrays, source, tx)
        row_bytes = 16 * n_samples

        def samples(first: int, stop: int, pose: int) -> Array:
            rows = slice(first, stop)
            return signal.read((pose, rows) if len(signal.shape) == 3 else (rows,))

        good, notes = np.ones((n_poses, n_antennas), dtype=np.bool_), []
        for pose in range(n_poses):
            positions = np.hstack([tx[pose], rx[pose]])
            parts = (
                np.hstack([np.abs(samples(a, b, pose)), positions[a:b]])
                for a, b in blocks(n_antennas, row_bytes)
            )
            what = f"antennas of plane {pose}" if n_poses > 1 else "antennas"
            good[pose], more = good_rows(
                parts, keep_good=options.keep_good, where=source, what=what
            )
            notes += more
        known = {name: _number(arrays, name, source) for name in NUMBERS}
        manifest, more = scene_manifest("mat", source, radar, {**known, "n_samples": n_samples})

        def poses() -> Iterator[RawPose]:
            for pose in range(n_poses):
                for first, stop in blocks(n_antennas, row_bytes):
                    chosen = good[pose, first:stop]
                    if chosen.any():
                        part = samples(first, stop, pose)[chosen]
                        yield RawPose(
                            signal=np.ascontiguousarray(part, dtype=np.complex64),
                            tx_positions=tx[pose, first:stop][chosen],
                            rx_positions=rx[pose, first:stop][chosen],
                            axes=axes[pose],
                            name=f"{source.stem}_{pose}" if n_poses > 1 else source.stem,
                        )

        return Scan(
            manifest=manifest,
            n_antennas=tuple(int(n) for n in good.sum(axis=1)),
            poses=poses,
            notes=(*notes, *more),
        )


def _given_names(radar: RadarManifest, options: ImportOptions) -> dict[str, str]:
    """Names in the file by our names, of the command line and of radar.toml."""
    pairs = [text.partition("=") for text in options.arrays]
    wrong = ["".join(pair) for pair in pairs if not pair[0] or not pair[2]]
    if wrong:
        raise UserError(what="--arrays must be OURS=THEIRS", got=wrong[0])
    given = {**radar.arrays, **{ours: theirs for ours, _, theirs in pairs}}
    unknown = sorted(set(given) - {*ARRAYS, *NUMBERS})
    if unknown:
        raise UserError(
            what=f"arrays.{unknown[0]} is no array that is read",
            expected=", ".join((*ARRAYS, *NUMBERS)),
        )
    return given


def _require_arrays(arrays: Mapping[str, MatArray], path: Path, there: str) -> None:
    """Raise UserError that lists what the file holds where signal or positions are missing."""
    has_signal = "signal" in arrays or {"signal_real", "signal_imag"} <= set(arrays)
    lacks = [] if has_signal else [("the signal", "signal, or signal_real and signal_imag")]
    lacks += [
        (name, "tx_positions and rx_positions, or positions")
        for name in ("tx_positions", "rx_positions")
        if not {name, "positions"} & set(arrays)
    ]
    for name, expected in lacks[:1]:
        what, hint = f"the file lacks {name}", "give the names with --arrays, as signal=NAME"
        raise UserError(what=what, where=path, expected=expected, got=there, hint=hint)


def _signal(arrays: Mapping[str, MatArray], path: Path) -> MatArray:
    if "signal" in arrays:
        signal = arrays["signal"]
    else:
        real, imag = arrays["signal_real"], arrays["signal_imag"]
        if real.shape != imag.shape:
            raise wrong_shape(path, "signal_imag", real.shape, imag.shape)
        signal = MatArray(
            shape=real.shape,
            kind="c" if {real.kind, imag.kind} <= set("fiu") else "O",
            read=lambda index: real.read(index) + 1j * imag.read(index),
        )
    if len(signal.shape) not in (2, 3) or 0 in signal.shape or signal.kind != "c":
        expected = "complex (n_antennas, n_samples) or (n_poses, n_antennas, n_samples)"
        raise wrong_shape(path, "signal", expected, f"{signal.kind} {signal.shape}")
    return signal


def _positions(
    arrays: Mapping[str, MatArray], path: Path, n_poses: int, n_antennas: int
) -> tuple[Floats, Floats]:
    """Transmitters and receivers, (n_poses, n_antennas, 3) [m]."""
    names = (
        ("positions", "positions") if "positions" in arrays else ("tx_positions", "rx_positions")
    )
    found = []
    for name in names:
        array = arrays[name]
        shapes = [(n_poses, n_antennas, 3)] + ([(n_antennas, 3)] if n_poses == 1 else [])
        if array.shape not in shapes or array.kind not in "fiu":
            expected = f"real {shapes[-1]}, as signal has {n_antennas} antennas"
            raise wrong_shape(path, name, expected, f"{array.kind} {array.shape}")
        found.append(array.numbers().reshape(n_poses, n_antennas, 3))
    return found[0], found[1]


def _axes(arrays: Mapping[str, MatArray], path: Path, tx: Floats) -> Floats:
    n_poses = len(tx)
    if "axes" not in arrays:
        return np.stack([plane_axes(one, towards=None, where=path) for one in tx])
    array = arrays["axes"]
    if array.shape not in ((n_poses, 3, 3), (3, 3)) or array.kind not in "fiu":
        raise wrong_shape(path, "axes", f"({n_poses}, 3, 3)", array.shape)
    axes = np.broadcast_to(array.numbers(), (n_poses, 3, 3))
    if not np.abs(axes @ axes.transpose(0, 2, 1) - np.eye(3)).max() < 1e-3:
        raise UserError(what="rows of axes are not orthonormal", where=path)
    return axes


def _number(arrays: Mapping[str, MatArray], name: str, path: Path) -> float | None:
    if name not in arrays:
        return None
    array = arrays[name]
    if int(np.prod(array.shape)) != 1 or array.kind not in "fiu":
        raise UserError(what=f"{name} must be a number", where=path, got=f"{array.shape}")
    return float(array.numbers().reshape(-1)[0])
