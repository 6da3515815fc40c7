"""Physical-optics captures of meshes in nested boxes."""

from geraf2.simulation.simulate import simulate
from geraf2.simulation.solids import build_solid
from geraf2.simulation.spec import (
    DisturbanceSpec,
    FigureSpec,
    NumericsSpec,
    ScanSpec,
    SceneSpec,
    load_spec,
    parse_spec,
)
from geraf2.simulation.world import WorldSpec

__all__ = [
    "DisturbanceSpec",
    "FigureSpec",
    "NumericsSpec",
    "ScanSpec",
    "SceneSpec",
    "WorldSpec",
    "build_solid",
    "load_spec",
    "parse_spec",
    "simulate",
]
