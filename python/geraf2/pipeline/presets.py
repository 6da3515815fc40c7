"""Presets: each a list of stages with one typed config."""

from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from geraf2.baselines import (
    BackProjectionConfig,
    LevelConfig,
    MatchedFilterConfig,
    NormalFieldConfig,
)
from geraf2.calibration.automatic import AUTOMATIC_VERSION
from geraf2.errors import UserError
from geraf2.glints import GlintConfig
from geraf2.io.toml import nearest
from geraf2.paper.config import PaperConfig
from geraf2.pipeline.baseline_stages import (
    BACK_PROJECTION_STAGES,
    MATCHED_FILTER_STAGES,
    NORMAL_FIELD_STAGES,
)
from geraf2.pipeline.glint_stages import GLINT_STAGES, HYBRID_STAGES
from geraf2.pipeline.paper_stages import GERAF1_STAGES, PAPER_STAGES
from geraf2.pipeline.stage import Stages
from geraf2.surfaces import FitConfig
from geraf2.surfaces.config import HeatmapFitConfig
from geraf2.surfaces.hybrid import HybridConfig


@dataclass(frozen=True, kw_only=True)
class GlintPreset:
    """Oriented points and a linear fit: seconds. Lengths in metres.

    ValueError for constants out of range.

    >>> from geraf2.surfaces import FitConfig
    >>> geraf2.GlintPreset(fit=FitConfig(spacing_m=0.006)).fit.spacing_m  # voxels [m]
    0.006
    """

    preset: Literal["glint"] = "glint"
    glints: GlintConfig = field(default_factory=GlintConfig)
    """What counts as a glint."""
    fit: FitConfig = field(default_factory=FitConfig)
    """How the surface is drawn through the glints."""


@dataclass(frozen=True, kw_only=True)
class HybridPreset:
    """Finer, and for scatterers and few planes: a second look, shadows, heat maps; 25 s of CPU.

    ValueError for constants out of range. Lengths in metres.

    >>> from geraf2.surfaces.config import HeatmapFitConfig
    >>> geraf2.HybridPreset(heatmaps=HeatmapFitConfig(n_rounds=0)).preset  # no heat maps
    'hybrid'
    """

    preset: Literal["hybrid"] = "hybrid"
    glints: GlintConfig = field(default_factory=GlintConfig)
    """What counts as a glint."""
    hybrid: HybridConfig = field(default_factory=HybridConfig)
    """What is done after the glints were found, with a fit of its own."""
    heatmaps: HeatmapFitConfig = field(default_factory=HeatmapFitConfig)
    """How the surface is fitted to heat maps at last; with n_rounds 0 not at all."""


@dataclass(frozen=True, kw_only=True)
class PaperPreset:
    """The learned method of the paper: minutes to an hour. Lengths in metres.

    ValueError for constants out of range.

    >>> geraf2.PaperPreset().preset
    'paper'
    """

    preset: Literal["paper"] = "paper"
    paper: PaperConfig = field(default_factory=PaperConfig)
    """Fields, rays, losses, stages."""


@dataclass(frozen=True, kw_only=True)
class Geraf1Preset:
    """To compare with: the learned method before the walls were modelled."""

    preset: Literal["geraf1"] = "geraf1"
    paper: PaperConfig = field(default_factory=PaperConfig)
    """As of the preset paper; what GeRaF 1 lacks is switched off."""
    level: LevelConfig = field(default_factory=LevelConfig)
    """How the level is chosen after the training."""


@dataclass(frozen=True, kw_only=True)
class MatchedFilterPreset:
    """To compare with: summed heat maps, a threshold, a Poisson surface."""

    preset: Literal["matched-filter"] = "matched-filter"
    matched_filter: MatchedFilterConfig = field(default_factory=MatchedFilterConfig)
    """Voxels, threshold, surface."""


@dataclass(frozen=True, kw_only=True)
class NormalFieldPreset:
    """To compare with: normals voxel by voxel, integrated."""

    preset: Literal["normal-field"] = "normal-field"
    normal_field: NormalFieldConfig = field(default_factory=NormalFieldConfig)
    """Voxels, votes, level."""


@dataclass(frozen=True, kw_only=True)
class BackProjectionPreset:
    """To compare with: a point cloud of the strongest returns."""

    preset: Literal["back-projection"] = "back-projection"
    back_projection: BackProjectionConfig = field(default_factory=BackProjectionConfig)
    """Voxels, threshold."""


PresetConfig: TypeAlias = (
    GlintPreset
    | HybridPreset
    | PaperPreset
    | Geraf1Preset
    | MatchedFilterPreset
    | NormalFieldPreset
    | BackProjectionPreset
)
_STAGES: dict[type[PresetConfig], Stages] = {
    GlintPreset: GLINT_STAGES,
    HybridPreset: HYBRID_STAGES,
    PaperPreset: PAPER_STAGES,
    Geraf1Preset: GERAF1_STAGES,
    MatchedFilterPreset: MATCHED_FILTER_STAGES,
    NormalFieldPreset: NORMAL_FIELD_STAGES,
    BackProjectionPreset: BACK_PROJECTION_STAGES,
}
PRESETS: dict[str, type[PresetConfig]] = {kind().preset: kind for kind in _STAGES}
"""Config of each preset, by its name."""
STAGE_NAMES = frozenset(stage.name for stages in _STAGES.values() for stage in stages)
"""Of all presets."""


def preset_type(name: str) -> type[PresetConfig]:
    """Look up the config of a preset; a UserError suggests the name that was meant."""
    if name not in PRESETS:
        raise UserError(
            what=f"unknown preset {name!r}{nearest(name, PRESETS)}", expected=", ".join(PRESETS)
        )
    return PRESETS[name]


def stages_of(config: PresetConfig) -> Stages:
    """Stages of a preset, each after those that it reads."""
    return _STAGES[type(config)]


def versions_of(config: PresetConfig) -> dict[str, int]:
    """Version of each stage of a preset: what is kept of its results holds as long as these do."""
    own = {stage.name: stage.version for stage in stages_of(config)}
    return {"calibration": AUTOMATIC_VERSION, **own}
