"""Importer of the GeRaF-SENS folder layout.

    capture/
        capture.json                       parameters (optional, see radar.toml)
        mf/<index>_<angle>_<sub>/          one folder for each frame
            tpos.npy  rpos.npy             (n_antennas, 3) real [m]
            adcr.npy  adci.npy             (n_antennas, n_samples) real
            rotation.npy                   (3, 3), columns viewing, horizontal, vertical

Sub-scans of one index and angle are parts of one plane. They become one pose if their axes agree
and no antenna position is repeated, and separate poses otherwise.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from geraf2._types import Array, Floats
from geraf2.apps.importers import NO_OPTIONS, ImportOptions, Scan
from geraf2.apps.importers._rows import wrong_shape
from geraf2.apps.importers._scene_manifest import scene_manifest
from geraf2.errors import UserError
from geraf2.io.arrays import read_npy
from geraf2.io.container import join_parts
from geraf2.io.manifest import RadarManifest, SceneManifest
from geraf2.io.text import read_object
from geraf2.io.toml import nearest_name
from geraf2.records import RawPose

ARRAY_NAMES = ("tpos", "rpos", "adcr", "adci", "rotation")

FRAME_NAME = re.compile(r"(?P<index>\d+)_(?P<angle>[+-]?\d+(?:\.\d+)?)_(?P<sub>\d+)")

# capture.json key -> radar.toml key
_CAPTURE_KEYS = {
    "start_frequency_hz": "start_frequency_hz",
    "chirp_slope_hz_per_s": "chirp_slope_hz_per_s",
    "adc_sample_rate_hz": "sample_rate_hz",
    "n_adc_samples": "n_samples",
    "path_bias_m": "path_bias_m",
}
_WALL_KEYS = ("box_size_m", "wall_thickness_m", "wall_permittivity")
_CENTER_KEY = "box_center_m"
_KNOWN_KEYS = (*_CAPTURE_KEYS, *_WALL_KEYS, _CENTER_KEY, "n_poses")

# Rotations in float32, typed in with four digits, are orthonormal to about 1e-4.
_ORTHONORMAL_TOLERANCE = 1e-3
# Antenna positions closer than this are equal: a twentieth of a 3 mm step.
_SAME_POSITION_M = 1.5e-4


@dataclass(frozen=True)
class Frame:
    """A part of a plane, whose headers were read."""

    folder: Path
    index: int
    angle_deg: float
    sub: int
    n_antennas: int
    n_samples: int


class GerafSensImporter:
    """Reads the GeRaF-SENS folder layout."""

    def open(self, source: Path, radar: RadarManifest, options: ImportOptions = NO_OPTIONS) -> Scan:
        """Check the headers of every frame, and the parameters; see Importer.open."""
        folders, notes = _find_frames(Path(source))
        frames = [check_headers(folder) for folder in folders]
        n_samples = frames[0].n_samples
        for frame in frames:
            if frame.n_samples != n_samples:
                raise UserError(
                    what="frames differ in their number of samples",
                    where=frame.folder / "adcr.npy",
                    expected=f"{n_samples} as in {frames[0].folder.name}",
                    got=frame.n_samples,
                )
        groups = group_frames(frames)
        capture = read_capture_json(Path(source))
        manifest, more_notes = capture_manifest(Path(source), capture, radar, n_samples)
        notes += more_notes
        expected = capture.get("n_poses")
        if isinstance(expected, int) and expected != len(groups):
            notes.append(f"capture.json states n_poses = {expected}, found {len(groups)}")
        return Scan(
            manifest=manifest,
            n_antennas=tuple(sum(frame.n_antennas for frame in group) for group in groups),
            poses=lambda: map(read_group, groups),
            notes=tuple(notes),
        )


def _find_frames(source: Path) -> tuple[list[Path], list[str]]:
    if not source.exists():
        raise UserError(what="no such folder", where=source)
    if not source.is_dir():
        raise UserError(what="is not a folder", where=source, expected="a capture with mf/ in it")
    root = source / "mf" if (source / "mf").is_dir() else source
    folders, skipped = list[Path](), list[Path]()
    for entry in root.iterdir():
        if FRAME_NAME.fullmatch(entry.name) and not entry.is_dir():
            what = "is a link that leads nowhere" if entry.is_symlink() else "is no folder"
            raise UserError(
                what=what, where=entry, hint="repair it, or remove it to skip the frame"
            )
        if not entry.is_dir() or entry.name.startswith("."):
            continue
        (folders if FRAME_NAME.fullmatch(entry.name) else skipped).append(entry)
    if not folders:
        raise UserError(
            what="has no frame folders",
            where=root,
            expected="mf/<index>_<angle>_<sub>/ with " + ", ".join(f"{n}.npy" for n in ARRAY_NAMES),
        )
    folders.sort(key=_order)
    notes = _repeated(folders)
    if skipped:
        names = ", ".join(sorted(path.name for path in skipped)[:4])
        notes.append(f"{len(skipped)} folders are no frames and were skipped: {names}")
    return folders, notes


def _repeated(folders: Sequence[Path]) -> list[str]:
    """Note on planes whose index occurs with several angles; UserError for a frame that repeats."""
    by_index: dict[int, dict[float, Path]] = {}
    for before, folder in pairwise(folders):
        if _order(before) == _order(folder):
            raise UserError(
                what=f"is the same frame as {before.name}",
                where=folder,
                hint="remove one of the two",
            )
    for folder in folders:
        index, angle, _ = _order(folder)
        by_index.setdefault(index, {}).setdefault(angle, folder)
    several = [of for of in by_index.values() if len(of) > 1]
    if not several:
        return []
    names = ", ".join(path.name for path in list(several[0].values())[:4])
    return [f"{len(several)} plane indices occur with several angles, the first as {names}"]


def _order(folder: Path) -> tuple[int, float, int]:
    match = FRAME_NAME.fullmatch(folder.name)
    assert match is not None  # only frames get here
    return int(match["index"]), float(match["angle"]), int(match["sub"])


def _load(path: Path, *, header_only: bool = False) -> Array:
    """One array, loaded without pickle; `header_only` maps it instead of reading it."""
    if not path.is_file():
        raise UserError(what="file of the frame is missing", where=path)
    return read_npy(path, header_only=header_only)


def check_headers(folder: Path) -> Frame:
    """Frame of a folder; UserError where an array is missing, cut short, or of another shape."""
    arrays = {name: _load(folder / f"{name}.npy", header_only=True) for name in ARRAY_NAMES}
    for name, array in arrays.items():
        if array.dtype.kind != "f" or array.dtype.itemsize not in (4, 8):
            where = folder / f"{name}.npy"
            raise wrong_shape(where, "array", "float32 or float64", array.dtype)
    shapes = {name: array.shape for name, array in arrays.items()}
    n_antennas, n_samples = (shapes["tpos"] or (0,))[0], (shapes["adcr"] or (0,))[-1]
    if n_antennas == 0:
        hint = "remove the folder to skip it"
        raise UserError(what="frame has 0 antennas", where=folder, hint=hint)
    wanted: dict[str, tuple[int, ...]] = {
        **dict.fromkeys(("tpos", "rpos"), (n_antennas, 3)),
        **dict.fromkeys(("adcr", "adci"), (n_antennas, max(n_samples, 1))),
        "rotation": (3, 3),
    }
    for name, shape in wanted.items():
        if shapes[name] != shape:
            where, expected = folder / f"{name}.npy", f"{shape}, by tpos.npy and adcr.npy"
            raise wrong_shape(where, "array", expected, shapes[name])
    return Frame(folder, *_order(folder), n_antennas, n_samples)


def read_group(group: Sequence[Frame]) -> RawPose:
    """Pose of frames that belong together."""
    parts = [_read_frame(frame) for frame in group]
    return replace(join_parts(parts), name="+".join(part.name for part in parts))


def _read_frame(frame: Frame) -> RawPose:
    arrays = {name: _load(frame.folder / f"{name}.npy") for name in ARRAY_NAMES}
    for name, array in arrays.items():
        bad = ~np.isfinite(array)
        if bad.any():
            share = f"{int(bad.sum())} of {array.size}"
            first = tuple(int(i) for i in np.argwhere(bad)[0])
            what = f"{share} values are NaN or infinite, first at {first}"
            raise UserError(what=what, where=frame.folder / f"{name}.npy")
    signal = np.empty(arrays["adcr"].shape, dtype=np.complex64)
    signal.real = arrays["adcr"]
    signal.imag = arrays["adci"]
    return RawPose(
        signal=signal,
        tx_positions=arrays["tpos"].astype(np.float64),
        rx_positions=arrays["rpos"].astype(np.float64),
        axes=_axes(frame.folder / "rotation.npy", arrays["rotation"]),
        name=frame.folder.name,
        angle_deg=frame.angle_deg,
    )


def _axes(path: Path, rotation: Array) -> Floats:
    """Rows viewing, horizontal, vertical, from the columns of the file."""
    axes: Floats = rotation.astype(np.float64).T.copy()
    error = float(np.abs(axes @ axes.T - np.eye(3)).max())
    if error > _ORTHONORMAL_TOLERANCE:
        raise UserError(
            what="columns are not orthonormal",
            where=path,
            expected=f"an error below {_ORTHONORMAL_TOLERANCE}",
            got=f"{error:.2g}",
        )
    return axes


def group_frames(frames: Sequence[Frame]) -> list[list[Frame]]:
    """Frames of each pose, in order. Only positions of sub-scans are read."""
    groups: list[list[Frame]] = []
    for frame in frames:
        last = groups[-1] if groups else None
        same = last and (last[0].index, last[0].angle_deg) == (frame.index, frame.angle_deg)
        if last and same and _belong_together(last, frame):
            last.append(frame)
        else:
            groups.append([frame])
    return groups


def _belong_together(group: Sequence[Frame], frame: Frame) -> bool:
    """Whether the axes agree and no antenna position is repeated."""

    def load(one: Frame, name: str) -> Floats:
        return np.asarray(_load(one.folder / f"{name}.npy"), dtype=np.float64)

    axes = load(group[0], "rotation")
    if np.abs(axes - load(frame, "rotation")).max() > _ORTHONORMAL_TOLERANCE:
        return False
    # Transmitter and receiver, scaled so that rounding gives equal integers.
    positions = [
        np.hstack([load(one, "tpos"), load(one, "rpos")]) / _SAME_POSITION_M
        for one in (*group, frame)
    ]
    join_parts = np.round(np.concatenate(positions))
    return len(np.unique(join_parts, axis=0)) == len(join_parts)


def read_capture_json(source: Path) -> dict[str, Any]:
    """Parameters of a capture; {} without the file."""
    path = source / "capture.json"
    if source.name == "mf" and not path.is_file():  # the user named the inner folder
        path = source.parent / "capture.json"
    values = read_object(path) if path.is_file() else {}
    for key in values:  # misspelt ones; others belong to other programs
        if key not in _KNOWN_KEYS and (meant := nearest_name(key, _KNOWN_KEYS)):
            raise UserError(what=f"unknown key {key!r}{meant}", where=path)
    return values


def capture_manifest(
    source: Path, capture: Mapping[str, Any], radar: RadarManifest, n_samples: int
) -> tuple[SceneManifest, list[str]]:
    """Manifest of a capture by its capture.json and what the user gives, and notes."""
    where = source / "capture.json" if capture else source
    known = {
        ours: _number(theirs, capture[theirs], where)
        for theirs, ours in _CAPTURE_KEYS.items()
        if capture.get(theirs) is not None
    }
    if radar.n_samples is None:
        radar = radar.model_copy(update={"n_samples": capture.get("n_adc_samples")})
    return scene_manifest(
        "geraf-sens", source, radar, {**known, "n_samples": n_samples}, walls=_walls(capture, where)
    )


def _walls(capture: Mapping[str, Any], where: Path) -> list[dict[str, Any]]:
    """Walls from box_size_m, wall_thickness_m, wall_permittivity; none unless all are given.

    Their middle is box_center_m, or the origin.
    """
    # box_size_m is a side, or a list from the outer box to the inner one of sides or triples. Three
    # numbers are the sides of one box, unless three thicknesses are given.
    values = [capture.get(key) for key in _WALL_KEYS]
    if any(value is None for value in values):
        return []
    sizes, thickness, permittivity = values
    entries = sizes if isinstance(sizes, list) else [sizes]
    flat = not any(isinstance(entry, list) for entry in entries)
    if flat and len(entries) == 3 and not (isinstance(thickness, list) and len(thickness) == 3):
        entries = [entries]
    columns = []
    for name, value in zip(_WALL_KEYS[1:], (thickness, permittivity), strict=True):
        column = value if isinstance(value, list) else [value] * len(entries)
        expected = f"one entry for each of {len(entries)} boxes"
        if len(column) != len(entries):
            what = f"key {name!r} has the wrong length"
            raise UserError(what=what, where=where, expected=expected, got=len(column))
        columns.append([_number(name, entry, where) for entry in column])
    center = capture.get(_CENTER_KEY, [0.0, 0.0, 0.0])
    if not isinstance(center, list) or len(center) != 3:
        what = f"key {_CENTER_KEY!r} must be three numbers"
        raise UserError(what=what, where=where, got=f"{str(center)[:60]!r}")
    return [
        {
            "center_m": [_number(_CENTER_KEY, entry, where) for entry in center],
            "size_m": [
                _number("box_size_m", side, where)
                for side in (entry if isinstance(entry, list) else [entry] * 3)
            ],
            "thickness_m": thickness,
            "permittivity": permittivity,
        }
        for entry, thickness, permittivity in zip(entries, *columns, strict=True)
    ]


def _number(name: str, value: Any, where: Path) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise UserError(
            what=f"key {name!r} must be a number", where=where, got=f"{str(value)[:60]!r}"
        )
    try:
        return float(value)
    except OverflowError:  # JSON allows integers of any length
        raise UserError(what=f"key {name!r} is beyond every number in use", where=where) from None
