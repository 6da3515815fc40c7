"""Specifications of simulations and suites of benchmarks."""

from dataclasses import is_dataclass
from types import NoneType
from typing import get_args, get_type_hints

from bad_inputs.table import bad, keys, put, swap, toml
from geraf2.simulation import SceneSpec
from geraf2.simulation.photo_spec import PhotosSpec

SIMULATE = "simulate spec.toml out"
# Decibels may be without an end: no noise, no leakage, no offset.
OPEN = (("snr_db", "1e30"), ("leakage_db", "-1e30"), ("dc_db", "-1e30"))


def walked():
    """Rows of a spec: each number below its range, above it and none, each choice unknown."""
    for key, kinds in [*_keys(SceneSpec), *_keys(PhotosSpec, "photos.")]:
        name, kind = key.split(".")[-1], kinds[0]
        for value in ('"no such"',) if isinstance(kind, str) else _bad_numbers(kind):
            is_list = len(kinds) > 1 and not isinstance(kind, str)
            text = f"[{', '.join([value] * len(kinds))}]" if is_list else value
            if (name, value) not in OPEN:
                yield bad(SIMULATE, toml("spec.toml", key, text), text=name)


def _keys(record, prefix=""):
    """Keys of a record and of the tables in it, each with the types of its values or its choices;
    PhotosSpec, which may be left out, and lists of tables but the walls are not followed."""
    for name, hint in get_type_hints(record).items():
        kinds = [kind for kind in get_args(hint) or (hint,) if kind not in (NoneType, Ellipsis)]
        if not is_dataclass(kinds[0]):
            yield prefix + name, kinds
        elif name not in ("photos", "rings", "sweeps", "arrays"):
            yield from _keys(kinds[0], f"{name}.")


def _bad_numbers(kind):
    huge = "9" * 18
    return {float: ("nan", "-1e30", "1e30"), int: ('"x"', "0.5", f"-{huge}", huge)}.get(kind, ())


# What the walk does not reach: names of files and objects, bounds on each other, what fits.
ROWS = [
    *keys(
        SIMULATE,
        "spec.toml",
        """
        figure.name 3
        figure.mesh "a.ply"
        figure.typo 1
        scan.n_poses 0
        scan.spacing_m "3mm"
        scan.standoff_m 0.05
        scan.aperture_m [0,0.1]|
        walls.size_m [0.05,0.05,0.05]
        walls.thickness_m 0.2
        world.effects ["leak"]|"iq"|["iq"]
        photos.size_px [640]
        photos.ring_elevations_deg []
        """,
    ),
    bad(SIMULATE, toml("spec.toml", "waveform.n_samples", "1048576"), text="GHz"),
    bad(SIMULATE, toml("spec.toml", "figure.name", '"yeti"'), text="yeti"),
    bad(SIMULATE, put("spec.toml", "[figure\n")),
    bad(SIMULATE, put("spec.toml", "[figure]\nmesh = 'no.ply'"), text="no.ply"),
    bad(
        SIMULATE,
        swap(
            "spec.toml",
            "[[walls]]\nsize_m = [0.16, 0.16, 0.16]",
            "[[walls]]\nsize_m = [0.12, 0.12, 0.12]\n[[walls]]\nsize_m = [0.16, 0.16, 0.16]",
        ),
        text="outermost first",
    ),
    bad("demo out --spec spec.toml --max-memory 1e-6", text="--max-memory"),
    bad("benchmark out --suite suite.toml --list", put("suite.toml", "")),
    bad("benchmark out --suite suite.toml --list", put("suite.toml", "[scenes]\n[methods]\n")),
    bad("benchmark out --suite suite.toml --list", put("suite.toml", "scenes = 3")),
]
