"""Baseline methods, from their published descriptions, on the project's own kernels."""

from geraf2.baselines.back_projection import (
    BackProjectionConfig,
    OrientedCloud,
    back_projection_cloud,
    cloud_as_mesh,
)
from geraf2.baselines.level import LevelConfig
from geraf2.baselines.matched_filter_surface import MatchedFilterConfig, matched_filter_surface
from geraf2.baselines.normal_field import NormalFieldConfig, normal_field_surface

BASELINE_VERSION = 2
"""Raised when a baseline's surface changes for the same capture and settings."""


__all__ = [
    "BASELINE_VERSION",
    "BackProjectionConfig",
    "LevelConfig",
    "MatchedFilterConfig",
    "NormalFieldConfig",
    "OrientedCloud",
    "back_projection_cloud",
    "cloud_as_mesh",
    "matched_filter_surface",
    "normal_field_surface",
]
