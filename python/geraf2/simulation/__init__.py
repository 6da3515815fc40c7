"""Physical-optics captures of meshes in nested boxes, and photos of the box."""

from geraf2.simulation.photo_spec import PhotosSpec
from geraf2.simulation.photos import simulate_photos
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
    "PhotosSpec",
    "ScanSpec",
    "SceneSpec",
    "WorldSpec",
    "build_solid",
    "load_spec",
    "parse_spec",
    "simulate",
    "simulate_photos",
]
