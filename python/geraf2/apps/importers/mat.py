"""Importer of named arrays in a MATLAB file, of version 5 to 7 (SciPy) or 7.3 (HDF5, h5py).

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

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geraf2._types import Array, Floats
from geraf2.apps.importers import NO_OPTIONS, ImportOptions, Scan
from geraf2.apps.importers._board import plane_axes
from geraf2.apps.importers._mat_variables import Variable, read_variables
from geraf2.apps.importers._rows import blocks, good_rows, wrong_shape
from geraf2.apps.importers._scene_manifest import scene_manifest
from geraf2.errors import UserError
from geraf2.io.file_kinds import refuse_other_kind
from geraf2.io.manifest import RadarManifest
from geraf2.io.regular import open_regular
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
_HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
_HDF5_OFFSETS = (0, 512)
_KIND_NAMES = {"c": "complex", "f": "real", "i": "real", "u": "real", "O": "other"}
# Letters of a list of what a file holds.
_LONGEST_LIST = 250


@dataclass(frozen=True, kw_only=True)
class _Array:
    """One array, in the order of MATLAB; parts along the first axes are read on demand."""

    shape: tuple[int, ...]
    kind: str
    read: Callable[[tuple[Any, ...]], Array]

    def numbers(self) -> Floats:
        return np.asarray(self.read((slice(None),) * len(self.shape)), dtype=np.float64)


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


def _require_arrays(arrays: Mapping[str, _Array], path: Path, there: str) -> None:
    """Raise UserError that lists what the file holds where signal or positions are missing."""
    hint = "give the names with --arrays, as signal=NAME"
    if "signal" not in arrays and not {"signal_real", "signal_imag"} <= set(arrays):
        raise UserError(
            what="the file lacks the signal",
            where=path,
            expected="signal, or signal_real and signal_imag",
            got=there,
            hint=hint,
        )
    for name in ("tx_positions", "rx_positions"):
        if not {name, "positions"} & set(arrays):
            raise UserError(
                what=f"the file lacks {name}",
                where=path,
                expected="tx_positions and rx_positions, or positions",
                got=there,
                hint=hint,
            )


def open_arrays(path: Path, names: Mapping[str, str]) -> tuple[dict[str, _Array], str]:
    """Arrays of the file, by our names, and a list of all that it holds."""
    if not path.is_file():
        raise UserError(what="no such file", where=path)
    refuse_other_kind(path, ("mat", "hdf5"))
    with open_regular(path) as handle:
        head = handle.read(max(_HDF5_OFFSETS) + len(_HDF5_MAGIC))
    is_hdf5 = any(head[at : at + len(_HDF5_MAGIC)] == _HDF5_MAGIC for at in _HDF5_OFFSETS)
    known, there = (_open_hdf5 if is_hdf5 else _open_version_5)(path, list(names.values()))
    found = {}
    for ours, theirs in names.items():
        # By its name, or as the only field of this name in a struct.
        fields = [name for name in known if name.endswith(f".{theirs}")]
        if theirs in known:
            found[ours] = known[theirs]
        elif len(fields) == 1:
            found[ours] = known[fields[0]]
    text = ", ".join(there)
    return found, text if len(text) <= _LONGEST_LIST else f"{text[:_LONGEST_LIST]} ..."


def _open_version_5(path: Path, names: list[str]) -> tuple[dict[str, _Array], list[str]]:
    variables = read_variables(path, {name.split(".")[0] for name in names})
    if variables is None:
        variables = _version_4(path)
    known: dict[str, _Array] = {}

    def add(name: str, variable: Variable) -> None:
        values = variable.values
        if values is not None:
            known[name] = _Array(
                shape=values.shape, kind=values.dtype.kind, read=lambda index: values[index]
            )
        for part in variable.fields:
            add(f"{name}.{part.name}", part)

    for variable in variables:
        add(variable.name, variable)
    return known, [str(variable) for variable in variables]


def _version_4(path: Path) -> list[Variable]:
    from scipy.io import loadmat  # noqa: PLC0415 - other formats do without

    with open_regular(path) as handle:
        begin = handle.read(4)
    try:
        if 0 not in begin:  # a file of version 4 has a zero there, others a text
            msg = "its version is not known"
            raise ValueError(msg)
        values = {name: np.asarray(value) for name, value in loadmat(path).items()}
    except Exception as error:  # SciPy raises anything on broken files
        reason = " ".join(str(error).split()) or type(error).__name__
        raise UserError(what=f"cannot be read as a MATLAB file: {reason}", where=path) from None
    return [
        Variable(name=name, shape=v.shape, kind=_KIND_NAMES.get(v.dtype.kind, "other"), values=v)
        for name, v in values.items()
        if not name.startswith("__")
    ]


def _open_hdf5(path: Path, names: list[str]) -> tuple[dict[str, _Array], list[str]]:
    try:
        import h5py  # noqa: PLC0415 - an extra
    except ImportError:
        raise UserError(
            what="is a MATLAB file of version 7.3, which needs h5py",
            where=path,
            hint="pip install 'geraf2[matlab]', or save it with '-v7'",
        ) from None
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise UserError(what=f"cannot be read as HDF5: {error}", where=path) from None
    known: dict[str, _Array] = {}
    foreign = set()

    def add(location: str, data: Any) -> None:
        if not isinstance(data, h5py.Dataset) or location.startswith("#"):
            return
        name = location.replace("/", ".").removesuffix(".value")  # Octave's arrays are groups
        if data.external or data.is_virtual:
            foreign.add(name)
        else:
            known[name] = _hdf5_array(data)

    try:
        file.visititems(add)
    except (OSError, RuntimeError, KeyError, TypeError) as error:
        raise UserError(what=f"cannot be read as HDF5: {error}", where=path) from None
    for name in names:
        _require_no_link(file, name, path)
        if name in foreign:
            raise UserError(what=f"{name} lies in another file", where=path)
    there = [
        str(Variable(name=name, shape=array.shape, kind=_KIND_NAMES.get(array.kind, "other")))
        for name, array in known.items()
    ]
    return known, there


def _hdf5_array(data: Any) -> _Array:
    parts = data.dtype.names
    is_complex = parts is not None and set(parts) == {"real", "imag"}
    kind = "c" if is_complex else "O" if parts else data.dtype.kind

    def read(index: tuple[Any, ...]) -> Array:
        # HDF5 holds MATLAB's arrays with the axes reversed.
        stored = data[(..., *reversed(index))].T
        return stored["real"] + 1j * stored["imag"] if is_complex else np.asarray(stored)

    return _Array(shape=tuple(reversed(data.shape)), kind=kind, read=read)


def _require_no_link(file: Any, name: str, path: Path) -> None:
    """Raise UserError where an object of the file is a link, which may open another file."""
    import h5py  # noqa: PLC0415 - an extra

    node = file
    for part in filter(None, re.split(r"[./]", name)):
        try:
            kind = node.id.links.get_info(part.encode()).type
        except (AttributeError, KeyError, RuntimeError):  # no group, or without such an object
            return
        if kind != h5py.h5l.TYPE_HARD:
            raise UserError(what=f"{name} is a link to another object or file", where=path)
        node = node[part]


def _signal(arrays: Mapping[str, _Array], path: Path) -> _Array:
    if "signal" in arrays:
        signal = arrays["signal"]
    else:
        real, imag = arrays["signal_real"], arrays["signal_imag"]
        if real.shape != imag.shape:
            raise wrong_shape(path, "signal_imag", real.shape, imag.shape)
        signal = _Array(
            shape=real.shape,
            kind="c" if {real.kind, imag.kind} <= set("fiu") else "O",
            read=lambda index: real.read(index) + 1j * imag.read(index),
        )
    if len(signal.shape) not in (2, 3) or 0 in signal.shape or signal.kind != "c":
        expected = "complex (n_antennas, n_samples) or (n_poses, n_antennas, n_samples)"
        raise wrong_shape(path, "signal", expected, f"{signal.kind} {signal.shape}")
    return signal


def _positions(
    arrays: Mapping[str, _Array], path: Path, n_poses: int, n_antennas: int
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


def _axes(arrays: Mapping[str, _Array], path: Path, tx: Floats) -> Floats:
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


def _number(arrays: Mapping[str, _Array], name: str, path: Path) -> float | None:
    if name not in arrays:
        return None
    array = arrays[name]
    if int(np.prod(array.shape)) != 1 or array.kind not in "fiu":
        raise UserError(what=f"{name} must be a number", where=path, got=f"{array.shape}")
    return float(array.numbers().reshape(-1)[0])
