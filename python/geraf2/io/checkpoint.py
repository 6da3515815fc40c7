"""Checkpoints: named arrays with a header of plain JSON, in safetensors; nothing is unpickled."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from geraf2._types import AnyPath, Array
from geraf2.errors import UserError
from geraf2.io.atomic import write_bytes_atomic
from geraf2.io.file_kinds import refuse_other_kind
from geraf2.io.regular import require_regular
from geraf2.io.text import parse_json

_FORMAT = "geraf2-checkpoint"


@dataclass(frozen=True, kw_only=True, eq=False)
class Checkpoint:
    """State of a training."""

    kind: str
    """What made it, e.g. the preset."""
    version: int
    """Of the layout of its arrays."""
    arrays: dict[str, Array]
    """Parameters, state of the optimiser and of the random numbers, by name."""
    header: dict[str, Any]
    """Plain JSON beside them: step, stage, settings."""


def save_checkpoint(path: AnyPath, checkpoint: Checkpoint) -> None:
    """Write a checkpoint whole or not at all."""
    arrays = {name: np.asarray(a, order="C") for name, a in checkpoint.arrays.items()}
    metadata = {
        "format": _FORMAT,
        "kind": checkpoint.kind,
        "version": str(checkpoint.version),
        "header": json.dumps(checkpoint.header, allow_nan=False),
    }
    write_bytes_atomic(path, _in_order(save(arrays, metadata)))


def _in_order(data: bytes) -> bytes:
    """Sort the names in the header, whose order safetensors leaves to chance."""
    # The file begins with the header's length, 8 bytes, and its JSON; arrays are relative to its
    # end.
    end = 8 + int.from_bytes(data[:8], "little")
    text = json.dumps(parse_json(data[8:end]), sort_keys=True, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)  # arrays begin at a multiple of 8
    return len(text).to_bytes(8, "little") + text + data[end:]


def load_checkpoint(path: AnyPath, *, kind: str, version: int) -> Checkpoint:
    """Read a checkpoint of one kind and version; UserError for anything else."""
    source = Path(path)
    refuse_other_kind(source)
    try:
        require_regular(source)
        with safe_open(source, framework="numpy") as stored:
            metadata = stored.metadata() or {}
            _require_same(source, metadata, kind, version)
            # Copied: what the reader hands out is not to be written to.
            arrays = {name: np.array(stored.get_tensor(name)) for name in stored.keys()}  # noqa: SIM118 - no mapping
        header = parse_json(metadata["header"])
    except (OSError, SafetensorError, KeyError, ValueError) as error:
        raise UserError(
            what=f"cannot be read as a checkpoint: {type(error).__name__}: {error}",
            where=source,
            hint="the file may be missing or cut off; start again without --resume",
        ) from error
    for name, array in arrays.items():
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise UserError(what=f"{name} holds numbers that are not finite", where=source)
    if not isinstance(header, dict):
        raise UserError(what="cannot be read as a checkpoint: no header", where=source)
    return Checkpoint(kind=kind, version=version, arrays=arrays, header=header)


def _require_same(source: Path, metadata: Mapping[str, str], kind: str, version: int) -> None:
    if metadata.get("format") != _FORMAT:
        raise UserError(what="is not a checkpoint of geraf2", where=source)
    got_kind, got_version = metadata.get("kind"), metadata.get("version")
    if got_kind != kind:
        raise UserError(
            what="is a checkpoint of another kind",
            where=source,
            expected=repr(kind),
            got=repr(got_kind),
            hint="choose another output folder, or start again without --resume",
        )
    if got_version != str(version):
        raise UserError(
            what="is a checkpoint of another version of geraf2",
            where=source,
            expected=f"layout {version}",
            got=f"layout {got_version}",
            hint="start again without --resume",
        )
