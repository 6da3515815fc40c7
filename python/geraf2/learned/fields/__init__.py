"""Fields with parameters, as torch modules; apart, because torch takes a second to load."""

from geraf2.fields.sdf_field import CubeDomain, Distance, SdfField, SdfSample
from geraf2.learned.fields.encoding import positional_encoding
from geraf2.learned.fields.learned_sdf_grid import LearnedSdfGrid, LearnedSdfGridConfig
from geraf2.learned.fields.reflectivity import (
    Power,
    ReflectivityGrid,
    ReflectivityGridConfig,
    ReflectivityMlp,
    ReflectivityMlpConfig,
    Sharpness,
)
from geraf2.learned.fields.sdf_mlp import FeatureSample, SdfMlp, SdfMlpConfig
from geraf2.learned.fields.sdf_mlp_grid import SdfMlpGrid

__all__ = [
    "CubeDomain",
    "Distance",
    "FeatureSample",
    "LearnedSdfGrid",
    "LearnedSdfGridConfig",
    "Power",
    "ReflectivityGrid",
    "ReflectivityGridConfig",
    "ReflectivityMlp",
    "ReflectivityMlpConfig",
    "SdfField",
    "SdfMlp",
    "SdfMlpConfig",
    "SdfMlpGrid",
    "SdfSample",
    "Sharpness",
    "positional_encoding",
]
