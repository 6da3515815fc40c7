"""Physical-optics captures of meshes in nested boxes."""

from geraf2.simulation.simulate import simulate
from geraf2.simulation.solids import build_solid
from geraf2.simulation.spec import (
    DisturbanceSpec,
    FigureSpec,
    NumericsSpec,
    ScanSpec,
    SceneSpec,
    WallSpec,
    WaveformSpec,
    load_spec,
    parse_spec,
)

__all__ = [
    "DisturbanceSpec",
    "FigureSpec",
    "NumericsSpec",
    "ScanSpec",
    "SceneSpec",
    "WallSpec",
    "WaveformSpec",
    "build_solid",
    "load_spec",
    "parse_spec",
    "simulate",
]
