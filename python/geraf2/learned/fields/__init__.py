"""Fields with parameters, as torch modules; importing them loads torch."""

from geraf2.fields.sdf_field import CubeDomain, Distance, SdfField, SdfSample
from geraf2.learned.fields.encoding import positional_encoding
from geraf2.learned.fields.learned_sdf_grid import LearnedSdfGrid
from geraf2.learned.fields.reflectivity import Power, ReflectivityGrid, ReflectivityMlp, Sharpness
from geraf2.learned.fields.sdf_mlp import SdfMlp, SdfMlpConfig

__all__ = [
    "CubeDomain",
    "Distance",
    "LearnedSdfGrid",
    "Power",
    "ReflectivityGrid",
    "ReflectivityMlp",
    "SdfField",
    "SdfMlp",
    "SdfMlpConfig",
    "SdfSample",
    "Sharpness",
    "positional_encoding",
]
