"""The subcommands, and the flags that all of them take."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from geraf2.errors import UserError


@dataclass(frozen=True)
class Command:
    """One subcommand."""

    module: str
    summary: str
    after_stop: str = "every file is whole, the same command starts over"
    """State of its output when it is interrupted, or when the disk is full."""


_CONTINUES = "every file is whole, the same command continues"

COMMANDS = {
    "demo": Command("demo", "simulate a carton, reconstruct it, write a report"),
    "import": Command("import_scene", "turn a capture of another format into a scene"),
    "info": Command("info", "what is in a scene, recording, bag or run, and what is odd"),
    "plan": Command("plan", "spacing, planes, time and coverage of a scan to be made"),
    "simulate": Command("simulate", "physical-optics capture of an object in boxes"),
    "calibrate": Command("calibrate", "delay, phases, frame, positions from the scan itself"),
    "los": Command("los", "outside of the box from photos, a mesh or its sides", _CONTINUES),
    "image": Command("image", "matched-filter volume of a scene"),
    "reconstruct": Command(
        "reconstruct",
        "surface of what is hidden in the box",
        "OUT is as it was; a training continues with --resume",
    ),
    "live": Command("live", "surface while the scan is made, plane by plane", _CONTINUES),
    "render": Command("render", "heat maps of planes from a run, with PSNR", _CONTINUES),
    "evaluate": Command("evaluate", "distance of a run to the truth"),
    "inspect": Command("inspect", "parts, sizes, CAD models: the right part, and whole"),
    "compare": Command("compare", "what appeared, vanished or moved since other runs"),
    "export": Command("export", "surface or glints of a run as one file"),
    "view": Command("view", "a run or a scene in 3D in a browser"),
    "verify": Command("verify", "is every file of a run or scene as it was written"),
    "batch": Command("batch", "reconstruct many scenes on many processes", _CONTINUES),
    "belt": Command("belt", "parcels on a belt, each reconstructed on a worker", _CONTINUES),
    "benchmark": Command("benchmark", "tables of methods over simulated scenes", _CONTINUES),
    "doctor": Command("doctor", "versions, CPU, threads, kernels, writable folders"),
}

ESTIMATED = ("demo", "simulate", "image", "reconstruct", "render")
"""Commands that estimate their memory before they begin: the others take no --max-memory."""

VALUE_FLAGS = ("--threads", "--max-memory")
"""Flags of all commands with a value."""

GLOBAL_FLAGS = ("--debug", "--version", "--json", "--quiet", "--verbose")


def take_values(arguments: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    """Arguments without the flags of all commands that have a value, and those values."""
    rest, values, words = list[str](), dict[str, str](), iter(arguments)
    for word in words:
        name, equals, value = word.partition("=")
        if name in VALUE_FLAGS:
            values[name] = value if equals else next(words, "")
        else:
            rest.append(word)
    return rest, values


def memory_bytes(text: str | None) -> float:
    """Memory that --max-memory allows; infinite without it."""
    if text is None:
        return math.inf
    try:
        allowed = 2.0**30 * float(text)
    except ValueError:
        allowed = math.nan
    if not allowed > 0.0:
        what = "must be a positive number of GiB"
        raise UserError(what=what, where="--max-memory", got=text or "nothing")
    return allowed


def thread_count(text: str | None) -> int | None:
    """Threads of --threads; None without it."""
    if text is None:
        return None
    from geraf2._bounds import MAX_THREADS  # noqa: PLC0415 - `--help` does without

    if not text.isdecimal() or len(text) > 9 or not 1 <= int(text) <= MAX_THREADS:
        what = f"must be a whole number from 1 to {MAX_THREADS}"
        raise UserError(what=what, where="--threads", got=text or "nothing")
    return int(text)
