"""Presets: lists of stages, each preset with one typed config."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

from geraf2.baselines import (
    BackProjectionConfig,
    LevelConfig,
    MatchedFilterConfig,
    NormalFieldConfig,
)
from geraf2.calibration.driver import CALIBRATION_VERSION
from geraf2.echoes import GlintConfig
from geraf2.errors import UserError
from geraf2.io.toml import from_table, merged, nearest, to_table
from geraf2.learned.config import CorrectedPaperConfig, PaperConfig
from geraf2.pipeline.stages.baselines import (
    BACK_PROJECTION_STAGES,
    MATCHED_FILTER_STAGES,
    NORMAL_FIELD_STAGES,
)
from geraf2.pipeline.stages.direct import BEST_STAGES, FAST_STAGES
from geraf2.pipeline.stages.learned import GERAF1_STAGES, PAPER_STAGES
from geraf2.pipeline.stages.stage import Stages
from geraf2.surfaces import FitConfig
from geraf2.surfaces.refinement import RefineConfig


@dataclass(frozen=True, kw_only=True)
class FastPreset:
    """Oriented points and a linear fit: seconds. Lengths in metres.

    Raises ValueError for constants out of range.

    >>> from geraf2.surfaces import FitConfig
    >>> geraf2.FastPreset(fit=FitConfig(spacing_m=0.006)).fit.spacing_m  # voxels [m]
    0.006
    """

    preset: Literal["fast"] = "fast"
    glints: GlintConfig = field(default_factory=GlintConfig)
    """Detection of glints."""
    fit: FitConfig = field(default_factory=FitConfig)
    """Fit of the surface to the glints."""


@dataclass(frozen=True, kw_only=True)
class BestPreset:
    """More accurate, and for few planes: also rim sub-apertures and shadows; 8 s of CPU.

    Lengths in metres. Raises ValueError for constants out of range.

    >>> geraf2.BestPreset().refine.fit.spacing_m
    0.003
    """

    preset: Literal["best"] = "best"
    glints: GlintConfig = field(default_factory=GlintConfig)
    """Detection of glints."""
    refine: RefineConfig = field(default_factory=RefineConfig)
    """Selection of glints and outlines, and the fit to them."""


@dataclass(frozen=True, kw_only=True)
class PaperPreset:
    """The learned method of the paper: minutes to an hour. Lengths in metres.

    Raises ValueError for constants out of range.

    >>> geraf2.PaperPreset().preset
    'paper'
    """

    preset: Literal["paper"] = "paper"
    paper: PaperConfig = field(default_factory=PaperConfig)
    """Fields, rays, losses, stages."""


@dataclass(frozen=True, kw_only=True)
class CorrectedPaperPreset:
    """The learned method of the paper with a corrected level. Lengths in metres.

    Raises ValueError for constants out of range.

    >>> geraf2.CorrectedPaperPreset().paper.two_way
    'unbiased'
    """

    preset: Literal["paper-corrected"] = "paper-corrected"
    paper: CorrectedPaperConfig = field(default_factory=CorrectedPaperConfig)
    """As in the preset paper, but without its bias of the level."""


@dataclass(frozen=True, kw_only=True)
class Geraf1Preset:
    """Baseline: the learned method before the walls were modelled."""

    preset: Literal["geraf1"] = "geraf1"
    paper: PaperConfig = field(default_factory=PaperConfig)
    """As in the preset paper, without the parts that GeRaF 1 lacks."""
    level: LevelConfig = field(default_factory=LevelConfig)
    """Choice of the level after the training."""


@dataclass(frozen=True, kw_only=True)
class MatchedFilterPreset:
    """Baseline: summed heat maps, a threshold, a Poisson surface."""

    preset: Literal["matched-filter"] = "matched-filter"
    matched_filter: MatchedFilterConfig = field(default_factory=MatchedFilterConfig)
    """Voxels, threshold, surface."""


@dataclass(frozen=True, kw_only=True)
class NormalFieldPreset:
    """Baseline: normals of voxels, integrated."""

    preset: Literal["normal-field"] = "normal-field"
    normal_field: NormalFieldConfig = field(default_factory=NormalFieldConfig)
    """Voxels, votes, level."""


@dataclass(frozen=True, kw_only=True)
class BackProjectionPreset:
    """Baseline: a point cloud of the strongest returns."""

    preset: Literal["back-projection"] = "back-projection"
    back_projection: BackProjectionConfig = field(default_factory=BackProjectionConfig)
    """Voxels, threshold."""


PresetConfig: TypeAlias = (
    FastPreset
    | BestPreset
    | PaperPreset
    | CorrectedPaperPreset
    | Geraf1Preset
    | MatchedFilterPreset
    | NormalFieldPreset
    | BackProjectionPreset
)
_STAGES: dict[type[PresetConfig], Stages] = {
    FastPreset: FAST_STAGES,
    BestPreset: BEST_STAGES,
    PaperPreset: PAPER_STAGES,
    CorrectedPaperPreset: PAPER_STAGES,
    Geraf1Preset: GERAF1_STAGES,
    MatchedFilterPreset: MATCHED_FILTER_STAGES,
    NormalFieldPreset: NORMAL_FIELD_STAGES,
    BackProjectionPreset: BACK_PROJECTION_STAGES,
}
PRESETS: dict[str, type[PresetConfig]] = {kind().preset: kind for kind in _STAGES}
"""Config type of each preset, by name."""
STAGE_NAMES = frozenset(stage.name for stages in _STAGES.values() for stage in stages)
"""Names of the stages of all presets."""


def preset_type(name: str) -> type[PresetConfig]:
    """Config type of a preset; the UserError of an unknown one suggests a name."""
    if name not in PRESETS:
        raise UserError(
            what=f"unknown preset {name!r}{nearest(name, PRESETS)}", expected=", ".join(PRESETS)
        )
    return PRESETS[name]


def preset_of_table(table: Mapping[str, Any], where: object) -> PresetConfig:
    """Parse the constants of config.toml; UserError for unknown or wrong ones.

    Tables that change only some constants keep the preset's other values.
    """
    name = table.get("preset")
    if isinstance(name, str) and name in PRESETS:
        table = merged(to_table(PRESETS[name]()), table)
    return from_table(table, tuple(PRESETS.values()), where)


def stages_of(config: PresetConfig) -> Stages:
    """Stages of a preset, in an order in which each follows its inputs."""
    return _STAGES[type(config)]


def versions_of(config: PresetConfig) -> dict[str, int]:
    """Version of each stage of a preset; stored results are valid for these versions."""
    own = {stage.name: stage.version for stage in stages_of(config)}
    return {"calibration": CALIBRATION_VERSION, **own}
