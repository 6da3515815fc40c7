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

__all__ = [
    "DisturbanceSpec",
    "FigureSpec",
    "NumericsSpec",
    "PhotosSpec",
    "ScanSpec",
    "SceneSpec",
    "build_solid",
    "load_spec",
    "parse_spec",
    "simulate",
    "simulate_photos",
]
