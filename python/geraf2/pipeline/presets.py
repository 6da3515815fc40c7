"""Presets: each a list of stages with one typed config."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Literal, TypeAlias

from geraf2.baselines import (
    BackProjectionConfig,
    LevelConfig,
    MatchedFilterConfig,
    NormalFieldConfig,
)
from geraf2.calibration.automatic import AUTOMATIC_VERSION
from geraf2.echoes import GlintConfig
from geraf2.errors import UserError
from geraf2.io.toml import from_table, merged, nearest, to_table
from geraf2.learned.config import CorrectedPaperConfig, PaperConfig
from geraf2.pipeline.stages.baselines import (
    BACK_PROJECTION_STAGES,
    MATCHED_FILTER_STAGES,
    NORMAL_FIELD_STAGES,
)
from geraf2.pipeline.stages.direct import GLINT_STAGES, HYBRID_STAGES
from geraf2.pipeline.stages.learned import GERAF1_STAGES, PAPER_STAGES
from geraf2.pipeline.stages.stage import Stages
from geraf2.surfaces import FitConfig
from geraf2.surfaces.config import HeatmapFitConfig
from geraf2.surfaces.hybrid import HybridConfig

FORMER_NAMES = {"glint": "fast", "hybrid": "best"}
"""Names that presets had before, which are still read."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class FastPreset:
    """Oriented points and a linear fit: seconds. Lengths in metres.

    ValueError for constants out of range.

    >>> from geraf2.surfaces import FitConfig
    >>> geraf2.FastPreset(fit=FitConfig(spacing_m=0.006)).fit.spacing_m  # voxels [m]
    0.006
    """

    preset: Literal["fast"] = "fast"
    glints: GlintConfig = field(default_factory=GlintConfig)
    """What counts as a glint."""
    fit: FitConfig = field(default_factory=FitConfig)
    """How the surface is drawn through the glints."""


@dataclass(frozen=True, kw_only=True)
class BestPreset:
    """Finer, and for scatterers and few planes: a second look, shadows, heat maps; 18 s of CPU.

    ValueError for constants out of range. Lengths in metres.

    >>> from geraf2.surfaces.config import HeatmapFitConfig
    >>> geraf2.BestPreset(heatmaps=HeatmapFitConfig(n_rounds=0)).preset  # no heat maps
    'best'
    """

    preset: Literal["best"] = "best"
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
class CorrectedPaperPreset:
    """The learned method of the paper with its level mended. Lengths in metres.

    ValueError for constants out of range.

    >>> geraf2.CorrectedPaperPreset().paper.two_way
    'unbiased'
    """

    preset: Literal["paper-corrected"] = "paper-corrected"
    paper: CorrectedPaperConfig = field(default_factory=CorrectedPaperConfig)
    """As of the preset paper; what puts the level off is set otherwise."""


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


GlintPreset, HybridPreset = FastPreset, BestPreset
"""Former names of these classes."""
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
    FastPreset: GLINT_STAGES,
    BestPreset: HYBRID_STAGES,
    PaperPreset: PAPER_STAGES,
    CorrectedPaperPreset: PAPER_STAGES,
    Geraf1Preset: GERAF1_STAGES,
    MatchedFilterPreset: MATCHED_FILTER_STAGES,
    NormalFieldPreset: NORMAL_FIELD_STAGES,
    BackProjectionPreset: BACK_PROJECTION_STAGES,
}
PRESETS: dict[str, type[PresetConfig]] = {kind().preset: kind for kind in _STAGES}
"""Config of each preset, by its name."""
STAGE_NAMES = frozenset(stage.name for stages in _STAGES.values() for stage in stages)
"""Of all presets."""


def present_name(name: str, level: int = logging.WARNING) -> str:
    """Name of a preset now, with a note in the log, at this level, where it had another before."""
    if name in FORMER_NAMES:
        _note_name(name, level)
    return FORMER_NAMES.get(name, name)


@cache
def _note_name(name: str, level: int) -> None:
    """Say once in a process what a preset is called now."""
    _log.log(level, "the preset %s is called %s now", name, FORMER_NAMES[name])


def preset_type(name: str) -> type[PresetConfig]:
    """Look up the config of a preset; a UserError suggests the name that was meant."""
    known = present_name(name)
    if known not in PRESETS:
        raise UserError(
            what=f"unknown preset {name!r}{nearest(name, [*PRESETS, *FORMER_NAMES])}",
            expected=", ".join(PRESETS),
        )
    return PRESETS[known]


def preset_of_table(table: Mapping[str, Any], where: object) -> PresetConfig:
    """Constants as config.toml holds them; UserError for what is unknown or wrong in them.

    Tables that change only some constants of a type keep the preset's others.
    """
    name = table.get("preset")
    if isinstance(name, str):
        name = present_name(name, logging.INFO)
        table = {**table, "preset": name}
        if name in PRESETS:
            table = merged(to_table(PRESETS[name]()), table)
    return from_table(table, tuple(PRESETS.values()), where, told_by="preset")


def name_in_keys(config: PresetConfig) -> str:
    """Name in keys of what is kept: the first that the preset had."""
    first = {new: old for old, new in FORMER_NAMES.items()}
    return first.get(config.preset, config.preset)


def stages_of(config: PresetConfig) -> Stages:
    """Stages of a preset, each after those that it reads."""
    return _STAGES[type(config)]


def versions_of(config: PresetConfig) -> dict[str, int]:
    """Version of each stage of a preset: what is kept of its results holds as long as these do."""
    own = {stage.name: stage.version for stage in stages_of(config)}
    return {"calibration": AUTOMATIC_VERSION, **own}
