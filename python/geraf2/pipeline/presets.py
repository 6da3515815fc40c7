"""Presets: each is one function and one typed config."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

from geraf2.baselines import (
    BASELINE_VERSION,
    BackProjectionConfig,
    LevelConfig,
    MatchedFilterConfig,
    NormalFieldConfig,
)
from geraf2.baselines.level import LEVEL_VERSION
from geraf2.calibration.driver import CALIBRATION_VERSION
from geraf2.echoes import GlintConfig
from geraf2.echoes.glints import GLINTS_VERSION
from geraf2.errors import UserError
from geraf2.freespace.silhouettes import OUTLINES_VERSION
from geraf2.io.toml import from_table, merge_tables, nearest_name, to_table
from geraf2.learned.config import TRAINING_VERSION, CorrectedPaperConfig, PaperConfig
from geraf2.pipeline.stages.baselines import (
    reconstruct_back_projection,
    reconstruct_matched_filter,
    reconstruct_normal_field,
)
from geraf2.pipeline.stages.direct import reconstruct_best, reconstruct_fast
from geraf2.pipeline.stages.job import Job
from geraf2.pipeline.stages.learned import reconstruct_geraf1, reconstruct_paper
from geraf2.surfaces import FitConfig
from geraf2.surfaces.extraction import MESH_VERSION
from geraf2.surfaces.fit import FIT_VERSION
from geraf2.surfaces.refinement import RefineConfig


@dataclass(frozen=True, kw_only=True)
class FastPreset:
    """Oriented points and a linear fit. Lengths in metres.

    Raises
    ------
    ValueError
        For constants out of range.

    Examples
    --------
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
    """More accurate, and for few planes: also shadows on the far walls.

    Lengths in metres.

    Raises
    ------
    ValueError
        For constants out of range.

    Examples
    --------
    >>> geraf2.BestPreset().refine.fit.spacing_m
    0.003
    """

    preset: Literal["best"] = "best"
    glints: GlintConfig = field(default_factory=GlintConfig)
    """Detection of glints."""
    refine: RefineConfig = field(default_factory=RefineConfig)
    """Outlines, and the fit to glints and outlines."""


@dataclass(frozen=True, kw_only=True)
class PaperPreset:
    """The learned method of the paper. Lengths in metres.

    Raises
    ------
    ValueError
        For constants out of range.

    Examples
    --------
    >>> geraf2.PaperPreset().preset
    'paper'
    """

    preset: Literal["paper"] = "paper"
    paper: PaperConfig = field(default_factory=PaperConfig)
    """Fields, rays, losses, stages."""


@dataclass(frozen=True, kw_only=True)
class CorrectedPaperPreset:
    """The learned method of the paper with a corrected level. Lengths in metres.

    Raises
    ------
    ValueError
        For constants out of range.

    Examples
    --------
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


@dataclass(frozen=True)
class _Route:
    """How a preset reconstructs."""

    run: Callable[[Job], None]
    versions: dict[str, int]
    """Version of the algorithm of each step, in order; a new one may give another surface."""


_SURFACE = {"sdf": FIT_VERSION, "mesh": MESH_VERSION}
_TRAINED = {"train": TRAINING_VERSION, "mesh": MESH_VERSION}
_ROUTES: dict[type[PresetConfig], _Route] = {
    FastPreset: _Route(reconstruct_fast, {"glints": GLINTS_VERSION, **_SURFACE}),
    BestPreset: _Route(
        reconstruct_best, {"glints": GLINTS_VERSION, "outlines": OUTLINES_VERSION, **_SURFACE}
    ),
    PaperPreset: _Route(reconstruct_paper, _TRAINED),
    CorrectedPaperPreset: _Route(reconstruct_paper, _TRAINED),
    Geraf1Preset: _Route(reconstruct_geraf1, _TRAINED),
    MatchedFilterPreset: _Route(
        reconstruct_matched_filter, {"baseline": BASELINE_VERSION, "mesh": MESH_VERSION}
    ),
    NormalFieldPreset: _Route(
        reconstruct_normal_field, {"mesh": 100 * BASELINE_VERSION + LEVEL_VERSION}
    ),
    BackProjectionPreset: _Route(reconstruct_back_projection, {"mesh": BASELINE_VERSION}),
}
PRESETS: dict[str, type[PresetConfig]] = {kind().preset: kind for kind in _ROUTES}
"""Config type of each preset, by name."""


def preset_type(name: str) -> type[PresetConfig]:
    """Config type of a preset; the UserError of an unknown one suggests a name."""
    if name not in PRESETS:
        raise UserError(
            what=f"unknown preset {name!r}{nearest_name(name, PRESETS)}",
            expected=", ".join(PRESETS),
        )
    return PRESETS[name]


def preset_of_table(table: Mapping[str, Any], where: object) -> PresetConfig:
    """Parse the constants of config.toml; UserError for unknown or wrong ones.

    Tables that change only some constants keep the preset's other values.
    """
    name = table.get("preset")
    if isinstance(name, str) and name in PRESETS:
        table = merge_tables(to_table(PRESETS[name]()), table)
    return from_table(table, tuple(PRESETS.values()), where)


def run_preset(job: Job) -> None:
    """Reconstruct with the preset of a job's config, and write the results."""
    _ROUTES[type(job.config)].run(job)


def step_names(config: PresetConfig) -> tuple[str, ...]:
    """Names of the steps of a preset, in order."""
    return tuple(_ROUTES[type(config)].versions)


def is_trained(config: PresetConfig) -> bool:
    """Whether a preset trains networks or grids, and can be resumed."""
    return hasattr(config, "paper")


def versions_of(config: PresetConfig) -> dict[str, int]:
    """Version of each step of a preset; stored results are valid for these versions."""
    return {"calibration": CALIBRATION_VERSION, **_ROUTES[type(config)].versions}
