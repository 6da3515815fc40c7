"""Values of flags: each number out of range or none, each choice unknown; and the rest."""

from importlib import import_module

from bad_inputs.lines import IMPORT, RUN
from bad_inputs.table import bad, sweep
from geraf2.cli._fields import walk
from geraf2.cli.main import COMMANDS
from geraf2.pipeline.presets import PRESETS

LINES = (
    *(f"{RUN.replace('--preset fast', '')} --preset {preset}" for preset in PRESETS),
    "image scene out --every 4",
    "plan --box 0.2 0.2 0.2",
    "evaluate run --truth truth.ply",
    "render run",
    "calibrate scene --box 0.16 0.16 0.16",
    "simulate spec.toml out",
    "los 0.2x0.2x0.2 out",
    "benchmark out --list",
    "demo out",
    "inspect run",
    "batch scene out --box 0.16 0.16 0.16 --list",
    IMPORT,
)
"""Command lines whose flags are walked."""
# Corners may be infinite, and are looked at where there are photos.
UNUSED = ("--photos.bounds",)


def walked(line):
    """Rows of a command line: a number below its range, above it and none, an unknown choice.

    Without flags that a line before it has.
    """
    command = line.split()[0]
    before = (other for other in LINES[: LINES.index(line)] if other.split()[0] == command)
    seen = {flag.name for other in before for flag in _flags(other)}
    for flag in _flags(line):
        if flag.name not in seen:
            n_values = max(flag.counts[0], 1)
            for value in _bad_values(flag.kinds[0]):
                yield bad(f"{line} {flag.name} {' '.join([value] * n_values)}", text=flag.name)


def _flags(line):
    name, *words = line.split()
    module = import_module(f"geraf2.cli.{COMMANDS[name].module}")
    defaults = module.defaults(words) if hasattr(module, "defaults") else {}
    for flag in walk(module.Config, defaults):
        is_free = flag.in_place or flag.is_fixed or flag.counts == (0, 0) or flag.name in words
        if not is_free and flag.name not in UNUSED:
            yield flag


def _bad_values(kind):
    if isinstance(kind, tuple):
        return ("no-such-choice",)
    huge = "9" * 40
    return {float: ("nan", "-1e30", "1e30"), int: ("x", "0.5", f"-{huge}", huge)}.get(kind, ())


# What the walk does not reach: bounds on each other, two flags, files, how many values there are.
ROWS = [
    *sweep(
        RUN + " {}",
        """
        threads 0
        fit.spacing-m 0
        fit.cap-lean -9 -9|0.2
        glints.subaperture.rim-sizes-m 0
        preset hybrid
        """,
    ),
    *sweep(RUN + " --preset best {}", "refine.rim.sizes-m 0|nan"),
    *sweep(RUN + " --preset paper {}", "paper.grid-n 0 25|\npaper.mesh-n 0 100000"),
    *sweep(
        "image scene out --every 4 {}",
        """
        pose 99
        size-m 0 0 0|nan 1 1
        depth-m 0.3 0.2
        angles-deg 60 0
        """,
    ),
    *sweep("plan --box 0.2 0.2 0.2 {}", "aperture 0 0.1\nelevations-deg 90\nspacing 1e-12"),
    *sweep("render run {}", "echo.max-edge-m 1e-7\nspacing-m 1e-7 5\nmax-memory 1e-6"),
    *sweep(
        "calibrate scene --box 0.16 0.16 0.16 {}",
        "channels 1 0\ndelay-search 0.1 0|-100 100\nreflector nan 0 0|",
    ),
    *sweep("calibrate scene {}", "box 0 1 1|nan 1 1\ndelay-from ear"),
    *sweep("plan --depth 0.3 {}", "spacing 1e-9\naperture 11 1\nstandoff 1\nplanes 3"),
    *sweep("los 0.2x0.2x0.2 out {}", "box-center nan 0 0|\nbounds 1 1 1 0 0 0|\nthreads -1"),
    *sweep(
        "los nerf out {}", "preset slow\ncamera-axes blender\nbounds 0 0 0 nan 1 1|\nhold-out x"
    ),
    *sweep("simulate spec.toml out {}", "max-memory 1e-6 0\nthreads 1e3"),
    *sweep("import geraf-sens frames out {}", "phase-sign 0 x\nmax-memory"),
    *sweep("demo out {}", "hybrid.fit.spacing-m 0\nglints.wall-margin-m inf"),
    bad("los 1e9x1e9x1e9 out", text="1e9"),
    bad("los -1x0.2x0.2 out", text="-1x"),
]
