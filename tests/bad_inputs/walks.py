"""Rows of every flag and of every key of a spec: each number out of range, each choice unknown."""

from dataclasses import is_dataclass
from importlib import import_module
from types import NoneType
from typing import get_args, get_type_hints

from bad_inputs.rows import BOX, IMPORT, SIMULATE
from bad_inputs.table import bad, toml
from geraf2.cli._fields import walk
from geraf2.cli.main import COMMANDS
from geraf2.pipeline.presets import PRESETS
from geraf2.simulation import SceneSpec

RECONSTRUCT = f"reconstruct scene out {BOX} --no-report --calibrate no --preset"
LINES = (
    *(f"{RECONSTRUCT} {preset}" for preset in PRESETS),
    "image scene out --every 4",
    "plan --box 0.2 0.2 0.2",
    "evaluate run --truth truth.ply",
    "render run",
    f"calibrate scene {BOX}",
    SIMULATE + " --seed 0",
    "los 0.2x0.2x0.2 out",
    "benchmark out --list",
    "demo out",
    "inspect run",
    f"batch scene out {BOX}",
    IMPORT,
)
"""Command lines whose flags are walked."""
# Corners may be infinite, and are looked at where there are photos.
UNUSED = ("--photos.bounds",)
# Decibels may be without an end: no noise, no leakage, no offset.
OPEN = (("snr_db", "1e30"), ("leakage_db", "-1e30"), ("dc_db", "-1e30"))


def walked(line):
    """Rows of a command line, without flags that a line before it has; of SIMULATE, of its spec."""
    if line == SIMULATE:
        yield from _spec()
        return
    command = line.split()[0]
    before = (other for other in LINES[: LINES.index(line)] if other.split()[0] == command)
    seen = {flag.name for other in before for flag in _flags(other)}
    for flag in _flags(line):
        if flag.name not in seen:
            kind, n_values = flag.kinds[0], max(flag.counts[0], 1)
            for value in ("no-such",) if isinstance(kind, tuple) else _wrong(kind):
                yield bad(f"{line} {flag.name} {' '.join([value] * n_values)}", text=flag.name)


def _wrong(kind, n_digits=40):
    """Values out of the range of numbers; a TOML file holds integers of 64 bits."""
    huge = "9" * n_digits
    return {float: ("nan", "-1e30", "1e30"), int: ("0.5", f"-{huge}", huge)}.get(kind, ())


def _flags(line):
    name, *words = line.split()
    module = import_module(f"geraf2.cli.{COMMANDS[name].module}")
    defaults = module.defaults(words) if hasattr(module, "defaults") else {}
    for flag in walk(module.Config, defaults):
        is_free = flag.in_place or flag.is_fixed or flag.counts == (0, 0) or flag.name in words
        if not is_free and flag.name not in UNUSED:
            yield flag


def _spec():
    for key, kinds in _keys(SceneSpec):
        name, kind = key.split(".")[-1], kinds[0]
        for value in ('"no such"',) if isinstance(kind, str) else _wrong(kind, 18):
            is_list = len(kinds) > 1 and not isinstance(kind, str)
            text = f"[{', '.join([value] * len(kinds))}]" if is_list else value
            if (name, value) not in OPEN:
                yield bad(SIMULATE, toml("spec.toml", key, text), text=name)


def _keys(record, prefix=""):
    """Keys of a record and of the tables in it, each with the types of its values or its choices;
    lists of tables but the walls are not followed."""
    for name, hint in get_type_hints(record).items():
        kinds = [kind for kind in get_args(hint) or (hint,) if kind not in (NoneType, Ellipsis)]
        if not is_dataclass(kinds[0]):
            yield prefix + name, kinds
        elif name not in ("rings", "sweeps", "arrays"):
            yield from _keys(kinds[0], f"{name}.")
