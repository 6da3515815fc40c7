"""Methods to compare with, from their published descriptions, on the project's own kernels."""

from dataclasses import dataclass, field

from geraf2.baselines.back_projection import (
    BackProjectionConfig,
    OrientedCloud,
    back_projection_cloud,
    cloud_as_mesh,
)
from geraf2.baselines.level import LevelConfig
from geraf2.baselines.matched_filter_surface import (
    MatchedFilterConfig,
    matched_filter_surface,
)
from geraf2.baselines.normal_field import NormalFieldConfig, normal_field_surface


@dataclass(frozen=True, kw_only=True)
class BaselineConfig:
    """Constants of the baselines."""

    matched_filter: MatchedFilterConfig = field(default_factory=MatchedFilterConfig)
    """Of `--preset matched-filter`."""
    back_projection: BackProjectionConfig = field(default_factory=BackProjectionConfig)
    """Of `--preset back-projection`."""
    normal_field: NormalFieldConfig = field(default_factory=NormalFieldConfig)
    """Of `--preset normal-field`."""
    geraf1_level: LevelConfig = field(default_factory=LevelConfig)
    """Of `--preset geraf1`: how the level is chosen after the training."""


__all__ = [
    "BackProjectionConfig",
    "BaselineConfig",
    "LevelConfig",
    "MatchedFilterConfig",
    "NormalFieldConfig",
    "OrientedCloud",
    "back_projection_cloud",
    "cloud_as_mesh",
    "matched_filter_surface",
    "normal_field_surface",
]
